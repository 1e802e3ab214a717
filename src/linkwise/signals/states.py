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

from linkwise.arrays import Floats
from linkwise.errors import RecordError
from linkwise.records.record import Record
from linkwise.signals.noise import bandwidth
from linkwise.signals.smooth import savitzky_golay, savitzky_golay_half, smoothing_spline

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

    time: Floats
    masses: tuple[str, ...]
    x: Floats
    v: Floats
    a: Floats
    forces: Floats
    driven: tuple[str, ...] = ()
    base: Floats | None = None
    base_velocity: Floats | None = None

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
    if not record.masses:
        raise RecordError(
            f"the record has no response channel to differentiate, only {', '.join(record.channels)}"
        )
    bodies = (*record.masses, *(["base"] if any(name.endswith(":base") for name in record.channels) else []))
    x, v, a, lost = _motions(record, bodies, method, order)
    if len(record) <= 2 * lost:
        raise RecordError(
            f"{len(record)} samples are too few: {lost} at each end have only one-sided derivatives"
        )
    kept = slice(lost, len(record) - lost)
    count = len(record.masses)
    driven = tuple(mass for mass in record.masses if f"force:{mass}" in record.channels)
    forces = np.zeros((len(record), count))
    for mass in driven:
        forces[:, record.masses.index(mass)] = record.channel(f"force:{mass}")
    return States(
        time=record.time[kept],
        masses=record.masses,
        x=x[kept, :count],
        v=v[kept, :count],
        a=a[kept, :count],
        forces=forces[kept],
        driven=driven,
        base=x[kept, count] if len(bodies) > count else None,
        base_velocity=v[kept, count] if len(bodies) > count else None,
    )


def finite_differences(samples: Floats, rate: float, derivative: int, *, order: int = 4) -> Floats:
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


def _motions(
    record: Record, bodies: tuple[str, ...], method: Method, order: int
) -> tuple[Floats, Floats, Floats, int]:
    """x, v, a (N, len(bodies)) of masses or the base, and how many samples at each end are poor."""
    sources = {body: source for body in bodies if (source := _source(record, body))}
    derived: dict[str, tuple[Floats, ...]] = {}
    lost = 0
    if sources:
        samples = np.column_stack([record.channel(source) for source in sources.values()])
        *found, lost = _derivatives(samples, record.rate, method, order)
        derived = {body: tuple(one[:, column] for one in found) for column, body in enumerate(sources)}
    motions: list[dict[str, Floats]] = []
    for body in bodies:
        motion = {
            kind: record.channel(name) for kind in "xva" if (name := f"{kind}:{body}") in record.channels
        }
        first = sources.get(body, "a")[0]  # the kind that was differentiated, "x" or "v"
        for kind, values in zip("xva"["xva".index(first) :], derived.get(body, ()), strict=False):
            # A differentiated channel is replaced by its smoothed self; what else was measured stays.
            motion[kind] = values if kind == first or kind not in motion else motion[kind]
        motions.append(motion)
    x, v, a = (np.column_stack([motion[kind] for motion in motions]) for kind in "xva")
    return x, v, a, lost


def _source(record: Record, body: str) -> str | None:
    """The channel that has to be differentiated for a mass or the base; None where x, v and a are measured."""
    has = {kind: f"{kind}:{body}" in record.channels for kind in "xva"}
    if not has["x"]:
        given = " and ".join(f"{kind}:{body}" for kind in "va" if has[kind])
        raise RecordError(
            f"{body} has {given} but no displacement x:{body}, and integrating a record drifts; add the channel, or use a "
            "method that works from the raw record (weak, ml)"
        )
    if not has["v"]:
        return f"x:{body}"
    return None if has["a"] else f"v:{body}"


def _derivatives(
    samples: Floats, rate: float, method: Method, order: int
) -> tuple[Floats, Floats, Floats, int]:
    """Value, first and second derivative of channels (N, C), and the number of samples at each end that are poor."""
    if method == "differences":
        first, second = (finite_differences(samples, rate, which, order=order) for which in (1, 2))
        return samples, first, second, 0
    if method == "spline":
        spline = smoothing_spline(samples, rate)
        return spline.value(), spline.first(), spline.second(), spline.reach
    halves = [savitzky_golay_half(float(band), rate) for band in bandwidth(samples, rate)]
    found = [savitzky_golay(samples[:, column], rate, half=half) for column, half in enumerate(halves)]
    value, first, second = (np.concatenate([one[kind] for one in found], axis=1) for kind in range(3))
    return value, first, second, max(halves)


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
