"""The record: evenly sampled channels, measured or simulated, in SI units; the input of every estimator.

Behind a simulated record stands the truth: noise-free motion, energies and predictability.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Protocol, overload

import numpy as np
from numpy.typing import ArrayLike

from linkwise.arrays import Bools, Floats
from linkwise.display import NotebookView
from linkwise.errors import RecordError, expect
from linkwise.model.coefficient import Text, by_constructor
from linkwise.records.channel import (
    COMMON,
    HELD,
    INTERPOLATIONS,
    MOTIONS,
    OF_CHANNELS,
    Channel,
    ClippedSamples,
    SensorUncertainty,
)
from linkwise.records.sample_checks import check_values, require_channel
from linkwise.records.timeline import EDGE, lowpass_for, sampled_columns, sampled_every

if TYPE_CHECKING:
    from linkwise.model.structure import Structure


@dataclass(frozen=True, eq=False)
class EnergyBalance:
    """Energies in J of a simulated structure, counted from the start of the simulation.

    Attributes
    ----------
    supplied : array of shape (N,)
        Energy at the start, and all work done on the structure since.
    kinetic : array of shape (N,)
        Kinetic energy of the masses.
    potential : array of shape (N, L)
        Energy stored in each of the L links.
    dissipated : array of shape (N, L)
        Energy dissipated by each link since the start. What the states of a link store counts until they give it back.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=0.5, rate=1000.0)
    >>> balance = record.simulated.energy
    >>> bool(abs(balance.residual).max() < 1e-12 * balance.supplied[0])
    True
    """

    supplied: Floats
    kinetic: Floats
    potential: Floats
    dissipated: Floats

    @property
    def work(self) -> Floats:
        """Work done on each link since the start, stored or dissipated, in J, shape (N, L)."""
        stored: Floats = self.potential - self.potential[:1]
        return stored + self.dissipated - self.dissipated[:1]

    @property
    def residual(self) -> Floats:
        """Energy stored and dissipated less energy supplied, in J, shape (N,): the error of the integration."""
        accounted: Floats = self.kinetic + self.potential.sum(axis=1) + self.dissipated.sum(axis=1)
        return accounted - self.supplied

    def rows(self, which: slice) -> EnergyBalance:
        """The balance at some of the samples; energies still count from the start of the simulation.

        Parameters
        ----------
        which : slice
            The samples, by index.

        Returns
        -------
        EnergyBalance
            Their energies in J.
        """
        return EnergyBalance(*(energies[which] for energies in vars(self).values()))


class MotionDiagnostics(Protocol):
    """Results of a simulation that cost more than the motion itself: computed on first use.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=0.5, rate=1000.0)
    >>> diagnostics = record.simulated.diagnostics
    >>> diagnostics.energy.kinetic.shape, diagnostics.horizon
    ((501,), None)
    """

    @property
    def energy(self) -> EnergyBalance:
        """The energy balance at every sample of the simulation."""

    @property
    def horizon(self) -> float | None:
        """Time in s past which a double-precision orbit cannot be trusted; None where it can throughout."""


@dataclass(frozen=True, eq=False)
class SimulationTruth:
    """The noise-free motion behind a simulated record, sample by sample.

    Attributes
    ----------
    structure : Structure
        The structure that was simulated.
    displacement, velocity : array of shape (N, n)
        Motion in m and m/s of the n masses, in the order of the structure, relative to the ground.
    base : array of shape (N,) or None
        Displacement of the base in m; None without a moving base.
    diagnostics : MotionDiagnostics
        Energies and predictability horizon of the whole simulation, computed on first use.
    noise : mapping of str to float
        Standard deviation of the noise added to each channel, in its SI unit.
    samples : range or None
        Indices of the samples of the simulation that are left in this record; None for all.
    states : mapping of str to array of shape (N,)
        States of links with memory by full name, such as ``"joint.z"``, in SI units.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=0.5, rate=1000.0)
    >>> record.simulated.velocity.shape
    (501, 2)
    """

    structure: Structure
    displacement: Floats
    velocity: Floats
    base: Floats | None
    diagnostics: MotionDiagnostics
    noise: Mapping[str, float] = field(default_factory=dict)
    samples: range | None = None
    states: Mapping[str, Floats] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"<SimulationTruth of {self.structure.name}: {len(self.displacement)} samples>"

    @cached_property
    def energy(self) -> EnergyBalance:
        """The energy balance at these samples; the first access costs about as much as the simulation."""
        energy = self.diagnostics.energy
        if self.samples is None:
            return energy
        return energy.rows(slice(self.samples.start, self.samples.stop, self.samples.step))

    @property
    def horizon(self) -> float | None:
        """Time in s past which a double-precision orbit cannot be trusted; None where it can throughout."""
        return self.diagnostics.horizon

    def rows(self, which: slice) -> SimulationTruth:
        """The truth at some of the samples.

        Parameters
        ----------
        which : slice
            The samples, by index.

        Returns
        -------
        SimulationTruth
            The motion at these samples.
        """
        all_samples = range(len(self.displacement)) if self.samples is None else self.samples
        return replace(
            self,
            displacement=self.displacement[which],
            velocity=self.velocity[which],
            base=None if self.base is None else self.base[which],
            samples=all_samples[which],
            states={name: values[which] for name, values in self.states.items()},
        )


LARGEST_RATIO = 1000.0  # dB, either way: the powers of nothing that is measured are further apart


def read_only(values: ArrayLike) -> Floats:
    """`values` as a read-only float64 array in C order, copied unless it is one already."""
    array = np.asarray(values)
    if array.flags.writeable or array.dtype != np.float64 or not array.flags.c_contiguous:
        array = np.array(array, dtype=np.float64, order="C")
        array.setflags(write=False)
    return array


@dataclass(frozen=True, eq=False, repr=False)
class Record(NotebookView):
    """N samples of C channels at the times ``start + k/rate``; immutable.

    Build a measured record with `Record.from_arrays` or `read_record`, which also refuse dead and duplicated sensors.

    Parameters
    ----------
    start : float
        Time of the first sample in s.
    rate : float
        Sampling rate in Hz.
    channels : tuple of str
        Names ``KIND:MASS`` of the C channels, with KIND one of ``x`` (m), ``v`` (m/s), ``a`` (m/s^2) and ``force`` (N), and
        MASS the name of a mass or ``base``; ``f:LINK`` (N) and ``state:LINK.NAME`` of a link.
    values : array of shape (N, C)
        Samples in the SI unit of each channel, NaN where a sample is missing; read-only.
    noise : mapping of str to float, optional
        Standard deviation of the noise of channels for which it is known, in the unit of the channel.
    simulated : SimulationTruth, optional
        The noise-free motion behind a simulated record.
    source : str, optional
        Where the record comes from.
    notes : tuple of str, optional
        What was assumed or done, one sentence each.
    interpolation : mapping of str to str, optional
        How inputs run between their samples: ``"held"``, ``"linear"``, or, by default, ``"band-limited"``.
    units : mapping of str to str, optional
        Units that a file stated of states of links, and SI units of channels of places that turn, such as ``"rad/s"``, by
        channel, to be checked against the structure; `values` are SI.
    uncertainty : mapping of str to SensorUncertainty, optional
        How well gain, offset and delay of sensors are known, by channel; ``"common"`` is a gain that all share.
    clipped : mapping of str to ClippedSamples, optional
        Readings at the end of a sensor's range, marked as missing by `mark_missing`, by channel.

    Raises
    ------
    RecordError
        If shapes do not match, a name is not a channel or is listed twice, or a value is infinite.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=0.5, rate=1000.0)
    >>> record
    Record of 501 samples at 1000 Hz, 0 to 0.5 s: x:m1, x:m2
    >>> record.between(0.1, 0.2)["x:m1"].shape
    (101,)
    >>> sorted(record.with_noise(20.0, seed=1).simulated.noise)
    ['x:m1', 'x:m2']
    """

    start: float
    rate: float
    channels: tuple[Channel, ...]
    values: Floats
    noise: Mapping[str, float] = field(default_factory=dict)
    simulated: SimulationTruth | None = None
    source: str = ""
    notes: tuple[str, ...] = ()
    interpolation: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    uncertainty: Mapping[str, SensorUncertainty] = field(default_factory=dict)
    clipped: Mapping[str, ClippedSamples] = field(default_factory=dict)
    __reduce__ = by_constructor

    if TYPE_CHECKING:  # that of the fields, with channels by their names, which are parsed

        def __init__(
            self,
            start: float,
            rate: float,
            channels: Sequence[str],
            values: ArrayLike,
            noise: Mapping[Any, float] = ...,
            *,
            simulated: SimulationTruth | None = ...,
            source: str = ...,
            **attributes: Any,
        ) -> None: ...

    def __post_init__(self) -> None:
        for name in ("start", "rate"):
            expect(f"Record: {name}", getattr(self, name), float)
        for name in OF_CHANNELS:
            expect(f"Record: {name}", getattr(self, name), Mapping)
        object.__setattr__(self, "channels", Channel.parse_all(self.channels))
        parsed = {channel: channel for channel in self.channels}
        for name, kind in (("start", float), ("rate", float), ("notes", tuple)):
            object.__setattr__(self, name, kind(getattr(self, name)))
        for name in OF_CHANNELS:
            given = getattr(self, name).items()
            object.__setattr__(self, name, MappingProxyType({parsed.get(k, k): v for k, v in given}))
        object.__setattr__(self, "values", read_only(self.values))
        for stated in ("noise", "uncertainty", "clipped"):
            for name in getattr(self, stated):
                if (stated, name) != ("uncertainty", COMMON):
                    require_channel(name, self.channels, OF_CHANNELS[stated].label)
        self._check_stated()
        common = self.uncertainty.get(COMMON, SensorUncertainty())
        if common.offset or common.delay:
            raise RecordError("sensors share a gain, not an offset or a delay", channel=COMMON)
        check_values(self.start, self.rate, self.channels, self.values)

    def _check_stated(self) -> None:
        """Raise RecordError for a channel that is listed twice, and for noise, interpolation or clipped samples that are not
        valid, or not of a channel of that kind.
        """
        for number, name in enumerate(self.channels):
            if name in self.channels[:number]:
                raise RecordError("is listed twice", channel=name)
        for measured, sigma in self.noise.items():
            if not (np.isfinite(sigma) and sigma >= 0.0):
                raise RecordError(f"noise must be a non-negative number, got {sigma!r}", channel=measured)
        for driving, kind in self.interpolation.items():
            if driving not in self.inputs:
                listed = ", ".join(self.inputs) or "there are none"
                wrong = f"an interpolation is given for a channel that is not an input of the record; inputs: {listed}"
            elif kind not in INTERPOLATIONS:
                wrong = f"unknown interpolation {kind!r}; choose from {', '.join(INTERPOLATIONS)}"
            elif kind == HELD and driving.endswith(":base"):
                wrong = "a base does not jump from sample to sample; choose linear or band-limited"
            else:
                continue
            raise RecordError(wrong, channel=driving)
        for overloaded, samples in self.clipped.items():
            if not isinstance(samples, ClippedSamples):
                raise RecordError(f"clipped samples of {overloaded} are ClippedSamples, got {samples!r}")
            if overloaded in self.inputs:
                message = (
                    "is an input, of which clipped samples cannot be bounds: an input is known at all times"
                )
                raise RecordError(f"{overloaded} {message}")

    @classmethod
    def from_arrays(
        cls,
        time: ArrayLike,
        channels: Mapping[Text, ArrayLike],
        *,
        noise: Mapping[str, float] | None = None,
        source: str = "",
        notes: Iterable[str] = (),
    ) -> Record:
        """Build a measured record from a time column and one array per channel.

        Parameters
        ----------
        time : array of shape (N,)
            Sampling times in s, even up to the rounding of printed digits. Steps that are multiples of the sampling interval
            are gaps, filled with missing samples.
        channels : mapping of str to array of shape (N,)
            Samples of each channel in its SI unit, NaN where missing.
        noise, source, notes : optional
            As of `Record`.

        Returns
        -------
        Record
            The record, with notes on what was assumed.

        Raises
        ------
        RecordError
            If times are uneven, lengths differ, there are fewer than 32 samples, or a response is constant, missing
            throughout or equal to another.

        Examples
        --------
        >>> import linkwise as lw
        >>> import numpy as np
        >>> time = np.arange(200) / 100.0
        >>> lw.Record.from_arrays(time, {"x:m1": 1e-3 * np.sin(20.0 * time)})
        Record of 200 samples at 100 Hz, 0 to 1.99 s: x:m1
        """
        expect("Record.from_arrays(time, channels): channels", channels, Mapping)
        columns = dict(zip(Channel.parse_all(channels), channels.values(), strict=True))
        line, values, remarks = sampled_columns(time, columns)
        all_notes = (*notes, *remarks)
        return cls(line.start, line.rate, tuple(columns), values, noise or {}, source=source, notes=all_notes)

    def __len__(self) -> int:
        return len(self.values)

    def __repr__(self) -> str:
        last = self.start + (len(self) - 1) / self.rate
        missing = int(self.missing.sum())
        gaps = f"; {missing} sample{'s' * (missing > 1)} missing" if missing else ""
        span = f"{len(self)} samples at {self.rate:g} Hz, {self.start:g} to {last:g} s"
        return f"Record of {span}: {', '.join(self.channels) or 'no channels'}{gaps}"

    @cached_property
    def time(self) -> Floats:
        """Sampling times in s, shape (N,), read-only."""
        return read_only(self.start + np.arange(len(self)) / self.rate)

    @property
    def step(self) -> float:
        """Sampling interval in s."""
        return 1.0 / self.rate

    @property
    def duration(self) -> float:
        """Time in s from the first sample to the last."""
        return (len(self) - 1) / self.rate

    @cached_property
    def missing(self) -> Bools:
        """True where a sample is missing, shape (N, C), read-only."""
        (mask := np.isnan(self.values)).setflags(write=False)
        return mask

    @cached_property
    def responses(self) -> tuple[Channel, ...]:
        """Channels that measure the motion of the masses, and the forces and states of links."""
        return tuple(channel for channel in self.channels if not channel.is_input)

    @property
    def motions(self) -> tuple[Channel, ...]:
        """Those of them that are displacements, velocities and accelerations."""
        return tuple(channel for channel in self.responses if channel.is_motion)

    @property
    def inputs(self) -> tuple[Channel, ...]:
        """Channels that drive the structure: applied forces and base motion."""
        return tuple(channel for channel in self.channels if channel.is_input)

    @property
    def forces(self) -> tuple[Channel, ...]:
        """Those of them that are applied forces."""
        return tuple(channel for channel in self.channels if channel.is_force)

    @property
    def masses(self) -> tuple[str, ...]:
        """Names of the masses with a response channel, in order of appearance."""
        return tuple(dict.fromkeys(channel.place for channel in self.responses if channel.is_motion))

    def motions_of(self, place: str) -> tuple[Channel, ...]:
        """Those that show displacement, velocity and acceleration of a place, relative to the ground, in this order.

        Parameters
        ----------
        place : str
            A mass, a point of a host or the base.

        Returns
        -------
        tuple of Channel
            Those that there are.
        """
        there = [channel for channel in self.channels if channel.place == place and not channel.relative]
        return tuple(channel for kind in MOTIONS for channel in there if channel.kind == kind)

    def unit(self, name: str) -> str:
        """SI unit of a channel.

        Parameters
        ----------
        name : str
            Name of the channel.

        Returns
        -------
        str
            The unit, such as ``"m/s"``.

        Raises
        ------
        RecordError
            If the channel is not in the record.
        """
        channel = self.channels[self._column(name)]
        return channel.unit if channel.kind == "state" else self.units.get(name, channel.unit)

    def _column(self, name: str) -> int:
        if name not in self.channels:
            message = f"is not in the record; the channels are {', '.join(self.channels)}"
            raise RecordError(message, channel=name)
        return self.channels.index(name)

    def channel(self, name: str) -> Floats:
        """Samples of one channel.

        Parameters
        ----------
        name : str
            Name of the channel.

        Returns
        -------
        array of shape (N,)
            Its samples in SI units, read-only.

        Raises
        ------
        RecordError
            If the channel is not in the record.
        """
        return self.values[:, self._column(name)]

    def select(self, names: Iterable[str]) -> Record:
        """Select channels.

        Parameters
        ----------
        names : iterable of str
            Names of the channels, in the order wanted.

        Returns
        -------
        Record
            The record with these channels only.

        Raises
        ------
        RecordError
            If a channel is not in the record.
        """
        columns = [self._column(name) for name in names]
        channels = tuple(self.channels[column] for column in columns)
        selected: dict[str, Any] = {
            kind: {name: value for name, value in getattr(self, kind).items() if name in (*channels, COMMON)}
            for kind in OF_CHANNELS
        }
        return replace(self, channels=channels, values=self.values[:, columns], **selected)

    @overload
    def __getitem__(self, which: str) -> Floats: ...
    @overload
    def __getitem__(self, which: slice) -> Record: ...
    def __getitem__(self, which: str | slice) -> Floats | Record:
        if isinstance(which, str):
            return self.channel(which)
        if not isinstance(which, slice) or which.step not in (None, 1):
            raise RecordError(
                'a record is asked for a channel, record["x:m1"], or sliced as record[first:last] without a step; '
                "record.decimate(factor) reduces the rate"
            )
        first, last, _ = which.indices(len(self))
        if last <= first:
            raise RecordError(f"record[{first}:{last}] is empty; the record has {len(self)} samples")
        return replace(
            self,
            start=self.start + first / self.rate,
            values=self.values[first:last],
            clipped={name: clipped.rows(slice(first, last)) for name, clipped in self.clipped.items()},
            simulated=self.simulated and self.simulated.rows(slice(first, last)),
        )

    def between(self, earliest: float, latest: float) -> Record:
        """Select samples by time.

        Parameters
        ----------
        earliest, latest : float
            First and last time in s, both included; either may be infinite.

        Returns
        -------
        Record
            The samples in between.

        Raises
        ------
        RecordError
            If there are none, or a time is NaN.
        """
        if np.isnan(earliest) or np.isnan(latest):
            message = f"times must be numbers, got {earliest:g} and {latest:g} s"
            raise RecordError(message, arguments=("earliest", "latest"))
        ends = (np.array([earliest, latest]) - self.start) * self.rate
        lowest, highest = np.clip(ends, -1.0, len(self))
        first, last = max(0, int(np.ceil(lowest - EDGE))), min(len(self), int(np.floor(highest + EDGE)) + 1)
        if last <= first:
            span = f"{self.start:g} to {self.start + self.duration:g} s"
            message = f"no sample between {earliest:g} and {latest:g} s; the record runs from {span}"
            raise RecordError(message, arguments=("earliest", "latest"))
        return self[first:last]

    def decimate(self, factor: int) -> Record:
        """Reduce the sampling rate, behind a linear-phase anti-alias filter.

        Samples at both ends, where the filter is incomplete, are dropped. White noise stays white, and known noise is reduced
        as the filter reduces it. The truth of a simulated record is not filtered.

        Parameters
        ----------
        factor : int
            Every `factor`-th sample is kept.

        Returns
        -------
        Record
            The record at ``rate / factor``, flat to 80 % of its Nyquist frequency and attenuated by 80 dB from 120 % on.

        Raises
        ------
        RecordError
            If `factor` is not a positive integer, samples are missing, a channel is held or linear between its samples, or the
            record is shorter than the filter.
        """
        if isinstance(factor, bool) or int(factor) != factor or factor < 1:
            raise RecordError(f"factor must be a positive integer, got {factor!r}")
        if factor == 1:
            return self
        antialias = lowpass_for(int(factor), self.channels, self.missing, self.interpolation)
        decimated = slice(antialias.half, len(self) - antialias.half, int(factor))
        return replace(
            self,
            start=self.start + antialias.half / self.rate,
            rate=self.rate / factor,
            values=antialias.apply(self.values),
            noise={name: sigma * antialias.noise_gain for name, sigma in self.noise.items()},
            simulated=self.simulated and self.simulated.rows(decimated),
            notes=(*self.notes, *antialias.notes(self.channels, self.values, self.rate)),
        )

    def with_noise(self, decibel: float, *, seed: int) -> Record:
        """Add white Gaussian noise to every response.

        The variance is ``mean(x**2) * 10**(-decibel/10)`` of each channel x, whose generator is seeded by `seed` and its
        name. Standard deviations are stored in `simulated.noise`, not in `noise`, since a user would not know them.

        Parameters
        ----------
        decibel : float
            Signal-to-noise ratio per channel in dB.
        seed : int
            Seed of the generators.

        Returns
        -------
        Record
            The record with noise.

        Raises
        ------
        RecordError
            If `decibel` is not finite or its amount is above 1000, or `seed` is negative.
        """
        if not abs(decibel) <= LARGEST_RATIO:
            raise RecordError(
                f"decibel must be within {LARGEST_RATIO:g} of zero, got {decibel!r}; without noise, use the record as it is"
            )
        if seed < 0:
            raise RecordError(f"seed must not be negative, got {seed}")
        earlier = self.simulated.noise if self.simulated else {}
        values, added = self.values.copy(), dict[str, float]()
        for name in self.responses:
            samples = values[:, self.channels.index(name)]
            sigma = 0.0
            if not np.isnan(samples).all():
                sigma = float(np.sqrt(np.nanmean(samples**2) * 10.0 ** (-decibel / 10.0)))
            generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(name.encode())))
            samples += sigma * generator.standard_normal(len(samples))
            added[name] = float(np.hypot(sigma, earlier.get(name, 0.0)))
        values.setflags(write=False)
        return replace(
            self,
            values=values,
            noise={name: sigma for name, sigma in self.noise.items() if name not in added},
            simulated=self.simulated and replace(self.simulated, noise=added),
            notes=(*self.notes, f"Noise of {decibel:g} dB per channel was added (seed {seed})."),
        )


def common_samples(record: Record) -> Record | None:
    """A record at the lowest of the rates at which the motion of its masses was sampled: every so-manyth of its samples,
    without a filter; None where most samples that all displacements, velocities and accelerations have follow one another.
    """
    complete = np.asarray(np.isfinite(record.select(record.motions).values).all(axis=1))
    every = sampled_every(complete)
    if every < 2:
        return None
    first = int(np.argmax(complete))
    start = record.start + first / record.rate
    values = record.values[first::every]
    return replace(record, start=start, rate=record.rate / every, values=values, simulated=None)
