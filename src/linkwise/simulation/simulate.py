"""From a structure and an excitation to the record that sensors would have made."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike

from linkwise.arrays import Floats
from linkwise.errors import RecordError, SimulationError
from linkwise.model.excitation import Excitation, Impulse, InputSignal, Sampled
from linkwise.model.link import BASE
from linkwise.model.structure import Structure
from linkwise.progress import Progress, ProgressReport, silent
from linkwise.records.channel import Channel
from linkwise.records.record import Record
from linkwise.records.truth import EnergyBalance, SimulationTruth
from linkwise.runtime import available_memory
from linkwise.simulation.energy_balance import energy_balance
from linkwise.simulation.horizon import horizon
from linkwise.simulation.link_forces import LinkForces
from linkwise.simulation.run import RunLog, integrate
from linkwise.simulation.schedule import RunSchedule
from linkwise.text import near_miss

_SAMPLE_BYTES = 32  # at least: time, and displacement, velocity and acceleration of one mass


class ExcitationKeywords(TypedDict, total=False):
    """The keywords of `Excitation.of`."""

    release: Mapping[str, float]
    impulses: Iterable[Impulse]
    forces: Mapping[str, InputSignal | str | float]
    base: InputSignal | str | float | None


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
    """Simulate from t = 0 and return what sensors see, with the truth in `.simulated`.

    Output at k/`rate` up to `duration` in s, or at `times` (N,), evenly spaced and not before 0. What drives the structure,
    as in `Excitation`: `release` {"x:m1": m, "v:m1": m/s}, `impulses` (Impulse(mass, N s, s), ...), `forces` {mass: expression
    of t or Sampled}, `base` likewise, its displacement. `sensors` are kinds ("x", "v", "a": on every mass) or channels
    ("a:m2"); forces and base motion are added as channels. `progress` is told the part that is done.

    The motion is integrated by a Taylor method to rounding. Raises SimulationError for what cannot be asked for and where a
    motion diverges, naming time and mass; StructureError where a mass or coefficient has no number.
    """
    grid = output_times(duration, rate, times)
    drive = Excitation.of(**excitation)
    check_excitation(structure, drive, float(grid[-1]))
    channels = _channels(structure, drive, sensors)
    motion = SimulatedMotion.of(RunSchedule(structure, drive, grid), progress)
    values = np.empty((len(grid), len(channels)))
    place = {name: i for i, name in enumerate(structure.mass_names)}
    arrays = {"x": motion.displacement, "v": motion.velocity}
    if any(channel.kind == "a" for channel in channels):
        arrays["a"] = LinkForces(structure, drive).accelerations(grid, motion.displacement, motion.velocity)
    for column, channel in enumerate(channels):
        if channel.is_input:
            values[:, column] = drive.drives[channel.mass].value(grid)
        else:
            values[:, column] = arrays[channel.kind][:, place[channel.mass]]
    base = None if drive.base is None else drive.base.value(grid)
    return Record(
        start=float(grid[0]),
        rate=float(rate) if rate is not None else (len(grid) - 1) / float(grid[-1] - grid[0]),
        channels=tuple(str(channel) for channel in channels),
        values=values,
        simulated=SimulationTruth(structure, motion.displacement, motion.velocity, base, motion),
        source=f"simulation of {structure.name}",
    )


@dataclass(frozen=True, eq=False)
class SimulatedMotion:
    """A schedule that was run: displacements and velocities (N, n) at its times, and the account of them when asked."""

    schedule: RunSchedule
    displacement: Floats
    velocity: Floats
    run: RunLog

    @classmethod
    def of(cls, schedule: RunSchedule, progress: Progress = silent) -> SimulatedMotion:
        """Run a schedule. SimulationError where it cannot be run to its end."""
        size = schedule.structure.size
        x, v = np.empty((len(schedule.times), size)), np.empty((len(schedule.times), size))

        def receive(first: int, states: Floats) -> None:
            rows = slice(first, first + len(states))
            x[rows], v[rows] = states[:, :size], states[:, size:]
            progress(ProgressReport((first + len(states)) / len(schedule.times), "simulating"))

        run = integrate(schedule, schedule.times, receive)
        x.flags.writeable = v.flags.writeable = False
        return cls(schedule, x, v, run)

    @cached_property
    def energy(self) -> EnergyBalance:
        """The energy balance at every output time."""
        return energy_balance(self.schedule, self.displacement, self.velocity, self.run)

    @cached_property
    def horizon(self) -> float | None:
        """The time in s from which the orbit cannot be trusted, None where it can throughout."""
        return horizon(self.schedule, self.displacement, self.run)


def output_times(duration: float | None, rate: float | None, times: ArrayLike | None = None) -> Floats:
    """The output times (N,) that `simulate` is asked for; raises SimulationError where they cannot be."""
    if times is None:
        if duration is None or rate is None:
            raise SimulationError("say how long and how often: duration in s and rate in Hz, or times")
        for what, value, unit in (("duration", duration, "s"), ("rate", rate, "Hz")):
            if not (np.isfinite(value) and value > 0.0):
                raise SimulationError(
                    f"{what} must be positive and finite, got {value!r} {unit}", arguments=(what,)
                )
        if _SAMPLE_BYTES * duration * rate > available_memory():
            raise SimulationError(
                f"{duration:g} s at {rate:g} Hz are {duration * rate:.3g} samples, more than memory holds; simulate a shorter "
                "time or sample slower"
            )
        count = int(np.floor(duration * rate * (1.0 + 1e-12) + 1e-9)) + 1
        if count < 2:
            raise SimulationError(
                f"{duration:g} s at {rate:g} Hz is less than one sampling interval; simulate longer or sample faster"
            )
        return np.arange(count) / float(rate)
    if duration is not None or rate is not None:
        raise SimulationError("times already says when to sample; leave out duration and rate")
    grid = np.array(times, dtype=float)
    row = grid.ndim == 1 and grid.size >= 2 and bool(np.all(np.isfinite(grid)))
    if not row or grid[0] < 0.0 or np.any(np.diff(grid) <= 0.0):
        raise SimulationError(
            "times must be one row of at least two increasing numbers, not before the start, 0"
        )
    even = np.linspace(grid[0], grid[-1], grid.size)
    if np.abs(grid - even).max() > 1e-6 * (even[1] - even[0]):
        raise SimulationError("times must be evenly spaced: a record has one sampling rate")
    return grid


def check_excitation(structure: Structure, drive: Excitation, end: float) -> None:
    """Raises SimulationError for an excitation that does not fit the structure, or that ends before `end` in s."""
    names = structure.mass_names
    for channel in drive.release:
        kind, colon, mass = channel.partition(":")
        if kind not in ("x", "v") or not colon:
            raise SimulationError(
                f"{channel!r} cannot be released: name a displacement, such as x:{names[0]}, or a velocity, v:{names[0]}"
            )
        _check_mass(mass, names, "a release")
    for impulse in drive.impulses:
        _check_mass(impulse.mass, names, "an impulse")
        if impulse.time >= end:
            raise SimulationError(
                f"{impulse.mass} is struck at {impulse.time:g} s, when the simulation has ended ({end:g} s)",
                impulse.time,
                impulse.mass,
            )
    for mass in drive.forces:
        _check_mass(mass, names, "a force")
    if drive.base is not None and not structure.base_incidence.any():
        raise SimulationError(
            'a motion of the base is given, but no link holds on to it: write "base" for "ground" in `between` of the links '
            "that do"
        )
    if drive.base is None and structure.base_incidence.any():
        held = structure.links[int(np.flatnonzero(structure.base_incidence)[0])].name
        raise SimulationError(
            f"link {held!r} holds on to the base, whose motion is not given: give base=..., its displacement as an expression "
            'of t or Sampled; "0" is a base at rest'
        )
    for name, given in drive.drives.items():
        if isinstance(given, Sampled) and (given.start > 0.0 or given.end < end - 1e-6 / given.rate):
            what = "the motion of the base" if name == BASE else f"the force on {name}"
            raise SimulationError(
                f"{what} is sampled from {given.start:g} to {given.end:g} s, but the simulation runs from 0 to {end:g} s; "
                "give more samples or simulate less"
            )


def _check_mass(name: str, names: tuple[str, ...], what: str) -> None:
    if name not in names:
        shown = ", ".join(names if len(names) <= 12 else (*names[:10], "...", names[-1]))
        raise SimulationError(
            f"unknown mass {name!r} in {what}{near_miss(name, names)}; the masses are {shown}",
            mass=name,
        )


def _channels(structure: Structure, drive: Excitation, sensors: Iterable[str]) -> list[Channel]:
    """Responses in the order asked for, then the inputs."""
    wanted = sensors.split() if isinstance(sensors, str) else list(sensors)
    if not wanted:
        raise SimulationError(
            'name at least one sensor: a kind, "x", "v" or "a", or a channel, such as "a:m1"'
        )
    found: dict[Channel, None] = {}
    for name in wanted:
        if name in ("x", "v", "a"):
            found.update(dict.fromkeys(Channel(name, mass) for mass in structure.mass_names))
            continue
        try:
            channel = Channel.parse(name)
        except RecordError as error:
            raise SimulationError(f"no sensor can be had: {error}") from None
        if channel.is_input:
            raise SimulationError(f"{name} is an input; it is in the record whenever it drives the structure")
        _check_mass(channel.mass, structure.mass_names, "a sensor")
        found[channel] = None
    inputs = [Channel("x", BASE) if name == BASE else Channel("force", name) for name in drive.drives]
    return [*found, *inputs]
