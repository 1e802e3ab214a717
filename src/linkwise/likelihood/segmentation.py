"""Records cut into segments: samples by channel, sensors, and what drives the structure at the flow's points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.likelihood.flow import Inputs
from linkwise.likelihood.segments import A, Segments, Sensors, V, X
from linkwise.likelihood.system import System
from linkwise.likelihood.tableau import POINTS
from linkwise.model.input_signal import Sampled
from linkwise.model.structure import Structure
from linkwise.records.channel import Channel
from linkwise.records.record import Record

_KINDS = {"x": X, "v": V, "a": A}


def cut_segments(
    records: Sequence[Record],
    structure: Structure,
    system: System,
    *,
    samples: int,
    refine: int,
    offsets: Sequence[str] = (),
    gains: Sequence[str] = (),
    loudness: Sequence[Floats] | None = None,
) -> Segments:
    """Segments of so many `samples` each, with `refine` steps of the flow a sample; records follow one another.

    All records have the same response channels. `offsets` and `gains` name the channels with an unknown constant error or
    factor; `loudness` has for each record the noise of its channels (C,) over the common one. Raises IdentificationError where
    channels differ, inputs have gaps, or a response belongs to no mass.
    """
    channels = records[0].responses
    _require_alike(records, structure, channels)
    parts = [_piece(record, channels, samples) for record in records]
    counts = [part.shape[2] for part in parts]
    data = np.concatenate(parts, axis=2)
    seen = np.isfinite(data)
    linked = np.ones(data.shape[2] - 1, dtype=bool)
    linked[np.cumsum(counts)[:-1] - 1] = False
    step = np.concatenate(
        [np.full(k, record.step / refine) for record, k in zip(records, counts, strict=True)]
    )
    return Segments(
        system=system,
        sensors=sensor_arrays(channels, structure, offsets, gains),
        samples=np.where(seen, data, 0.0),
        observed=seen,
        step=step,
        linked=linked,
        inputs=flow_inputs(records, structure, counts, samples=samples, refine=refine),
        refine=refine,
        relative_noise=None if loudness is None else np.repeat(np.stack(loudness, axis=1), counts, axis=1),
    )


def sensor_arrays(
    channels: Sequence[str], structure: Structure, offsets: Sequence[str], gains: Sequence[str]
) -> Sensors:
    """What each channel measures, and which unknown offset and gain it has."""
    parsed = [Channel.parse(name) for name in channels]
    index = {name: i for i, name in enumerate(structure.mass_names)}
    lost = [name for name in (*offsets, *gains) if name not in channels]
    if lost:
        raise IdentificationError(
            f"no offset or gain of {lost[0]} can be found: the record has {', '.join(channels)}"
        )
    return Sensors(
        kind=np.array([_KINDS[each.kind] for each in parsed]),
        mass=np.array([index[each.mass] for each in parsed]),
        offset=np.array([offsets.index(name) if name in offsets else -1 for name in channels]),
        gain=np.array([gains.index(name) if name in gains else -1 for name in channels]),
    )


def _require_alike(records: Sequence[Record], structure: Structure, channels: tuple[str, ...]) -> None:
    if not channels:
        raise IdentificationError(
            f"the record has no response, only {', '.join(records[0].channels)}: give a channel x:MASS, v:MASS or a:MASS"
        )
    for record in records[1:]:
        if record.responses != channels or record.inputs != records[0].inputs:
            raise IdentificationError(
                f"records that are fitted together need the same channels in the same order: {', '.join(records[0].channels)} "
                f"in the first, {', '.join(record.channels)} in another; select the common ones with record.select"
            )
    unknown = [name for name in channels if Channel.parse(name).mass not in structure.mass_names]
    if unknown:
        raise IdentificationError(
            f"channel {unknown[0]} belongs to no mass of the structure, whose masses are {', '.join(structure.mass_names)}"
        )


def _piece(record: Record, channels: tuple[str, ...], samples: int) -> Floats:
    """(samples, C, K) of one record, NaN behind its end."""
    values = record.select(channels).values
    count = -(-len(record) // samples)
    padded = np.full((count * samples, len(channels)), np.nan)
    padded[: len(record)] = values
    return np.ascontiguousarray(padded.reshape(count, samples, len(channels)).transpose(1, 2, 0))


def flow_inputs(
    records: Sequence[Record], structure: Structure, counts: Sequence[int], *, samples: int, refine: int
) -> Inputs:
    """Forces and base motion at the points of every step, band-limited interpolation between their samples."""
    forced = [
        (i, f"force:{name}")
        for i, name in enumerate(structure.mass_names)
        if f"force:{name}" in records[0].channels
    ]
    has_base = bool(np.any(structure.base_incidence))
    force = base = None
    if forced:
        force = np.zeros((samples * refine, len(POINTS), structure.size, sum(counts)))
        for i, name in forced:
            pieces = [
                _at_points(record, name, count, samples, refine)[0]
                for record, count in zip(records, counts, strict=True)
            ]
            force[:, :, i] = np.concatenate(pieces, axis=2)
    if has_base:
        if "x:base" not in records[0].channels:
            has = [name for name in records[0].inputs if name.endswith(":base")]
            told = (
                f"; {has[0]} alone leaves its drift open: integrate it, take the drift out, and"
                if has
                else ":"
            )
            raise IdentificationError(
                f"a link hangs on the base, whose displacement the record lacks{told} give a channel x:base"
            )
        pieces = [
            np.stack(_at_points(record, "x:base", count, samples, refine), axis=2)
            for record, count in zip(records, counts, strict=True)
        ]
        base = np.concatenate(pieces, axis=3)
    return Inputs(force, base)


def _at_points(record: Record, name: str, count: int, samples: int, refine: int) -> tuple[Floats, Floats]:
    """Value and rate of an input, (steps, points, segments) each; held behind the last sample."""
    values = record.channel(name)
    if not np.isfinite(values).all():
        raise IdentificationError(
            f"channel {name} has missing samples, and what drives the structure must be known throughout"
        )
    signal = Sampled(record.start, record.rate, values, band_limited=len(values) > _BAND_LIMITED)
    step = record.step / refine
    steps = np.arange(count * samples * refine).reshape(count, samples * refine)
    time = record.start + step * (steps.T[:, None, :] + POINTS[None, :, None])
    inside = np.minimum(time, signal.end)
    return signal.value(inside), np.where(time <= signal.end, signal.derivative(inside), 0.0)


_BAND_LIMITED = 64  # samples that a windowed sinc needs to be what it says
