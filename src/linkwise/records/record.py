"""What was seen: evenly sampled channels, measured or simulated, in SI units. Everything on the left ends
here.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from linkwise.arrays import Bools, Floats
from linkwise.errors import RecordError
from linkwise.records.channel import Channel
from linkwise.records.decimation import lowpass
from linkwise.records.timeline import Timeline
from linkwise.records.truth import SimulationTruth


@dataclass(frozen=True, eq=False, repr=False)
class Record:
    """N samples of C channels at `start` + k/`rate`.

    `values` (N, C) float64, read-only, in the SI unit of each channel, NaN where a sample is missing;
    `noise` the standard deviation of a channel where the user knows it; `simulated` the truth, for a
    simulated record only; `source` says where the record comes from and `notes` what was done to it on the
    way, each a sentence for the user.

    Raises RecordError for shapes that do not fit, names that are no channels or stand twice, and infinite
    values. What makes a *measured* record useless (a dead sensor, one sensor under two names) is refused by
    `from_arrays`, since a simulated structure may well have a mass that rests or two that move alike.
    """

    start: float
    rate: float
    channels: tuple[str, ...]
    values: Floats
    noise: Mapping[str, float] = field(default_factory=dict)
    simulated: SimulationTruth | None = None
    source: str = ""
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "start", float(self.start))
        object.__setattr__(self, "rate", float(self.rate))
        object.__setattr__(self, "channels", tuple(self.channels))
        object.__setattr__(self, "notes", tuple(self.notes))
        object.__setattr__(self, "values", _frozen(self.values))
        object.__setattr__(self, "noise", MappingProxyType(dict(self.noise)))
        self._check_names()
        self._check_values()

    def _check_names(self) -> None:
        for name in self.channels:
            Channel.parse(name)
        twice = [name for i, name in enumerate(self.channels) if name in self.channels[:i]]
        if twice:
            raise RecordError("stands twice in the record; a channel may stand once", channel=twice[0])
        for name, sigma in self.noise.items():
            if name not in self.channels:
                raise RecordError(
                    f"noise is given for a channel that is not there; there are {self._listed}", channel=name
                )
            if not (np.isfinite(sigma) and sigma >= 0.0):
                raise RecordError(
                    f"a standard deviation of {sigma!r} cannot be; it is a number >= 0", channel=name
                )

    def _check_values(self) -> None:
        if not (np.isfinite(self.rate) and self.rate > 0.0):
            raise RecordError(f"a sampling rate of {self.rate!r} Hz cannot be; it is a number above 0")
        if not np.isfinite(self.start):
            raise RecordError(f"a record cannot start at {self.start!r} s")
        if self.values.ndim != 2 or self.values.shape[1] != len(self.channels):
            raise RecordError(
                f"values have the shape {self.values.shape}, expected (samples, {len(self.channels)}) for "
                f"the channels {self._listed}"
            )
        if not self.channels or not len(self.values):
            raise RecordError("a record needs at least one channel and one sample")
        infinite = np.argwhere(np.isinf(self.values))
        if len(infinite):
            row, column = infinite[0]
            raise RecordError(
                f"the value at {self.start + row / self.rate:g} s is infinite; a sample that is missing is "
                "NaN",
                channel=self.channels[column],
            )

    @classmethod
    def from_arrays(
        cls,
        time: ArrayLike,
        channels: Mapping[str, ArrayLike],
        *,
        noise: Mapping[str, float] | None = None,
        source: str = "",
        notes: Iterable[str] = (),
        file: str | None = None,
        lines: NDArray[np.int64] | None = None,
    ) -> Record:
        """A measured record from a time column in s and one array per channel name, in SI units.

        The time must be even but for the rounding of printed figures; steps that are whole multiples are
        gaps, filled with missing samples. `file` and `lines` (N,) are for the errors of a file reader.
        Raises RecordError for an uneven time, unequal lengths, fewer than 32 samples, a response that is
        constant, missing throughout or equal to another.
        """
        moments = np.asarray(time)
        if moments.ndim != 1 or moments.dtype.kind not in "iuf":
            raise RecordError(
                f"time must be one column of numbers, not {moments.dtype} of shape {moments.shape}", file
            )
        timeline = Timeline.fit(moments, file=file, lines=lines)
        told = [*notes, *timeline.notes]
        values = np.full((timeline.count, len(channels)), np.nan)
        for column, (name, array) in enumerate(channels.items()):
            samples = np.asarray(array)
            if samples.shape != moments.shape:
                raise RecordError(
                    f"has the shape {samples.shape}, the time {moments.shape}", file, channel=name
                )
            told += _samples_notes(name, samples, file, lines)
            values[timeline.index, column] = samples
        values.setflags(write=False)
        _refuse_dead(tuple(channels), values, file)
        origin = source or (file or "")
        return cls(
            timeline.start, timeline.rate, tuple(channels), values, noise or {}, None, origin, tuple(told)
        )

    def __len__(self) -> int:
        return len(self.values)

    def __repr__(self) -> str:
        last = self.start + (len(self) - 1) / self.rate
        absent = int(self.missing.sum())
        gaps = f"; {absent} samples missing" if absent else ""
        span = f"{len(self)} samples at {self.rate:g} Hz, {self.start:g} to {last:g} s"
        return f"Record of {span}: {self._listed}{gaps}"

    @property
    def _listed(self) -> str:
        return ", ".join(self.channels) or "no channels"

    @cached_property
    def time(self) -> Floats:
        """(N,) s, read-only."""
        return _frozen(self.start + np.arange(len(self)) / self.rate)

    @property
    def step(self) -> float:
        """The sampling interval in s."""
        return 1.0 / self.rate

    @property
    def duration(self) -> float:
        """From the first sample to the last, in s."""
        return (len(self) - 1) / self.rate

    @cached_property
    def missing(self) -> Bools:
        """(N, C), True where a sample is missing."""
        absent = np.isnan(self.values)
        absent.setflags(write=False)
        return absent

    @property
    def responses(self) -> tuple[str, ...]:
        """The channels that tell how the structure moved."""
        return tuple(name for name in self.channels if not Channel.parse(name).is_input)

    @property
    def inputs(self) -> tuple[str, ...]:
        """The channels that tell what drove it: applied forces and base motion."""
        return tuple(name for name in self.channels if Channel.parse(name).is_input)

    @property
    def masses(self) -> tuple[str, ...]:
        """The masses with a sensor on them, in order of appearance."""
        return tuple(dict.fromkeys(Channel.parse(name).mass for name in self.responses))

    def unit(self, name: str) -> str:
        """The SI unit of a channel."""
        self._column(name)
        return Channel.parse(name).unit

    def _column(self, name: str) -> int:
        if name not in self.channels:
            raise RecordError(f"is not in the record; there are {self._listed}", channel=name)
        return self.channels.index(name)

    def channel(self, name: str) -> Floats:
        """(N,) read-only values of one channel; RecordError lists what there is."""
        return self.values[:, self._column(name)]

    def select(self, names: Iterable[str]) -> Record:
        """The same record with these channels only, in this order."""
        chosen = tuple(names)
        columns = [self._column(name) for name in chosen]
        noise = {name: self.noise[name] for name in chosen if name in self.noise}
        return replace(self, channels=chosen, values=self.values[:, columns], noise=noise)

    def __getitem__(self, which: slice) -> Record:
        if not isinstance(which, slice) or which.step not in (None, 1):
            raise RecordError(
                "a record is cut as record[first:last], without a step; record.decimate(factor) thins it out"
            )
        first, last, _ = which.indices(len(self))
        if last <= first:
            raise RecordError(f"record[{first}:{last}] holds nothing; the record has {len(self)} samples")
        return replace(
            self,
            start=self.start + first / self.rate,
            values=self.values[first:last],
            simulated=self.simulated and self.simulated.rows(slice(first, last)),
        )

    def between(self, earliest: float, latest: float) -> Record:
        """The samples from `earliest` to `latest` in s, both included; either may be infinite.

        Raises RecordError where there is no sample between them, and for a time that is no number.
        """
        if np.isnan(earliest) or np.isnan(latest):
            raise RecordError(f"a record is cut between two times, got {earliest:g} and {latest:g} s")
        edge = 1e-6  # of a step: a bound that was typed in decimals is meant to hit the sample
        ends = np.array([earliest - self.start, latest - self.start]) * self.rate
        ends = np.clip(ends, -1.0, len(self))
        first = max(0, int(np.ceil(ends[0] - edge)))
        last = min(len(self), int(np.floor(ends[1] + edge)) + 1)
        if last <= first:
            end = self.start + self.duration
            raise RecordError(
                f"no sample between {earliest:g} and {latest:g} s; the record runs from {self.start:g} to "
                f"{end:g} s"
            )
        return self[first:last]

    def decimate(self, factor: int) -> Record:
        """Every `factor`-th sample behind an anti-alias filter (see `decimation.lowpass` for its figures).

        The filter is symmetric, so nothing shifts in time; the samples at both ends that it cannot reach are
        dropped. Known noise is reduced as the filter reduces white noise; the truth of a simulated record is
        picked, not filtered. Raises RecordError where samples are missing and where less than one sample
        would be left.
        """
        if isinstance(factor, bool) or int(factor) != factor or factor < 1:
            raise RecordError(f"a record is decimated by a whole number above 0, not by {factor!r}")
        if factor == 1:
            return self
        if self.missing.any():
            name = self.channels[int(np.argmax(self.missing.any(axis=0)))]
            raise RecordError(
                "samples are missing, and no filter crosses a gap; cut whole pieces with record.between "
                "first",
                channel=name,
            )
        filter_ = lowpass(int(factor))
        if len(self) < filter_.length:
            raise RecordError(
                f"{len(self)} samples are too few to decimate by {factor}: its anti-alias filter spans "
                f"{filter_.length}"
            )
        values = filter_.apply(self.values)
        kept = slice(filter_.half, len(self) - filter_.half, int(factor))
        return replace(
            self,
            start=self.start + filter_.half / self.rate,
            rate=self.rate / factor,
            values=values,
            noise={name: sigma * filter_.noise_gain for name, sigma in self.noise.items()},
            simulated=self.simulated and self.simulated.rows(kept),
            notes=(
                *self.notes,
                f"Decimated by {factor}; {filter_.half} samples at each end went into the filter.",
            ),
        )

    def with_noise(self, decibel: float, *, seed: int) -> Record:
        """White Gaussian noise on every response, at this signal-to-noise ratio per channel.

        METHODS section 2 and the paper: sigma^2 = mean(x^2) 10^(-dB/10), x the channel as it is, mean
        included; missing samples do not count. Each channel draws from its own generator, made from `seed`
        and the channel's name, so its noise is the same whatever other channels there are. What was added
        stands in `simulated.noise` as part of the truth, not in `noise`: a user would not know it (noise
        that was known before is forgotten, since it is no longer the whole).
        """
        if not np.isfinite(decibel):
            raise RecordError(
                f"a signal-to-noise ratio of {decibel!r} dB cannot be; leave the noise out instead"
            )
        values = self.values.copy()
        added = {}
        for name in self.responses:
            column = self._column(name)
            samples = values[:, column]
            sigma = (
                float(np.sqrt(np.nanmean(samples**2) * 10.0 ** (-decibel / 10.0)))
                if not np.isnan(samples).all()
                else 0.0
            )
            generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(name.encode())))
            samples += sigma * generator.standard_normal(len(self))
            before = self.simulated.noise.get(name, 0.0) if self.simulated else 0.0
            added[name] = float(np.hypot(sigma, before))
        values.setflags(write=False)
        return replace(
            self,
            values=values,
            noise={name: sigma for name, sigma in self.noise.items() if name not in added},
            simulated=self.simulated and replace(self.simulated, noise=added),
            notes=(*self.notes, f"Noise of {decibel:g} dB per channel was added (seed {seed})."),
        )


def _frozen(values: ArrayLike) -> Floats:
    """`values` as a read-only float64 array in C order, copied unless it is one already."""
    array = np.asarray(values)
    if array.flags.writeable or array.dtype != np.float64 or not array.flags.c_contiguous:
        array = np.array(array, dtype=np.float64, order="C")
        array.setflags(write=False)
    return array


def _samples_notes(
    name: str, samples: NDArray[np.generic], file: str | None, lines: NDArray[np.int64] | None
) -> list[str]:
    """What the user should know of one measured column (N,); RecordError unless it holds real, finite numbers."""
    if samples.dtype.kind not in "iuf":
        raise RecordError(f"must be real numbers, not {samples.dtype}", file, channel=name)
    if samples.dtype.kind in "iu":
        return [
            f"{name}: whole numbers, taken as they are in {Channel.parse(name).unit}; counts need a unit."
        ]
    infinite = np.flatnonzero(np.isinf(samples))
    if len(infinite):
        row = int(infinite[0])
        line = None if lines is None else int(lines[row])
        where = "" if line else f" (sample {row})"
        message = f"the value is infinite{where}; an overload is no sample, leave its cell empty"
        raise RecordError(message, file, line, name)
    absent = int(np.isnan(samples).sum())
    return [f"{name}: {absent} of {len(samples)} samples are missing."] if absent else []


def _refuse_dead(names: tuple[str, ...], values: Floats, file: str | None) -> None:
    """RecordError for a response that says nothing: missing throughout, constant, or a copy of another."""
    seen: dict[bytes, str] = {}
    for column, name in enumerate(names):
        if Channel.parse(name).is_input:
            continue
        samples = values[:, column]
        there = samples[~np.isnan(samples)]
        if not len(there):
            raise RecordError("every sample is missing; leave the channel out", file, channel=name)
        if np.all(there == there[0]):
            raise RecordError(
                f"every sample is {there[0]:g}: a sensor that does not move tells nothing; leave the "
                "channel out",
                file,
                channel=name,
            )
        peak = np.max(np.abs(there))
        key = (
            np.append(samples / peak, peak).astype(np.float32).tobytes()
        )  # alike but for the rounding of units
        if key in seen:
            raise RecordError(
                f"holds the same samples as {seen[key]}; one of them is not what it says", file, channel=name
            )
        seen[key] = name
