"""Links that supply energy to the motion by more than their uncertainty, which no spring or damper does.

The force at v = 0 is left out of their power, since a spring returns the energy it stores.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from linkwise.arrays import Floats
from linkwise.estimates.link_estimate import NORMAL_95, CoefficientEstimate, LinkEstimate
from linkwise.model.structure import Link

_SIGNIFICANT = 3.0  # standard errors of the mean power: by chance once in 740 links that dissipate nothing
_ROUNDING = 1e-12  # of the largest power
# that a law supplies energy: less is at the ends of a motion, where a sum of terms bends away
_OF_THE_TIME = 0.01


def active_coefficients(link: LinkEstimate, d: Floats, v: Floats) -> Iterator[CoefficientEstimate]:
    """Coefficients that are negative by more than their interval and whose force alone would then supply energy at all times.

    Such are those of dampers and friction: a positive one opposes the motion everywhere.

    Parameters
    ----------
    link : LinkEstimate
        The link.
    d, v : array of shape (R,)
        Elongations in m and rates in m/s.

    Yields
    ------
    CoefficientEstimate
        The coefficient.
    """
    law, values = link.link.law, {**link.link.values, **link.link.zero_states}
    moving, resting = (law.partials(d, rate, values).by_coefficient for rate in (v, np.zeros_like(v)))
    for coefficient in link.coefficients:
        name = coefficient.name.rpartition(".")[2]
        if coefficient.interval is None or coefficient.interval[1] >= 0.0 or name in law.nonlinear:
            continue
        power = np.nan_to_num((moving[name] - resting[name]) * v)
        if np.all(power >= -_ROUNDING * np.max(np.abs(power))) and power.any():
            yield coefficient


def supplying_time(link: LinkEstimate, d: Floats, v: Floats) -> float:
    """Part of the time that a link as a whole supplies energy to the motion, by more than its intervals.

    Parameters
    ----------
    link : LinkEstimate
        The link.
    d, v : array of shape (R,)
        Elongations in m and rates in m/s.

    Returns
    -------
    float
        From 0 to 1; 0 without intervals, with memory, and where it is less than a hundredth of the time.
    """
    if link.covariance is None or not link.free or link.link.law.states:
        return 0.0
    power, slopes = _dissipated(link.link, link.free, d, v)
    deviation = np.sqrt(np.maximum(np.einsum("ir,ij,jr->r", slopes, link.covariance, slopes), 0.0))
    part = float(np.mean((deviation > 0.0) & (power < -NORMAL_95 * deviation)))
    return part if part > _OF_THE_TIME else 0.0


def supplied_power(link: Link, free: Sequence[str], covariance: Floats, d: Floats, v: Floats) -> float | None:
    """Mean power that a link supplies to the motion, where that is significant.

    Parameters
    ----------
    link : Link
        The link, all coefficients numbers.
    free : sequence of str
        Names of its q unknown coefficients.
    covariance : array of shape (q, q)
        Their covariance.
    d, v : array of shape (R,)
        Elongations in m and rates in m/s.

    Returns
    -------
    float or None
        Mean power in W; None unless it is above three standard errors.
    """
    powers, slopes_in_time = _dissipated(link, free, d, v)
    power, slopes = float(np.mean(powers)), np.mean(slopes_in_time, axis=1)
    deviation = float(np.sqrt(max(float(slopes @ covariance @ slopes), 0.0)))
    return -power if deviation > 0.0 and power < -_SIGNIFICANT * deviation else None


def _dissipated(link: Link, free: Sequence[str], d: Floats, v: Floats) -> tuple[Floats, Floats]:
    """The power (R,) that a link dissipates, and its derivatives (q, R) by the `free` coefficients."""
    moving, resting = (link.law.partials(d, rate, link.values) for rate in (v, np.zeros_like(v)))
    power = np.broadcast_to((moving.force - resting.force) * v, v.shape)
    slopes = [
        np.broadcast_to((moving.by_coefficient[name] - resting.by_coefficient[name]) * v, v.shape)
        for name in free
    ]
    finite = np.isfinite(power) & np.isfinite(slopes).all(axis=0)
    return power[finite], np.array(slopes)[:, finite]
