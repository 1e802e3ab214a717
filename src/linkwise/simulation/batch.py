"""Structures of one shape under excitations of one kind, integrated side by side in the lanes of one integrator.

Energies are integrated along with the motion, and crossings of given elongations are events. Laws with kinks cannot be
run in a batch: their events end a step in one lane but not in the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import zip_longest

import numpy as np

from linkwise.arrays import Bools, Floats
from linkwise.simulation.integrator.formulas import SCALE, CompiledSystem, compiled_system
from linkwise.simulation.run import FARTHEST, MOST_STEPS, RunSchedule, run_time_parameters

LANES = 4  # numbers in a register of most processors; with more, all lanes wait for the slowest
_NEVER = 1e9  # m: an elongation that is never crossed


@dataclass(frozen=True, eq=False)
class BatchRun:
    """One of the runs over N times: displacements in m and velocities in m/s (N, n), the energy in J that links have
    `dissipated` (N, L), the `work` (N,) of the excitation since the start, and for each link the times in s at which it
    crossed one of its levels.
    """

    x: Floats
    v: Floats
    dissipated: Floats
    work: Floats
    crossings: tuple[Floats, ...]


def can_batch(schedule: RunSchedule) -> bool:
    """Whether a schedule can be run in a batch: no law of it has a kink or a flat part."""
    return not compiled_system(schedule.shape).kinks


def run_batch(schedules: Sequence[RunSchedule], levels: Sequence[Sequence[Floats]]) -> list[BatchRun | None]:
    """Run up to `LANES` schedules that differ in numbers only; None for one that diverged or took too many steps.

    `levels` has, by run and link, the elongations in m whose crossings are recorded. Raises ValueError for a shape with kinks.
    """
    by_link = [list(zip_longest(*link_levels, fillvalue=_NEVER)) for link_levels in zip(*levels, strict=True)]
    watched = tuple(link for link, link_levels in enumerate(by_link) for _ in link_levels)
    all_levels = np.array([level for own in by_link for level in own]).reshape(-1, len(schedules))
    system = compiled_system(schedules[0].shape)
    completed = np.ones(len(schedules), dtype=bool)
    while True:
        runs = np.flatnonzero(completed)
        lanes = np.resize(runs, LANES)  # an empty lane repeats a completed run
        own = [schedules[run] for run in lanes.tolist()]
        batch = _Batch(system, watched, own, all_levels[:, lanes])
        failed = batch.run()[: len(runs)]
        completed[runs[failed]] = False
        if failed.all() or not failed.any():
            kept = np.flatnonzero(completed).tolist()
            return [batch.lane(kept.index(run)) if run in kept else None for run in range(len(schedules))]


class _Batch:
    """One attempt to run all lanes to the end."""

    def __init__(
        self,
        system: CompiledSystem,
        watched: tuple[int, ...],
        schedules: Sequence[RunSchedule],
        levels: Floats,
    ) -> None:
        self.schedules, self.watched, self.layout = schedules, watched, system.layout
        self.integrator = integrator = system.batch(LANES, watched)
        schedule = schedules[0]
        self.size, self.times = schedule.structure.size, schedule.times
        parameters = np.stack(
            [run_time_parameters(lane.structure, self.layout) for lane in schedules], axis=1
        )
        state = np.zeros_like(integrator.state)
        state[: 2 * self.size] = np.stack([lane.start for lane in schedules], axis=1) / SCALE
        integrator.place(state, np.concatenate([parameters, levels]))
        self.states = np.empty((len(self.times), *state.shape))
        self.masses = np.stack([lane.structure.mass_values for lane in schedules], axis=1)
        self.next = 0  # index of the first output time that has not been reached

    def run(self) -> Bools:
        """Run from stop to stop; returns which lanes failed, (LANES,)."""
        schedule = self.schedules[0]
        stops = schedule.stops
        limits = np.searchsorted(self.times, stops, side="left")
        most_steps = MOST_STEPS // self.size + 1
        for number, stop in enumerate(stops):
            if number in schedule.jumps:
                self.apply_impulses(number)
            if self.next < len(self.times) and self.times[self.next] == stop:
                self.states[self.next] = self.integrator.state
                self.next += 1
            if number == len(stops) - 1:
                break
            if schedule.pieces.shape[1]:
                self.integrator.set_parameters(self.layout.pieces, schedule.pieces[number][:, None])
            wanted = self.times[self.next : limits[number + 1]]
            states, failed = self.integrator.propagate(np.append(wanted, stops[number + 1]), most_steps)
            if failed.any():
                return failed
            self.states[self.next : self.next + len(wanted)] = states[: len(wanted)]
            self.next += len(wanted)
        farthest = np.abs(self.states[:, : self.size]).max(axis=(0, 1)) * SCALE
        return np.asarray(~(farthest <= FARTHEST))

    def apply_impulses(self, stop: int) -> None:
        """Velocities jump by J, and the work grows by m J (v - J/2), with v the velocity after the jump."""
        state = self.integrator.state
        jumps = np.stack([lane.jumps[stop] for lane in self.schedules], axis=1)
        state[: 2 * self.size] += jumps / SCALE
        speeds, jumps = state[self.size : 2 * self.size] * SCALE, jumps[self.size :]
        state[-1] += (self.masses * jumps * (speeds - 0.5 * jumps)).sum(axis=0)
        self.integrator.set_state(state)

    def lane(self, lane: int) -> BatchRun:
        """The run of a lane."""
        states, size = self.states[..., lane].copy(), self.size
        states[:, : 2 * size] *= SCALE
        crossings: list[list[float]] = [[] for _ in self.schedules[lane].structure.links]
        for link, crossed in zip(self.watched, self.integrator.crossings, strict=True):
            crossings[link] += [time for which, time in crossed if which == lane]
        return BatchRun(
            x=states[:, :size],
            v=states[:, size : 2 * size],
            dissipated=states[:, 2 * size : -1],
            work=states[:, -1],
            crossings=tuple(map(np.array, crossings)),
        )
