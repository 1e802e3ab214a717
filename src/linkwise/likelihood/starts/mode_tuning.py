"""Frequencies and damping of modes, and equivalent springs and dampers of links, as a filter predicts the samples best."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import scipy

from linkwise.arrays import Floats
from linkwise.likelihood.starts.kalman import innovations, log_likelihood
from linkwise.likelihood.starts.linear_part import LinearPart, inputs_of, samples_of
from linkwise.model.structure import Structure
from linkwise.records.record import Record

_TRIED = 2000  # samples that decide how fast the forces of links change
_TUNED = 4000  # samples that the frequencies of modes are tuned to
_ROUGH = 0.05  # relative size of a change of a frequency or damping without a prior
_DIFFERENCE, _STEPS = 1e-3, 12  # of the search for them
_CHANGES = 10.0 ** np.arange(
    -4.0, 3.0
)  # of a force over a sample, relative to its size: tried one after the other
_STIFF = 0.1  # such a change, at which springs and dampers of open links are found first
_SPRINGS = 10.0 ** np.arange(0.0, 6.5, 0.5)  # sizes of springs that are tried before, in those of the motion
_RATIO = 0.1  # of the critical damping of the masses at their ends: dampers beside these springs
_ROUNDS, _GAIN = 4, 1.0  # of that search, and what the log likelihood rises by where another round may gain


def likeliest_change(record: Record, linear: LinearPart, sigma: Mapping[str, float]) -> tuple[float, float]:
    """The log likelihood, and by how much the forces of open links then change in a sample, relative to their size."""
    first = slice(None, min(_TRIED, len(record)))
    samples, inputs = samples_of(record, linear)[first], inputs_of(record)[first]
    return max(
        (log_likelihood(linear.model(record, sigma, change), samples, inputs), float(change))
        for change in _CHANGES
    )


def tuned_modes(record: Record, structure: Structure, sigma: Mapping[str, float]) -> dict[str, float]:
    """Frequencies and damping of modes that are unknown, from what a filter with random forces of links predicts.

    Parameters
    ----------
    record : Record
        The record.
    structure : Structure
        The structure; frequencies and damping of modes have numbers or starts.
    sigma : mapping of str to float
        Standard deviations of the noise by channel, in SI units.

    Returns
    -------
    dict of str to float
        Values by name of the parameter; empty where all modes are known.
    """
    linear = LinearPart.of(structure)
    return _tuned(record, structure, sigma, linear, likeliest_change(record, linear, sigma)[1])[0]


def tuned_part(
    record: Record, structure: Structure, sigma: Mapping[str, float]
) -> tuple[dict[str, float], LinearPart]:
    """Values of unknown modes as `tuned_modes`, and the linear system with springs and dampers for the open links.

    These explain most of the forces of links, so that errors of modes are not taken for forces.
    """
    values: dict[str, float] = {}
    linear = _stiffened(record, LinearPart.of(structure), sigma)
    units, change, best = linear.equivalent_units(record), _STIFF, -np.inf
    units = np.maximum(units, _ROUGH * np.abs(linear.equivalent))
    for _ in range(_ROUNDS):
        tuned, part = _tuned(record, with_starts(structure, values), sigma, linear, change, units)
        likelihood, change = likeliest_change(record, part, sigma)
        if likelihood < best + _GAIN:
            break
        values, linear, best = tuned, part, likelihood
    return values, linear


def _tuned(
    record: Record,
    structure: Structure,
    sigma: Mapping[str, float],
    linear: LinearPart,
    change: float,
    units: Floats | None = None,
) -> tuple[dict[str, float], LinearPart]:
    """Values of unknown modes, and the linear system with these, and with equivalents found where they have `units`."""
    free = [p for p in structure.parameters if p.name.owner in structure.mass_names and not p.name.is_shape]
    if not free and units is None:
        return {}, linear
    start = np.array([float(p.start or 0.0) for p in free])
    unit = np.array(
        [min(p.sigma, _ROUGH * abs(value) or _ROUGH) for p, value in zip(free, start, strict=True)]
    )
    stated = np.array([p.sigma < np.inf for p in free], dtype=bool)
    first = slice(None, min(_TUNED, len(record)))
    samples, inputs = samples_of(record, linear)[first], inputs_of(record)[first]

    untuned = LinearPart.of(structure, linear.equivalent)

    def moved_values(moved: Floats) -> tuple[dict[str, float], Floats]:
        values: dict[str, float] = dict(
            zip((p.name for p in free), map(float, start + unit * moved[: len(free)]), strict=True)
        )
        equivalent = linear.equivalent
        if units is not None:
            equivalent = equivalent + units * moved[len(free) :].reshape(equivalent.shape)
        return values, equivalent

    def residual(moved: Floats) -> Floats:
        model = untuned.with_values(*moved_values(moved)).model(record, sigma, change)
        return np.append(innovations(model, samples, inputs).ravel(), moved[: len(free)][stated])

    count = len(free) + (0 if units is None else units.size)
    lower, upper = np.full(count, -np.inf), np.full(count, np.inf)
    for bound, side in ((lower, "lower"), (upper, "upper")):
        bound[: len(free)] = [
            (getattr(p, side) - value) / size for p, value, size in zip(free, start, unit, strict=True)
        ]
    if units is not None:
        limits = np.array([linear.bounds(number, record.rate) for number in range(len(units))])
        moves = (limits - linear.equivalent[..., None]) / units[..., None]
        lower[len(free) :], upper[len(free) :] = moves[..., 0].ravel(), moves[..., 1].ravel()
    lower, upper = (
        np.minimum(lower, 0.0),
        np.maximum(upper, 0.0),
    )  # which rounding of a start at its bound exceeds
    optimum = scipy.optimize.least_squares(
        lambda shifted: residual(shifted - 1.0),  # from 1, of which a difference is a part
        np.ones(count),
        bounds=(lower + 1.0, upper + 1.0),
        diff_step=_DIFFERENCE,
        max_nfev=_STEPS,
    )
    values, equivalent = moved_values(np.asarray(optimum.x) - 1.0)
    return values, LinearPart.of(with_starts(structure, values), equivalent)


def _stiffened(record: Record, linear: LinearPart, sigma: Mapping[str, float]) -> LinearPart:
    """The linear system with a spring and a damper of the likeliest size in each open link, one after the other."""
    first = slice(None, min(_TRIED, len(record)))
    samples, inputs = samples_of(record, linear)[first], inputs_of(record)[first]

    def likelihood(part: LinearPart) -> float:
        return log_likelihood(part.model(record, sigma, _STIFF), samples, inputs)

    best = likelihood(linear)
    for number, unit in enumerate(linear.equivalent_units(record)[:, 0]):
        (_, most), _ = linear.bounds(number, record.rate)
        for spring in unit * _SPRINGS[unit * _SPRINGS < most]:
            equivalent = linear.equivalent.copy()
            equivalent[number] = spring, _RATIO * np.sqrt(spring * linear.mass(number))
            trial = LinearPart.of(linear.structure, equivalent)
            rise = likelihood(trial) - best
            if rise > _GAIN:
                linear, best = trial, best + rise
    return linear


def with_starts(structure: Structure, values: Mapping[str, float]) -> Structure:
    """A structure with other starts of unknown coefficients."""
    links = []
    for link in structure.links:
        own = {
            name: replace(coefficient, value=values[f"{link.name}.{name}"])
            for name, coefficient in link.coefficients.items()
            if f"{link.name}.{name}" in values
        }
        links.append(replace(link, coefficients={**link.coefficients, **own}) if own else link)
    return replace(structure, links=tuple(links))
