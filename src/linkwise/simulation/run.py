"""One run of a structure through its excitation: the states at given times, and where the run cannot go on.

The run goes from stop to stop (impulses, knots of sampled inputs, the edges of blocks) and integrates each stretch with
run-time parameters that hold the input's polynomial there. The same schedule run again over other output times takes the same
steps, so what is worked out later (energies) belongs to the same orbit, chaotic or not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Floats
from linkwise.errors import SimulationError
from linkwise.simulation.branches import settle
from linkwise.simulation.integrator import equations, last_finite, propagate
from linkwise.simulation.schedule import RunSchedule
from linkwise.simulation.shape import SCALE

Receiver = Callable[[int, Floats], object]

EXTENDED_STEPS = 128
EXTENDED_WORK = 1280
"""The first steps are taken in 80-bit arithmetic: as many as this over the number of masses, at least `EXTENDED_STEPS`. In a
chaotic structure the earliest rounding errors grow longest: without these steps the paper's chain of 6 departs from the
400-bit reference by 5e-6 at the end of the file, with them by 1e-7."""
FARTHEST = 1e4  # m; a structure that moves farther diverges
CHUNK = 4096  # steps between two looks at a run
_BLIND = (
    1  # the same while a kink is exactly zero and therefore not watched: within a step it stays near zero
)
_PATIENCE = 4_000_000  # steps times masses between two output samples before a run counts as hopeless
_CROWD = 1000  # that many kinks ...
_MOMENT = 1e-6  # ... within this part of the run are chatter
_REST = 1e-3  # of the run: longest trial step of a structure at rest, whose own step has no end


@dataclass(frozen=True)
class RunLog:
    """How a run went: its number of steps, the times at which a law bent, and those at which it was interrupted."""

    steps: int
    kinks: tuple[float, ...]
    waypoints: tuple[float, ...]


@dataclass(frozen=True)
class RunOptions:
    """How to run a schedule: the `longest_step` in s, whether to start in `extended` precision, an earlier run of the same
    schedule and manner to be `repeated` step by step, and a `log` that takes the time after every step.
    """

    longest_step: float = np.inf
    extended: bool = True
    repeated: RunLog | None = None
    log: list[float] | None = None


def integrate(
    schedule: RunSchedule, times: Floats, receive: Receiver, manner: RunOptions = RunOptions()
) -> RunLog:
    """Run the schedule and hand over the states (M, 2n) at `times` (increasing, within the schedule), block by block.

    `receive(first, states)` takes the states at times[first], times[first + 1], ... in SI units, in an array that is used
    again, and returns True to end the run. At an impulse the state is the one after it.
    Raises SimulationError where the motion diverges, a law is not finite, or a link sticks.
    """
    return _Run(schedule, times, receive, manner).run()


class _Run:
    """Where a run stands, and the output that waits to be handed over."""

    def __init__(self, schedule: RunSchedule, times: Floats, receive: Receiver, manner: RunOptions) -> None:
        self.schedule, self.times, self.receive = schedule, times, receive
        self.manner = manner
        self.repeated = () if manner.repeated is None else manner.repeated.waypoints
        self.equations = equations(schedule.shape)
        smooth = manner.extended and not schedule.pieces.shape[1]
        self.integrator = (self.equations.extended if smooth else None) or self.equations.double
        self.early = self.integrator is not self.equations.double
        self.extended_steps = max(EXTENDED_STEPS, EXTENDED_WORK // schedule.structure.size)
        with np.errstate(over="ignore"):  # a start that overflows is refused as diverging
            self.place(self.integrator, 0.0, schedule.start / SCALE)
        self.steps = 0
        self.kinks: list[float] = []
        self.waypoints: list[float] = []
        self.next = 0  # the first output time that has not been reached
        self.held = np.empty((min(len(times), 2 * schedule.block), 2 * schedule.structure.size))
        self.count = 0
        self.over = False

    def place(self, integrator: Any, time: float, state: NDArray[Any]) -> None:
        """Put an integrator where the run stands."""
        kind = integrator.state.dtype.type
        integrator.pars[:] = self.schedule.parameters(self.equations.layout, kind)
        integrator.state[:] = state
        integrator.time = kind(time)

    def run(self) -> RunLog:
        """From the first stop to the last."""
        schedule, stops, layout = self.schedule, self.schedule.stops, self.equations.layout
        limits = np.searchsorted(self.times, stops, side="left").tolist()
        for number, stop in enumerate(stops):
            if number in schedule.jumps:
                self.integrator.state[:] += schedule.jumps[number] / SCALE
            if self.next < len(self.times) and self.times[self.next] == stop:
                self.keep(self.integrator.state[None])
            if self.over or number == len(stops) - 1:
                break
            if schedule.pieces.shape[1]:
                self.integrator.pars[layout.pieces] = schedule.pieces[number]
            if self.equations.kinks:
                self.settle(stops[number + 1])
            self.stretch(stops[number + 1], limits[number + 1])
        self.hand_over()
        return RunLog(self.steps, tuple(self.kinks), tuple(self.waypoints))

    def stretch(self, end: float, limit: int) -> None:
        """Integrate to `end`, keeping the states at the output times below number `limit`."""
        fruitless = 0
        while not self.over:
            began, state = self.integrator.time, self.integrator.state.copy()
            while self.next < limit and self.times[self.next] <= began:
                self.keep(state[None])
            wanted = self.times[self.next : min(limit, self.before_waypoint())]
            gone = propagate(
                self.integrator,
                np.concatenate([[began], wanted, [end]]).astype(state.dtype),
                most_steps=self.patience(),
                longest_step=self.manner.longest_step,
                log=self.manner.log,
            )
            self.steps += gone.steps
            reached = gone.states[1 : 1 + len(wanted)]
            self.keep(reached)
            fruitless = 0 if len(reached) else fruitless + gone.steps
            if gone.ended == "done":
                return
            if gone.ended == "not finite":
                self.refuse_not_finite(float(began), state)
            if gone.ended == "kink":
                self.bend(end)
                continue
            self.waypoints.append(float(self.integrator.time))
            if self.early:
                early, self.integrator, self.early = self.integrator, self.equations.double, False
                self.place(self.integrator, float(early.time), early.state)
            if self.integrator.time >= end:
                return
            if self.muted():
                self.settle(end)
            seen = np.vstack([gone.states, self.integrator.state]).astype(float) * SCALE
            self.look(np.full(len(seen), float(self.integrator.time)), seen)
            if fruitless > _PATIENCE // self.schedule.structure.size + 2 * CHUNK:
                self.refuse_hopeless(fruitless)

    def patience(self) -> int:
        """How many steps to take before looking where the run stands."""
        if self.early:
            return max(self.extended_steps - self.steps, 1)  # 0 would be without end
        return _BLIND if self.muted() else CHUNK

    def muted(self) -> bool:
        """Whether a kink is exactly zero and not watched; only symmetry or rest keeps it there."""
        return bool(self.equations.kinks) and bool(self.integrator.pars[self.equations.layout.muted].any())

    def before_waypoint(self) -> int:
        """The number of the first output time behind the place where the run it repeats was interrupted next."""
        passed = len(self.waypoints)
        if passed >= len(self.repeated):
            return len(self.times)
        return int(np.searchsorted(self.times, self.repeated[passed], side="right"))

    def keep(self, states: NDArray[Any]) -> None:
        """Take the states at the next output times, and hand over what has been taken when it is a block."""
        size = self.schedule.block
        for first in range(0, len(states), size):
            block = states[first : first + size]
            if self.count + len(block) > len(self.held):
                self.hand_over()
            place = self.held[self.count : self.count + len(block)]
            np.multiply(block, SCALE, out=place, casting="same_kind")
            self.count += len(block)
            self.next += len(block)

    def hand_over(self) -> None:
        """Pass the states that were taken on to the receiver."""
        if not self.count or self.over:
            return
        block = self.held[: self.count]
        first = self.next - self.count
        self.count = 0
        self.look(self.times[first : first + len(block)], block)
        self.over = bool(self.receive(first, block))

    def look(self, times: Floats, states: Floats) -> None:
        """Refuse a motion that has gone too far."""
        x = states[:, : self.schedule.structure.size]
        if x.max() > FARTHEST or x.min() < -FARTHEST:
            row = int(np.argmax(np.abs(x).max(axis=1) > FARTHEST))
            self.refuse_far(float(times[row]), states[row])

    def settle(self, end: float) -> None:
        """Choose the branches on which the motion goes on and leave the kinks behind; refuse a structure that sticks."""
        blind, began = self.equations.blind, float(self.integrator.time)
        blind.pars[:], blind.state[:], blind.time = self.integrator.pars, self.integrator.state, began
        settled = settle(self.equations, min(end - began, _REST * self.schedule.end))
        if settled.stuck is not None:
            self.refuse_stuck(settled.stuck)
        passed = self.times[self.next : np.searchsorted(self.times, settled.moment, side="left")]
        passed = passed[passed > began]
        gone = propagate(blind, np.concatenate([[began], passed, [settled.moment]]))
        self.keep(gone.states[1 : 1 + len(passed)])
        self.integrator.pars[:], self.integrator.state[:] = blind.pars, blind.state
        self.integrator.time = settled.moment

    def bend(self, end: float) -> None:
        """Pass a kink: go on on the other branch."""
        now = float(self.integrator.time)
        self.kinks.append(now)
        recent = self.kinks[-_CROWD:]
        if len(recent) == _CROWD and now - recent[0] < _MOMENT * self.schedule.end:
            self.refuse_stuck(None)
        if now < end:
            self.settle(end)

    def refuse_stuck(self, kink: int | None) -> NoReturn:
        """Stop where a law changes its branch without end."""
        time = float(self.integrator.time)
        owner = -1 if kink is None else self.equations.owner(kink)
        link = self.schedule.structure.links[owner] if owner >= 0 else None
        who = f"link {link.name!r} (law {link.law.text})" if link else "a law"
        ends = link.between if link else ()
        mass = next((end for end in ends if end in self.schedule.structure.mass_names), None)
        raise SimulationError(
            f"at {time:g} s {who} sticks: its force jumps so that the motion is pushed back onto the jump from both sides, "
            "and the equations do not say how it goes on; write a jump as a steep slope, such as F*tanh(v/s) with a small s "
            "for F*sign(v)",
            time,
            mass,
        )

    def refuse_far(self, time: float, state: Floats) -> NoReturn:
        """Stop a motion that runs away."""
        number = int(np.argmax(np.abs(state[: self.schedule.structure.size])))
        mass = self.schedule.structure.mass_names[number]
        raise SimulationError(
            f"the motion diverges: at {time:g} s mass {mass} is {abs(state[number]):.3g} m from its place; a link with "
            "negative stiffness or damping needs a term that holds it back, or its sign is wrong",
            time,
            mass,
        )

    def refuse_not_finite(self, began: float, state: NDArray[Any]) -> NoReturn:
        """Stop where no number is finite any more: find the last moment before."""
        if self.count and self.times[self.next - 1] > began:
            began, state = float(self.times[self.next - 1]), self.held[self.count - 1] / SCALE
        time, state = last_finite(self.integrator, began, state)
        state = np.asarray(state * SCALE, dtype=float)
        if np.abs(state).max() > FARTHEST:
            self.refuse_far(time, state)
        names, links = self.schedule.structure.mass_names, self.schedule.structure.links
        base = self.schedule.excitation.base
        where = 0.0 if base is None else float(base.value(time))
        d = self.schedule.structure.elongations(state[: len(names)], where)
        number = int(np.argmax(np.abs(state[: len(names)])))
        raise SimulationError(
            f"the motion cannot go on after {time:g} s: a force is not a finite number; mass {names[number]} is at "
            f"{state[number]:.3g} m and the elongations are "
            + ", ".join(f"{link.name} {value:.3g} m" for link, value in list(zip(links, d, strict=True))[:6]),
            time,
            names[number],
        )

    def refuse_hopeless(self, steps: int) -> NoReturn:
        """Stop a motion that became so fast that it would never arrive."""
        time = float(self.integrator.time)
        speeds = np.abs(self.integrator.state[self.schedule.structure.size :])
        mass = self.schedule.structure.mass_names[int(np.argmax(speeds))]
        raise SimulationError(
            f"at {time:g} s the motion takes more than {steps} steps between two output times, mass {mass} being the fastest: "
            "it diverges, or the structure is too stiff for this sampling rate; check stiffnesses, masses and their units",
            time,
            mass,
        )
