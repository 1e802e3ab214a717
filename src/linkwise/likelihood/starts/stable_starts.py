"""Starts of linear links with which a structure is stable: noise gives springs and dampers of either sign, and of any size."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.starts.linear_part import LinearPart, is_linear
from linkwise.model.link import Link


def stable_starts(
    linear: LinearPart, starts: Mapping[str, float], stated: Mapping[str, float], rate: float
) -> dict[str, float]:
    """Starting values with those of linear links moved to where the motion neither grows nor is too fast to be followed.

    Parameters
    ----------
    linear : LinearPart
        The linear system of the structure, with numbers for its modes.
    starts : mapping of str to float
        Starting values by name of the parameter.
    stated : mapping of str to float
        Starts that count as they are.
    rate : float
        Samples per second.

    Returns
    -------
    dict of str to float
        The starting values.
    """
    values = dict(starts)
    for number, index in enumerate(linear.open):
        link = linear.structure.links[index]
        own = {
            name: coefficient.value
            for name, coefficient in link.coefficients.items()
            if coefficient.value is not None
        }
        own |= {name: values[key] for name in link.coefficients if (key := f"{link.name}.{name}") in values}
        free = [name for name in link.law.linear if f"{link.name}.{name}" in values.keys() - stated.keys()]
        if not free or own.keys() != link.coefficients.keys() or not is_linear(link.law):
            continue
        slopes = _slopes(link, own)
        missing = np.clip(slopes, *np.transpose(linear.bounds(number, rate))) - slopes
        if not missing.any():
            continue
        columns = [_slopes(link, own | {name: 2.0 * own[name] or 1.0}) - slopes for name in free]
        change = np.linalg.lstsq(np.stack(columns, axis=1), missing, rcond=None)[0]
        for name, part in zip(free, change, strict=True):
            values[f"{link.name}.{name}"] += float(part) * (own[name] or 1.0)
    return values


def _slopes(link: Link, values: Mapping[str, float]) -> Floats:
    """Stiffness in N/m and damping in N s/m of a linear link."""
    partials = link.law.partials(0.0, 0.0, dict(values))
    return np.array([float(partials.by_d), float(partials.by_v)])
