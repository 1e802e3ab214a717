"""Gains of channels that the records do not tell, as of all that they show together: one factor leaves the laws alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.likelihood.shooting.anneal import AnnealingStatus

_LARGEST = 0.5  # relative standard error from which a gain is not told
_COLLINEAR = 1e5
"""Variance of a gain over that with all other unknowns known; the sensitivities, in single precision, resolve some 1e7."""


class SearchedGains(Protocol):
    """A fit: how its search ended, and the channels of the gains that it does not tell, of which nothing is known."""

    @property
    def status(self) -> AnnealingStatus: ...

    @property
    def chi_square_off(self) -> bool: ...

    @property
    def has_errors(self) -> bool: ...

    @property
    def untold(self) -> tuple[str, ...]: ...


def untold_gains(names: Sequence[str], values: Floats, covariance: Floats, first: int) -> tuple[str, ...]:
    """The gains that the others among the unknowns stand for.

    Parameters
    ----------
    names : sequence of str
        The channels of the gains.
    values : array of shape (g,)
        The gains.
    covariance : array of shape (P, P)
        Covariance of all unknowns; zero in rows of those at a bound.
    first : int
        Row of the first gain.

    Returns
    -------
    tuple of str
        Their channels.
    """
    variance = covariance.diagonal()
    gains = first + np.arange(len(names))
    positive = np.isfinite(variance) & (variance > 0.0)
    alone = np.zeros(len(variance))
    free = np.flatnonzero(positive)
    deviation = np.sqrt(variance[free])
    correlation = covariance[np.ix_(free, free)] / np.outer(deviation, deviation)
    try:
        alone[free] = np.linalg.inv(correlation).diagonal()
    except np.linalg.LinAlgError:
        alone[free] = np.inf
    determined = positive & (alone > 0.0) & (alone < _COLLINEAR)
    return tuple(
        name
        for name, value, row in zip(names, values, gains.tolist(), strict=True)
        if not (determined[row] and np.sqrt(variance[row]) < _LARGEST * abs(value))
    )


def require_told(fit: SearchedGains) -> None:
    """Raise IdentificationError where the records do not tell gains of which nothing is known beforehand.

    A search that was interrupted, or ended far from the records or without standard errors, does not say what they tell.
    """
    converged = fit.status is AnnealingStatus.CONVERGED
    explained = fit.has_errors and not fit.chi_square_off and fit.status is not AnnealingStatus.INTERRUPTED
    if fit.untold and (converged or explained):
        raise IdentificationError(
            f"the records do not tell the gain of {', '.join(fit.untold)}: another scale of forces, masses or motion explains "
            f"them as well. Leave {'it' if len(fit.untold) == 1 else 'one of them'} out, or state how well it is "
            "known, by a calibration",
            arguments=("calibration",),
        )
