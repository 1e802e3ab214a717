"""What sensors on every mass tell of the links of a tree: force, and elongation up to an unknown line.

Accelerations of all masses give the force of every link, B f = w - M a, where the links close no circles. A displacement tells
elongations outright; a velocity up to a constant, an acceleration up to a line, both of which drift with the noise
that is summed up on the way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from linkwise.arrays import Floats, Indices
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.signals.noise import bandwidth
from linkwise.signals.smooth import savitzky_golay, savitzky_golay_half

DRIFT = 3.0  # Hz: below it a twice integrated acceleration is drift
_DEGREE = 5
_SHORTEST = 6  # samples to each side that tell two unknowns from noise


@dataclass(frozen=True, eq=False)
class LinkSignals:
    """`d`, `v`, `force` (L, N) of the links in m, m/s, N; `step` in s.

    `integration_order` (L,) is how many integrations the elongation has behind it: it is known up to a polynomial with so
    many numbers. `random_walk_intensity` (L,) is the standard deviation of the noise that drives this polynomial, in units
    of its highest derivative, per sample.
    """

    d: Floats
    v: Floats
    force: Floats
    integration_order: Indices
    random_walk_intensity: Floats
    step: float


def determines_links(record: Record, structure: Structure) -> bool:
    """Whether every mass has a sensor and a known size, and the links form a tree that hangs on the ground or the base."""
    if not all(any(f"{kind}:{name}" in record.channels for kind in "xva") for name in structure.mass_names):
        return False
    if any(mass.mass.value is None for mass in structure.masses):
        return False
    incidence = structure.incidence.toarray()
    return bool(
        incidence.shape[0] == incidence.shape[1] and np.linalg.matrix_rank(incidence) == len(incidence)
    )


def needs_integration(record: Record, structure: Structure) -> bool:
    """Whether the record `determines_links` of the structure, and of the place of some mass by sums over time alone."""
    placed = all(f"x:{name}" in record.channels for name in structure.mass_names)
    return not placed and determines_links(record, structure)


def link_signals(record: Record, structure: Structure, sigma: dict[str, float]) -> LinkSignals:
    """The links of a `structure` that the record `determines_links` of, with `sigma` of the channels' noise."""
    motions, lost, noise = [], [], []
    for name in structure.mass_names:
        kind = next(kind for kind in "xva" if f"{kind}:{name}" in record.channels)
        motions.append(_motion(record, f"{kind}:{name}", kind, sigma))
        lost.append("xva".index(kind))
        noise.append(sigma[f"{kind}:{name}"])
    x, v, a = np.stack(motions, axis=1)
    pushes = np.stack(
        [
            record.channel(f"force:{name}") if f"force:{name}" in record.channels else np.zeros(len(record))
            for name in structure.mass_names
        ]
    )
    incidence = structure.incidence.toarray()
    base = record.channel("x:base") if "x:base" in record.channels else None
    touched = incidence.T != 0.0
    most = np.where(touched, lost, 0).max(axis=1)
    driven = touched & (np.asarray(lost) == most[:, None])
    return LinkSignals(
        d=structure.elongations(x.T, base).T,
        v=structure.elongations(v.T, None if base is None else np.gradient(base, record.step)).T,
        force=np.linalg.solve(incidence, pushes - structure.mass_values[:, None] * a),
        integration_order=most,
        random_walk_intensity=np.sqrt((driven * np.square(noise)).sum(axis=1)),
        step=record.step,
    )


def masses_from_links(record: Record, structure: Structure, d: Floats, v: Floats) -> tuple[Floats, Floats]:
    """Displacements and velocities (n, N) of the masses from elongations and rates (L, N) of a tree."""
    base = record.channel("x:base") if "x:base" in record.channels else np.zeros(len(record))
    still = np.zeros((len(record), structure.size))
    fixed = structure.elongations(still, base).T
    rates = structure.elongations(still, np.gradient(base, record.step)).T
    across = structure.incidence.toarray().T
    return np.linalg.solve(across, d - fixed), np.linalg.solve(across, v - rates)


def filled(record: Record, name: str) -> Floats:
    """A channel (N,) with missing samples bridged by straight lines, which only a start may do."""
    values = record.channel(name)
    lost = np.isnan(values)
    if lost.any():
        places = np.arange(len(values))
        values = np.interp(places, places[~lost], values[~lost])
    return values


def smoothed(record: Record, name: str, sigma: dict[str, float]) -> tuple[Floats, Floats, Floats]:
    """Value, rate and second rate (N,) of a channel."""
    values = filled(record, name)
    highest = float(bandwidth(values, record.rate, [sigma[name]])[0])
    half = min(
        savitzky_golay_half(highest, record.rate, degree=_DEGREE),
        (len(values) - 1) // 2,
    )
    value, rate, bend = savitzky_golay(values, record.rate, half=half, degree=_DEGREE)
    return value[:, 0], rate[:, 0], bend[:, 0]


def summed(values: Floats, step: float) -> Floats:
    """The integral (N,) from the first sample on, by Simpson's rule."""
    return np.asarray(scipy.integrate.cumulative_simpson(values, dx=step, initial=0.0))


def _motion(record: Record, name: str, kind: str, sigma: dict[str, float]) -> Floats:
    """(3, N) displacement, velocity and acceleration, the sums starting at 0."""
    if kind == "x":
        return np.stack(smoothed(record, name, sigma))
    values = filled(record, name)
    if kind == "v":
        value, rate, _ = smoothed(record, name, sigma)
        return np.stack([summed(values, record.step), value, rate])
    velocity = summed(values, record.step)
    return np.stack([summed(velocity, record.step), velocity, values])


def highpassed(values: Floats, rate: float, cut: float) -> Floats:
    """`values` (N,) without what is slower than `cut` Hz: a Gaussian in frequency, ends mirrored."""
    mirrored = np.concatenate([values, values[::-1]])
    frequency = np.fft.rfftfreq(len(mirrored), 1.0 / rate)
    kept = 1.0 - np.exp(-0.5 * (frequency / cut) ** 2)
    return np.asarray(np.fft.irfft(np.fft.rfft(mirrored) * kept, len(mirrored))[: len(values)])


def window_half(seen: LinkSignals, link: int, periods: float) -> int:
    """Half the samples of a window that spans so many `periods` of a link's motion, by the zeros of what is not drift."""
    moving = highpassed(seen.d[link], 1.0 / seen.step, DRIFT)
    turns = int(np.count_nonzero(np.diff(np.signbit(moving))))
    most = (len(moving) - 1) // 4
    return int(np.clip(round(periods * len(moving) / max(turns, 1)), min(_SHORTEST, most), most))
