"""Motion of masses that no sensor shows, from measured states of links: a voltage gives the rate of its link."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from linkwise.arrays import Floats
from linkwise.model.link import BASE, GROUND, Link
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.signals.states import integral, smoothed

_AFFINE = 1e-6  # relative difference of slopes of a rate by v up to which it counts as affine


def motion_from_states(
    record: Record, structure: Structure, sigma: Mapping[str, float], x: Floats, v: Floats
) -> tuple[int, ...]:
    """Fill displacements and velocities (n, N) of masses that are 0 so far, and give the numbers of these masses.

    Of a link whose one end moves as is known, and that has a measured state with a rate a(state) + b v, as of a piezoelectric
    transducer or a coil; displacements are integrals from 0.
    """
    names = structure.mass_names
    known_velocities = {name: row for name, row in zip(names, v, strict=True) if row.any()}
    known_velocities[GROUND] = np.zeros(len(record))
    if f"x:{BASE}" in record.channels:
        known_velocities[BASE] = np.gradient(record.channel(f"x:{BASE}"), record.step)
    filled, waiting = [], list(structure.links)
    while waiting:
        links, waiting = waiting, []
        for link in links:
            first, second = link.between
            if first not in known_velocities and second not in known_velocities:
                waiting.append(link)  # until a link of one of its ends gives it
            if (first in known_velocities) == (second in known_velocities):
                continue
            rate = _rate(link, record, sigma)
            if rate is None:
                continue
            name = second if first in known_velocities else first
            known_velocities[name] = (
                known_velocities[first] - rate
                if first in known_velocities
                else known_velocities[second] + rate
            )
            number = names.index(name)
            v[number], x[number] = known_velocities[name], integral(known_velocities[name], record.step)
            filled.append(number)
        if len(waiting) == len(links):
            break
    return tuple(filled)


def _rate(link: Link, record: Record, sigma: Mapping[str, float]) -> Floats | None:
    """The rate of a link (N,) in m/s from the first measured state that determines it; None if none does."""
    states = link.law.states
    for number, name in enumerate(states):
        channel = f"state:{link.name}.{name}"
        if channel not in record.channels:
            continue
        state, changing, _ = smoothed(record, channel, sigma[channel])
        values: dict[str, float | Floats] = {**link.values, **dict.fromkeys(states, 0.0), name: state}
        at_rest, slope = _affine(link, number, values)
        if slope is not None:
            return np.asarray((changing - at_rest) / slope)
    return None


def _affine(link: Link, number: int, values: Mapping[str, float | Floats]) -> tuple[Floats, Floats | None]:
    """The rate of a state at v = 0, and its slope by v; None for the slope where the rate depends on d or bends with v."""

    def rate(d: float, v: float) -> Floats:
        return np.asarray(link.law.state_rates(d, v, values)[number])

    at_rest = rate(0.0, 0.0)
    slope = rate(0.0, 1.0) - at_rest
    estimates = (rate(1.0, 1.0) - at_rest, at_rest - rate(0.0, -1.0), 0.5 * (rate(0.0, 2.0) - at_rest))
    steady = all(np.abs(estimate - slope).max() <= _AFFINE * np.abs(slope).max() for estimate in estimates)
    return at_rest, slope if steady and np.abs(slope).min() > 0.0 else None
