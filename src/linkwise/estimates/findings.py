"""Findings on identified laws, in sentences: what the record does not determine (METHODS section 7), and which links supply
energy to the motion by more than their uncertainty, which no spring or damper does.

Verdicts say whether an answer can be trusted (`linkwise.verdict`); findings are told beside them, and change no grade.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from linkwise.arrays import Bools, Floats
from linkwise.estimates.link_estimate import NORMAL_95, CoefficientEstimate, LinkEstimate
from linkwise.model.link import Link
from linkwise.model.named_laws import named_law_of
from linkwise.model.parameters import Parameter
from linkwise.model.structure import Structure

_SIGNIFICANT = 3.0  # standard errors of the mean power: by chance once in 740 links that dissipate nothing
_ROUNDING = 1e-12  # of the largest power
# that a law supplies energy: less is at the ends of a motion, where a sum of terms bends away
_OF_THE_TIME = 0.01


def supplied_power(link: Link, free: Sequence[str], covariance: Floats, d: Floats, v: Floats) -> float | None:
    """Mean power in W that a link supplies to the motion `d` in m and `v` in m/s (R,); None unless it is above three
    standard errors, by the `covariance` (q, q) of its `free` coefficients.
    """
    powers, slopes_in_time = _dissipated(link, free, d, v)
    if not powers.size:
        return None
    power, slopes = float(np.mean(powers)), np.mean(slopes_in_time, axis=1)
    deviation = float(np.sqrt(max(float(slopes @ covariance @ slopes), 0.0)))
    return -power if deviation > 0.0 and power < -_SIGNIFICANT * deviation else None


def _dissipated(link: Link, free: Sequence[str], d: Floats, v: Floats) -> tuple[Floats, Floats]:
    """The power (R,) that a link dissipates, and its derivatives (q, R) by the `free` coefficients."""
    moving, resting = (link.law.partials(d, rate, link.values) for rate in (v, np.zeros_like(v)))
    power = np.broadcast_to((moving.force - resting.force) * v, v.shape)
    differences = (moving.by_coefficient[name] - resting.by_coefficient[name] for name in free)
    slopes = [np.broadcast_to(difference * v, v.shape) for difference in differences]
    finite = np.isfinite(power) & np.isfinite(slopes).all(axis=0)
    return power[finite], np.array(slopes)[:, finite]


_COLLINEAR = 0.995  # correlation from which only a combination of two coefficients is reported as determined


def bound_findings(parameters: Sequence[Parameter], free: Bools, structure: Structure) -> Iterator[str]:
    """Sentences on the unknowns that their bounds stopped, where `free` (p,) is False, with the named law that has no such
    bound where there is one.
    """
    for number in np.flatnonzero(~free).tolist():
        parameter, advice = parameters[number], "widen the bound if it is not physical"
        for law in (named_law_of(structure.links[index].law) for index, _ in parameter.members if index >= 0):
            if law is not None and law.wider:
                advice = f'the law "{law.wider}" has no such bound, and takes loops that this one cannot have'
        yield f"{parameter.name} was stopped by its bound and has no interval; {advice}."


def link_findings(link: LinkEstimate, supply: float | None) -> Iterator[str]:
    """Sentences on one identified link, which supplies a significant mean power in W to the motion, or None."""
    yield from (*_extrapolated(link), *_correlated(link), *_insignificant(link))
    if supply is not None:
        yield (
            f"{link.link.name} feeds energy into the motion, {supply:.3g} W on average, which no damper does. An applied "
            "force that is not in the record can have this effect."
        )


def energy_findings(link: LinkEstimate, d: Floats, v: Floats) -> Iterator[str]:
    """Sentences on a link that supplies energy during a part of its motion `d` in m and `v` in m/s (R,), by more than its
    intervals: one for each coefficient that is negative there, or one for the link.
    """
    feeds = "it would feed energy"  # of memory or signals, whose energy the motion alone does not tell
    if link.link.law.is_plain:
        if link.covariance is None or not link.free:
            return
        power, slopes = _dissipated(link.link, link.free, d, v)
        deviation = link.deviation(slopes)
        part = float(np.mean((deviation > 0.0) & (power < -NORMAL_95 * deviation)))
        if not part > _OF_THE_TIME:
            return
        feeds = f"{link.link.name} feeds energy for {100.0 * part:.2g} % of the time"
    feeds += " into the motion, which no damper or friction does. A missing term, link or applied force can have this effect."
    negative = tuple(_active_coefficients(link, d, v))
    for coefficient in negative:
        yield f"{coefficient.name} is negative, {coefficient.value:.3g} {coefficient.unit}: {feeds}"
    if not negative and link.link.law.is_plain:
        yield feeds


def _active_coefficients(link: LinkEstimate, d: Floats, v: Floats) -> Iterator[CoefficientEstimate]:
    """Coefficients that are negative by more than their interval and whose force alone would then supply energy at all
    times, at elongations `d` in m and rates `v` in m/s (R,). Such are those of dampers and friction: a positive one
    opposes the motion everywhere.
    """
    law, values = link.link.law, {**link.link.values, **link.link.zero_states}
    moving, resting = (law.partials(d, rate, values).by_coefficient for rate in (v, np.zeros_like(v)))
    for coefficient in link.coefficients:
        name = coefficient.name.key
        if coefficient.interval is None or coefficient.interval[1] >= 0.0 or name in law.nonlinear:
            continue
        power = np.nan_to_num((moving[name] - resting[name]) * v)
        if np.all(power >= -_ROUNDING * np.max(np.abs(power))) and power.any():
            yield coefficient


def _extrapolated(link: LinkEstimate) -> Iterator[str]:
    if not link.wells or not link.free:
        return
    (low, high), unit = link.d_range, link.link.law.motion_units[0]
    name, visited = link.link.name, f"(d from {low:.4g} to {high:.4g} {unit})"
    positions = [well.value for well in link.wells]
    inside = [position for position in positions if low <= position <= high]
    if len(inside) == 1:
        yield (
            f"{name} never left the well at {inside[0]:+.4g} {unit} {visited}: its barrier and its other wells are "
            "extrapolated. Use a stronger excitation."
        )
    elif not inside:
        yield (
            f"{name} reached none of its wells {visited}: they are extrapolated. Record until it comes to rest, or start it "
            "from a well."
        )
    elif missed := ", ".join(f"{position:+.4g} {unit}" for position in positions if position not in inside):
        yield f"{name} never reached the well at {missed} {visited}, which is extrapolated."


def _correlated(link: LinkEstimate) -> Iterator[str]:
    if link.covariance is None:
        return
    scale = np.sqrt(np.maximum(link.covariance.diagonal(), np.finfo(float).tiny))
    correlation = link.covariance / np.outer(scale, scale)
    for i, j in np.argwhere(np.tril(np.abs(correlation) > _COLLINEAR, -1)).tolist():
        yield (
            f"{link.link.name}: {link.free[j]} and {link.free[i]} are strongly correlated ({correlation[i, j]:+.4f}); the "
            "record determines a combination of them far better than each. A wider range of motion "
            "separates them."
        )


def _insignificant(link: LinkEstimate) -> Iterator[str]:
    for coefficient in link.coefficients:
        if coefficient.interval is not None and coefficient.interval[0] < 0.0 < coefficient.interval[1]:
            error = coefficient.standard_error or 0.0
            yield (
                f"{coefficient.name} cannot be distinguished from zero: {coefficient.value:.3g} within ±{error:.2g} "
                f"{coefficient.unit}."
            )
