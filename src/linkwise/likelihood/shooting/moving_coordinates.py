"""Segments of records in coordinates that move with a base: what sensors show of its motion, and its acceleration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from linkwise.arrays import Bools, Floats
from linkwise.likelihood.shooting.late_base import EDGE, LateBase, values_at_delays
from linkwise.likelihood.shooting.segmentation import cut, signal_at_points
from linkwise.likelihood.shooting.segments import Segments
from linkwise.signals.base_frame import FramedRecord


def in_moving_coordinates(segments: Segments, frames: Sequence[FramedRecord]) -> Segments:
    """Add to segments of records in coordinates that move what their sensors show of that, and its acceleration.

    Parameters
    ----------
    segments : Segments
        The segments of all records.
    frames : sequence of FramedRecord
        The records.

    Returns
    -------
    Segments
        The segments; the same where no coordinates move.
    """
    samples, refine = len(segments.samples), segments.refine
    inputs = replace(segments.inputs, frame=_frame_acceleration(frames, samples, refine))
    carried = _carried(frames, samples)
    if carried is None or not len(segments.sensors.late):
        return replace(segments, inputs=inputs, carried=carried)
    base, inside = _late_base(segments, frames)
    observed = segments.observed & inside
    samples_inside = np.where(observed, segments.samples, 0.0)
    segments = replace(segments, observed=observed, samples=samples_inside, clipped=None)
    return replace(segments, inputs=inputs, carried=carried, late_base=base)


def _late_base(segments: Segments, frames: Sequence[FramedRecord]) -> tuple[LateBase, Bools]:
    """What late sensors show of moving coordinates, and (M, C, K) where the record of the base reaches far enough for it."""
    late = [int(channel) for channel in segments.sensors.late]
    values, inside = [], []
    for frame in frames:
        names, nothing = list(frame.names.values()), np.zeros((1, len(frame.record)))
        shown = [frame.carried.get(names[channel], nothing)[0] for channel in late]
        delayed = np.stack([values_at_delays(signal, frame.record.rate) for signal in shown], axis=2)
        values.append(np.stack([cut(signal, len(segments.samples)) for signal in delayed]))
        reaches = np.ones((len(frame.record), len(names)))
        for channel in late:
            if names[channel] in frame.carried:
                reaches[:EDGE, channel] = reaches[-EDGE:, channel] = 0.0
        inside.append(np.nan_to_num(cut(reaches, len(segments.samples))))
    through = np.nan_to_num(np.concatenate(values, axis=3))
    base = LateBase.through(late, through, segments.step * segments.refine)
    return base, np.concatenate(inside, axis=2) > 0.0


def _carried(frames: Sequence[FramedRecord], samples: int) -> Floats | None:
    """(2, M, C, K) what the sensors show of moving coordinates, and its rate; 0 behind the end of a record."""
    if not any(frame.carried for frame in frames):
        return None
    parts = []
    for frame in frames:
        nothing = np.zeros((2, len(frame.record)))
        shown = np.stack([frame.carried.get(name, nothing) for name in frame.names.values()], axis=2)
        parts.append(np.stack([cut(values, samples) for values in shown]))
    return np.nan_to_num(np.concatenate(parts, axis=3))


def _frame_acceleration(frames: Sequence[FramedRecord], samples: int, refine: int) -> Floats | None:
    """(J, 5, K) acceleration of the coordinates at the points of every step."""
    if not any(frame.acceleration is not None for frame in frames):
        return None
    pieces = [
        signal_at_points(
            frame.record, frame.acceleration, -(-len(frame.record) // samples), (samples, refine)
        )[0]
        for frame in frames
        if frame.acceleration is not None
    ]
    return np.concatenate(pieces, axis=2)
