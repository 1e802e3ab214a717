"""Starting states of annealing at the nodes, and the scales of defects.

Displacements are smoothed and differentiated, velocities smoothed and integrated once, accelerations twice, and the drift of
the integrals is removed. A mass without a sensor starts at rest, or with the motion that a measured state of its link gives: a
voltage gives the rate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.expression import differentiate, symbols
from linkwise.likelihood.starts.drift import (
    elongations_from_forces,
    link_signals,
    masses_from_links,
    needs_integration,
)
from linkwise.likelihood.starts.kalman import LinearPart
from linkwise.likelihood.starts.link_states import link_states, signals_of
from linkwise.likelihood.starts.values import require_supported, smoothed_motion
from linkwise.model.link import BASE, GROUND, Link
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.signals.states import integral, smoothed
from linkwise.weak.displacements import motion_without_drift


def motion_from_states(
    record: Record, structure: Structure, sigma: Mapping[str, float], x: Floats, v: Floats
) -> tuple[int, ...]:
    """Fill displacements and velocities (n, N) of masses that are 0 so far, and give the numbers of these masses.

    Of a link whose one end moves as is known, and that has a measured state with a rate a(state) + b v, as of a piezoelectric
    transducer or a coil; displacements are integrals from 0.
    """
    names = structure.mass_names
    known = {name: row for name, row in zip(names, v, strict=True) if row.any()}
    known[GROUND] = np.zeros(len(record))
    if f"x:{BASE}" in record.channels:
        known[BASE] = np.gradient(record.channel(f"x:{BASE}"), record.step)
    filled: list[int] = []
    for link in structure.links * len(
        structure.links
    ):  # again, once other links have given the motion of an end
        first, second = link.between
        rate = _rate(link, record, sigma) if (first in known) != (second in known) else None
        if rate is not None:
            name = second if first in known else first
            known[name] = known[first] - rate if first in known else known[second] + rate
            number = names.index(name)
            v[number], x[number] = known[name], integral(known[name], record.step)
            filled.append(number)
    return tuple(filled)


def _rate(link: Link, record: Record, sigma: Mapping[str, float]) -> Floats | None:
    """The rate of a link (N,) in m/s from the first measured state that determines it; None if none does."""
    for number, (name, expression) in enumerate(link.law.named_rates):
        channel, slope = f"state:{link.name}.{name}", symbols(differentiate(expression, "v"))
        if channel not in record.channels or "d" in symbols(expression) or not {"d", "v"}.isdisjoint(slope):
            continue
        state, changing, _ = smoothed(record, channel, sigma[channel])
        signals = dict(zip(link.law.signals, signals_of(record, link.law), strict=True))
        values: dict[str, float | Floats] = {**link.values, **link.zero_states, **signals, name: state}
        at_rest, moving = (np.asarray(link.law.state_rates(0.0, v, values)[number]) for v in (0.0, 1.0))
        if np.abs(moving - at_rest).min() > 0.0:
            return np.asarray((changing - at_rest) / (moving - at_rest))
    return None


# of the motion of the measured masses: the scale of a defect of an unmeasured mass at q = 1
_UNMEASURED = 0.1

_LEAST = 0.3  # of the noise, relative to the motion: the least scale of a defect beside hosts

# of the motion that a measured state of a link determines, with the starts of its coefficients
_FROM_STATES = 0.3


@dataclass(frozen=True, eq=False)
class StartStates:
    """Starting states of all masses.

    Attributes
    ----------
    x, v : array of shape (n, N)
        Displacements in m and velocities in m/s.
    memory : array of shape (S, N)
        States of links, in the order of `System.states`.
    scale : array of shape (2 n + S,)
        Scales of the defects in m, m/s and units of states.
    """

    x: Floats
    v: Floats
    memory: Floats
    scale: Floats


def start_states(record: Record, structure: Structure, sigma: dict[str, float], samples: int) -> StartStates:
    """Starting states from the sensors of a record.

    Elongations follow from forces (`elongations_from_forces`) where displacements were not measured, every mass has a sensor
    and all coefficients are numbers.

    Parameters
    ----------
    record : Record
        The record.
    structure : Structure
        The structure.
    sigma : dict of str to float
        Standard deviations of the noise by channel, in SI units.
    samples : int
        Samples in a segment, over which a defect of the velocity accumulates.

    Returns
    -------
    StartStates
        The states.

    Raises
    ------
    IdentificationError
        If no channel shows the motion of a mass.
    """
    if structure.hosts:
        return _states_with_hosts(record, structure, sigma)
    x, v = _motion(record, structure, sigma)
    scale = np.full((2, structure.size), np.nan)
    reach = np.sqrt(samples) / 4.0
    for i, name in enumerate(structure.mass_names):
        for channel in record.motions_of(name)[:1]:
            noise = sigma[channel]
            ratio = max(noise / np.sqrt(np.nanmean(record.channel(channel) ** 2)), 1e-12)
            rough = ratio * _rms(x[i]), ratio * _rms(v[i])
            scale[:, i] = (noise, noise * record.rate * reach) if channel.kind == "x" else rough
    for number in motion_from_states(record, structure, sigma, x, v):
        scale[:, number] = _FROM_STATES * _rms(x[number]), _FROM_STATES * _rms(v[number])
    hidden = np.isnan(scale[0])
    if hidden.all():
        raise IdentificationError(
            f"no channel shows the motion of a mass ({', '.join(record.responses)} alone), from which the states start: "
            f"record a displacement, velocity or acceleration, such as rel:v:{structure.mass_names[0]}"
        )
    for order, motion in enumerate((x, v)):
        scale[order, hidden] = _UNMEASURED * np.sqrt(np.mean(motion[~hidden] ** 2))
    memory, sizes = link_states(record, structure, sigma, x, v)
    return StartStates(x, v, memory, np.concatenate([scale.ravel(), sizes]))


def _states_with_hosts(record: Record, structure: Structure, sigma: dict[str, float]) -> StartStates:
    """The states that a smoother finds, and the scales of defects from its deviations.

    Where all laws are known these sink far below the noise, and equations as stiff as that lose the covariance to rounding.
    """
    require_supported(record, structure)
    motion = smoothed_motion(record, LinearPart.of(structure), sigma).with_drift_tracked(structure)
    memory, sizes = link_states(record, structure, sigma, motion.x, motion.v)
    size = np.sqrt(np.stack([np.mean(motion.x**2, axis=1), np.mean(motion.v**2, axis=1)]))
    noise = min(sigma[name] / np.sqrt(np.nanmean(record.channel(name) ** 2)) for name in record.responses)
    least = _LEAST * max(min(noise, 1.0), 1e-12) * size
    scale = np.clip(motion.deviation.reshape(2, -1), least, np.maximum(_UNMEASURED * size, least))
    return StartStates(motion.x, motion.v, memory, np.concatenate([scale.ravel(), sizes]))


def _motion(record: Record, structure: Structure, sigma: dict[str, float]) -> tuple[Floats, Floats]:
    """Displacements and velocities (n, N), zero for masses without a sensor."""
    numbers = all(c.value is not None for link in structure.links for c in link.coefficients.values())
    of_states = _forces_of_states(record, structure, sigma)
    if numbers and of_states is not None and needs_integration(record, structure):
        signals = link_signals(record, structure, sigma)
        signals = replace(signals, force=signals.force - of_states)
        return masses_from_links(record, structure, *elongations_from_forces(signals, structure.links))
    return measured_motion(record, structure, sigma)


def _forces_of_states(record: Record, structure: Structure, sigma: Mapping[str, float]) -> Floats | None:
    """The forces (L, N) of measured states in links; None where one is not measured, or acts on what the motion does."""
    forces = np.zeros((len(structure.links), len(record)))
    for force, link in zip(forces, structure.links, strict=True):
        law = link.law
        channels = {name: f"state:{link.name}.{name}" for name in law.states}
        apart = all(
            {"d", "v"}.isdisjoint(symbols(differentiate(law.expression, name))) for name in law.states
        )
        if law.signals or not (apart and set(channels.values()) <= set(record.channels)):
            return None
        states = {name: smoothed(record, channel, sigma[channel])[0] for name, channel in channels.items()}
        if states and None not in link.values.values():
            at_rest = law.force(0.0, 0.0, {**link.values, **link.zero_states})
            force[:] = law.force(0.0, 0.0, {**link.values, **states}) - at_rest
    return forces


def measured_motion(record: Record, structure: Structure, sigma: dict[str, float]) -> tuple[Floats, Floats]:
    """Displacements and velocities (n, N) of the masses, smoothed, integrated where need be; zero without a sensor."""
    x, v = np.zeros((2, structure.size, len(record)))
    for i, name in enumerate(structure.mass_names):
        by_kind = {c.kind: motion_without_drift(record, c, sigma[c]) for c in record.motions_of(name)}
        for order, (motion, kinds) in enumerate(((x, "xva"), (v, "vxa"))):
            motion[i] = next((by_kind[kind][order] for kind in kinds if kind in by_kind), 0.0)
    return x, v


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))
