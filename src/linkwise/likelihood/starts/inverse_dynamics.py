"""Inverse dynamics of a tree of links: their forces, and their elongations up to a polynomial, from sensors on every mass.

Accelerations of all masses give the force of every link by B f = w - M a if the links form no closed loops. An elongation is
known from displacements, up to a constant from velocities, and up to a line from accelerations; the latter two drift with the
integrated noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.signals.states import DRIFT_FREQUENCY, channel_motion, highpass

_OFFSET = 1e-4  # of the power of a parabola: noise, integrated twice, leaves more beside it
# samples on each side of a window's centre: fewer do not separate an offset and a slope from noise
_SHORTEST = 6


@dataclass(frozen=True, eq=False)
class LinkSignals:
    """Signals of L links.

    Attributes
    ----------
    d, v, force : array of shape (L, N)
        Elongations in m, rates in m/s and forces in N.
    integration_order : array of int, shape (L,)
        Number of integrations behind each elongation, which is known up to a polynomial with as many coefficients.
    random_walk_intensity : array of shape (L,)
        Standard deviation per sample of the noise that drives this polynomial, in the unit of its highest derivative.
    step : float
        Sampling interval in s.
    """

    d: Floats
    v: Floats
    force: Floats
    integration_order: Indices
    random_walk_intensity: Floats
    step: float


def determines_links(record: Record, structure: Structure) -> bool:
    """Whether inverse dynamics applies: each mass is known and has a sensor, and the links form a tree on a support.

    Parameters
    ----------
    record : Record
        The record.
    structure : Structure
        The structure.

    Returns
    -------
    bool
        Whether it does.
    """
    if not all(record.motions_of(name) for name in structure.mass_names):
        return False
    if any(mass.mass.value is None for mass in structure.masses):
        return False
    incidence = structure.incidence.toarray()
    return bool(
        incidence.shape[0] == incidence.shape[1] and np.linalg.matrix_rank(incidence) == len(incidence)
    )


def needs_integration(record: Record, structure: Structure) -> bool:
    """Whether inverse dynamics applies and some displacement is known by integration only.

    Parameters
    ----------
    record : Record
        The record.
    structure : Structure
        The structure.

    Returns
    -------
    bool
        Whether it does.
    """
    displaced = all(f"x:{name}" in record.channels for name in structure.mass_names)
    return not displaced and determines_links(record, structure)


def link_signals(record: Record, structure: Structure, sigma: dict[str, float]) -> LinkSignals:
    """Signals of the links, where `determines_links` holds.

    Parameters
    ----------
    record : Record
        The record.
    structure : Structure
        The structure.
    sigma : dict of str to float
        Standard deviations of the noise by channel, in SI units.

    Returns
    -------
    LinkSignals
        The signals.
    """
    motions, orders, noise = [], [], []
    for name in structure.mass_names:
        channel = record.motions_of(name)[0]
        motions.append(channel_motion(record, channel, sigma[channel]))
        orders.append(channel.order)
        noise.append(sigma[channel])
    x, v, a = np.stack(motions, axis=1)
    applied = np.stack(
        [
            record.channel(f"force:{name}") if f"force:{name}" in record.channels else np.zeros(len(record))
            for name in structure.mass_names
        ]
    )
    incidence = structure.incidence.toarray()
    base = record.channel("x:base") if "x:base" in record.channels else None
    connected = incidence.T != 0.0
    order = np.where(connected, orders, 0).max(axis=1)
    driven = connected & (np.asarray(orders) == order[:, None])
    d = structure.elongations(x.T, base).T
    rate = structure.elongations(v.T, None if base is None else np.gradient(base, record.step)).T
    for number in np.flatnonzero(order == 2).tolist():
        d[number], rate[number] = _without_offset(d[number], rate[number])
    return LinkSignals(
        d=d,
        v=rate,
        force=np.linalg.solve(incidence, applied - structure.mass_values[:, None] * a),
        integration_order=order,
        random_walk_intensity=np.sqrt((driven * np.square(noise)).sum(axis=1)),
        step=record.step,
    )


def _without_offset(d: Floats, v: Floats) -> tuple[Floats, Floats]:
    """Elongation and rate without the curvature that the offset of an accelerometer leaves, where it dwarfs the motion."""
    time = np.linspace(-1.0, 1.0, len(d))
    legendre = np.polynomial.legendre
    parabola, line = legendre.legfit(time, d, 2), legendre.legfit(time, v, 1)
    motion = np.mean((d - legendre.legval(time, parabola)) ** 2)
    parabola[:2], line[0] = 0.0, 0.0  # a line is an unknown of every window
    bend = legendre.legval(time, parabola)
    return (d, v) if motion > _OFFSET * np.mean(bend**2) else (d - bend, v - legendre.legval(time, line))


def masses_from_links(record: Record, structure: Structure, d: Floats, v: Floats) -> tuple[Floats, Floats]:
    """Motion of the masses from that of a tree of links.

    Parameters
    ----------
    record : Record
        The record, for the motion of the base.
    structure : Structure
        The structure.
    d, v : array of shape (L, N)
        Elongations in m and rates in m/s.

    Returns
    -------
    x, x_rate : array of shape (n, N)
        Displacements in m and velocities in m/s.
    """
    base = record.channel("x:base") if "x:base" in record.channels else np.zeros(len(record))
    at_rest = np.zeros((len(record), structure.size))
    d_of_base = structure.elongations(at_rest, base).T
    v_of_base = structure.elongations(at_rest, np.gradient(base, record.step)).T
    transposed = structure.incidence.toarray().T
    return np.linalg.solve(transposed, d - d_of_base), np.linalg.solve(transposed, v - v_of_base)


def window_half(signals: LinkSignals, link: int, periods: float) -> int:
    """Half width of a window over some periods of the motion of a link, by its zero crossings.

    Parameters
    ----------
    signals : LinkSignals
        Signals of all links.
    link : int
        Index of the link.
    periods : float
        Number of periods.

    Returns
    -------
    int
        Samples on each side of the centre.
    """
    motion = highpass(signals.d[link], 1.0 / signals.step, DRIFT_FREQUENCY)
    crossings = int(np.count_nonzero(np.diff(np.signbit(motion))))
    longest = (len(motion) - 1) // 4
    return int(
        np.clip(
            round(periods * len(motion) / max(crossings, 1)),
            min(_SHORTEST, longest),
            longest,
        )
    )
