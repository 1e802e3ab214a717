"""Channels: a kind of quantity at a mass or the base, `KIND:MASS`, or of a link, `f:LINK` and `state:LINK.NAME`, or a signal
that laws name, `signal:NAME`, their units, and what a record states of them beside their samples.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from math import isinf, isnan
from typing import Any, Literal, NamedTuple

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import RecordError, expect
from linkwise.model.excitation import Sampled
from linkwise.model.law import unit_dimension
from linkwise.units import converts, factor_to_si


class Kind(NamedTuple):
    """A kind of channel: its quantity, the SI units of it (of places that turn: `angular_unit`), and of what it is one.

    `order` counts the derivatives of a displacement; None where it is no motion.
    """

    quantity: str
    unit: str
    angular_unit: str = ""
    of: Literal["mass", "link", "state", "signal"] = "mass"
    order: int | None = None
    is_input: bool = False


KINDS = {
    "x": Kind("displacement", "m", "rad", order=0),
    "v": Kind("velocity", "m/s", "rad/s", order=1),
    "a": Kind("acceleration", "m/s^2", "rad/s^2", order=2),
    "force": Kind("applied force", "N", "N m", is_input=True),
    "f": Kind("force in a link", "N", "N m", of="link"),
    "state": Kind("state of a link", "?", of="state"),
    "signal": Kind("signal of a law", "?", of="signal", is_input=True),
}
"""All kinds, and all that other modules know of them; a place is a mass, a point of a host or the base."""
MOTIONS = tuple(key for key, kind in KINDS.items() if kind.order is not None)
ANGULAR_UNITS = frozenset(kind.angular_unit for kind in KINDS.values() if kind.angular_unit)
BASE = "base"
FORCE = "force:"  # with which the names of applied forces begin
_RELATIVE = "rel:"
_RESERVED = frozenset(":[]()\"',;\t\n")


class Channel(str):
    """One sensor, or one input: its name, a text that is equal to any other of the same characters, and what that says.

    Parameters
    ----------
    kind : {"x", "v", "a", "force", "f", "state", "signal"}
        Displacement (m), velocity (m/s), acceleration (m/s^2), applied force (N), force in a link (N), state of a link, or
        signal that laws name.
    place : str
        Name of the mass, or "base" for the moving base; of a link or a signal its name, of a state "LINK.NAME".
    relative : bool, optional
        Whether a sensor shows the motion of the mass relative to the base, as "rel:x:m1" does.

    Examples
    --------
    >>> import linkwise as lw
    >>> channel = lw.records.Channel.parse("v:m1")
    >>> channel, channel.kind, channel.place, channel.unit, channel.is_input
    ('v:m1', 'v', 'm1', 'm/s', False)
    """

    __slots__ = ("kind", "place", "relative")
    kind: str
    place: str
    relative: bool

    def __new__(cls, kind: str, place: str, relative: bool = False) -> Channel:
        channel = super().__new__(cls, f"{_RELATIVE if relative else ''}{kind}:{place}")
        for name, value in (("kind", kind), ("place", place), ("relative", relative)):
            object.__setattr__(channel, name, value)
        return channel

    def __reduce__(self) -> tuple[type[Channel], tuple[str, str, bool]]:
        return Channel, (self.kind, self.place, self.relative)

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"the {name} of a channel cannot be changed")

    @classmethod
    def parse(cls, name: str) -> Channel:
        """Read the name of a channel.

        Parameters
        ----------
        name : str
            KIND:MASS, such as "x:m1".

        Returns
        -------
        Channel
            The channel.

        Raises
        ------
        RecordError
            If it is not the name of a channel.
        """
        if isinstance(name, Channel):
            return name
        if type(name) is not str:  # a comparison takes no call
            expect("the name of a channel", name, str)
        relative = name.startswith(_RELATIVE)
        kind, _, place = name.removeprefix(_RELATIVE).partition(":")
        channel = cls(kind, place, relative)
        if not place or not kind:
            wrong = f"expected KIND:MASS, such as x:m1, with KIND one of {', '.join(KINDS)}"
        elif kind not in KINDS:
            known = ", ".join(f"{key} ({kind.quantity}, {kind.unit})" for key, kind in KINDS.items())
            wrong = f"unknown kind {kind!r}; choose from {known}"
        elif place != place.strip() or _RESERVED & set(place):
            unit = ": a record is in SI units, which its channels do not state" if "[" in place else ""
            wrong = f"{place!r} is not a valid name of a {KINDS[kind].of}{unit}"
        elif kind == "force" and place == BASE:
            wrong = "a base is moved by x:base, v:base or a:base, not by a force"
        elif kind == "state" and not (channel.link and channel.state):
            wrong = "a state is written state:LINK.NAME"
        elif relative and (not channel.is_motion or place == BASE):
            wrong = "only the motion of a mass is relative to the base, as in rel:x:m1"
        else:
            return channel
        raise RecordError(f"{name!r} is not a channel: {wrong}")

    @classmethod
    def parse_all(cls, names: Iterable[str]) -> tuple[Channel, ...]:
        """Read the names of channels.

        Parameters
        ----------
        names : iterable of str
            The names, as of `parse`.

        Returns
        -------
        tuple of Channel
            The channels.

        Raises
        ------
        RecordError
            If one is not the name of a channel.
        """
        return tuple(map(cls.parse, names))

    @property
    def is_motion(self) -> bool:
        """Whether it shows a displacement, a velocity or an acceleration."""
        return self.kind in MOTIONS

    @property
    def order(self) -> int:
        """Which derivative of a displacement a motion is."""
        return MOTIONS.index(self.kind)

    @property
    def is_force(self) -> bool:
        """Whether it is an applied force."""
        return self.kind == "force"

    @property
    def of_link(self) -> bool:
        """Whether it shows the force in a link or its state."""
        return KINDS[self.kind].of in ("link", "state")

    @property
    def at_place(self) -> bool:
        """Whether it is at a mass, a point of a host or the base."""
        return KINDS[self.kind].of == "mass"

    @property
    def link(self) -> str:
        """The name of the link of such a channel."""
        return self.place.rpartition(".")[0] if self.kind == "state" else self.place

    @property
    def state(self) -> str:
        """The name that a state has in its link."""
        return self.place.rpartition(".")[2]

    @property
    def unit(self) -> str:
        """The SI unit where nothing turns; "?" of a state or a signal, which is in the unit that its law gives it."""
        return KINDS[self.kind].unit

    @property
    def angular_unit(self) -> str:
        """The SI unit where the place turns, in which a force is a moment; empty of a state."""
        return KINDS[self.kind].angular_unit

    @property
    def is_input(self) -> bool:
        """True for what drives the structure (applied force, base motion, signal), False for a response."""
        return KINDS[self.kind].is_input or (self.place == BASE and self.at_place)


HELD, LINEAR, BAND_LIMITED = INTERPOLATIONS = ("held", "linear", "band-limited")
ORDER_OF = {HELD: 0, LINEAR: 1, BAND_LIMITED: 5}
_ENOUGH = 64  # samples from which a windowed sinc interpolates accurately


def interpolated(start: float, rate: float, values: Floats, kind: str = BAND_LIMITED) -> Sampled:
    """The input with samples `values` (N,) and what runs between them."""
    band_limited = kind == BAND_LIMITED and len(values) > _ENOUGH
    return Sampled(start, rate, values, order=ORDER_OF[kind], band_limited=band_limited)


def at_samples(values: Floats, kind: str = BAND_LIMITED) -> Floats:
    """Samples (N,) of an input for sums that stand for integrals: a held one jumps at each, and has its mean there."""
    return values if kind != HELD else 0.5 * (values + np.append(values[:1], values[:-1]))


@dataclass(frozen=True, eq=False)
class ClippedSamples:
    """What a sensor read where it was overloaded or nearly so, as `mark_missing` keeps it in `Record.clipped`.

    Attributes
    ----------
    samples : array of shape (N,)
        The channel as it is with these readings marked as missing, NaN.
    readings : array of shape (N,)
        The readings there, in the unit of the channel; NaN elsewhere.
    sides : array of shape (N,)
        1 where the true reading is the one given or more, -1 where it is the one given or less, 0 where it is exact.

    Raises
    ------
    RecordError
        If lengths differ, a reading has no side or another than these, or the channel has a sample where there is a reading.

    Examples
    --------
    >>> import linkwise as lw
    >>> import numpy as np
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=2.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> x = record.channel("x:m1")
    >>> peak = 0.8 * np.abs(x).max()
    >>> overloaded = {"x:m1": np.clip(x, -peak, peak), "x:m2": record.channel("x:m2")}
    >>> marked = lw.inspection.mark_missing(lw.Record.from_arrays(record.time, overloaded))
    >>> sides = marked.clipped["x:m1"].sides
    >>> int((sides > 0).sum()), int((sides < 0).sum())
    (22, 22)
    """

    samples: Floats
    readings: Floats
    sides: Floats

    def __post_init__(self) -> None:
        for name in ("samples", "readings", "sides"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=float))
        shapes = [array.shape for array in (self.samples, self.readings, self.sides)]
        if len(set(shapes)) > 1 or len(shapes[0]) != 1:
            raise RecordError(
                f"clipped samples, their readings and sides are arrays of one length, got the shapes {shapes}"
            )
        is_read = ~np.isnan(self.readings)
        wrong = np.flatnonzero(is_read & ~np.isin(self.sides, (-1.0, 0.0, 1.0)))
        if len(wrong):
            raise RecordError(
                f"the side of a reading is -1, 0 or 1, got {self.sides[wrong[0]]:g} at sample {wrong[0]}"
            )
        both = np.flatnonzero(is_read & ~np.isnan(self.samples))
        if len(both):
            raise RecordError(
                f"a clipped sample is missing in its channel, and sample {both[0]} is there beside its reading: mark it as NaN"
            )

    def of(self, samples: Floats) -> ClippedSamples | None:
        """The readings of a channel, if it is as it was when they were marked.

        Parameters
        ----------
        samples : array of shape (N,)
            The channel.

        Returns
        -------
        ClippedSamples or None
            None where it was changed since, so that the readings are those of another signal.
        """
        return self if np.array_equal(self.samples, samples, equal_nan=True) else None

    def rows(self, which: slice) -> ClippedSamples:
        """The readings among some samples.

        Parameters
        ----------
        which : slice
            The samples.

        Returns
        -------
        ClippedSamples
            Those of the samples alone.
        """
        return ClippedSamples(*(column[which] for column in vars(self).values()))

    def followed_by(self, others: ClippedSamples, gap: int) -> ClippedSamples:
        """The readings of this part of a channel and of another.

        Parameters
        ----------
        others : ClippedSamples
            Those of the other part.
        gap : int
            The number of missing samples between them.

        Returns
        -------
        ClippedSamples
            Those of both.
        """
        missing = np.full(gap, np.nan)
        pairs = zip(vars(self).values(), vars(others).values(), strict=True)
        return ClippedSamples(*(np.concatenate([first, missing, second]) for first, second in pairs))


_ANGLE = re.compile(r"(?<![a-z])([munµμ]?rad|deg|°|rev|turn|rpm|arcmin|arcsec|m?grad|m?gon)|(radian|degree)")
_MOMENT = re.compile(r"N\s*[*·⋅ ]?\s*[mcd]?m$|(lbf|ozf|kgf|newton)[ *·]|[ *·](lbf|ozf|kgf)$")


def is_angular(unit: str, kind: str) -> bool:
    """Whether a channel of a kind such as "x" in a unit is that of a rotation: an angle, its rate, or a moment."""
    row = KINDS.get(kind)
    if row is None or not row.angular_unit:
        return False
    words = _MOMENT if row.unit == "N" else _ANGLE
    return words.search(unit) is not None and converts(unit, row.angular_unit)


def si_unit(unit: str, kind: str) -> str:
    """The SI unit of a channel of `kind` that is stated in `unit`."""
    if kind == "signal":
        return str(unit_dimension(unit))
    return KINDS[kind].angular_unit if is_angular(unit, kind) else KINDS[kind].unit


@dataclass(frozen=True)
class ChannelAttribute:
    """An attribute of channels, under the name of its field in `Record`.

    `label` is what messages call it. `stored` is the type that files store it as, a number or a text for each channel;
    None for one that formats write in a way of their own. `absent` stands for no value in formats that hold one for every
    channel. One `of_samples` belongs to those of a record, not to its sensors.
    """

    label: str
    stored: Any = None
    absent: float | str = ""
    of_samples: bool = False


OF_CHANNELS = {
    "noise": ChannelAttribute("noise", stored=float, absent=math.nan),
    "interpolation": ChannelAttribute("interpolation", stored=str, absent=BAND_LIMITED),
    "units": ChannelAttribute("unit"),  # of a column, which holds it in its header
    "uncertainty": ChannelAttribute("uncertainty"),  # see files/mapping.py
    "clipped": ChannelAttribute("clipped samples", of_samples=True),
}
STORED = {name: attribute for name, attribute in OF_CHANNELS.items() if attribute.stored is not None}
"""Those that the formats of files store without knowing them."""


COMMON = "common"  # in place of a channel: a gain that all sensors share


@dataclass(frozen=True)
class SensorUncertainty:
    """Standard deviations to which gain, offset and delay of a sensor are known beforehand.

    0 says that there is no such error, infinity that nothing is known of it. `identify` by maximum likelihood and `discover`
    find the errors with the laws, with these priors, and count them in every interval.

    Parameters
    ----------
    gain : float, optional
        Of the gain, relative: 0.01 for a calibration to 1 %.
    offset : float, optional
        Of the constant error, in the SI unit of the channel.
    delay : float, optional
        Of the delay, in s.

    Raises
    ------
    RecordError
        If one of them is negative or not a number.

    Examples
    --------
    >>> import linkwise as lw
    >>> from dataclasses import replace
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=2.0, rate=1000.0).with_noise(30.0, seed=1)
    >>> record = replace(record, uncertainty={"x:m1": lw.records.SensorUncertainty(gain=0.01, offset=1e-4)})
    >>> fit = lw.identify(record, lw.bnes_chain(2).unknown("nes"))
    >>> [(error.channel, error.kind) for error in fit.sensor_errors]
    [('x:m1', 'offset'), ('x:m1', 'gain')]
    """

    gain: float = 0.0
    offset: float = 0.0
    delay: float = 0.0

    def __post_init__(self) -> None:
        for name in ("gain", "offset", "delay"):
            sigma = getattr(self, name)
            if isnan(sigma) or sigma < 0.0:
                raise RecordError(f"the standard deviation of a {name} must not be negative, got {sigma!r}")

    def __bool__(self) -> bool:
        return bool(self.gain or self.offset or self.delay)

    def described(self, channel: Channel | str, of_state: str = "") -> str:
        """Say what is known of the sensor of a channel.

        Parameters
        ----------
        channel : Channel or str
            The channel, or ``"common"``.
        of_state : str, optional
            The unit that a file stated of the channel, of a state of a link; the SI unit of a rotation.

        Returns
        -------
        str
            A sentence.
        """
        known = []
        for name in ("gain", "offset", "delay"):
            sigma = getattr(self, name)
            if isinf(sigma):
                known.append(f"its {name} is unknown")
            elif sigma:
                size = {"gain": f"{100.0 * sigma:.3g} %", "delay": f"{sigma:.3g} s"}.get(name, f"{sigma:.3g}")
                if name == "offset" and isinstance(channel, Channel):
                    size = size_in_unit(sigma, channel, of_state, digits=3)
                known.append(f"its {name} is known to {size}")
        return f"{'The gain that all sensors share' if channel == COMMON else channel}: {', '.join(known)}."


def size_in_unit(size: float, channel: Channel, of_state: str = "", *, digits: int = 6) -> str:
    """A size in SI with the unit of a channel; that of a state in the unit that a file stated, else with words for it."""
    unit = channel.unit
    if "?" not in unit:
        return f"{size:.{digits}g} {of_state or unit}"
    if not of_state:
        return f"{size:.{digits}g} in its SI unit"
    return f"{size / factor_to_si(of_state, '?'):.{digits}g} {of_state}"
