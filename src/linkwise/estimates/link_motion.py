"""How the links moved, as an estimator saw it: elongations, rates, and the force that was measured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from linkwise.arrays import Floats
from linkwise.deprecation import Deprecated, DeprecatedAttribute
from linkwise.model.structure import Structure

_DENSE = 64  # masses up to which all link forces are solved for together
_DETERMINED = 1e-9  # smallest singular value of the incidence, relative, that still tells forces apart


@dataclass(frozen=True, eq=False)
class LinkMotion:
    """`time` (R,) s, elongations `d` (R, L) m and rates `v` (R, L) m/s of the links of `structure`, identified.

    `d_range` (L, 2) m is the range of every elongation; it may be wider than that of a smoothed `d`.

    `compute_residual` gives, when asked, what the identified laws leave of the equation of motion of every mass, m a + B f
    - w, (R, n) in N; NaN where it is not seen, None where no mass is.
    """

    structure: Structure
    time: Floats
    d: Floats
    v: Floats
    d_range: Floats
    compute_residual: Callable[[], Floats | None]

    visited = DeprecatedAttribute(Deprecated("d_range", since="0.2.0", until="0.4.0"))
    leave = DeprecatedAttribute(Deprecated("compute_residual", since="0.2.0", until="0.4.0"))

    @cached_property
    def force(self) -> Floats | None:
        """(R, L) measured force of every link in N: the identified one and its share of the residuals.

        What is seen of a force is smoothed; the residual is that of smoothed equations, so their sum is not bent by it. NaN
        where masses do not tell a force, None where they tell none: links that close circles, masses without a sensor.
        """
        residual = self.compute_residual()
        if residual is None:
            return None
        incidence = self.structure.incidence
        share = np.full(self.d.shape, np.nan)
        if (
            self.structure.size <= _DENSE
            and not np.isnan(residual).any()
            and _told_apart(incidence.toarray())
        ):
            share = np.linalg.lstsq(incidence.toarray(), residual.T)[0].T
        else:
            rows = incidence.tocsr()
            for mass in np.flatnonzero(np.diff(rows.indptr) == 1):
                place = rows.indptr[mass]
                share[:, rows.indices[place]] = rows.data[place] * residual[:, mass]
        if np.isnan(share).all():
            return None
        links = self.structure.links
        identified = [link.force(self.d[:, i], self.v[:, i]) for i, link in enumerate(links)]
        return np.asarray(np.stack(identified, axis=1) - share)


def extremes(d: Floats, deviation: Floats | float = 0.0) -> Floats:
    """(L, 2) smallest and largest of elongations (N, L), less two deviations (L,) of the noise that stretches them."""
    low, high = np.nanmin(d, axis=0), np.nanmax(d, axis=0)
    inward = np.minimum(2.0 * np.asarray(deviation), 0.5 * (high - low))
    return np.stack([low + inward, high - inward], axis=1)


def _told_apart(incidence: Floats) -> bool:
    """Whether forces of the links follow from forces on the masses."""
    singular = np.linalg.svd(incidence, compute_uv=False)
    return bool(incidence.shape[1] <= incidence.shape[0] and singular[-1] > _DETERMINED * singular[0])
