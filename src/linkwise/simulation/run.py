"""One run of a structure through its schedule of stops, jumps and inputs: the states at given times, or the error that
ends it.

The run goes from stop to stop (impulses, knots of sampled inputs, ends of blocks) and integrates each interval with
run-time parameters that hold the polynomials of the inputs there. The same schedule run again with other output times
takes the same steps, so what is computed later (energies) belongs to the same orbit, chaotic or not.

At an event, and at the start of an interval, a kink g may be exactly zero and its sign open. A trial step that does not
detect kinks decides: with the branches assumed, g a moment later must have the sign that was assumed. If neither sign
agrees, the force pushes the motion back onto the kink from both sides, as dry friction does to a mass at rest: the link
sticks, and the equations of motion have no solution.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from linkwise.arrays import Floats
from linkwise.display import near_miss
from linkwise.errors import RecordError, SimulationError
from linkwise.expression import Call, Expression, Power, walk
from linkwise.model.excitation import Excitation, Sampled
from linkwise.model.link import BASE
from linkwise.model.structure import Structure
from linkwise.records.channel import KINDS, Channel
from linkwise.records.channel_units import places_of, unit_in
from linkwise.runtime import available_memory
from linkwise.simulation.integrator.formulas import (
    SCALE,
    CompiledSystem,
    Integrator,
    Outcome,
    ParameterLayout,
    Placement,
    StepRule,
    SystemShape,
    Time,
    compiled_system,
)

_SIGNAL = "signal:"  # with which the names of signals of laws begin among the drives
BLOCK = 4096  # output samples between two stops, at which progress is reported and divergence detected ...
_BUFFER = 500_000  # ... but at most this over the number of masses, to limit memory


@dataclass(frozen=True, eq=False)
class RunSchedule:
    """A structure and its excitation from 0 to `end` in s, ready to run; `times` (N,) in s are the output times."""

    structure: Structure
    excitation: Excitation
    times: Floats

    @property
    def end(self) -> float:
        """Last output time in s."""
        return float(self.times[-1])

    @cached_property
    def shape(self) -> SystemShape:
        """The key of the compiled equations of motion."""
        topology, inputs = self.structure.topology, []
        for name, drive in self.excitation.drives.items():
            signal = name.removeprefix(_SIGNAL) if name.startswith(_SIGNAL) else None
            where = signal or topology.weights(topology.index[name])
            inputs.append((where, drive.order if isinstance(drive, Sampled) else drive.expression))
        return SystemShape(*self.structure.shape_key, tuple(inputs))

    @cached_property
    def block(self) -> int:
        """Output samples between two stops."""
        return min(max(_BUFFER // self.structure.size, 64), BLOCK)

    @cached_property
    def stops(self) -> Floats:
        """Times (S,) in s at which integration stops, including 0 and `end`."""
        stops = {*self.times[self.block : -1 : self.block].tolist()}
        stops |= {impulse.time for impulse in self.excitation.impulses}
        stops = stops.union(*(drive.pieces.edges.tolist() for drive in self._sampled))
        return np.array([0.0, *sorted(stop for stop in stops if 0.0 < stop < self.end), self.end])

    @property
    def _sampled(self) -> list[Sampled]:
        return [drive for drive in self.excitation.drives.values() if isinstance(drive, Sampled)]

    @cached_property
    def start(self) -> Floats:
        """Initial displacements in m, velocities in m/s and states of links, (2n + S,).

        Raises StructureError for a state whose initial value is neither known nor released.
        """
        size, topology = self.structure.size, self.structure.topology
        state = np.zeros(topology.dimension)
        release = released(self.structure, self.excitation)
        for column, (number, name) in enumerate(topology.states):
            link = self.structure.links[number]
            given = release.pop(Channel("state", f"{link.name}.{name}"), None)
            state[2 * size + column] = link.initial_state(name) if given is None else given
        for channel, value in release.items():
            state[topology.index[channel.place] + channel.order * size] = value
        return state

    @cached_property
    def jumps(self) -> dict[int, Floats]:
        """Jump (2n + S,) of the state in m and m/s at each stop with an impulse."""
        jumps: dict[int, Floats] = {}
        for impulse in self.excitation.impulses:
            stop = int(np.searchsorted(self.stops, impulse.time))
            jump = jumps.setdefault(stop, np.zeros(self.structure.topology.dimension))
            topology = self.structure.topology
            for mass, part in topology.weights(topology.index[impulse.mass]):
                jump[self.structure.size + mass] += part * impulse.momentum / self.structure.mass_values[mass]
        return jumps

    @cached_property
    def pieces(self) -> Floats:
        """Parameters (S - 1, w) of the sampled inputs between stops, in the order of `ParameterLayout.inputs`."""
        columns = [np.empty((len(self.stops) - 1, 0))]
        middle = 0.5 * (self.stops[1:] + self.stops[:-1])
        for drive in self._sampled:
            edges, coefficients = drive.pieces
            piece = np.clip(np.searchsorted(edges, middle, side="right") - 1, 0, len(coefficients) - 1)
            columns += [edges[piece, None], _without_rounding(edges, coefficients)[piece]]
        return np.hstack(columns)


def run_time_parameters(
    structure: Structure, layout: ParameterLayout, kind: type = np.float64
) -> NDArray[Any]:
    """The run-time parameters (P,) of a structure, those of inputs 0; in extended precision a number is what its decimals
    say.
    """
    laws = zip(structure.links, layout.coefficients, strict=True)
    given = [link.values[name] for link, names in laws for name in names], structure.mass_values.tolist()
    exact = kind is np.float64
    coefficients, masses = (own if exact else [kind(repr(float(x))) for x in own] for own in given)
    values: NDArray[Any] = np.zeros(layout.size, dtype=kind)
    values[layout.values] = coefficients
    values[layout.inverse_masses] = 1.0 / (np.array(masses) * kind(SCALE))
    values[layout.branches] = 1.0
    return values


def _without_rounding(edges: Floats, coefficients: Floats) -> Floats:
    """Coefficients (S, w), 0 where they add less to a piece than its rounding: a spline never rests, and Taylor series of
    motions that are nearly at rest underflow.
    """
    lengths = np.diff(edges)[: len(coefficients), None]
    added = np.abs(coefficients) * lengths ** np.arange(coefficients.shape[1])
    return np.where(added > np.finfo(float).eps * added.max(initial=0.0), coefficients, 0.0)


_FRACTION = 1e-3  # of a step: far enough for g to exceed rounding, short enough for g to keep its sign
_SHORTEST = 1e-12  # of a step
_RESOLUTION_OF_TIME = 4.0  # of the spacing of numbers: a moment that time can tell
_ROUNDING = 1e-12  # of the terms of g: a g that stays that small counts as zero
_ON_KINK = 1e-6  # of the change of g within the moment: if smaller, g counts as zero
_CLEAR = 1e-6  # of the terms of g: a g that is larger has the sign that it shows


class BranchChoice(NamedTuple):
    """How a motion continues: with `parameters` (P,), and up to `time` in s without detection of kinks.

    `stuck` is the number of the kink that the motion cannot leave, or None.
    """

    time: float
    parameters: NDArray[Any]
    stuck: int | None = None


def branches_hold(system: CompiledSystem, start: Placement) -> bool:
    """Whether every kink is watched, far from zero, and of the sign that `start` has, so that the motion just goes on."""
    parameters, layout, time = start.parameters, system.layout, float(start.time)
    if parameters[layout.unwatched].any():
        return False
    values, sizes = system.kinks_at(start.state, parameters, time)
    return bool((values * parameters[layout.branches] > _CLEAR * sizes).all())


@np.errstate(over="ignore", invalid="ignore")  # of a kink's value; what is not finite has no branch
def choose_branches(system: CompiledSystem, start: Placement, longest: float) -> BranchChoice:
    """The branches of the motion that follows from `start`; `longest` in s bounds the trial step.

    A kink that stays exactly zero (nothing moves), or as small as rounding, is not watched.
    """
    state, time, parameters = start.state, float(start.time), start.parameters.copy()
    integrator, layout = system.without_events, system.layout
    branches, unwatched = parameters[layout.branches], parameters[layout.unwatched]
    values, sizes = system.kinks_at(state, parameters, time)
    for _ in range(system.kinks):  # kinks may be nested, inner ones first
        signs = np.where(values == 0.0, branches, np.sign(values))
        if (signs == branches).all():
            break
        branches[:] = signs
        values, sizes = system.kinks_at(state, parameters, time)
    reversals = np.zeros(system.kinks, dtype=int)
    fraction = _FRACTION
    while True:
        integrator.place(Placement(time, state, parameters))
        later_state, later = integrator.trial_step(fraction, longest)
        then, _ = system.kinks_at(later_state, parameters, later)
        on_kink = np.abs(values) <= _ON_KINK * np.abs(then - values)
        passed = ~on_kink & (values * then < 0.0)
        resolved = 0.1 * (later - time) > _RESOLUTION_OF_TIME * np.spacing(time)
        if passed.any() and fraction > _SHORTEST and resolved:
            fraction *= 0.1  # another kink is passed within this moment
            continue
        on_kink |= passed  # nearer to it than time can tell
        wrong = on_kink & (then * branches < 0.0)
        if not wrong.any():
            # a slider that slides: its force stays at the limit, up to rounding
            slides = (then == values) & (np.abs(values) <= _ROUNDING * sizes)
            unwatched[:] = (then == 0.0) | slides
            return BranchChoice(later, parameters)
        reversals += wrong
        if reversals.max() > 2:
            return BranchChoice(time, parameters, int(np.argmax(reversals)))
        branches[wrong] *= -1.0
        values, sizes = system.kinks_at(state, parameters, time)


_SAMPLE_BYTES = 32  # at least: time, and displacement, velocity and acceleration of one mass
_ALWAYS_FREE = 2**30  # bytes that `available_memory` takes to be there
_SHOWN = 12  # masses listed in a message


def output_times(duration: float | None, rate: float | None, times: ArrayLike | None = None) -> Floats:
    """Output times (N,) in s at `rate` in Hz over `duration` in s, or `times` (N,). Raises SimulationError if invalid."""
    if times is None:
        return _even_times(duration, rate)
    if duration is not None or rate is not None:
        raise SimulationError("times cannot be combined with duration or rate")
    grid = np.array(times, dtype=float)
    valid = grid.ndim == 1 and grid.size >= 2 and bool(np.all(np.isfinite(grid)))
    if not valid or grid[0] < 0.0 or np.any(np.diff(grid) <= 0.0):
        wanted = "a one-dimensional array of at least two increasing numbers, not negative"
        raise SimulationError(f"times must be {wanted}")
    even = np.linspace(grid[0], grid[-1], grid.size)
    if np.abs(grid - even).max() > 1e-6 * (even[1] - even[0]):
        raise SimulationError("times must be evenly spaced, since a record has one sampling rate")
    return grid


def _even_times(duration: float | None, rate: float | None) -> Floats:
    if duration is None or rate is None:
        raise SimulationError("duration in s and rate in Hz, or times, must be given")
    for quantity, value, unit in (("duration", duration, "s"), ("rate", rate, "Hz")):
        if not (np.isfinite(value) and value > 0.0):
            raise SimulationError(f"{quantity} must be positive and finite, got {value!r} {unit}")
    size = _SAMPLE_BYTES * duration * rate
    if size > _ALWAYS_FREE and size > available_memory():
        raise SimulationError(
            f"{duration:g} s at {rate:g} Hz are {duration * rate:.3g} samples, more than memory can hold; simulate a shorter "
            "time, or at a lower rate"
        )
    count = int(np.floor(duration * rate * (1.0 + 1e-12) + 1e-9)) + 1
    if count < 2:
        raise SimulationError(
            f"{duration:g} s at {rate:g} Hz is less than one sampling interval; simulate a longer time, or at a higher rate"
        )
    return np.arange(count) / float(rate)


def check_excitation(structure: Structure, excitation: Excitation, end: float) -> None:
    """Raise SimulationError for an excitation that does not fit the structure, or ends before `end` in s."""
    for channel in released(structure, excitation):
        check_place(channel, structure, "a release")
        host = next((host for host in structure.hosts if channel.place in host.points), None)
        if host is not None:
            raise SimulationError(
                f"the release {channel} is that of a point, which moves as the modes of {host.name} do; release these, such "
                f"as {channel.kind}:{host.coordinates[0]}, or give an impulse or a force",
                mass=channel.place,
            )
    for impulse in excitation.impulses:
        check_place(Channel("force", impulse.mass), structure, "an impulse")
        if impulse.time >= end:
            message = f"the impulse on {impulse.mass} at {impulse.time:g} s is after the end of the simulation ({end:g} s)"
            raise SimulationError(message, impulse.time, impulse.mass)
    for mass in excitation.forces:
        check_place(Channel("force", mass), structure, "a force")
    check_base(structure, moves=excitation.base is not None)
    for name in excitation.signals:
        check_place(Channel("signal", name), structure, "an excitation")
    for name in structure.signals.keys() - excitation.signals.keys():
        raise SimulationError(
            f"a law names the signal {name}, whose course is not given; give signals={{{name!r}: ...}}, an expression of t or "
            'Sampled, or "0" for none'
        )
    for name, given in excitation.drives.items():
        if isinstance(given, Sampled) and (given.start > 0.0 or given.end < end - 1e-6 / given.rate):
            drive = "the motion of the base" if name == BASE else f"the force on {name}"
            drive = name if name.startswith(_SIGNAL) else drive
            raise SimulationError(
                f"{drive} is sampled from {given.start:g} to {given.end:g} s, but the simulation runs from 0 to {end:g} s; "
                "give more samples or simulate a shorter time"
            )


def released(structure: Structure, excitation: Excitation) -> dict[Channel, float]:
    """What is released. Raises SimulationError for anything but displacements, velocities and states of links."""
    release = {}
    for name, value in excitation.release.items():
        with suppress(RecordError):
            channel = Channel.parse(name)
            if channel.kind in ("x", "v", "state") and not channel.relative:
                release[channel] = value
                continue
        example = next(iter(structure.mass_names), "m1")
        message = f"unknown release {name!r}; expected a displacement, such as x:{example}, or a velocity, v:{example}"
        raise SimulationError(message)
    return release


def check_place(channel: Channel, structure: Structure, where: str) -> None:
    """Raise SimulationError unless a channel is of the structure; `where` says what names it."""
    names, place, of = places_of(channel.kind, structure), channel.place, KINDS[channel.kind].of
    if place in names or (of == "mass" and place in structure.mass_names):
        return
    shown = ", ".join(names if len(names) <= _SHOWN else (*names[: _SHOWN - 2], "...", names[-1])) or "none"
    places = "masses and points" if structure.hosts else "masses"
    listed = places if of == "mass" else f"{of}s"
    message = f"unknown {of} {place!r} in {where}{near_miss(place, names)}; the {listed} are {shown}"
    raise SimulationError(message, mass=place if of == "mass" else None)


def check_base(structure: Structure, *, moves: bool) -> None:
    """The motion of the base must be given, so that it `moves`, if, and only if, a link has the base as an end."""
    on_base = np.flatnonzero(structure.base_incidence)
    if moves and not on_base.size:
        raise SimulationError(
            'the motion of the base is given, but no link has "base" as an end; write "base" instead of "ground" in `between`'
        )
    if on_base.size and not moves:
        raise SimulationError(
            f'link {structure.links[int(on_base[0])].name!r} has "base" as an end, but the motion of the base is not given; '
            'give base=..., its displacement as an expression of t or Sampled, or "0" for a base at rest'
        )


_MOST_LINKS = 6  # whose elongations a message shows
_ROOT = (
    "; the law of link {} has a root or a power that is no integer, which the integrator cannot follow through 0: write "
    "(x**2 + 1e-14)**0.75 for abs(x)**1.5, as the named law hertz does"
)


def diverged(schedule: RunSchedule, time: float, state: Floats) -> SimulationError:
    """The motion has gone too far at `time` in s, where displacements are the first n entries of `state` in m."""
    x = state[: schedule.structure.size]
    number = int(np.argmax(np.abs(x)))
    mass = schedule.structure.mass_names[number]
    unit = unit_in(schedule.structure, f"x:{mass}")
    return SimulationError(
        f"the motion diverges: at {time:g} s the displacement of mass {mass} is {abs(x[number]):.3g} {unit}; a link with "
        "negative stiffness or damping needs a term that limits the motion, or its sign is wrong",
        time,
        mass,
    )


def _is_root(node: Expression) -> bool:
    """Whether a node of a law has no Taylor series where its argument is 0."""
    if isinstance(node, Power):
        return not isinstance(node.exponent, int)
    return isinstance(node, Call) and node.function == "sqrt"


Motion = tuple[Floats, Floats, Floats]
"""Displacements in m and velocities in m/s (M, n), and states of links (M, S)."""
Receiver = Callable[[int, Floats, Floats, Floats], object]

EXTENDED_STEPS = 64
EXTENDED_WORK = 640
"""The first steps are taken in 80-bit arithmetic: this number over the number of masses, but at least `EXTENDED_STEPS`. In a
chaotic structure the earliest rounding errors grow longest: without these steps the paper's chain of 6 departs from the
400-bit reference by 5e-6 at the end of the file, with them by 2e-7."""
FARTHEST = 1e4  # m; a structure that moves farther diverges
CHUNK = 4096  # steps between two checks of a run
# the same while a kink is exactly zero and not watched: within one step it stays near zero
_UNWATCHED_STEPS = 1
MOST_STEPS = 4_000_000  # times masses between two output times before a run is given up
_CROWD = 1000  # that many kinks ...
_INSTANT = 1e-6  # ... within this fraction of the run are chatter
_SEARCH = 100_000  # steps in the search for the last finite state
_REST = 1e-3  # of the run: longest trial step of a structure at rest, whose own step is unlimited


@dataclass(frozen=True)
class RunLog:
    """The course of a run: its number of steps, the times in s of kinks, and those at which it was interrupted."""

    steps: int
    kinks: tuple[float, ...]
    interruptions: tuple[float, ...]


@dataclass(frozen=True)
class RunOptions:
    """How to run a schedule.

    `longest_step` in s bounds the steps; `extended` says whether to start in 80-bit arithmetic; `repeated` is an earlier run
    of the same schedule and options to repeat step by step; the time after every step is appended to `log`; `into` has room
    for the motion at all output times.
    """

    longest_step: float = np.inf
    extended: bool = True
    repeated: RunLog | None = None
    log: list[float] | None = None
    into: Motion | None = None


def room(structure: Structure, count: int) -> Motion:
    """Room for the motion of a structure at a number of times."""
    size, states = structure.size, len(structure.topology.states)
    return np.empty((count, size)), np.empty((count, size)), np.empty((count, states))


def integrate(
    schedule: RunSchedule,
    times: Floats,
    receive: Receiver = lambda first, x, v, states: None,
    options: RunOptions = RunOptions(),
) -> RunLog:
    """Run a schedule and hand over the motion at `times` (M,) in s (increasing, within the schedule), block by block.

    `receive(first, x, v, states)` takes it at times[first], times[first + 1], ..., in arrays that are reused unless the
    options give their own, and returns True to end the run. At an impulse the motion is the one after it. Raises
    SimulationError where the motion diverges, a force is not finite, or a link sticks.
    """
    return _Run(schedule, times, receive, options).run()


class _Run:
    """The state of a run, and the output that waits to be handed over."""

    def __init__(self, schedule: RunSchedule, times: Floats, receive: Receiver, options: RunOptions) -> None:
        self.schedule, self.times, self.receive = schedule, times, receive
        self.options = options
        self.repeated = () if options.repeated is None else options.repeated.interruptions
        self.system = compiled_system(schedule.shape)
        smooth = options.extended and not schedule.pieces.shape[1]
        self.integrator = (self.system.extended if smooth else None) or self.system.double
        self.in_extended = self.integrator is not self.system.double
        self.extended_steps = max(EXTENDED_STEPS, EXTENDED_WORK // schedule.structure.size)
        with np.errstate(over="ignore"):  # a start that overflows is refused as diverging
            self.place(self.integrator, 0.0, schedule.start / SCALE)
        self.steps = 0
        self.kinks: list[float] = []
        self.interruptions: list[float] = []
        self.next = 0  # index of the first output time that has not been reached
        self.motion = options.into or room(schedule.structure, min(len(times), 2 * schedule.block))
        self.first = 0  # index of the output time of the first row of `motion`
        self.handed = 0  # index of the first output time that has not been handed over
        self.stopped = False

    def place(self, integrator: Integrator, time: Time, state: Floats) -> None:
        """Start an integrator of any precision from the current time and state."""
        parameters = run_time_parameters(self.schedule.structure, self.system.layout, integrator.dtype)
        integrator.place(Placement(time, state, parameters))

    @np.errstate(over="ignore", invalid="ignore")  # what goes too far or is not finite is refused
    def run(self) -> RunLog:
        """From the first stop to the last."""
        schedule, stops, layout = self.schedule, self.schedule.stops, self.system.layout
        limits = np.searchsorted(self.times, stops, side="left").tolist()
        for number, stop in enumerate(stops):
            if number in schedule.jumps:
                self.integrator.add_to_state(schedule.jumps[number] / SCALE)
            if self.next < len(self.times) and self.times[self.next] == stop:
                self.store(self.integrator.state[None])
            if self.stopped or number == len(stops) - 1:
                break
            if schedule.pieces.shape[1]:
                self.integrator.set_parameters(layout.pieces, schedule.pieces[number])
            if self.system.kinks and not branches_hold(self.system, self.placement()):
                self.leave_kinks(stops[number + 1])
            self.advance(stops[number + 1], limits[number + 1])
        self.flush()
        return RunLog(self.steps, tuple(self.kinks), tuple(self.interruptions))

    def advance(self, end: float, limit: int) -> None:
        """Integrate to `end` in s and store the states at the output times of index below `limit`."""
        fruitless = 0
        while not self.stopped:
            start, state = self.integrator.time, self.integrator.state
            while self.next < limit and self.times[self.next] <= start:
                self.store(state[None])
            if start >= end:
                return
            wanted = self.times[self.next : min(limit, self.before_interruption())]
            stops = np.empty(len(wanted) + 1)
            stops[:-1], stops[-1] = wanted, end
            rule = StepRule(self.step_limit(), self.options.longest_step, self.options.log)
            result = self.integrator.propagate(stops, rule)
            self.steps += result.steps
            reached = result.states[: len(wanted)]
            self.store(reached)
            fruitless = 0 if len(reached) else fruitless + result.steps
            if result.outcome is Outcome.DONE:
                return
            if result.outcome is Outcome.NOT_FINITE:
                raise self.not_finite(float(start), state)
            if result.outcome is Outcome.KINK:
                self.pass_kink(end)
                continue
            self.interruptions.append(float(self.integrator.time))
            if self.in_extended:
                extended, self.integrator, self.in_extended = self.integrator, self.system.double, False
                self.place(self.integrator, float(extended.time), extended.state)
            if self.integrator.time >= end:
                return
            if self.unwatched():
                self.leave_kinks(end)
            states = np.vstack([state[None], result.states, self.integrator.state]).astype(float) * SCALE
            x = states[:, : self.schedule.structure.size]
            self.check_distance(np.full(len(x), float(self.integrator.time)), x)
            if fruitless > MOST_STEPS // self.schedule.structure.size + 2 * CHUNK:
                raise self.too_many_steps(fruitless)

    def step_limit(self) -> int:
        """Number of steps until the next check."""
        if self.in_extended:
            return max(self.extended_steps - self.steps, 1)  # 0 would be unlimited
        return _UNWATCHED_STEPS if self.unwatched() else CHUNK

    def unwatched(self) -> bool:
        """Whether a kink is exactly zero and not watched; only symmetry or rest keeps it there."""
        unwatched = self.system.layout.unwatched
        return bool(self.system.kinks and self.integrator.parameters[unwatched].any())

    def before_interruption(self) -> int:
        """Index of the first output time after the next interruption of the run that is repeated."""
        passed = len(self.interruptions)
        if passed >= len(self.repeated):
            return len(self.times)
        return int(np.searchsorted(self.times, self.repeated[passed], side="right"))

    def store(self, states: NDArray[np.floating]) -> None:
        """Store the scaled states at the next output times, and hand over complete blocks."""
        block, size = self.schedule.block, self.schedule.structure.size
        kinds = slice(size), slice(size, 2 * size), slice(2 * size, None)
        for first in range(0, len(states), block):
            part = states[first : first + block]
            rows = slice(self.next - self.first, self.next - self.first + len(part))
            for columns, motion in zip(kinds, self.motion, strict=True):
                np.multiply(part[:, columns], SCALE, out=motion[rows], casting="same_kind")
            self.next += len(part)
            if self.next - self.handed >= block:
                self.flush()

    def flush(self) -> None:
        """Hand the stored states over to the receiver."""
        if self.next == self.handed or self.stopped:
            return
        x, v, states = (part[self.handed - self.first : self.next - self.first] for part in self.motion)
        self.check_distance(self.times[self.handed : self.next], x)
        self.stopped = bool(self.receive(self.handed, x, v, states))
        self.handed = self.next
        if self.options.into is None:
            self.first = self.next

    def check_distance(self, times: Floats, x: Floats) -> None:
        """Raise SimulationError where displacements (M, n) in m have gone too far."""
        if x.max() > FARTHEST or x.min() < -FARTHEST:
            row = int(np.argmax(np.abs(x).max(axis=1) > FARTHEST))
            raise diverged(self.schedule, float(times[row]), x[row])

    def placement(self) -> Placement:
        """Where the motion is."""
        integrator = self.integrator
        return Placement(float(integrator.time), integrator.state, integrator.parameters)

    def leave_kinks(self, end: float) -> None:
        """Choose the branches on which the motion continues, and leave the kinks behind; a sticking link raises."""
        placement = self.placement()
        start = float(placement.time)
        choice = choose_branches(self.system, placement, min(end - start, _REST * self.schedule.end))
        if choice.stuck is not None:
            raise self.sticking(choice.stuck)
        if not choice.time > start:  # a force that is not finite leaves no step
            raise self.not_finite(start, placement.state)
        passed = self.times[self.next : np.searchsorted(self.times, choice.time, side="left")]
        passed = passed[passed > start]
        smooth = self.system.without_events
        smooth.place(Placement(start, placement.state, choice.parameters))
        result = smooth.propagate(np.append(passed, choice.time), StepRule())
        self.store(result.states[: len(passed)])
        self.integrator.place(Placement(choice.time, smooth.state, choice.parameters))

    def pass_kink(self, end: float) -> None:
        """Record a kink and continue on the other branch."""
        time = float(self.integrator.time)
        self.kinks.append(time)
        recent = self.kinks[-_CROWD:]
        if len(recent) == _CROWD and time - recent[0] < _INSTANT * self.schedule.end:
            raise self.sticking(None)
        if time < end:
            self.leave_kinks(end)

    def sticking(self, kink: int | None) -> SimulationError:
        """The error of a law that changes its branch without end; `kink` is one of it, None if unknown."""
        structure, time = self.schedule.structure, float(self.integrator.time)
        number = None if kink is None else self.system.link_of(kink)
        link = None if number is None else structure.links[number]
        subject = f"link {link.name!r} (law {link.law.text})" if link else "a law"
        masses = [end for end in (link.between if link else ()) if end in structure.mass_names]
        return SimulationError(
            f"at {time:g} s {subject} sticks: its force jumps so that the motion is pushed back onto the jump from both "
            "sides, and the equations of motion have no solution; replace the jump by a steep slope, such as F*tanh(v/s) with "
            "a small s for F*sign(v)",
            time,
            next(iter(masses), None),
        )

    def not_finite(self, start: float, state: Floats) -> SimulationError:
        """The error of a state that is not finite, at the last time before."""
        if self.next > self.handed and self.times[self.next - 1] > start:
            start = float(self.times[self.next - 1])
            state = np.concatenate([part[self.next - 1 - self.first] for part in self.motion]) / SCALE
        integrator, parameters = self.integrator, self.integrator.parameters
        integrator.place(Placement(start, state, parameters))
        for _ in range(_SEARCH):
            time, state = float(integrator.time), integrator.state
            outcome = integrator.propagate(self.schedule.stops[-1:], StepRule(most=1)).outcome
            if outcome in (Outcome.DONE, Outcome.NOT_FINITE) or not np.isfinite(integrator.state).all():
                break
        state = np.asarray(state * SCALE, dtype=float)
        structure, base = self.schedule.structure, self.schedule.excitation.base
        if np.abs(state[: 2 * structure.size]).max() > FARTHEST:
            return diverged(self.schedule, time, state)
        x = state[: structure.size]
        d = structure.elongations(x, 0.0 if base is None else float(base.value(time)))
        number = int(np.argmax(np.abs(x)))
        mass, elongations = structure.mass_names[number], zip(structure.links[:_MOST_LINKS], d, strict=False)
        rooted = [link.name for link in structure.links if any(map(_is_root, walk(link.law.expression)))]
        return SimulationError(
            f"a force is not finite after {time:g} s: the displacement of mass {mass} is {x[number]:.3g} "
            f"{unit_in(structure, f'x:{mass}')} and the elongations are "
            + ", ".join(f"{link.name} {value:.3g} {link.law.motion_units[0]}" for link, value in elongations)
            + "".join(map(_ROOT.format, rooted[:1])),
            time,
            mass,
        )

    def too_many_steps(self, steps: int) -> SimulationError:
        """The error of more than so many steps between two output times."""
        structure, time = self.schedule.structure, float(self.integrator.time)
        velocities = self.integrator.state[structure.size : 2 * structure.size]
        mass = structure.mass_names[int(np.argmax(np.abs(velocities)))]
        return SimulationError(
            f"at {time:g} s the motion takes more than {steps} steps between two output times, mass {mass} being the fastest: "
            "it diverges, or the structure is too stiff for this sampling rate; check stiffnesses, masses and their units",
            time,
            mass,
        )
