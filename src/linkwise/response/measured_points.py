"""Measured points beside computed curves: steady motion in stepped or slowly swept sines, and decays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import RecordError
from linkwise.inspection.level_quantities import ring_downs
from linkwise.records.channel import Channel
from linkwise.records.record import Record
from linkwise.response.options import FORCE, Drive
from linkwise.signals.noise import channel_noise

_CYCLES = 8  # in a block, over which the motion counts as steady
_HARMONICS = 3
_SAMPLES = 64  # of a period
_SILENT = 0.05  # of the largest excitation: a cycle with less is none
_STEADY = 0.8  # of the power of a block that its harmonics must hold: just after a step they do not
_PER_CYCLE = 2 * _HARMONICS + 2  # samples at least


@dataclass(frozen=True, eq=False)
class MeasuredPoints:
    """Points of measured motion beside the curve of C channels.

    Attributes
    ----------
    hz : array of shape (P,)
        Frequencies in Hz.
    size : array of shape (P,)
        Amplitudes of the excitation in its unit; NaN in a decay.
    amplitude : array of shape (P, C)
        Half of peak to peak of each channel, NaN where it was not measured.

    Examples
    --------
    >>> import linkwise as lw
    >>> lw.response.MeasuredPoints(hz=[3.0], size=[0.5], amplitude=[[0.01]]).size
    [0.5]
    """

    hz: Floats
    size: Floats
    amplitude: Floats

    def to_list(self, channels: Sequence[str], excitation: str = "") -> list[dict[str, Any]]:
        """The points as plain data.

        Parameters
        ----------
        channels : sequence of str
            The C channels.
        excitation : str
            The key of the size of the excitation, which is left out without one.

        Returns
        -------
        list of dict
            "hz", the size and "amplitude" of each point.
        """
        points: list[dict[str, Any]] = []
        for hz, size, values in zip(self.hz.tolist(), self.size.tolist(), self.amplitude, strict=True):
            measured = np.isfinite(values)
            shown = zip(np.array(channels)[measured].tolist(), values[measured].tolist(), strict=True)
            points.append({"hz": hz, **({excitation: size} if excitation else {}), "amplitude": dict(shown)})
        return points


def steady_points(record: Record, drive: Drive, channels: Sequence[Channel]) -> MeasuredPoints:
    """The points of a stepped or slowly swept sine, by blocks of cycles of the recorded excitation.

    Each block is fitted by harmonics of the phase of the excitation, which leaves out most of the noise. RecordError where the
    record lacks the excitation, or all channels, or shows no steady cycles.
    """
    wanted = [drive.kind] if drive.kind == FORCE else ["x", "v", "a"]
    driven = _measured_channel(record, wanted, drive.place)
    if driven is None:
        named = " or ".join(f"{kind}:{drive.place}" for kind in wanted)
        held = ", ".join(record.channels)
        raise RecordError(f"measured points need the excitation, {named}, and the record holds {held}")
    shown = [_measured_channel(record, ("x", "v", "a"), channel.place) for channel in channels]
    if not any(shown):
        raise RecordError(
            f"none of {', '.join(channels)} was measured, nor the velocity or acceleration there; the record holds "
            f"{', '.join(record.channels)}"
        )
    signal = record.channel(driven) - np.nanmean(record.channel(driven))
    edges = _starts_of_cycles(signal)
    rows = []
    for first in range(0, len(edges) - _CYCLES, _CYCLES):
        block = edges[first : first + _CYCLES + 1]
        at = np.arange(int(np.ceil(block[0])), int(np.floor(block[-1])) + 1)
        cycles = np.interp(at, block, np.arange(len(block)))
        omega = 2.0 * np.pi * _CYCLES * record.rate / (block[-1] - block[0])
        if len(at) < _PER_CYCLE * _CYCLES or np.ptp(np.diff(block)) > 0.2 * np.mean(np.diff(block)):
            continue
        order = 0 if drive.kind == FORCE else drive.order - driven.order
        size = _swing(signal[at], cycles, omega, order)
        swings = [
            _swing(record.channel(name)[at], cycles, omega, channel.order - name.order) if name else np.nan
            for name, channel in zip(shown, channels, strict=True)
        ]
        if np.isfinite(size) and np.isfinite(swings).any():
            rows.append([omega / (2.0 * np.pi), size, *swings])
    if not rows:
        raise RecordError(
            f"{driven} shows no {_CYCLES} steady cycles in a row: measured points need a stepped or slowly swept sine",
            channel=driven,
        )
    table = np.array(rows)
    return MeasuredPoints(table[:, 0], table[:, 1], table[:, 2:])


def decay_points(record: Record, hz: float, channels: Sequence[Channel]) -> MeasuredPoints:
    """The frequency over the amplitude of the decaying mode nearest to `hz`, as `inspect --levels` follows it.

    RecordError where no mode rings down.
    """
    rings = ring_downs(record, channel_noise(record))
    if not rings:
        raise RecordError("no mode rings down in this record, so there is no decay to lay over the curve")
    ring = min(rings, key=lambda ring: abs(float(ring.frequency[-1]) - hz))
    taken, omega = ring.channel, 2.0 * np.pi * ring.frequency
    amplitude = np.full((len(omega), len(channels)), np.nan)
    for column, channel in enumerate(channels):
        if channel.place == taken.place:
            amplitude[:, column] = ring.amplitude * omega ** (channel.order - taken.order)
    if np.isnan(amplitude).all():
        message = f"the mode rings down most clearly in {taken}, which is not shown: show x:{taken.place}"
        raise RecordError(message, channel=taken)
    return MeasuredPoints(ring.frequency, np.full(len(omega), np.nan), amplitude)


def _measured_channel(record: Record, kinds: Sequence[str], place: str) -> Channel | None:
    """The first channel of these kinds at a place that the record has."""
    names = (Channel(kind, place) for kind in kinds)
    return next((name for name in names if name in record.channels), None)


def _starts_of_cycles(signal: Floats) -> Floats:
    """Where a signal goes up through zero, in samples; cycles begin below a part of its size, so that noise makes none."""
    signal = np.nan_to_num(signal)
    least = _SILENT * np.abs(signal).max()
    ups = np.flatnonzero((signal[:-1] < 0.0) & (signal[1:] >= 0.0))
    lowest = np.minimum.reduceat(signal, np.concatenate([[0], ups[:-1] + 1])) if len(ups) else ups
    ups = ups[lowest < -least]
    return np.asarray(ups + signal[ups] / (signal[ups] - signal[ups + 1]))


def _swing(values: Floats, cycles: Floats, omega: float, order: int) -> float:
    """Half of peak to peak of the periodic part, differentiated `order` times; NaN where it is not most of the motion."""
    k = np.arange(1, _HARMONICS + 1)
    phases = 2.0 * np.pi * np.outer(cycles, k)
    basis = np.hstack([np.ones((len(cycles), 1)), np.cos(phases), np.sin(phases)])
    here = np.isfinite(values)
    if here.sum() < 2 * basis.shape[1]:
        return np.nan
    fitted = np.linalg.lstsq(basis[here], values[here], rcond=None)[0]
    left = values[here] - basis[here] @ fitted
    if np.var(left) > (1.0 - _STEADY) * np.var(values[here]):
        return np.nan
    harmonics = fitted[1 : _HARMONICS + 1] - 1j * fitted[_HARMONICS + 1 :]
    harmonics = harmonics * (1j * k * omega) ** float(order)
    turn = np.exp(2j * np.pi * np.outer(np.linspace(0.0, 1.0, _SAMPLES, endpoint=False), k))
    return float(0.5 * np.ptp((turn @ harmonics).real))
