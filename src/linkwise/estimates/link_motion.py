"""Motion of links as measured or estimated: elongations, rates and forces."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from linkwise.arrays import Floats
from linkwise.deprecation import Deprecated, DeprecatedAttribute
from linkwise.model.structure import Structure

_DENSE = 64  # masses up to which all link forces are solved for at once
_DETERMINED = 1e-9  # relative singular value of the incidence below which link forces are not determined


@dataclass(frozen=True, eq=False)
class LinkMotion:
    """Motion of the L links of an identified structure at R times.

    Attributes
    ----------
    structure : Structure
        The identified structure.
    time : array of shape (R,)
        Times in s.
    d, v : array of shape (R, L)
        Elongations in m and rates in m/s.
    d_range : array of shape (L, 2)
        Smallest and largest elongation in m; may be wider than the range of a smoothed `d`.
    compute_residual : callable
        Computes the residuals M a + B f - w of the masses, shape (R, n), in N: NaN where not measured, None for no mass.
    identified_force : array of shape (R, L), optional
        Forces of the identified links in N, with the states of those with memory; None where they are not known.
    measured_force : array of shape (R, L), optional
        Forces in N that load cells showed, less their offsets; NaN for links without.
    residuals : mapping of str to array of shape (R,), optional
        What the fit leaves of each response, in standard deviations of its noise; NaN where a sample is missing. None by
        methods that do not fit the samples.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=6.0, rate=1000.0).with_noise(30.0, seed=1)
    >>> estimate = lw.identify(record, chain.unknown("nes"), method="weak")
    >>> motion = estimate.motion
    >>> motion.d.shape == motion.v.shape
    True
    """

    structure: Structure
    time: Floats
    d: Floats
    v: Floats
    d_range: Floats
    compute_residual: Callable[[], Floats | None]
    identified_force: Floats | None = None
    measured_force: Floats | None = None
    residuals: Mapping[str, Floats] | None = None

    visited = DeprecatedAttribute(Deprecated("d_range", since="0.2.0", until="0.4.0"))
    leave = DeprecatedAttribute(Deprecated("compute_residual", since="0.2.0", until="0.4.0"))

    @cached_property
    def force(self) -> Floats | None:
        """(R, L) measured forces of the links in N: the identified forces less their shares of the residuals.

        The residuals are those of smoothed equations, so smoothing does not bias the sum. NaN where the masses do not
        determine a force; None where they determine none, as with closed loops of links or masses without a sensor.
        """
        if self.measured_force is not None:
            return self.measured_force
        residual = self.compute_residual()
        if residual is None:
            return None
        incidence = self.structure.incidence
        share = np.full(self.d.shape, np.nan)
        if (
            self.structure.size <= _DENSE
            and not np.isnan(residual).any()
            and _determines_forces(incidence.toarray())
        ):
            share = np.linalg.lstsq(incidence.toarray(), residual.T)[0].T
        else:
            rows = incidence.tocsr()
            for mass in np.flatnonzero(np.diff(rows.indptr) == 1):
                entry = rows.indptr[mass]
                share[:, rows.indices[entry]] = rows.data[entry] * residual[:, mass]
        if np.isnan(share).all():
            return None
        links = self.structure.links
        identified = [link.force(self.d[:, i], self.v[:, i]) for i, link in enumerate(links)]
        return np.asarray(np.stack(identified, axis=1) - share)


def extremes(d: Floats, deviation: Floats | float = 0.0) -> Floats:
    """Ranges of elongations, corrected for noise.

    Parameters
    ----------
    d : array of shape (N, L)
        Elongations in m.
    deviation : array of shape (L,) or float, optional
        Standard deviations of their noise; the range is narrowed by two of them at both ends.

    Returns
    -------
    array of shape (L, 2)
        Smallest and largest elongation in m.
    """
    low, high = np.nanmin(d, axis=0), np.nanmax(d, axis=0)
    inward = np.minimum(2.0 * np.asarray(deviation), 0.5 * (high - low))
    return np.stack([low + inward, high - inward], axis=1)


def _determines_forces(incidence: Floats) -> bool:
    """Whether the forces of the links follow from those on the masses."""
    singular = np.linalg.svd(incidence, compute_uv=False)
    return bool(incidence.shape[1] <= incidence.shape[0] and singular[-1] > _DETERMINED * singular[0])
