"""How well models predict pieces of the records that they were not fitted to.

Each block of the records has a parabola of its own about the fit. A model is fitted to all blocks but one, by the sum of their
parabolas, and pays what that of the block left out says. What it pays more than the selected model, in all blocks together,
is its `excess`; blocks that disagree give it a scatter (cross-validation over blocks; Geisser, J. Am. Stat. Assoc. 70, 1975).
States follow the unknowns as the whole record determines. What is known beforehand of the unknowns belongs to no block: every
fit has the whole of it, and pays an equal part of what it says with each block.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from linkwise.arrays import Floats
from linkwise.discovery.selection import Selection
from linkwise.likelihood.search import FEWEST
from linkwise.likelihood.shooting.normal_equations import add_prior
from linkwise.likelihood.tests.score_test import candidate_forces
from linkwise.runtime import one_blas_thread

_BLOCKS = 10  # long enough for what residuals remember


class Excess(NamedTuple):
    """What a model pays more than another one in -2 log likelihood of the blocks left out, and the `scatter` of that."""

    excess: float
    scatter: float


@dataclass(frozen=True, eq=False)
class BlockParabolas:
    """Slopes (B, u) and curvatures (B, u, u) of blocks in u scaled unknowns about a fit, where these have `values` (u,).

    The first of them belong to coefficients, in the places that `numbers` gives, and the first `selected` to those of the fit;
    the others are errors of sensors, which every model finds. `prior` is the slope (u,) and the curvature (u, u) of what is
    known beforehand, which are in no block.
    """

    slopes: Floats
    curvatures: Floats
    values: Floats
    numbers: dict[int, int]
    selected: int
    prior: tuple[Floats, Floats] | None = None

    def prediction(self, chosen: Collection[int], than: Collection[int] | None = None) -> Excess:
        """That of the model with the coefficients `chosen`, by number; NaN where it is not determined without a block.

        Over the selected model, or over that with the coefficients `than`.
        """
        try:
            excess = self._paid(chosen) - self._paid(range(self.selected) if than is None else than)
        except np.linalg.LinAlgError:
            return Excess(np.nan, np.nan)
        scatter = np.sqrt(len(excess)) * np.std(excess, ddof=1)
        return Excess(float(excess.sum()), float(scatter))

    def _paid(self, chosen: Collection[int]) -> Floats:
        """(B,) what the model pays for each block, fitted to the others."""
        places = {self.numbers[k] for k in chosen}
        free = np.flatnonzero([k in places or k >= len(self.numbers) for k in range(len(self.values))])
        move = -self.values
        move[free] = 0.0
        whole, slope = self.curvatures.sum(axis=0), self.slopes.sum(axis=0)
        known_slope, known = self.prior or (0.0 * slope, 0.0 * whole)
        slope, whole = slope + known_slope, whole + known
        paid = np.empty(len(self.slopes))
        for block, (own_slope, own) in enumerate(zip(self.slopes, self.curvatures, strict=True)):
            others = whole - own
            pull = slope - own_slope - others @ move
            moved = move.copy()
            moved[free] = np.linalg.solve(others[np.ix_(free, free)], pull[free])
            own_slope, own = own_slope + known_slope / len(paid), own + known / len(paid)
            paid[block] = moved @ own @ moved - 2.0 * own_slope @ moved
        return paid


def block_parabolas(selection: Selection, added: Sequence[int] = ()) -> BlockParabolas | None:
    """Those of the blocks of the records, in the parameters of a selection and the terms `added`, by number.

    None where the records are too short for blocks, or random forces act.
    """
    optimum = selection.fit.optimum
    segments, scales, p = optimum.segments, optimum.scales, len(selection.inside)
    if segments.count < FEWEST * _BLOCKS or selection.fit.random_forces:
        return None
    forces = selection.candidates.forces([selection.entries[k] for k in added], selection.structure)
    with one_blas_thread(), np.errstate(over="ignore", invalid="ignore"):  # a term may be infinite somewhere
        tested, _ = candidate_forces(segments, optimum.misfit, forces)
        scores = optimum.block_scores(_BLOCKS, tested)
    if scores is None:
        return None
    values = np.zeros(scores.scores.shape[1])
    values[:p] = optimum.point.theta / scales.theta[:p]
    scale = optimum.noise**2 * selection.quadratic.overdispersion
    numbers = {k: place for place, k in enumerate((*range(p), *added))}
    slope, curvature = np.zeros_like(scores.scores[0]), np.zeros_like(scores.information[0])
    add_prior(curvature, slope, optimum.misfit)
    slopes, curvatures = (
        np.concatenate([[parts[0] - known], parts[1:]])  # the first block has what is known beforehand
        for parts, known in ((scores.scores, slope), (scores.information, curvature))
    )
    prior = slope / scale, curvature / scale
    return BlockParabolas(slopes / scale, curvatures / scale, values, numbers, p, prior)
