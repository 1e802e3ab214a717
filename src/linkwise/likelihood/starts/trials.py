"""Random starting values of the sizes that units and motion imply."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from linkwise.arrays import Floats
from linkwise.model.law import unit_dimension
from linkwise.model.parameters import Parameter

_DECADES = 1.5  # above and below the size that units imply


def unit_sizes(
    parameters: Sequence[Parameter], d: Floats, v: Floats, force: float, voltage: float | None = None
) -> dict[str, float]:
    """A size for each parameter by name, from its unit.

    `d` and `v` are elongations in m and rates in m/s, `force` in N is the size of the forces, and `voltage` in V that of a
    voltage that goes with them.
    """
    length = float(np.std(d)) or 1.0
    speed = float(np.std(v)) or 1.0
    time = length / speed
    mass = force * time**2 / length
    current = 1.0 if voltage is None else force * speed / (voltage or 1.0)
    sizes: dict[str, float] = {}
    for parameter in parameters:
        unit = unit_dimension(parameter.unit if parameter.unit != "?" else "")
        powers = (unit.kilogram, unit.metre, unit.second, unit.ampere)
        bases = (mass, length, time, current)
        sizes[parameter.name] = float(np.prod([b ** float(p) for b, p in zip(bases, powers, strict=True)]))
    return sizes


def trial_values(
    parameters: Sequence[Parameter],
    given: Mapping[str, float],
    sizes: Mapping[str, float],
    rng: np.random.Generator,
    *,
    first: bool,
) -> Floats:
    """Values (q,) to start from; the `first` trial takes starts as they are given or stated."""
    values = []
    for parameter in parameters:
        start = given.get(parameter.name, parameter.start)
        low, high = parameter.lower, parameter.upper
        if start is not None:
            value = start * (1.0 if first else 10.0 ** rng.normal(0.0, 0.2))
        elif np.isfinite(low) and np.isfinite(high):
            value = low + (high - low) * rng.uniform(0.05, 0.95)
        else:
            value = sizes[parameter.name] * 10.0 ** rng.uniform(-_DECADES, _DECADES)
            value *= -1.0 if high <= 0.0 or (low < 0.0 and rng.random() < 0.3) else 1.0
        margin = 1e-9 * (abs(value) + sizes[parameter.name])
        values.append(np.clip(value, low + margin, high - margin))
    return np.array(values, dtype=float)
