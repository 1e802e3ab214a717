"""How the links moved, as an estimator saw it: elongations, rates, and the force that accelerations alone tell."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from linkwise.structure import Structure

Floats = NDArray[np.float64]

_DENSE = 64  # masses up to which all link forces are solved for together
_DETERMINED = 1e-9  # smallest singular value of the incidence, relative, that still tells forces apart


@dataclass(frozen=True, eq=False)
class LinkMotion:
    """`time` (R,) s, elongations `d` (R, L) m and rates `v` (R, L) m/s of the links of `structure`, identified.

    `acceleration` (R, n) m/s^2 is NaN for masses that were not seen; `push` (R, n) N the applied forces, or None.
    """

    structure: Structure
    time: Floats
    d: Floats
    v: Floats
    acceleration: Floats
    push: Floats | None

    @cached_property
    def force(self) -> Floats | None:
        """(R, L) force of every link in N from B f = w - M a, no law assumed; NaN where masses cannot tell it.

        None where they tell no link's: links that close circles, or masses without a sensor.
        """
        masses = self.structure.mass_values
        right = (0.0 if self.push is None else self.push) - self.acceleration * masses
        incidence = self.structure.incidence
        force = np.full(self.d.shape, np.nan)
        if len(masses) <= _DENSE and not np.isnan(right).any():
            dense = incidence.toarray()
            singular = np.linalg.svd(dense, compute_uv=False)
            if dense.shape[1] <= dense.shape[0] and singular[-1] > _DETERMINED * singular[0]:
                return np.asarray(np.linalg.lstsq(dense, right.T)[0].T)
        rows = incidence.tocsr()
        for mass in np.flatnonzero(np.diff(rows.indptr) == 1):
            place = rows.indptr[mass]
            force[:, rows.indices[place]] = rows.data[place] * right[:, mass]
        return None if np.isnan(force).all() else force
