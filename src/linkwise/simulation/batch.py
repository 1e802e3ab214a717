"""Many structures of one shape under one kind of excitation, run side by side in the lanes of one integrator.

Energies are integrated along with the motion, passages of links over given elongations are events. Laws with kinks cannot be
run so: their events end a step of one lane and not of the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Bools, Floats, Indices
from linkwise.simulation.integrator import BatchIntegrator, equations
from linkwise.simulation.run import FARTHEST
from linkwise.simulation.schedule import RunSchedule
from linkwise.simulation.shape import SCALE, ParameterLayout

LANES = (
    4  # numbers in a register of most processors; more gains nothing, since all lanes wait for the slowest
)
_PATIENCE = 4_000_000  # steps times masses between two stops before a lane counts as hopeless
_NOWHERE = 1e9  # m: an elongation that nothing passes


@dataclass(frozen=True, eq=False)
class BatchResult:
    """W runs at `time` (N,) s: `x`, `v` (N, n, W) in m and m/s; `heat` (N, L, W) and `work` (N, W) in J since the start.

    `passages` holds run by run and link by link the times in s at which it was at one of its tops. Where `alive` (W,) is False
    the motion diverged or came to no end, and its numbers mean nothing.
    """

    time: Floats
    x: Floats
    v: Floats
    heat: Floats
    work: Floats
    passages: tuple[tuple[Floats, ...], ...]
    alive: Bools


def can_batch(schedule: RunSchedule) -> bool:
    """Whether a schedule can be run side by side with others: no law of it bends or wakes up."""
    return not equations(schedule.shape).kinks


def run_batch(schedules: Sequence[RunSchedule], tops: Sequence[Floats]) -> BatchResult:
    """Run up to `LANES` schedules that differ in numbers only; `tops` (W, K) m for each link, NaN where there are fewer.

    Raises ValueError for a shape with kinks.
    """
    watched = tuple(link for link, each in enumerate(tops) for _ in range(each.shape[1]))
    levels = np.concatenate([np.where(np.isnan(each), _NOWHERE, each) for each in tops], axis=1)
    first = equations(schedules[0].shape)
    batch = first.batch(LANES, watched)
    alive = np.ones(len(schedules), dtype=bool)
    while alive.any():
        seats = np.flatnonzero(alive)
        lanes = np.resize(seats, LANES)  # an empty lane repeats a living one
        flight = _Flight(batch, first.layout, [schedules[run] for run in lanes.tolist()], levels[lanes])
        failed = flight.run()
        if not failed[: len(seats)].any():
            return _landed(flight, watched, len(tops), alive, seats)
        alive[seats[failed[: len(seats)]]] = False
    size, links, runs = schedules[0].structure.size, len(tops), len(schedules)
    time = schedules[0].times
    none = np.full((len(time), size, runs), np.nan)
    lost = tuple(tuple(np.empty(0) for _ in range(links)) for _ in range(runs))
    return BatchResult(time, none, none, np.full((len(time), links, runs), np.nan), none[:, 0], lost, alive)


class _Flight:
    """One try to bring all lanes to the end."""

    def __init__(
        self,
        batch: BatchIntegrator,
        layout: ParameterLayout,
        schedules: Sequence[RunSchedule],
        levels: Floats,
    ) -> None:
        self.batch, self.layout, self.schedules = batch, layout, schedules
        schedule = schedules[0]
        self.size, self.times = schedule.structure.size, schedule.times
        integrator = batch.integrator
        integrator.set_time(0.0)
        parameters = np.stack([each.parameters(layout) for each in schedules], axis=1)
        integrator.pars[:] = np.concatenate([parameters, levels.T])
        integrator.state[:] = 0.0
        integrator.state[: 2 * self.size] = np.stack([each.start for each in schedules], axis=1) / SCALE
        for each in batch.passages:
            each.clear()
        self.states = np.empty((len(self.times), integrator.dim, LANES))
        self.masses = np.stack([each.structure.mass_values for each in schedules], axis=1)
        self.next = 0

    def run(self) -> Bools:
        """From stop to stop; returns which lanes failed."""
        schedule, integrator = self.schedules[0], self.batch.integrator
        stops = schedule.stops
        limits = np.searchsorted(self.times, stops, side="left")
        patience = _PATIENCE // self.size + 1
        for number, stop in enumerate(stops):
            if number in schedule.jumps:
                self.strike(number)
            if self.next < len(self.times) and self.times[self.next] == stop:
                self.states[self.next] = integrator.state
                self.next += 1
            if number == len(stops) - 1:
                break
            if schedule.pieces.shape[1]:
                integrator.pars[self.layout.pieces] = schedule.pieces[number][:, None]
            wanted = self.times[self.next : limits[number + 1]]
            grid = np.concatenate([[stop], wanted, [stops[number + 1]]])
            states, failed = self.batch.propagate(grid, patience)
            if failed.any():
                return failed
            self.states[self.next : self.next + len(wanted)] = states[1 : 1 + len(wanted)]
            self.next += len(wanted)
        farthest = np.abs(self.states[:, : self.size]).max(axis=(0, 1)) * SCALE
        return np.asarray(~(farthest <= FARTHEST))

    def strike(self, stop: int) -> None:
        """A blow: velocities jump, and the work grows by m J (v - J/2) with v the velocity after it."""
        state = self.batch.integrator.state
        jumps = np.stack([each.jumps[stop] for each in self.schedules], axis=1)
        state[: 2 * self.size] += jumps / SCALE
        speeds, jumps = state[self.size : 2 * self.size] * SCALE, jumps[self.size :]
        state[-1] += (self.masses * jumps * (speeds - 0.5 * jumps)).sum(axis=0)


def _landed(
    flight: _Flight, watched: tuple[int, ...], links: int, alive: Bools, seats: Indices
) -> BatchResult:
    """What the lanes brought home, run by run; NaN for those that did not come."""
    size, runs = flight.size, len(alive)
    table = flight.states[..., :runs]
    if len(seats) < runs:
        table = np.full((*flight.states.shape[:2], runs), np.nan)
        table[..., seats] = flight.states[..., : len(seats)]
    table[:, : 2 * size] *= SCALE
    times: list[list[list[float]]] = [[[] for _ in range(links)] for _ in range(runs)]
    for link, noted in zip(watched, flight.batch.passages, strict=True):
        for lane, time in noted:
            if lane < len(seats):
                times[int(seats[lane])][link].append(time)
    return BatchResult(
        time=flight.times,
        x=table[:, :size],
        v=table[:, size : 2 * size],
        heat=table[:, 2 * size : -1],
        work=table[:, -1],
        passages=tuple(tuple(np.array(each) for each in run) for run in times),
        alive=alive,
    )
