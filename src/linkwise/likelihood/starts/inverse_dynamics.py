"""Inverse dynamics of a tree of links: their forces, and their elongations up to a polynomial, from sensors on every mass.

Accelerations of all masses give the force of every link, B f = w - M a, if the links form no circles. An elongation is known
from displacements, up to a constant from velocities, and up to a line from accelerations; the last two drift with the noise
that is integrated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.signals.integrate import DRIFT_FREQUENCY, channel_motion, highpass

_SHORTEST = (
    6  # samples on each side of a window's centre: fewer do not separate an offset and a slope from noise
)


@dataclass(frozen=True, eq=False)
class LinkSignals:
    """`d`, `v`, `force` (L, N) of the links in m, m/s, N; `step` in s.

    `integration_order` (L,) is the number of integrations behind the elongation, which is known up to a polynomial with as
    many coefficients. `random_walk_intensity` (L,) is the standard deviation of the noise that drives this polynomial, in
    units of its highest derivative, per sample.
    """

    d: Floats
    v: Floats
    force: Floats
    integration_order: Indices
    random_walk_intensity: Floats
    step: float


def determines_links(record: Record, structure: Structure) -> bool:
    """Whether inverse dynamics applies: every mass has a sensor and a known value, and the links form a tree on a support."""
    if not all(any(f"{kind}:{name}" in record.channels for kind in "xva") for name in structure.mass_names):
        return False
    if any(mass.mass.value is None for mass in structure.masses):
        return False
    incidence = structure.incidence.toarray()
    return bool(
        incidence.shape[0] == incidence.shape[1] and np.linalg.matrix_rank(incidence) == len(incidence)
    )


def needs_integration(record: Record, structure: Structure) -> bool:
    """Whether inverse dynamics applies, with the displacement of some mass known by integration only."""
    displaced = all(f"x:{name}" in record.channels for name in structure.mass_names)
    return not displaced and determines_links(record, structure)


def link_signals(record: Record, structure: Structure, sigma: dict[str, float]) -> LinkSignals:
    """The signals of the links; `sigma` are the standard deviations of the noise by channel, in SI units.

    `determines_links` must hold.
    """
    motions, orders, noise = [], [], []
    for name in structure.mass_names:
        kind = next(kind for kind in "xva" if f"{kind}:{name}" in record.channels)
        motions.append(channel_motion(record, f"{kind}:{name}", sigma[f"{kind}:{name}"]))
        orders.append("xva".index(kind))
        noise.append(sigma[f"{kind}:{name}"])
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
    return LinkSignals(
        d=structure.elongations(x.T, base).T,
        v=structure.elongations(v.T, None if base is None else np.gradient(base, record.step)).T,
        force=np.linalg.solve(incidence, applied - structure.mass_values[:, None] * a),
        integration_order=order,
        random_walk_intensity=np.sqrt((driven * np.square(noise)).sum(axis=1)),
        step=record.step,
    )


def masses_from_links(record: Record, structure: Structure, d: Floats, v: Floats) -> tuple[Floats, Floats]:
    """Displacements and velocities (n, N) of the masses from elongations and rates (L, N) of a tree of links."""
    base = record.channel("x:base") if "x:base" in record.channels else np.zeros(len(record))
    at_rest = np.zeros((len(record), structure.size))
    d_of_base = structure.elongations(at_rest, base).T
    v_of_base = structure.elongations(at_rest, np.gradient(base, record.step)).T
    transposed = structure.incidence.toarray().T
    return np.linalg.solve(transposed, d - d_of_base), np.linalg.solve(transposed, v - v_of_base)


def window_half(signals: LinkSignals, link: int, periods: float) -> int:
    """Half the samples of a window over so many `periods` of a link's motion, counted by zero crossings above the drift."""
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
