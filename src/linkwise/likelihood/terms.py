"""What is unknown of a sensor or an input beside the coefficients: one class a kind, in one interface.

A `Term` says what it puts among the unknowns of a fit, what is known of these beforehand, what an error of unit size adds to
what a channel shows, by which it is estimated as well as tested, and how it is told once it is found. A kind that is tested
and can be admitted has its line in `ERRORS`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum, auto
from math import inf, isinf
from typing import Any, ClassVar, NamedTuple, Self, TypeAlias, TypeVar

import numpy as np
import scipy

from linkwise.arrays import Floats
from linkwise.display import near_miss
from linkwise.errors import IdentificationError
from linkwise.estimates.causes import (
    CAUSE_KINDS,
    CLOCK,
    CROSSTALK,
    GAIN_DRIFT,
    HIGH_PASS,
    HUM,
    NONLINEARITY,
    Cause,
    SensorErrorEstimate,
)
from linkwise.records.channel import BAND_LIMITED, BASE, COMMON, FORCE, Channel, interpolated
from linkwise.records.record import Record
from linkwise.registry import Registry
from linkwise.signals.base_frame import FramedRecord
from linkwise.signals.force_window import COARSE

Stated: TypeAlias = str | Sequence[str] | Mapping[str, float | None]
"""A channel, several, or numbers by channel, None where one is not stated."""
NoisyFrames: TypeAlias = Sequence[tuple[FramedRecord, Mapping[str, float]]]
"""Records in the coordinates of the equations, with the standard deviations of their noise by channel."""
PPM = 1e-6
PIECES, MOST_PIECES = 8, 64
"""Pieces of a drift in each record, and the most that may be asked for: more would follow the motion itself."""
_FASTEST = 5e4  # ppm: beyond, a record has another rate
_STATED = 1e-4  # relative: to which a corner that is stated is known, so that the equations need no case of their own
_BINS = 15  # of a spectrum, over which its power is averaged
_TINY = float(np.finfo(float).tiny)


def numbers_by_channel(stated: Stated) -> dict[str, float | None]:
    """The numbers that are stated, None where one is not."""
    names = (stated,) if isinstance(stated, str) else stated or ()
    return dict(names) if isinstance(names, Mapping) else dict.fromkeys(names)


class Block(IntEnum):
    """Where an unknown stands behind the coefficients: sizes of what is added, gains and delays, in this order."""

    ADDED = auto()
    GAINS = auto()
    DELAYS = auto()


@dataclass(frozen=True, eq=False)
class Shown:
    """What a channel shows, and a `ramp` from 0 to 1 along the record, arrays of one shape; the `duration` of that in s; and
    what gives the `rate` of what is shown, and its `integral` beside the mean.
    """

    value: Floats
    ramp: Floats
    duration: float | Floats
    rate: Callable[[], Floats]
    integral: Callable[[], Floats]

    @classmethod
    def in_record(cls, record: Record, value: Floats) -> Shown:
        """What a channel shows in a record, as `value` (N,) has it."""
        elapsed = record.time - record.start
        return cls(
            value,
            elapsed / max(record.duration, _TINY),
            record.duration,
            lambda: interpolated(0.0, record.rate, value).derivative(elapsed),
            lambda: integrated(value, record.step),
        )


def integrated(values: Floats, step: float) -> Floats:
    """(N,) the integral of what samples (N,) show beside their mean, from 0 at the first."""
    centred = values - values.mean()
    return np.concatenate([[0.0], np.cumsum(0.5 * step * (centred[1:] + centred[:-1]))])


@dataclass(frozen=True, eq=False)
class Unknown:
    """What a term puts among the unknowns: some sizes, of which `known` has means and standard deviations.

    They are those of a `channel`, named as the equations name it; of waveforms in the record number `record`, at whose samples
    a size of 1 adds `shapes` (N, count), else in all records, which a constant shifts by as much.
    """

    term: Term
    channel: str
    known: Sequence[tuple[float, float]]
    record: int | None = None
    shapes: Floats = field(default_factory=lambda: np.ones((1, 1)), repr=False)

    @property
    def count(self) -> int:
        return len(self.known)

    def in_record(self, number: int, samples: int) -> Floats:
        """(N, count) what sizes of 1 add to the N samples of the record of a number."""
        acts = self.record in (None, number)
        return np.broadcast_to(self.shapes if acts else 0.0, (samples, self.count))


class Found(NamedTuple):
    """What a fit found of an unknown: its `sizes` (count,) and their standard deviations."""

    unknown: Unknown
    sizes: Floats
    deviations: Floats

    @property
    def term(self) -> Term:
        return self.unknown.term

    @property
    def error(self) -> float:
        """Root mean square of the standard deviations."""
        return float(np.sqrt(np.mean(self.deviations**2)))


@dataclass(frozen=True)
class Term(ABC):
    """An error of a `channel`, named as the record names it; the `argument` of `identify` asks for one of its `kind`."""

    channel: str
    kind: ClassVar[str]
    argument: ClassVar[str]
    block: ClassVar[Block] = Block.ADDED
    null: ClassVar[float] = 0.0

    @classmethod
    def named_by(cls, cause: Cause) -> Self:
        """The error that a cause names."""
        return cls(cause.where)

    @property
    def unit(self) -> str:
        """That of its size; empty where it is that of the channel."""
        return CAUSE_KINDS[self.kind].unit

    @property
    def known(self) -> tuple[float, float]:
        """Mean and standard deviation to which its first size is known beforehand."""
        return self.null, inf

    @abstractmethod
    def columns(self, shown: Shown) -> list[Floats]:
        """What each of its sizes, if 1, adds to what the channel shows of the motion."""

    @classmethod
    def tested(cls, shown: Shown) -> Floats:
        """What is tested: its first column, beside which others are what a start leaves open."""
        return cls("").columns(shown)[0]

    def refusal(self, records: Sequence[Record]) -> str:
        """Why it cannot be estimated from these records; empty where it can."""
        sensors = self.sensors(records[0])
        if self.channel in sensors:
            return ""
        there = ", ".join(name for name in sensors if name != COMMON)
        return f"no {self.kind} of {self.channel} can be estimated{near_miss(self.channel, sensors)}: " + (
            f"the record has {there}" if there else "the record has no sensor with one"
        )

    def sensors(self, record: Record) -> Sequence[str]:
        """The channels of which there may be one."""
        return record.responses

    def unknowns(self, frames: NoisyFrames) -> Iterator[Unknown]:
        """What is unknown of it in some records."""
        yield Unknown(self, frames[0][0].names.get(self.channel, self.channel), [self.known])

    def estimate(self, value: float, error: float, unit: str) -> SensorErrorEstimate | None:
        """How its size is reported, in the unit of the channel or its own; None of what is told in sentences or was stated."""
        return SensorErrorEstimate(self.channel, self.kind, value, error, self.unit or unit)

    def beside(self, errors: Sequence[Term], record: Record) -> tuple[Term, ...] | None:
        """The errors with this one, of which nothing is known; None where it is there, or is one of no sensor."""
        is_there = any(one.channel == self.channel for one in of_kind(errors, type(self)))
        return None if is_there or self.channel not in self.sensors(record) else (*errors, self)


T = TypeVar("T", bound=Term)


def of_kind(errors: Iterable[Term], kind: type[T]) -> list[T]:
    """Those of one kind."""
    return [one for one in errors if isinstance(one, kind)]


@dataclass(frozen=True)
class Constant(Term):
    """A number that is the same in all records, known to within a `deviation`."""

    deviation: float = inf

    @property
    def known(self) -> tuple[float, float]:
        return self.null, self.deviation


@dataclass(frozen=True)
class Offset(Constant):
    """What a sensor shows beside the motion throughout."""

    kind, argument = "offset", "offsets"

    def columns(self, shown: Shown) -> list[Floats]:
        return [np.ones_like(shown.value)]


@dataclass(frozen=True)
class Gain(Constant):
    """The factor by which a sensor, or the channel of a force or of an accelerating base, is too large."""

    kind, argument = "gain", "gains"
    block = Block.GAINS
    null = 1.0

    def columns(self, shown: Shown) -> list[Floats]:
        return [shown.value]

    def sensors(self, record: Record) -> Sequence[str]:
        return (*record.responses, *record.forces, *accelerating_base(record), COMMON)


@dataclass(frozen=True)
class Delay(Constant):
    """How late a channel is in s, of which `taken_out` has been taken out of the records.

    Of one that is `near`, as a diagnosis or a clock tells, no shift far away is tried.
    """

    taken_out: float = 0.0
    near: bool = False
    kind, argument = "delay", "delays"
    block = Block.DELAYS

    @property
    def known(self) -> tuple[float, float]:
        return -self.taken_out, self.deviation

    def columns(self, shown: Shown) -> list[Floats]:
        return [-shown.rate()]

    def sensors(self, record: Record) -> Sequence[str]:
        of_masses = (name for name in record.responses if not name.of_link)
        return (*of_masses, *record.forces, *accelerating_base(record))

    def estimate(self, value: float, error: float, unit: str) -> SensorErrorEstimate | None:
        return super().estimate(self.taken_out + value, error, unit)

    def taking_out(self, found: float) -> Delay:
        """The same with what was found of it taken out as well."""
        return replace(self, taken_out=self.taken_out + found)

    def beside(self, errors: Sequence[Term], record: Record) -> tuple[Term, ...] | None:
        late = late_channels(record, self.channel)
        is_there = {*late} <= {one.channel for one in of_kind(errors, Delay)}
        return None if is_there else nearly_on_time(errors, late)


def nearly_on_time(errors: Iterable[Term], late: Collection[str]) -> tuple[Term, ...]:
    """The errors with delays of some channels, near those that are taken out."""
    errors = [
        replace(one, near=True) if isinstance(one, Delay) and one.channel in late else one for one in errors
    ]
    known = {one.channel for one in of_kind(errors, Delay)}
    return (*errors, *(Delay(name, near=True) for name in late if name not in known))


def accelerating_base(record: Record) -> tuple[Channel, ...]:
    """The only channel of a base whose displacement is not recorded, so that its acceleration acts on the masses."""
    motions = record.motions_of(BASE)
    return motions if len(motions) == 1 and motions[0].order > 0 else ()


def late_channels(record: Record, channel: str) -> tuple[str, ...]:
    """The channels whose delays stand for that of a channel: all responses for the only input, late as they are early.

    That of one of several inputs is its own, and that of a base beside channels of links. None for one that is not
    band-limited between its samples, for a displacement of the base beside other inputs, and for a channel of a link.
    """
    base = accelerating_base(record)
    beside_links = channel in base and any(name.of_link for name in record.responses)
    if channel in record.inputs and (len(record.inputs) > 1 or beside_links):
        is_smooth = record.interpolation.get(channel, BAND_LIMITED) == BAND_LIMITED
        return (channel,) if (channel.startswith(FORCE) or channel in base) and is_smooth else ()
    of_input = channel in record.inputs
    return tuple(name for name in record.responses if name.is_motion and (of_input or name == channel))


@dataclass(frozen=True)
class Waveform(Term):
    """What a sensor adds over time in known shapes, each of unknown size in every record."""

    wrong: ClassVar[str]
    """What is said of a number that cannot be stated."""

    @classmethod
    def stated(cls, stated: Stated) -> list[Self]:
        """Those of channels, with a number where one is stated; IdentificationError for one that cannot be."""
        kind: Any = cls
        numbers = numbers_by_channel(stated)
        for name, number in numbers.items():
            if number is not None and not (_is_number(number) and cls.is_possible(number)):
                raise IdentificationError(cls.wrong.format(name=name, number=number))
        return [kind(*pair) for pair in numbers.items()]

    @staticmethod
    def is_possible(number: float) -> bool:
        """Whether a number may be stated."""
        return number > 0.0

    def seen(self, frame: FramedRecord, number: int, noise: Mapping[str, float]) -> Floats:
        """(N,) what its columns follow from, in the record of this number."""
        return frame.record.channel(frame.names[self.channel])

    def unknowns(self, frames: NoisyFrames) -> Iterator[Unknown]:
        for number, (frame, noise) in enumerate(frames):
            columns = self.columns(Shown.in_record(frame.record, self.seen(frame, number, noise)))
            known = [self.known, *[(0.0, inf)] * (len(columns) - 1)]
            yield Unknown(self, frame.names[self.channel], known, number, np.stack(columns, axis=1))

    def gaps_in(self, records: Sequence[Record]) -> str:
        """That samples of the channel are missing; empty where none is."""
        if all(np.isfinite(record.channel(self.channel)).all() for record in records):
            return ""
        return (
            f"no {self.kind} of {self.channel} can be estimated: samples of it are missing, over which it has no integral and "
            "no rate"
        )


@dataclass(frozen=True)
class Disturbance(Waveform):
    """What a sensor adds of itself, which is told in a sentence."""

    @abstractmethod
    def description(self, found: Found, unit: str) -> str:
        """What was found of it in one record."""

    def estimate(self, value: float, error: float, unit: str) -> None:
        return None


@dataclass(frozen=True)
class Drift(Disturbance):
    """A slow drift: a line of pieces of a length in `seconds`, of 8 where None, from 0 or from `anywhere` at the start."""

    seconds: float | None = None
    anywhere: bool = False
    kind, argument = "drift", "drifts"
    wrong = "the pieces of the drift of {name} must have a positive length in s, got {number!r}"

    def columns(self, shown: Shown) -> list[Floats]:
        longest = float(np.max(shown.duration))
        count = PIECES if self.seconds is None else max(1, round(longest / self.seconds))
        pieces = [np.clip(count * shown.ramp - number, 0.0, 1.0) for number in range(count)]
        return [np.ones_like(shown.ramp), *pieces] if self.anywhere else pieces

    @classmethod
    def tested(cls, shown: Shown) -> Floats:
        return cls("", inf).columns(shown)[0]

    def refusal(self, records: Sequence[Record]) -> str:
        shortest = max(record.duration for record in records) / MOST_PIECES
        if self.seconds is None or shortest <= self.seconds < inf:
            return super().refusal(records)
        return (
            f"the pieces of the drift of {self.channel} must be {shortest:.3g} s long at least, got {self.seconds:g} s: more "
            f"than {MOST_PIECES} of them would follow the motion"
        )

    def beside(self, errors: Sequence[Term], record: Record) -> tuple[Term, ...] | None:
        """The errors with a drift in one piece, or in more where that is there: these may follow the motion."""
        there = [one for one in of_kind(errors, Drift) if one.channel == self.channel]
        if not there:
            line = replace(self, seconds=record.duration)
            return Term.beside(line, errors, record)
        others = tuple(one for one in errors if one not in there)
        return (*others, self) if there[0].seconds == record.duration else None

    def description(self, found: Found, unit: str) -> str:
        path = np.concatenate([[] if self.anywhere else [0.0], np.cumsum(found.sizes)])
        return (
            f"{self.channel} drifts over {np.ptp(path):.4g} {unit} (estimated with the other unknowns in {len(path) - 1} "
            f"pieces, standard error of each {found.error:.2g})."
        )


@dataclass(frozen=True)
class Hum(Disturbance):
    """A hum of a `frequency` in Hz, of unknown amplitude and phase."""

    frequency: float = 0.0
    kind, argument = HUM, "hums"

    def columns(self, shown: Shown) -> list[Floats]:
        phase = 2.0 * np.pi * self.frequency * shown.duration * shown.ramp
        return [np.cos(phase), np.sin(phase)]

    def refusal(self, records: Sequence[Record]) -> str:
        half = min(record.rate for record in records) / 2.0
        if 0.0 < self.frequency < half:
            return super().refusal(records)
        return (
            f"the hum of {self.channel} must have a frequency between 0 and half the rate, {half:g} Hz, got "
            f"{self.frequency:g} Hz"
        )

    def description(self, found: Found, unit: str) -> str:
        return (
            f"{self.channel} has a hum of {float(np.hypot(*found.sizes)):.4g} {unit} at {self.frequency:g} Hz (estimated with "
            f"the other unknowns, standard error {found.error:.2g})."
        )


@dataclass(frozen=True)
class OfMotion(Waveform):
    """What a sensor shows beside the motion that follows from what it shows.

    Of its samples it would hold their noise as well, so that a fit is repeated with what the one before has `shown` by record.
    """

    shown: Sequence[Floats] = field(default=(), compare=False, repr=False, kw_only=True)

    def refusal(self, records: Sequence[Record]) -> str:
        return super().refusal(records) or self.gaps_in(records)

    def seen(self, frame: FramedRecord, number: int, noise: Mapping[str, float]) -> Floats:
        return self.shown[number] if self.shown else super().seen(frame, number, noise)

    def left(self, motion: Floats, samples: Floats, step: float, size: float) -> Floats:
        """(N,) what it follows from along a `motion` (N,) without noise, by the size that a fit to the samples (N,) found."""
        return motion


def _passed(motion: Floats, step: float, corner: float) -> Floats:
    """(N,) what a high pass of first order, at rest before, leaves of a motion (N,), by the trapezoidal rule."""
    half = np.pi * corner * step
    bands = np.array([[1.0 + half], [half - 1.0]]).repeat(len(motion), axis=1)
    integral = scipy.linalg.solve_banded(
        (1, 0), bands, np.append(0.0, 0.5 * step * (motion[1:] + motion[:-1]))
    )
    return np.asarray(motion - 2.0 * np.pi * corner * integral)


@dataclass(frozen=True)
class HighPass(OfMotion):
    """A high pass of first order, whose `corner` in Hz may be stated.

    It takes off a channel its corner times the integral of what that shows, beside a constant and a ramp from its state and
    its mean before, which a `drift` from anywhere holds. Noise adds up in the integral.
    """

    corner: float | None = None
    drift: bool = field(default=False, compare=False)
    kind, argument = HIGH_PASS, "corners"
    wrong = "the corner of {name} must be a positive frequency in Hz, got {number!r}"

    @property
    def known(self) -> tuple[float, float]:
        return (self.null, inf) if self.corner is None else (self.corner, _STATED * self.corner)

    def columns(self, shown: Shown) -> list[Floats]:
        slow = [] if self.drift else [np.ones_like(shown.ramp), shown.ramp]
        return [-2.0 * np.pi * shown.integral(), *slow]

    def left(self, motion: Floats, samples: Floats, step: float, size: float) -> Floats:
        """(N,) what the high pass leaves of a motion, and of its state at the start."""
        passed = _passed(motion, step, size)
        decay = np.exp(-2.0 * np.pi * size * step * np.arange(len(motion)))
        return np.asarray(passed + decay * (decay @ (samples - passed)) / (decay @ decay))

    def estimate(self, value: float, error: float, unit: str) -> SensorErrorEstimate | None:
        return super().estimate(value, error, unit) if self.corner is None else None


@dataclass(frozen=True)
class Crosstalk(Waveform):
    """A part of what the channel `source` shows, which a channel of the same kind shows as well."""

    source: str = ""
    kind, argument = CROSSTALK, "admit"

    @classmethod
    def named_by(cls, cause: Cause) -> Self:
        return cls(cause.where, source=cause.source)

    def columns(self, shown: Shown) -> list[Floats]:
        return [shown.value]

    def refusal(self, records: Sequence[Record]) -> str:
        return super().refusal(records) or replace(self, channel=self.source).gaps_in(records)

    def seen(self, frame: FramedRecord, number: int, noise: Mapping[str, float]) -> Floats:
        return frame.record.channel(frame.names[self.source])

    def estimate(self, value: float, error: float, unit: str) -> SensorErrorEstimate:
        return SensorErrorEstimate(self.channel, self.kind, value, error, self.unit, self.source)

    def beside(self, errors: Sequence[Term], record: Record) -> tuple[Term, ...] | None:
        return None if self in errors else (*errors, self)


@dataclass(frozen=True)
class GainDrift(OfMotion):
    """A gain that drifts by its size along a record."""

    kind, argument = GAIN_DRIFT, "admit"

    def columns(self, shown: Shown) -> list[Floats]:
        return [shown.value * shown.ramp]


@dataclass(frozen=True)
class Nonlinearity(OfMotion):
    """A cubic part of what a sensor shows, its size at the largest value that it shows."""

    kind, argument = NONLINEARITY, "admit"

    def columns(self, shown: Shown) -> list[Floats]:
        return [shown.value * (shown.value / max(np.abs(shown.value).max(), _TINY)) ** 2]

    @classmethod
    def tested(cls, shown: Shown) -> Floats:
        """Nothing where as few samples show it as a hit that is coarse, the shape of which between them is not known."""
        column = super().tested(shown)
        power = np.square(column)
        showing = float(np.sum(power)) ** 2 / max(float(np.sum(power**2)), _TINY)
        return column if showing > COARSE else np.zeros_like(column)


@dataclass(frozen=True)
class Clock(Waveform):
    """A clock that runs fast by a `ratio` in ppm, None where it is to be found; `taken_out` is taken out of the records.

    It makes its `members` late by the ratio of the time from the middle: sensors by that of their only input, as it is early.
    """

    ratio: float | None = None
    members: tuple[str, ...] = ()
    taken_out: float = 0.0
    kind, argument = CLOCK, "clocks"
    wrong = (
        "the clock of {name} must run fast by a number of ppm, negative for a slow one, and by less than "
        f"{_FASTEST:g} ppm, got {{number!r}}"
    )

    @staticmethod
    def is_possible(number: float) -> bool:
        return abs(number) < _FASTEST

    @property
    def late(self) -> dict[str, float]:
        """By which ratio each member is late, of what is taken out."""
        return dict.fromkeys(self.members, self._sign * self.taken_out)

    @property
    def _sign(self) -> float:
        return 1.0 if self.channel in self.members else -1.0

    def columns(self, shown: Shown) -> list[Floats]:
        return [PPM * shown.duration * (0.5 - shown.ramp) * shown.rate()]

    def refusal(self, records: Sequence[Record]) -> str:
        return next(filter(None, (one.gaps_in(records) for one in self._of_members)), "")

    @property
    def _of_members(self) -> list[Clock]:
        return [replace(self, channel=name) for name in self.members] if self.ratio is None else []

    def seen(self, frame: FramedRecord, number: int, noise: Mapping[str, float]) -> Floats:
        """What a channel shows, of moving coordinates as well, less frequencies at which it shows noise."""
        name = frame.names[self.channel]
        value = frame.record.channel(name)
        if name in frame.carried:
            value = value + frame.carried[name][0]
        spectrum = np.fft.rfft(value)
        power = scipy.ndimage.uniform_filter1d(np.abs(spectrum) ** 2 / len(value), _BINS)
        passed = np.clip(1.0 - noise[name] ** 2 / np.maximum(power, _TINY), 0.0, 1.0)
        return np.fft.irfft(passed * spectrum, len(value))

    def unknowns(self, frames: NoisyFrames) -> Iterator[Unknown]:
        for one in self._of_members:
            yield from (replace(of_one, term=self) for of_one in Waveform.unknowns(one, frames))

    def estimate(self, value: float, error: float, unit: str) -> SensorErrorEstimate | None:
        return super().estimate(self.taken_out + self._sign * value, error, unit)

    def taking_out(self, found: float) -> Clock:
        """The same with what was found of the ratio in its members taken out as well."""
        return replace(self, taken_out=self.taken_out + self._sign * found)

    def beside(self, errors: Sequence[Term], record: Record) -> tuple[Term, ...] | None:
        """The errors with the clock, and delays of its members in the middle of a record; None where it cannot be told."""
        members = late_channels(record, self.channel)
        is_there = any(one.channel == self.channel for one in of_kind(errors, Clock))
        if is_there or not members or self.channel not in self.sensors(record):
            return None
        clock = replace(self, members=members, taken_out=self.ratio or 0.0)
        return (*nearly_on_time(errors, members), clock)

    def sensors(self, record: Record) -> Sequence[str]:
        return record.responses if len(record.inputs) > 1 else record.channels


def beside_clocks(errors: Sequence[Term], clocks: Stated, record: Record) -> tuple[Term, ...]:
    """The errors with clocks of channels, and their ratios in ppm where they are stated.

    Raises IdentificationError for a ratio that is not small, and a channel whose clock cannot be told from those of other
    inputs.
    """
    for clock in Clock.stated(clocks):
        wider = clock.beside(errors, record)
        if wider is None:
            raise IdentificationError(
                f"no clock of {clock.channel} can be estimated{near_miss(clock.channel, clock.sensors(record))}; clocks are "
                "those of sensors of masses, or of the only input. Name the sensors that another device recorded",
                arguments=("clocks",),
            )
        errors = wider
    return tuple(errors)


ERRORS: Registry[type[Term]] = Registry(
    "error of a sensor",
    {
        one.kind: one
        for one in (Gain, Offset, Delay, Drift, HighPass, Clock, Crosstalk, GainDrift, Nonlinearity)
    },
)
"""The kinds of errors that are tested along the motion of a fit, and that can be admitted."""


def frequencies_by_channel(hums: Mapping[str, float | Sequence[float]]) -> dict[str, tuple[float, ...]]:
    """Frequencies in Hz by channel, one or several of each; IdentificationError where they are no numbers by channel."""
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


def with_integrated(errors: Sequence[Term], frames: Sequence[FramedRecord]) -> tuple[Term, ...]:
    """The errors with drifts of sensors from which integrals of the motion of a base were taken, from anywhere.

    One whose offset is free starts from that.
    """
    if not any(frame.drifting for frame in frames):
        return tuple(errors)
    named = {plain: name for name, plain in frames[0].names.items()}
    integrals = dict.fromkeys(named[plain] for frame in frames for plain in frame.drifting)
    held = {one.channel for one in of_kind(errors, Offset) if isinf(one.deviation)}
    stated = {one.channel: one for one in of_kind(errors, Drift)}
    drifts = [replace(stated.get(name, Drift(name)), anywhere=name not in held) for name in integrals]
    anywhere = {one.channel for one in drifts if one.anywhere}
    others = (
        replace(one, drift=True) if isinstance(one, HighPass) and one.channel in anywhere else one
        for one in errors
        if not (isinstance(one, Drift) and one.channel in integrals)
    )
    return (*others, *drifts)


def known_to_within(errors: Sequence[Term], deviations: Mapping[str, float]) -> tuple[Term, ...] | None:
    """The errors with gains of channels, known to relative deviations; None where nothing is known of one of them."""
    if {*deviations} & {*unknown_gains(errors)}:
        return None
    others = (one for one in errors if not (isinstance(one, Gain) and one.channel in deviations))
    return (*others, *(Gain(name, deviation) for name, deviation in deviations.items()))


def unknown_gains(errors: Iterable[Term]) -> list[str]:
    """The channels of whose gains nothing is known."""
    return [one.channel for one in of_kind(errors, Gain) if isinf(one.deviation)]


def late_beside_clocks(errors: Sequence[Term]) -> list[str]:
    """The channels with an unknown delay that is not that of a clock."""
    members = {name for clock in of_kind(errors, Clock) for name in clock.members}
    return [one.channel for one in of_kind(errors, Delay) if one.channel not in members]
