"""States by differentiation: what the paper's way to equations needs (its section 3, step 3).

What was measured is taken as measured. What was not is derived from the channel next to it: v from x, a from v where
there is a v, else from x; a channel that had to be smoothed for that is replaced by its smoothed self.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import factorial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from linkwise.errors import RecordError
from linkwise.noise import bandwidth
from linkwise.record import Record
from linkwise.smooth import savitzky_golay, savitzky_golay_half, smoothing_spline

Array = NDArray[np.float64]
Method = Literal["spline", "savgol", "differences"]

_METHODS = {
    "spline": "smoothing spline, smoothness by generalised cross-validation",
    "savgol": "Savitzky-Golay, window by the bandwidth of the channel",
    "differences": "central differences of order 2, 4 or 6, for data without noise",
}


@dataclass(frozen=True, eq=False)
class States:
    """Motion of n masses at N times: `time` (N,) s, `x`, `v`, `a` (N, n) in m, m/s, m/s^2, `masses` (n,) their names.

    `forces` (N, n) N are the applied forces, zero where none was recorded; `base` and `base_velocity` (N,) the motion
    of the base in m and m/s, None without one. `driven` names the masses with a force channel.
    """

    time: Array
    masses: tuple[str, ...]
    x: Array
    v: Array
    a: Array
    forces: Array
    driven: tuple[str, ...] = ()
    base: Array | None = None
    base_velocity: Array | None = None

    def __len__(self) -> int:
        return len(self.time)


def differentiate(record: Record, method: Method = "spline", *, order: int = 4) -> States:
    """States of every mass with a sensor.

    `method` is "spline" (quintic smoothing spline, smoothness found by cross-validation), "savgol" (Savitzky-Golay,
    degree 5, window from the bandwidth) or "differences" (central, of `order` 2, 4 or 6, no smoothing). Samples at both
    ends that one-sided derivatives would spoil are left out, so `time` may be shorter than the record; nothing is lost
    where x, v and a are measured.

    Raises RecordError for a mass without displacement, a base known only by its velocity or acceleration, missing samples, an
    unknown method or order.
    """
    if method not in _METHODS:
        listed = ", ".join(f'"{name}" ({what})' for name, what in _METHODS.items())
        raise RecordError(f"{method!r} is no way to differentiate; there are {listed}")
    _require_complete(record)
    motions = [_motion(record, mass, method, order) for mass in record.masses]
    if not motions:
        raise RecordError(
            f"the record has no response channel to differentiate, only {', '.join(record.channels)}"
        )
    base = _motion(record, "base", method, order) if _has_base(record) else None
    lost = max(motion.lost for motion in [*motions, *([base] if base else [])])
    kept = slice(lost, len(record) - lost)
    if len(record) <= 2 * lost:
        raise RecordError(
            f"{len(record)} samples are too few: {lost} at each end have only one-sided derivatives"
        )
    forces = np.zeros((len(record), len(motions)))
    driven = tuple(mass for mass in record.masses if f"force:{mass}" in record.channels)
    for mass in driven:
        forces[:, record.masses.index(mass)] = record.channel(f"force:{mass}")
    return States(
        time=record.time[kept],
        masses=record.masses,
        x=np.column_stack([motion.x for motion in motions])[kept],
        v=np.column_stack([motion.v for motion in motions])[kept],
        a=np.column_stack([motion.a for motion in motions])[kept],
        forces=forces[kept],
        driven=driven,
        base=base.x[kept] if base else None,
        base_velocity=base.v[kept] if base else None,
    )


def finite_differences(samples: Array, rate: float, derivative: int, *, order: int = 4) -> Array:
    """The first or second time derivative (N, ...) of samples (N, ...) at `rate` Hz, of `order` 2, 4 or 6 up to both ends.

    Raises RecordError for another order or derivative, or too few samples.
    """
    if order not in (2, 4, 6) or derivative not in (1, 2):
        raise RecordError(
            f"differences come in order 2, 4 and 6 for derivatives 1 and 2; got order {order!r} for {derivative!r}"
        )
    half = order // 2
    length = order + derivative  # points that a one-sided stencil of this order needs
    if len(samples) < max(length, 2 * half + 1):
        raise RecordError(f"{len(samples)} samples are too few for differences of order {order}")
    answer = np.zeros_like(samples)
    count = len(samples) - 2 * half
    for lag, weight in enumerate(_stencil(2 * half + 1, half, derivative)):
        answer[half : half + count] += weight * samples[lag : lag + count]
    for row in range(half):
        weights = _stencil(length, row, derivative)
        answer[row] = np.tensordot(weights, samples[:length], axes=1)
        answer[-1 - row] = (-1) ** derivative * np.tensordot(weights, samples[: -length - 1 : -1], axes=1)
    return answer * rate**derivative


@dataclass(frozen=True, eq=False)
class _Motion:
    """One mass: x, v, a (N,), and how many samples at each end are poor."""

    x: Array
    v: Array
    a: Array
    lost: int


def _motion(record: Record, mass: str, method: Method, order: int) -> _Motion:
    measured = {
        kind: record.channel(f"{kind}:{mass}") for kind in "xva" if f"{kind}:{mass}" in record.channels
    }
    if "x" not in measured:
        given = " and ".join(f"{kind}:{mass}" for kind in measured) or f"force:{mass}"
        raise RecordError(
            f"{mass} has {given} but no displacement x:{mass}, and integrating a record drifts; add the channel, or use a "
            "method that works from the raw record (weak, ml)"
        )
    if "v" in measured and "a" in measured:
        return _Motion(measured["x"], measured["v"], measured["a"], 0)
    x, first, second, lost = _derivatives(measured["x"], record.rate, method, order)
    if "v" not in measured:
        return _Motion(x, first, measured.get("a", second), lost)
    v, a, _, lost = _derivatives(measured["v"], record.rate, method, order)
    return _Motion(measured["x"], v, a, lost)


def _derivatives(samples: Array, rate: float, method: Method, order: int) -> tuple[Array, Array, Array, int]:
    """Value, first and second derivative of one channel (N,), and the number of samples at each end that are poor."""
    if method == "differences":
        first, second = (finite_differences(samples, rate, which, order=order) for which in (1, 2))
        return samples, first, second, 0
    if method == "spline":
        spline = smoothing_spline(samples, rate)
        return spline.value()[:, 0], spline.first()[:, 0], spline.second()[:, 0], spline.reach
    half = savitzky_golay_half(float(bandwidth(samples, rate)[0]), rate)
    value, first, second = savitzky_golay(samples, rate, half=half)
    return value[:, 0], first[:, 0], second[:, 0], half


def _has_base(record: Record) -> bool:
    return any(name.endswith(":base") for name in record.channels)


def _require_complete(record: Record) -> None:
    """Raise RecordError, with the first place and the longest complete piece, where samples are missing."""
    holes = record.missing
    if not holes.any():
        return
    column = int(np.argmax(holes.sum(axis=0)))
    first = float(record.time[int(np.argmax(holes[:, column]))])
    edges = np.flatnonzero(np.concatenate([[True], holes.any(axis=1), [True]]))
    longest = int(np.argmax(np.diff(edges)))
    piece = record.time[edges[longest] : edges[longest + 1] - 1]
    advice = (
        f"record.between({piece[0]:g}, {piece[-1]:g}) is the longest complete piece"
        if piece.size
        else "no row is complete"
    )
    raise RecordError(
        f"{int(holes[:, column].sum())} samples are missing, the first at {first:g} s, and derivatives do not cross a gap; "
        f"{advice}, and the weak form needs no derivatives",
        channel=record.channels[column],
    )


@lru_cache(maxsize=64)
def _stencil(points: int, at: int, derivative: int) -> tuple[float, ...]:
    """Weights of evenly spaced samples (step 1) for a derivative at sample `at`, exact for the highest degree possible."""
    powers = np.vander(np.arange(points, dtype=np.float64) - at, points, increasing=True).T
    right = np.zeros(points)
    right[derivative] = factorial(derivative)
    return tuple(np.linalg.solve(powers, right))
