"""One run of a structure through its schedule: the states at given times.

The run goes from stop to stop (impulses, knots of sampled inputs, ends of blocks) and integrates each interval with run-time
parameters that hold the polynomials of the inputs there. The same schedule run again with other output times takes the same
steps, so what is computed later (energies) belongs to the same orbit, chaotic or not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Floats
from linkwise.simulation.branches import branches_hold, choose_branches
from linkwise.simulation.integrator.compiled import compiled_system
from linkwise.simulation.integrator.interface import Integrator, Outcome, Placement, Time
from linkwise.simulation.integrator.shape import SCALE
from linkwise.simulation.run_errors import diverged, not_finite, sticking, too_many_steps
from linkwise.simulation.schedule import RunSchedule

Receiver = Callable[[int, Floats], object]

EXTENDED_STEPS = 128
EXTENDED_WORK = 1280
"""The first steps are taken in 80-bit arithmetic: this number over the number of masses, but at least `EXTENDED_STEPS`. In a
chaotic structure the earliest rounding errors grow longest: without these steps the paper's chain of 6 departs from the
400-bit reference by 5e-6 at the end of the file, with them by 1e-7."""
FARTHEST = 1e4  # m; a structure that moves farther diverges
CHUNK = 4096  # steps between two checks of a run
# the same while a kink is exactly zero and not watched: within one step it stays near zero
_UNWATCHED_STEPS = 1
MOST_STEPS = 4_000_000  # times masses between two output times before a run is given up
_CROWD = 1000  # that many kinks ...
_INSTANT = 1e-6  # ... within this fraction of the run are chatter
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
    of the same schedule and options to repeat step by step; the time after every step is appended to `log`; `most_steps` is
    that between two output times.
    """

    longest_step: float = np.inf
    extended: bool = True
    repeated: RunLog | None = None
    log: list[float] | None = None
    most_steps: int = MOST_STEPS


def integrate(
    schedule: RunSchedule, times: Floats, receive: Receiver, options: RunOptions = RunOptions()
) -> RunLog:
    """Run a schedule and hand over the states (M, 2n + S) at `times` in s (increasing, within the schedule), block by block.

    `receive(first, states)` takes the states at times[first], times[first + 1], ... in SI units, in an array that is reused,
    and returns True to end the run. At an impulse the state is the one after it. Raises SimulationError where the motion
    diverges, a force is not finite, or a link sticks.
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
        self.buffer = np.empty((min(len(times), 2 * schedule.block), schedule.structure.topology.dimension))
        self.buffered = 0
        self.stopped = False

    def place(self, integrator: Integrator, time: Time, state: Floats) -> None:
        """Start an integrator of any precision from the current time and state."""
        parameters = self.schedule.parameters(self.system.layout, integrator.dtype)
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
            result = self.integrator.propagate(
                stops,
                most_steps=self.step_limit(),
                longest_step=self.options.longest_step,
                log=self.options.log,
            )
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
            self.check_distance(np.full(len(states), float(self.integrator.time)), states)
            if fruitless > self.options.most_steps // self.schedule.structure.size + 2 * CHUNK:
                raise too_many_steps(
                    self.schedule, float(self.integrator.time), self.integrator.state, fruitless
                )

    def step_limit(self) -> int:
        """Number of steps until the next check."""
        if self.in_extended:
            return max(self.extended_steps - self.steps, 1)  # 0 would be unlimited
        return _UNWATCHED_STEPS if self.unwatched() else CHUNK

    def unwatched(self) -> bool:
        """Whether a kink is exactly zero and not watched; only symmetry or rest keeps it there."""
        return bool(self.system.kinks) and bool(
            self.integrator.parameters[self.system.layout.unwatched].any()
        )

    def before_interruption(self) -> int:
        """Index of the first output time after the next interruption of the run that is repeated."""
        passed = len(self.interruptions)
        if passed >= len(self.repeated):
            return len(self.times)
        return int(np.searchsorted(self.times, self.repeated[passed], side="right"))

    def store(self, states: NDArray[np.floating]) -> None:
        """Store the scaled states at the next output times, and hand over complete blocks."""
        size = self.schedule.block
        for first in range(0, len(states), size):
            block = states[first : first + size]
            if self.buffered + len(block) > len(self.buffer):
                self.flush()
            rows = self.buffer[self.buffered : self.buffered + len(block)]
            np.multiply(block, SCALE, out=rows, casting="same_kind")
            self.buffered += len(block)
            self.next += len(block)

    def flush(self) -> None:
        """Hand the stored states over to the receiver."""
        if not self.buffered or self.stopped:
            return
        block = self.buffer[: self.buffered]
        first = self.next - self.buffered
        self.buffered = 0
        self.check_distance(self.times[first : first + len(block)], block)
        self.stopped = bool(self.receive(first, block))

    def check_distance(self, times: Floats, states: Floats) -> None:
        """Raise SimulationError for a motion that has gone too far."""
        x = states[:, : self.schedule.structure.size]
        if x.max() > FARTHEST or x.min() < -FARTHEST:
            row = int(np.argmax(np.abs(x).max(axis=1) > FARTHEST))
            raise diverged(self.schedule, float(times[row]), states[row])

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
        result = smooth.propagate(np.append(passed, choice.time))
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

    def sticking(self, kink: int | None) -> Exception:
        """The error of a law that changes its branch without end."""
        link = None if kink is None else self.system.link_of(kink)
        links = self.schedule.structure.links
        return sticking(self.schedule, float(self.integrator.time), None if link is None else links[link])

    def not_finite(self, start: float, state: Floats) -> Exception:
        """The error of a state that is not finite, at the last time before."""
        if self.buffered and self.times[self.next - 1] > start:
            start, state = float(self.times[self.next - 1]), self.buffer[self.buffered - 1] / SCALE
        time, state = self.integrator.last_finite(start, state)
        state = np.asarray(state * SCALE, dtype=float)
        if np.abs(state[: 2 * self.schedule.structure.size]).max() > FARTHEST:
            return diverged(self.schedule, time, state)
        return not_finite(self.schedule, time, state)
