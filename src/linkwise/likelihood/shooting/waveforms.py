"""What sensors add to their signals over time, in known shapes of unknown size: drift by pieces of a line, and hum.

A drift is a line of pieces, each of which rises from 0 to 1 after the one before and stays there. A hum is a cosine and a
sine of one frequency, of which amplitude and phase follow.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.display import near_miss
from linkwise.errors import IdentificationError
from linkwise.records.record import Record

PIECES, MOST_PIECES = 8, 64
"""Pieces of a drift in each record, and the most that may be asked for: more would follow the motion itself."""


@dataclass(frozen=True, eq=False)
class Waveforms:
    """`values` (M, w, K) at the samples, per unit of the size, that w waveforms add to their `channel` (w,)."""

    channel: Indices
    values: Floats

    def chosen(self, which: Indices) -> Waveforms:
        """Those in some of the segments."""
        return Waveforms(self.channel, self.values[..., which])

    def added(self, channel: int, sizes: Floats) -> Floats:
        """(M, K) what waveforms of these `sizes` (w,) add to a channel."""
        own = self.channel == channel
        return np.asarray(np.einsum("w,mwk->mk", sizes[own], self.values[:, own]))


@dataclass(frozen=True)
class Disturbance:
    """A drift, or a hum of some `frequency` in Hz, of a channel in the record number `record`, in `count` waveforms.

    A drift from an `unknown_start` has a constant as the first of them.
    """

    channel: str
    record: int
    count: int
    frequency: float | None = None
    unknown_start: bool = False

    @classmethod
    def of(
        cls,
        drifts: Mapping[str, float | None],
        hums: Mapping[str, Sequence[float]],
        records: Sequence[Record],
        unknown_starts: Collection[str] = (),
    ) -> tuple[Disturbance, ...]:
        """Those of some channels in every record, each with sizes of its own.

        `drifts` has the lengths of pieces in s, `hums` frequencies in Hz; drifts of the channels in `unknown_starts` may start
        anywhere.

        Raises IdentificationError for a channel that no record has as a response, pieces that are too many, and a frequency
        beyond half the rate.
        """
        responses = records[0].responses
        for name in (*drifts, *hums):
            if name not in responses:
                raise IdentificationError(
                    f"no drift or hum of {name} can be estimated{near_miss(name, responses)}: the record has the sensors "
                    f"{', '.join(responses)}",
                    arguments=("drifts",) if name in drifts else ("hums",),
                )
        for name, seconds in drifts.items():
            longest = max(record.duration for record in records)
            if seconds is not None and not longest / MOST_PIECES <= seconds < np.inf:
                raise IdentificationError(
                    f"the pieces of the drift of {name} must be {longest / MOST_PIECES:.3g} s long at least, got {seconds:g} "
                    f"s: more than {MOST_PIECES} of them would follow the motion",
                    arguments=("drifts",),
                )
        half = min(record.rate for record in records) / 2.0
        for name, frequency in ((name, frequency) for name, several in hums.items() for frequency in several):
            if not 0.0 < frequency < half:
                raise IdentificationError(
                    f"the hum of {name} must have a frequency between 0 and half the rate, {half:g} Hz, got {frequency:g} Hz",
                    arguments=("hums",),
                )
        return tuple(
            disturbance
            for number, record in enumerate(records)
            for disturbance in (
                *(
                    cls(name, number, _pieces(record, seconds) + start, unknown_start=start)
                    for name, seconds in drifts.items()
                    for start in [name in unknown_starts]
                ),
                *(cls(name, number, 2, frequency) for name, several in hums.items() for frequency in several),
            )
        )

    def shapes(self, record: Record) -> Floats:
        """(N, count) its waveforms at the samples of a record."""
        elapsed = record.time - record.start
        if self.frequency is not None:
            phase = 2.0 * np.pi * self.frequency * elapsed
            return np.stack([np.cos(phase), np.sin(phase)], axis=1)
        count = self.count - self.unknown_start
        pieces = elapsed / max(record.duration, np.finfo(float).tiny) * count
        rising = np.clip(pieces[:, None] - np.arange(count), 0.0, 1.0)
        return np.insert(rising, 0, 1.0, axis=1) if self.unknown_start else rising

    def describe(self, sizes: Floats, deviations: Floats, unit: str) -> str:
        """A sentence on what was found, from the sizes (count,) and their standard deviations."""
        error = float(np.sqrt(np.mean(deviations**2)))
        if self.frequency is not None:
            amplitude = float(np.hypot(*sizes))
            return (
                f"{self.channel} has a hum of {amplitude:.4g} {unit} at {self.frequency:g} Hz (estimated with the other "
                f"unknowns, standard error {error:.2g})."
            )
        first = [] if self.unknown_start else [0.0]
        path = np.concatenate([first, np.cumsum(sizes)])
        return (
            f"{self.channel} drifts over {np.ptp(path):.4g} {unit} (estimated with the other unknowns in {len(path) - 1} "
            f"pieces, standard error of each {error:.2g})."
        )


def _pieces(record: Record, seconds: float | None) -> int:
    return PIECES if seconds is None else max(1, round(record.duration / seconds))


def lengths_by_channel(drifts: str | Sequence[str] | Mapping[str, float | None]) -> dict[str, float | None]:
    """Channels that drift, with the lengths of pieces in s where they are stated.

    Parameters
    ----------
    drifts : str, sequence of str or mapping of str to float or None
        A channel, several, or the lengths by channel.

    Returns
    -------
    dict of str to float or None
        The lengths by channel.

    Raises
    ------
    IdentificationError
        If a length is no positive number.
    """
    if not isinstance(drifts, Mapping):
        return dict.fromkeys((drifts,) if isinstance(drifts, str) else drifts or ())
    for name, seconds in drifts.items():
        if seconds is not None and not (_is_number(seconds) and seconds > 0.0):
            raise IdentificationError(
                f"the pieces of the drift of {name} must have a positive length in s, got {seconds!r}"
            )
    return dict(drifts)


def frequencies_by_channel(hums: Mapping[str, float | Sequence[float]]) -> dict[str, tuple[float, ...]]:
    """Frequencies of hums in Hz by channel.

    Parameters
    ----------
    hums : mapping of str to float or sequence of float
        One frequency or several.

    Returns
    -------
    dict of str to tuple of float
        The frequencies.

    Raises
    ------
    IdentificationError
        If they are not numbers by channel.
    """
    frequencies = {}
    for name, several in hums.items() if isinstance(hums, Mapping) else [(hums, None)]:
        values: object = (several,) if _is_number(several) else several
        if isinstance(values, str) or not isinstance(values, Sequence) or not all(map(_is_number, values)):
            raise IdentificationError(
                f'hums takes frequencies in Hz by channel, as in {{"x:m1": 50.0}}, got {hums!r}'
            )
        frequencies[str(name)] = tuple(float(frequency) for frequency in values)
    return frequencies


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
