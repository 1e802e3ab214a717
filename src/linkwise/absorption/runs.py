"""Motions of several structures under one excitation, with the energy that went through them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from linkwise.absorption.crossings import after_onset, crossings, distinct
from linkwise.absorption.potentials import Potentials, elongations
from linkwise.arrays import Bools, Floats, Indices
from linkwise.errors import SimulationError
from linkwise.simulation.batch import can_batch, run_batch
from linkwise.simulation.schedule import RunSchedule
from linkwise.simulation.simulate import SimulatedMotion


@dataclass(frozen=True, eq=False)
class Runs:
    """W runs: `x`, `v` (N, n, W) in m and m/s at `time` (N,) in s, energies in J counted from the start.

    `heat` (N, L, W) is what each link dissipated, `put_in` (N, W) what was there at the start, potentials counted from d = 0,
    and all work done since. `passages` holds, run by run and link by link, the times in s at which the link went from well to
    well.
    """

    time: Floats
    x: Floats
    v: Floats
    heat: Floats
    put_in: Floats
    passages: tuple[tuple[Floats, ...], ...]

    def only(self, which: Indices) -> Runs:
        """Some of the runs."""
        passages = tuple(self.passages[run] for run in which)
        return Runs(
            self.time,
            self.x[..., which],
            self.v[..., which],
            self.heat[..., which],
            self.put_in[..., which],
            passages,
        )


def single_run(motion: SimulatedMotion, tops: list[Floats]) -> Runs:
    """One motion by itself, in the best precision there is and past the kinks of its laws; `tops` (K,) m of each link."""
    energy, schedule = motion.energy, motion.schedule
    base = schedule.excitation.base
    d = schedule.structure.elongations(
        motion.displacement, None if base is None else base.value(schedule.times)
    )
    found = crossings(schedule, motion.run, tops)
    passages = tuple(after_onset(found[k], schedule.times, d[:, k], tops[k]) for k in range(len(tops)))
    return Runs(
        time=schedule.times,
        x=motion.displacement[..., None],
        v=motion.velocity[..., None],
        heat=energy.dissipated[..., None],
        put_in=energy.supplied[..., None],
        passages=(passages,),
    )


def batch_runs(
    schedules: Sequence[RunSchedule], potentials: Potentials, alone: bool = False
) -> tuple[Runs, Bools]:
    """Schedules that differ in numbers only, `potentials` those of their structures, and (W,) which came to their end.

    They are run side by side in double precision; one by one where laws are not smooth, and on request: `alone`.
    """
    if alone or not can_batch(schedules[0]):
        return _one_by_one(schedules, potentials)
    schedule = schedules[0]
    batch = run_batch(schedules, [each.tops for each in potentials.barriers])
    base = schedule.excitation.base
    where = None if base is None else base.value(schedule.times)
    start = np.stack([each.start for each in schedules], axis=1)[None]
    size = schedule.structure.size
    at_start = None if base is None else base.value(np.zeros(1))
    energy = (
        potentials.kinetic(start[:, size:]) + potentials.stored(start[:, :size], at_start) + potentials.floor
    )
    passages = []
    d = elongations(schedule.structure, batch.x, where)
    for run in range(len(schedules)):
        tops = potentials.tops(run)
        cleaned = (
            after_onset(distinct(times, schedule.end), batch.time, d[:, run, link], tops[link])
            for link, times in enumerate(batch.passages[run])
        )
        passages.append(tuple(cleaned))
    return Runs(batch.time, batch.x, batch.v, batch.heat, batch.work + energy, tuple(passages)), batch.alive


def _one_by_one(schedules: Sequence[RunSchedule], potentials: Potentials) -> tuple[Runs, Bools]:
    points, structure = len(schedules[0].times), schedules[0].structure
    size, links, count = structure.size, len(structure.links), len(schedules)
    x, v = np.full((points, size, count), np.nan), np.full((points, size, count), np.nan)
    heat, put_in = np.full((points, links, count), np.nan), np.full((points, count), np.nan)
    passages: list[tuple[Floats, ...]] = []
    alive = np.ones(count, dtype=bool)
    for run, schedule in enumerate(schedules):
        try:
            one = single_run(SimulatedMotion.of(schedule), potentials.tops(run))
        except SimulationError:
            alive[run] = False
            passages.append(tuple(np.empty(0) for _ in range(links)))
            continue
        x[..., run], v[..., run] = one.x[..., 0], one.v[..., 0]
        heat[..., run], put_in[:, run] = one.heat[..., 0], one.put_in[:, 0]
        passages += one.passages
    return Runs(schedules[0].times, x, v, heat, put_in, tuple(passages)), alive
