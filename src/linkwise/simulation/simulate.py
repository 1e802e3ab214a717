"""From a structure and an excitation to the record that sensors would measure; links alone on a rig beside a mass at
rest; and how long an orbit can be trusted.

A chaotic structure doubles every error in a fraction of a second, rounding errors included, so past some time no orbit
computed in double precision is the true one. A second run shows when: with steps bounded to a fraction of those the
integrator would take, each Taylor series is truncated with an error thousands of times smaller (the remainder of order p
is proportional to the step to p + 1), which is a tighter tolerance without a new compilation, and every rounding error is
a different one.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from types import NoneType
from typing import TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike

from linkwise.arrays import Floats
from linkwise.errors import RecordError, SimulationError, expect
from linkwise.model.excitation import Excitation, Impulse, InputSignal
from linkwise.model.law import Law
from linkwise.model.link import BASE, GROUND, Link, Mass
from linkwise.model.structure import Structure
from linkwise.progress import Progress, ProgressReport, silent
from linkwise.records.channel import KINDS, MOTIONS, Channel
from linkwise.records.channel_units import in_units_of, places_of
from linkwise.records.record import EnergyBalance, Record, SimulationTruth
from linkwise.simulation.energy import LinkForces, energy_balance
from linkwise.simulation.run import (
    RunLog,
    RunOptions,
    RunSchedule,
    check_excitation,
    check_place,
    integrate,
    output_times,
    room,
)

_DEPARTURE = 1e-3  # of the largest displacement
_STEP = 0.6  # of the mean step of the first run


@dataclass(frozen=True, eq=False)
class SimulatedMotion:
    """Displacements in m and velocities in m/s (N, n), and states of links (N, S), at the output times of a schedule.

    `run` is the log of the run.
    """

    schedule: RunSchedule
    displacement: Floats
    velocity: Floats
    states: Floats
    run: RunLog

    @classmethod
    def of(cls, schedule: RunSchedule, progress: Progress = silent) -> SimulatedMotion:
        """Run a schedule. Raises SimulationError if the run cannot be completed."""
        count = len(schedule.times)
        motion = room(schedule.structure, count)

        def receive(first: int, x: Floats, v: Floats, states: Floats) -> None:
            progress(ProgressReport((first + len(x)) / count, "simulating"))

        run = integrate(schedule, schedule.times, receive, RunOptions(into=motion))
        for part in motion:
            part.flags.writeable = False
        return cls(schedule, *motion, run)

    @cached_property
    def energy(self) -> EnergyBalance:
        """The energy balance at every output time; of a rig without the spring at rest beside it."""
        balance = energy_balance(self.schedule, self.displacement, self.velocity, self.run)
        if not isinstance(self.schedule.structure, _MovedStructure):
            return balance
        return replace(balance, potential=balance.potential[:, :-1], dissipated=balance.dissipated[:, :-1])

    @cached_property
    def horizon(self) -> float | None:
        """Time in s past which the orbit cannot be trusted: the first output time at which a second run, in double precision,
        departs from it by more than `_DEPARTURE` of its largest value; None where it can throughout.
        """
        allowed = _DEPARTURE * np.abs(self.displacement).max()
        departures: list[float] = []

        def receive(first: int, x: Floats, v: Floats, states: Floats) -> bool:
            apart = np.abs(x - self.displacement[first : first + len(x)]).max(axis=1) > allowed
            if apart.any():
                departures.append(float(self.schedule.times[first + int(np.argmax(apart))]))
            return bool(departures)

        options = RunOptions(_STEP * self.schedule.end / max(self.run.steps, 1), extended=False)
        integrate(self.schedule, self.schedule.times, receive, options)
        return departures[0] if departures else None


_MASS, _SPRING = "mass at rest", "spring at rest"


@dataclass(frozen=True)
class _MovedStructure(Structure):
    """A structure of links between base and ground, and of masses that these do not move."""

    def _check_ends(self) -> None:
        """All ends are those of the rig, which was checked, and of the mass at rest."""


def with_mass_at_rest(structure: Structure) -> Structure:
    """The structure of a rig, and a mass on a spring that nothing moves behind its links; others as they are."""
    if not structure.on_rig:
        return structure
    spring = Link(_SPRING, (_MASS, GROUND), Law.parse("k*d"), {"k": 1.0})
    return _MovedStructure(structure.name, (Mass(_MASS, 1.0),), (*structure.links, spring))


class ExcitationKeywords(TypedDict, total=False):
    """The keywords of `Excitation`."""

    release: Mapping[str, float]
    impulses: Iterable[Impulse]
    forces: Mapping[str, InputSignal | str | float]
    base: InputSignal | str | float | None
    signals: Mapping[str, InputSignal | str | float]


def simulate(
    structure: Structure,
    *,
    duration: float | None = None,
    rate: float | None = None,
    times: ArrayLike | None = None,
    sensors: Iterable[str] = ("x",),
    progress: Progress = silent,
    **excitation: Unpack[ExcitationKeywords],
) -> Record:
    """Simulate a structure from t = 0 and return what sensors measure.

    The motion is integrated by a Taylor method to rounding precision.

    Parameters
    ----------
    structure : Structure
        A structure whose masses and coefficients have values.
    duration : float, optional
        Time in s to simulate.
    rate : float, optional
        Sampling rate in Hz.
    times : array of shape (N,), optional
        Output times in s instead of duration and rate, evenly spaced and not negative.
    sensors : iterable of str, optional
        Kinds of sensors on every mass (``"x"``, ``"v"``, ``"a"``; ``"rel:x"`` relative to the base), on every link (``"f"``,
        its force; of links alone on a rig the default) or in every state of a link (``"state"``), or channels (``"a:m2"``,
        ``"f:spring"``, ``"state:piezo.V"``).
        Forces and signals are always recorded, and the displacement of the base, unless its velocity or acceleration is named
        (``"a:base"``).
    progress : Progress, optional
        Called with a `ProgressReport` while the simulation runs.
    **excitation
        What drives the structure, as in `Excitation`: `release`, ``{"x:m1": m, "v:m1": m/s}``, where ``"state:piezo.V"`` takes
        the place of the initial value of a state; `impulses`, a sequence of
        `Impulse`; `forces`, for each mass an expression of t in N or `Sampled`; `base`, its displacement in m, and `signals`,
        each signal that laws name in its SI unit, likewise.

    Returns
    -------
    Record
        The channels without noise; `Record.simulated` has the motion of all masses, energies and the predictability horizon.

    Raises
    ------
    SimulationError
        If an argument is not valid, or the motion diverges; the error has time and mass.
    StructureError
        If a mass or coefficient has no value.
    TypeError
        If `structure` is no `Structure`.

    Examples
    --------
    >>> import linkwise as lw
    >>> lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=1.0, rate=1000.0, sensors=["x", "a:m2"])
    Record of 1001 samples at 1000 Hz, 0 to 1 s: x:m1, x:m2, a:m2
    """
    expect("simulate(structure): structure", structure, Structure)
    for name, value in (("duration", duration), ("rate", rate)):
        expect(f"simulate(structure): {name}", value, float, NoneType)
    grid = output_times(duration, rate, times)
    drive = Excitation(**excitation)
    check_excitation(structure, drive, float(grid[-1]))
    channels = recorded_channels(structure, drive, sensors)
    moved = with_mass_at_rest(structure)
    motion = SimulatedMotion.of(RunSchedule(moved, drive, grid), progress)
    forces, orbit = LinkForces(moved, drive), (grid, motion.displacement, motion.velocity, motion.states)
    kinds = {channel.kind for channel in channels}
    arrays = {"x": motion.displacement, "v": motion.velocity}
    if "a" in kinds:
        arrays["a"] = forces.accelerations(*orbit)
    if "f" in kinds:
        arrays["f"] = forces.links(*orbit)
    states = {
        f"{structure.links[number].name}.{name}": motion.states[:, column]
        for column, (number, name) in enumerate(structure.topology.states)
    }
    record = Record(
        start=float(grid[0]),
        rate=float(rate) if rate is not None else (len(grid) - 1) / float(grid[-1] - grid[0]),
        channels=tuple(channels),
        values=_measured(structure, drive, grid, channels, arrays | states),
        simulated=SimulationTruth(
            structure,
            motion.displacement[:, : structure.size],
            motion.velocity[:, : structure.size],
            drive.base_at(grid),
            motion,
            states=states,
        ),
        source=f"simulation of {structure.name}",
    )
    return in_units_of(record, structure)


def _measured(
    structure: Structure,
    drive: Excitation,
    grid: Floats,
    channels: list[Channel],
    arrays: Mapping[str, Floats],
) -> Floats:
    """What channels measure (N, C), of arrays of all masses and links by kind of channel, and states by name."""
    values = np.empty((len(grid), len(channels)))
    for kind in MOTIONS:
        shown = [n for n, channel in enumerate(channels) if channel.kind == kind and not channel.is_input]
        if shown:
            rows = np.array([structure.topology.row(channels[n].place) for n in shown])
            seen = arrays[kind] @ rows.T
            if len(shown) == len(channels):  # of all, whose copy would double the memory
                values = seen
            else:
                values[:, shown] = seen
    for column, channel in enumerate(channels):
        order = channel.order if channel.is_motion else 0
        if channel.is_input:
            signal = drive.drives[channel.place if channel.at_place else channel]
            values[:, column] = signal.derivative(grid, order)
        elif channel.kind == "state":
            values[:, column] = arrays[channel.place]
        elif not channel.is_motion:
            values[:, column] = arrays[channel.kind][:, structure.links.index(structure.link(channel.place))]
        if channel.relative:
            values[:, column] -= drive.drives[BASE].derivative(grid, order)
    values.setflags(write=False)  # so that the record need not copy them
    return values


def recorded_channels(structure: Structure, excitation: Excitation, sensors: Iterable[str]) -> list[Channel]:
    """Responses in the order of `sensors`, then the inputs."""
    wanted = sensors.split() if isinstance(sensors, str) else list(sensors)
    if structure.on_rig and wanted == ["x"]:
        wanted = ["f"]
    if not wanted:
        raise SimulationError(
            'sensors must have at least one kind, "x", "v" or "a", or "f" or "state" of links, or channel, such as "a:m1"'
        )
    repeated = next((name for i, name in enumerate(wanted) if name in wanted[:i]), None)
    if repeated is not None:
        raise SimulationError(f"the sensor {repeated} is listed twice", arguments=("sensors",))
    responses: dict[Channel, None] = {}
    of_base: dict[Channel, None] = {}
    for name in wanted:
        kind = name.removeprefix("rel:")
        if kind in MOTIONS or (name in KINDS and not KINDS[name].is_input):
            _require_moving_base(excitation, name, name != kind)
            places = places_of(kind, structure)
            responses.update(dict.fromkeys(Channel(kind, place, name != kind) for place in places))
            continue
        try:
            channel = Channel.parse(name)
        except RecordError as error:
            raise SimulationError(f"invalid sensor: {error}") from None
        _require_moving_base(excitation, name, channel.relative or channel.place == BASE)
        if channel.place == BASE:
            of_base[channel] = None
            continue
        if channel.is_input:
            raise SimulationError(f"{name} is an input, which is recorded whenever it drives the structure")
        check_place(channel, structure, "a sensor")
        responses[channel] = None
    forces = [Channel("force", mass) for mass in excitation.forces]
    base = list(of_base) or [Channel("x", BASE)] if excitation.base is not None else []
    return [*responses, *forces, *base, *(Channel("signal", name) for name in excitation.signals)]


def _require_moving_base(excitation: Excitation, sensor: str, needed: bool) -> None:
    if needed and excitation.base is None:
        raise SimulationError(f"sensor {sensor} needs a base that moves: give its displacement (`base`)")


NEIGHBOURS = 12
APART = 1e-12  # of the release, from one neighbour to the next: less than any test rig could repeat


@dataclass(frozen=True, eq=False)
class OrbitEnvelope:
    """A simulated motion, and the range of the orbits that start so close to it that no test could tell the releases apart.

    Up to the horizon they coincide; past it the record is one of many possible orbits.

    Attributes
    ----------
    record : Record
        The displacements of the N samples.
    least, greatest : numpy.ndarray, shape (N, n)
        The extremes of the neighbouring orbits, sample by sample, in m: releases differ by multiples of 1e-12 of themselves.

    Examples
    --------
    >>> import linkwise as lw
    >>> motion = lw.analysis.orbit_envelope(lw.bnes_chain(2), {"v:m1": 1.0}, duration=1.0, rate=1000.0)
    >>> motion.horizon is None, motion.masses
    (True, ('m1', 'm2'))
    """

    record: Record
    least: Floats
    greatest: Floats

    @property
    def horizon(self) -> float | None:
        """Time in s past which the orbit is one of many; None where it is predictable throughout."""
        return self.record.simulated.horizon if self.record.simulated else None

    @property
    def masses(self) -> tuple[str, ...]:
        """Names of the masses, in the order of the structure."""
        return self.record.masses


def orbit_envelope(
    structure: Structure, release: Mapping[str, float], *, duration: float, rate: float
) -> OrbitEnvelope:
    """The motion of every mass after a release, with the range of neighbouring orbits where it is chaotic.

    Twelve neighbours are simulated, and only if the motion has a horizon.

    Parameters
    ----------
    structure : Structure
        What moves; every coefficient is a number.
    release : dict of str to float
        Velocities in m/s and displacements in m at time 0: ``{"v:m1": 1.0, "x:m2": 0.01}``.
    duration : float
        Length of the record in s.
    rate : float
        Sampling rate in Hz.

    Returns
    -------
    OrbitEnvelope
        The record and the extremes of its neighbours.

    Raises
    ------
    TypeError
        If `release` is no mapping.
    SimulationError, StructureError
        As `simulate` raises them.

    Examples
    --------
    >>> import linkwise as lw
    >>> motion = lw.analysis.orbit_envelope(lw.bnes_chain(2), {"v:m1": 1.0}, duration=1.0, rate=1000.0)
    >>> bool((motion.least == motion.greatest).all())  # predictable throughout
    True
    """

    def run(factor: float) -> Record:
        start = {name: factor * value for name, value in release.items()}
        return simulate(structure, release=start, duration=duration, rate=rate)

    record = run(1.0)
    least, greatest = record.values.copy(), record.values.copy()
    if record.simulated is not None and record.simulated.horizon is not None:
        for number in range(1, NEIGHBOURS + 1):
            values = run(1.0 + number * APART).values
            np.minimum(least, values, out=least)
            np.maximum(greatest, values, out=greatest)
    return OrbitEnvelope(record, least, greatest)
