"""Checks of records: names and values of any record, what a measured one should not contain, inputs without gaps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError, RecordError
from linkwise.records.channel import Channel
from linkwise.records.clipped_samples import ClippedSamples
from linkwise.records.interpolation import check_interpolation

FASTEST = 1e30  # Hz, and its inverse the slowest rate: accelerations of such records stay finite
LARGEST = 1e100  # in any unit: products of four larger values are not finite


def check_clipped(channels: Sequence[str], clipped: Mapping[str, object]) -> None:
    """Raise RecordError for clipped samples of a name that is not a response of these channels."""
    for name, samples in clipped.items():
        if name not in channels:
            raise RecordError(
                f'clipped samples of "{name}", which is not a channel; the channels are {", ".join(channels)}'
            )
        if not isinstance(samples, ClippedSamples):
            raise RecordError(f"clipped samples of {name} are ClippedSamples, got {samples!r}")
        if Channel.parse(name).is_input:
            raise RecordError(
                f"{name} is an input, of which clipped samples cannot be bounds: an input is known at all times"
            )


def check_names(
    channels: Sequence[str], noise: Mapping[str, float], interpolation: Mapping[str, str]
) -> None:
    """Raise RecordError for a name that is not a channel or is listed twice, and for invalid noise or interpolation."""
    for name in channels:
        Channel.parse(name)
    repeated = [name for i, name in enumerate(channels) if name in channels[:i]]
    if repeated:
        raise RecordError("is listed twice", channel=repeated[0])
    for name, sigma in noise.items():
        if name not in channels:
            raise RecordError(
                f"noise is given for a channel that is not in the record; the channels are {', '.join(channels)}",
                channel=name,
            )
        if not (np.isfinite(sigma) and sigma >= 0.0):
            raise RecordError(f"noise must be a non-negative number, got {sigma!r}", channel=name)

    check_interpolation([name for name in channels if Channel.parse(name).is_input], interpolation)


def check_rate(rate: float, file: str | None = None) -> None:
    """Raise RecordError for a rate in Hz at which nothing is measured, and with whose square no computer calculates."""
    if not 1.0 / FASTEST <= rate <= FASTEST:
        raise RecordError(
            f"rate must be between {1.0 / FASTEST:g} and {FASTEST:g} Hz, got {rate:g} Hz; check the times and their unit",
            file,
            arguments=("rate",),
        )


def check_values(start: float, rate: float, channels: Sequence[str], values: Floats) -> None:
    """Raise RecordError for an invalid start in s or rate in Hz, and for values that are not (N, C) or are infinite."""
    if not (np.isfinite(rate) and rate > 0.0):
        raise RecordError(f"rate must be positive and finite, got {rate!r} Hz")
    check_rate(rate)
    if not np.isfinite(start):
        raise RecordError(f"start must be finite, got {start!r} s")
    if values.ndim != 2 or values.shape[1] != len(channels):
        raise RecordError(
            f"values have the shape {values.shape}, expected (samples, {len(channels)}) for "
            f"the channels {', '.join(channels)}"
        )
    if not channels or not len(values):
        raise RecordError("a record needs at least one channel and one sample")
    beyond = np.argwhere(np.abs(values) > LARGEST)
    if len(beyond):
        row, column = beyond[0]
        raise RecordError(
            f"the value at {start + row / rate:g} s is {_beyond(values[row, column])}; mark a missing sample by NaN",
            channel=channels[column],
        )


def _beyond(value: float) -> str:
    return "infinite" if np.isinf(value) else f"{value:g}, more than {LARGEST:g}"


def column_notes(
    name: str, samples: NDArray[np.generic], file: str | None, lines: NDArray[np.int64] | None
) -> list[str]:
    """Notes on one measured column (N,). Raises RecordError unless it holds real, finite numbers."""
    if samples.dtype.kind not in "iuf":
        raise RecordError(f"must be real numbers, got {samples.dtype}", file, channel=name)
    if samples.dtype.kind in "iu":
        return [f"{name}: integers were taken as values in {Channel.parse(name).unit}; counts need a unit."]
    beyond = np.flatnonzero(np.abs(samples) > LARGEST)
    if len(beyond):
        row = int(beyond[0])
        line = None if lines is None else int(lines[row])
        where = "" if line else f" (sample {row})"
        message = f"the value is {_beyond(samples[row])}{where}; leave the cell of an overloaded sample empty"
        raise RecordError(message, file, line, name)
    missing = int(np.isnan(samples).sum())
    return [f"{name}: {missing} of {len(samples)} samples are missing."] if missing else []


def check_responses(names: tuple[str, ...], values: Floats, file: str | None) -> None:
    """Raise RecordError for a response without information: missing throughout, constant, or a copy of another.

    `values` (N, C) are the columns of the channels `names`; inputs may be constant or equal.
    """
    names_by_samples: dict[bytes, str] = {}
    for column, name in enumerate(names):
        if Channel.parse(name).is_input:
            continue
        samples = values[:, column]
        present = samples[~np.isnan(samples)]
        if not len(present):
            raise RecordError("every sample is missing; leave the channel out", file, channel=name)
        if np.all(present == present[0]):
            raise RecordError(
                f"every sample is {present[0]:g}: a constant channel carries no information; leave it out",
                file,
                channel=name,
            )
        peak = np.max(np.abs(present))
        # single precision, so that copies in different units compare equal
        with np.errstate(over="ignore"):
            key = np.append(samples / peak, peak).astype(np.float32).tobytes()
        if key in names_by_samples:
            raise RecordError(
                f"has the same samples as {names_by_samples[key]}; one of the two is mislabelled",
                file,
                channel=name,
            )
        names_by_samples[key] = name


def require_complete(name: str, samples: Floats, start: float, rate: float) -> None:
    """Raise IdentificationError where the input `name`, (N,) `samples` from `start` in s at `rate` in Hz, has gaps."""
    missing = np.isnan(samples)
    if not missing.any():
        return
    if missing.all():
        raise IdentificationError(
            f"channel {name}: every sample is missing, and inputs must be complete; give its values, or leave the channel out"
        )
    edges = np.flatnonzero(np.diff(np.concatenate([[True], missing, [True]])))
    first, last = max(zip(edges[::2], edges[1::2] - 1, strict=True), key=lambda piece: piece[1] - piece[0])
    earliest, latest = start + first / rate, start + last / rate
    raise IdentificationError(
        f"channel {name}: {missing.sum()} of {len(samples)} samples are missing, the first at "
        f"{start + int(np.argmax(missing)) / rate:.9g} s, and inputs must be complete; cut the record to a piece without gaps "
        f"(the longest: record.between({earliest:.9g}, {latest:.9g})), or interpolate across gaps that are short against the "
        "changes of this input",
        arguments=("earliest", "latest"),
    )
