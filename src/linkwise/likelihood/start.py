"""Where annealing starts: states at the nodes from the sensors, and the scale on which a defect is natural.

What a mass shows decides: a displacement is smoothed and differentiated, a velocity smoothed and integrated once, an
acceleration twice, with the drift of the sums taken out. A mass without a sensor starts at rest; annealing moves it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from linkwise.noise import bandwidth, noise_sigma
from linkwise.record import Record
from linkwise.smooth import savitzky_golay, savitzky_golay_half
from linkwise.structure import Structure

Array = NDArray[np.float64]

_DEGREE = 5
_DRIFT = 3.0  # Hz: below it a twice integrated acceleration is drift
_UNSEEN = 0.1  # of the motion of the seen masses: how far a node of a hidden mass is free to move at q = 1


@dataclass(frozen=True, eq=False)
class States:
    """Displacements and velocities (n, N) of all masses, `sigma` (n,) of what their sensor makes of both, (2n,)."""

    x: Array
    v: Array
    scale: Array


def channel_noise(record: Record) -> dict[str, float]:
    """Standard deviation of the noise in every response: stated by the record, else found in it."""
    names = [name for name in record.responses if name not in record.noise]
    found = noise_sigma(record.select(names).values) if names else ()
    floor = {name: 1e-12 * float(np.nanmax(np.abs(record.channel(name)))) for name in record.responses}
    sigma = dict(record.noise) | {
        name: float(np.nan_to_num(value)) for name, value in zip(names, found, strict=True)
    }
    return {name: max(sigma[name], floor[name]) for name in record.responses}


def start_states(record: Record, structure: Structure, sigma: dict[str, float], samples: int) -> States:
    """The motion as the sensors tell it. `samples` is the length of a segment, over which a velocity defect builds up."""
    shape = (structure.size, len(record))
    x, v, scale = np.zeros(shape), np.zeros(shape), np.full((2, structure.size), np.nan)
    reach = np.sqrt(samples) / 4.0
    for i, mass in enumerate(structure.mass_names):
        kinds = [kind for kind in "xva" if f"{kind}:{mass}" in record.channels]
        if not kinds:
            continue
        seen = {kind: _smoothed(record, f"{kind}:{mass}", sigma) for kind in kinds}
        ratio = max(
            sigma[f"{kinds[0]}:{mass}"] / np.sqrt(np.nanmean(record.channel(f"{kinds[0]}:{mass}") ** 2)),
            1e-12,
        )
        v[i] = (
            seen["v"][0]
            if "v" in seen
            else seen["x"][1]
            if "x" in seen
            else _undrifted(seen["a"][0], record.rate)
        )
        x[i] = seen["x"][0] if "x" in seen else _integrated(v[i], record.rate, drifts="v" not in seen)
        scale[0, i] = sigma[f"x:{mass}"] if "x" in seen else ratio * _rms(x[i])
        scale[1, i] = sigma[f"x:{mass}"] * record.rate * reach if "x" in seen else ratio * _rms(v[i])
    hidden = np.isnan(scale[0])
    for order, motion in enumerate((x, v)):
        seen_motion = np.sqrt(np.mean(motion[~hidden] ** 2))
        scale[order, hidden] = _UNSEEN * seen_motion
    return States(x, v, scale.ravel())


def nodes(states: Sequence[States], samples: int) -> Array:
    """(2, n, K) the states at the first sample of every segment, record after record."""
    return np.concatenate([np.stack([each.x[:, ::samples], each.v[:, ::samples]]) for each in states], axis=2)


def _smoothed(record: Record, name: str, sigma: dict[str, float]) -> tuple[Array, Array]:
    """Value and rate (N,) of a channel; missing samples bridged by straight lines, which only a start may do."""
    values = record.channel(name)
    lost = np.isnan(values)
    if lost.any():
        places = np.arange(len(values))
        values = np.interp(places, places[~lost], values[~lost])
    highest = float(bandwidth(values, record.rate, [sigma[name]])[0])
    half = min(savitzky_golay_half(highest, record.rate, degree=_DEGREE), (len(values) - 1) // 2)
    value, rate, _ = savitzky_golay(values, record.rate, half=half, degree=_DEGREE)
    return value[:, 0], rate[:, 0]


def _integrated(values: Array, rate: float, *, drifts: bool) -> Array:
    total = np.asarray(cumulative_trapezoid(values, dx=1.0 / rate, initial=0.0))
    return _highpassed(total, rate) if drifts else total


def _undrifted(acceleration: Array, rate: float) -> Array:
    return _highpassed(np.asarray(cumulative_trapezoid(acceleration, dx=1.0 / rate, initial=0.0)), rate)


def _highpassed(values: Array, rate: float) -> Array:
    """`values` without what is slower than the drift: a Gaussian in frequency, ends mirrored."""
    mirrored = np.concatenate([values, values[::-1]])
    frequency = np.fft.rfftfreq(len(mirrored), 1.0 / rate)
    kept = 1.0 - np.exp(-0.5 * (frequency / _DRIFT) ** 2)
    return np.asarray(np.fft.irfft(np.fft.rfft(mirrored) * kept, len(mirrored))[: len(values)])


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
