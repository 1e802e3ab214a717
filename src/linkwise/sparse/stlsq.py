"""Sequentially thresholded least squares (Brunton et al. 2016; step 6 of the paper's section 3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from linkwise.errors import IdentificationError
from linkwise.sparse.gram import Array, Gram
from linkwise.sparse.regressor import Candidate, Regressor
from linkwise.sparse.selection import best, candidate

_STEPS = np.geomspace(1e-10, 0.5, 59)  # thresholds of the path, a factor 1.47 apart
_PASSES = 50  # supports only shrink; a loop this long means nothing is left to drop one by one


@final
@dataclass(frozen=True)
class Stlsq(Regressor):
    """Fit, drop every term whose contribution ||c_j A_j|| / ||b|| is below the threshold, fit again, until none drops.

    The threshold is a share of the equation's right-hand side, so it means the same in every unit. With `threshold`
    None it rises from 1e-10 to 0.5, each step going on from the support of the one before, and the support of smallest
    BIC is taken; the whole path stands in the fit. Raises IdentificationError for a threshold outside [0, 1).
    """

    threshold: float | None = None

    def __post_init__(self) -> None:
        if self.threshold is not None and not 0 <= self.threshold < 1:
            raise IdentificationError(
                f"a threshold of {self.threshold!r} was given; it is the share of an equation's right-hand side below which a "
                "term is dropped, 0 <= threshold < 1"
            )

    def solve(self, gram: Gram, target: int) -> tuple[Array, float, tuple[Candidate, ...]]:
        scaled = gram.project(gram.alive, target)[0]
        if self.threshold is not None:
            return _shrink(gram, target, scaled, self.threshold), self.threshold, ()
        path = [candidate(gram, target, scaled != 0, 0.0)]
        for step in _STEPS:
            shrunk = _shrink(gram, target, scaled, step)
            if np.count_nonzero(shrunk) < np.count_nonzero(scaled):
                path.append(candidate(gram, target, shrunk != 0, float(step)))
            scaled = shrunk
        chosen = best(path)
        return gram.project(chosen.support, target)[0], chosen.setting, tuple(path)


def _shrink(gram: Gram, target: int, scaled: Array, threshold: float) -> Array:
    """Scaled coefficients after dropping, from those of a larger support, until every term left reaches the threshold."""
    for _ in range(_PASSES):
        kept = (np.abs(scaled) >= threshold * gram.norms[target]) & (scaled != 0)
        if np.array_equal(kept, scaled != 0):
            break
        scaled = gram.project(kept, target)[0]
    return scaled
