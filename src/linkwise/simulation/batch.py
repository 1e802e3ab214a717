"""Structures of one shape under excitations of one kind, integrated side by side in the lanes of one integrator.

Energies are integrated along with the motion, and crossings of given elongations are events. Laws with kinks cannot be
run in a batch: their events end a step in one lane but not in the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Bools, Floats, Indices
from linkwise.simulation.integrator.formulas import SCALE, CompiledSystem, compiled_system
from linkwise.simulation.run import FARTHEST, MOST_STEPS, RunSchedule, run_time_parameters

LANES = 4  # numbers in a register of most processors; with more, all lanes wait for the slowest
_NEVER = 1e9  # m: an elongation that is never crossed


@dataclass(frozen=True, eq=False)
class BatchResult:
    """The motion of W runs at N times in s: displacements in m and velocities in m/s (N, n, W), the energy in J that links
    have `dissipated` (N, L, W), the `work` (N, W) of the excitation since the start, for each run and link the times in s
    at which it crossed one of its levels, and whether a run was `completed` (W,): one that diverged or took too many steps
    has NaN.
    """

    time: Floats
    x: Floats
    v: Floats
    dissipated: Floats
    work: Floats
    crossings: tuple[tuple[Floats, ...], ...]
    completed: Bools


def can_batch(schedule: RunSchedule) -> bool:
    """Whether a schedule can be run in a batch: no law of it has a kink or a flat part."""
    return not compiled_system(schedule.shape).kinks


def run_batch(schedules: Sequence[RunSchedule], levels: Sequence[Floats]) -> BatchResult:
    """Run up to `LANES` schedules that differ in numbers only.

    `levels` has for each link the elongations (W, K) in m whose crossings are recorded, NaN where a run has fewer. Raises
    ValueError for a shape with kinks.
    """
    watched = tuple(link for link, array in enumerate(levels) for _ in range(array.shape[1]))
    all_levels = np.concatenate([np.where(np.isnan(array), _NEVER, array) for array in levels], axis=1)
    system = compiled_system(schedules[0].shape)
    completed = np.ones(len(schedules), dtype=bool)
    while True:
        runs = np.flatnonzero(completed)
        lanes = np.resize(runs, LANES)  # an empty lane repeats a completed run
        own = [schedules[run] for run in lanes.tolist()]
        batch = _Batch(system, watched, own, all_levels[lanes])
        failed = batch.run()[: len(runs)]
        completed[runs[failed]] = False
        if failed.all() or not failed.any():
            return _collected(batch, watched, len(levels), completed, runs[~failed])


class _Batch:
    """One attempt to run all lanes to the end."""

    def __init__(
        self,
        system: CompiledSystem,
        watched: tuple[int, ...],
        schedules: Sequence[RunSchedule],
        levels: Floats,
    ) -> None:
        self.schedules, self.layout = schedules, system.layout
        self.integrator = integrator = system.batch(LANES, watched)
        schedule = schedules[0]
        self.size, self.times = schedule.structure.size, schedule.times
        parameters = np.stack(
            [run_time_parameters(lane.structure, self.layout) for lane in schedules], axis=1
        )
        state = np.zeros_like(integrator.state)
        state[: 2 * self.size] = np.stack([lane.start for lane in schedules], axis=1) / SCALE
        integrator.place(state, np.concatenate([parameters, levels.T]))
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


def _collected(
    batch: _Batch, watched: tuple[int, ...], links: int, completed: Bools, runs: Indices
) -> BatchResult:
    """The result of the lanes, run by run; NaN for runs that were not completed."""
    size, count = batch.size, len(completed)
    states = batch.states[..., :count]
    if len(runs) < count:
        states = np.full((*batch.states.shape[:2], count), np.nan)
        states[..., runs] = batch.states[..., : len(runs)]
    states[:, : 2 * size] *= SCALE
    times: list[list[list[float]]] = [[[] for _ in range(links)] for _ in range(count)]
    for link, crossings in zip(watched, batch.integrator.crossings, strict=True):
        for lane, time in crossings:
            if lane < len(runs):
                times[int(runs[lane])][link].append(time)
    return BatchResult(
        time=batch.times,
        x=states[:, :size],
        v=states[:, size : 2 * size],
        dissipated=states[:, 2 * size : -1],
        work=states[:, -1],
        crossings=tuple(tuple(np.array(link) for link in run) for run in times),
        completed=completed,
    )
