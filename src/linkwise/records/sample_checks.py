"""What samples of channels, and what is stated of them, must be: rates and values that are finite and not too large,
responses that say something, inputs without gaps; an error names the file, the line and the channel.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Floats, stretches
from linkwise.errors import IdentificationError, RecordError
from linkwise.records.channel import Channel

FASTEST = 1e30  # Hz, and its inverse the slowest rate: accelerations of such records stay finite
LARGEST = 1e100  # in any unit: products of four larger values are not finite


def require_channel(name: str, channels: Sequence[Channel], stated: str, file: str | None = None) -> None:
    """Raise RecordError where something that is `stated` is of none of the channels."""
    if name not in channels:
        message = f"is not in the record, and something is stated of it ({stated}); the channels are {', '.join(channels)}"
        raise RecordError(message, file, channel=name)


class Rows(NamedTuple):
    """Where samples stand: in a file, if they are from one, and on which line (N,) each, if it has lines."""

    file: str | None = None
    lines: NDArray[np.int64] | None = None

    def error(self, message: str, row: int, channel: str, arguments: Sequence[str] = ()) -> RecordError:
        """An error about one sample."""
        line = None if self.lines is None else int(self.lines[row])
        where = "" if line else f" (sample {row})"
        return RecordError(f"{message}{where}", self.file, line, channel, arguments=arguments)


NOWHERE = Rows()


def check_rate(rate: float, file: str | None = None) -> None:
    """Raise RecordError for a rate in Hz at which nothing is measured, and with whose square no computer calculates."""
    if not 1.0 / FASTEST <= rate <= FASTEST:
        message = f"rate must be between {1.0 / FASTEST:g} and {FASTEST:g} Hz, got {rate:g} Hz; check the times and their unit"
        raise RecordError(message, file, arguments=("rate",))


def check_values(start: float, rate: float, channels: Sequence[str], values: Floats) -> None:
    """Raise RecordError for an invalid start in s or rate in Hz, and for values that are not (N, C) or are infinite."""
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
    if max(np.fmax.reduce(values, axis=None), -np.fmin.reduce(values, axis=None)) > LARGEST:
        row, column = np.argwhere(np.abs(values) > LARGEST)[0]
        message = f"the value at {start + row / rate:g} s is {_beyond(values[row, column])}; mark a missing sample by NaN"
        raise RecordError(message, channel=channels[column])


def _beyond(value: float) -> str:
    return "infinite" if np.isinf(value) else f"{value:g}, more than {LARGEST:g}"


def column_notes(name: Channel, samples: NDArray[np.generic], rows: Rows) -> list[str]:
    """Notes on one measured column (N,). Raises RecordError unless it holds real, finite numbers."""
    if samples.dtype.kind not in "iuf":
        raise RecordError(f"must be real numbers, got {samples.dtype}", rows.file, channel=name)
    if samples.dtype.kind in "iu":
        return [f"{name}: integers were taken as values in {name.unit}; counts need a unit."]
    beyond = np.flatnonzero(np.abs(samples) > LARGEST)
    if len(beyond):
        message = f"the value is {_beyond(samples[beyond[0]])}; leave the cell of an overloaded sample empty"
        raise rows.error(message, int(beyond[0]), name)
    missing = int(np.isnan(samples).sum())
    return [f"{name}: {missing} of {len(samples)} samples are missing."] if missing else []


def check_responses(names: Iterable[Channel], values: Floats, file: str | None) -> None:
    """Raise RecordError for a response without information: missing throughout, constant, or a copy of another.

    `values` (N, C) are the columns of the channels `names`; inputs may be constant or equal.
    """
    names_by_samples: dict[bytes, str] = {}
    for column, name in enumerate(names):
        if name.is_input:
            continue
        samples = values[:, column]
        present = samples[~np.isnan(samples)]
        if not len(present):
            raise RecordError("every sample is missing; leave the channel out", file, channel=name)
        if np.all(present == present[0]):
            message = (
                f"every sample is {present[0]:g}: a constant channel carries no information; leave it out"
            )
            raise RecordError(message, file, channel=name)
        peak = np.max(np.abs(present))
        # single precision, so that copies in different units compare equal
        with np.errstate(over="ignore"):
            key = np.append(samples / peak, peak).astype(np.float32).tobytes()
        if key in names_by_samples:
            message = f"has the same samples as {names_by_samples[key]}; one of the two is mislabelled"
            raise RecordError(message, file, channel=name)
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
    piece = max(stretches(~missing), key=lambda piece: piece.stop - piece.start)
    earliest, latest = start + piece.start / rate, start + (piece.stop - 1) / rate
    raise IdentificationError(
        f"channel {name}: {missing.sum()} of {len(samples)} samples are missing, the first at "
        f"{start + int(np.argmax(missing)) / rate:.9g} s, and inputs must be complete; cut the record to a piece without gaps "
        f"(the longest is from {earliest:.9g} to {latest:.9g} s: record.between({earliest:.9g}, {latest:.9g})), or "
        "interpolate across gaps that are short against the changes of this input",
        arguments=("earliest", "latest"),
    )
