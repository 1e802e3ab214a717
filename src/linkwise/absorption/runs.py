"""Motions of several structures under one excitation, with the energy supplied and dissipated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from linkwise.absorption.crossings import after_onset, crossings, distinct
from linkwise.absorption.harvesters import delivered_energy
from linkwise.absorption.places import have_equal_shapes
from linkwise.absorption.potentials import Potentials, elongations
from linkwise.arrays import Bools, Floats, Indices
from linkwise.errors import SimulationError
from linkwise.expression import Expression
from linkwise.simulation.batch import can_batch, run_batch
from linkwise.simulation.motion import SimulatedMotion
from linkwise.simulation.schedule import RunSchedule


@dataclass(frozen=True, eq=False)
class Runs:
    """W runs at `time` (N,) s: `x` (N, n, W) m and `v` (N, n, W) m/s.

    `dissipated` (N, L, W) J is the energy that each link has dissipated, `supplied` (N, W) J the energy at the start, with
    potentials relative to d = 0, and all work done since. `crossings` holds, by run and link, the times in s at which the link
    went from one well to another; `delivered` the energy (W,) J that harvesters given by an expression took, by link.
    """

    time: Floats
    x: Floats
    v: Floats
    dissipated: Floats
    supplied: Floats
    crossings: tuple[tuple[Floats, ...], ...]
    delivered: Mapping[str, Floats] = field(default_factory=dict)

    def of_runs(self, runs: Indices) -> Runs:
        """Some of the runs."""
        return Runs(
            self.time,
            self.x[..., runs],
            self.v[..., runs],
            self.dissipated[..., runs],
            self.supplied[..., runs],
            tuple(self.crossings[run] for run in runs),
            {link: energy[runs] for link, energy in self.delivered.items()},
        )


def single_run(motion: SimulatedMotion, tops: list[Floats], powers: Mapping[str, Expression]) -> Runs:
    """One motion in full precision and with the kinks of its laws.

    `tops` (K,) m are those of the barriers of each link, `powers` those that links deliver, in W.
    """
    energy, schedule = motion.energy, motion.schedule
    base = schedule.excitation.base
    d = schedule.structure.elongations(
        motion.displacement, None if base is None else base.value(schedule.times)
    )
    times = crossings(schedule, motion.run, tops)
    return Runs(
        time=schedule.times,
        x=motion.displacement[..., None],
        v=motion.velocity[..., None],
        dissipated=energy.dissipated[..., None],
        supplied=energy.supplied[..., None],
        crossings=(tuple(after_onset(times[k], schedule.times, d[:, k], tops[k]) for k in range(len(tops))),),
        delivered={link: np.array([energy]) for link, energy in delivered_energy(motion, powers).items()},
    )


def batch_runs(
    schedules: Sequence[RunSchedule],
    potentials: Potentials,
    powers: Mapping[str, Expression],
    *,
    one_by_one: bool = False,
) -> tuple[Runs, Bools]:
    """Runs of schedules that differ in numbers only, and (W,) which of them came to their end.

    `potentials` are those of their structures, `powers` those that their links deliver, in W. The runs are made side by side
    in double precision, or `one_by_one`, as they are if a law is not smooth or has memory, or shapes of hosts differ.
    """
    memory = any(link.law.states for link in schedules[0].structure.links)
    alike = have_equal_shapes(potentials.structures)
    if one_by_one or memory or powers or not (alike and can_batch(schedules[0])):
        return _one_by_one(schedules, potentials, powers)
    schedule = schedules[0]
    batch = run_batch(schedules, [link.tops for link in potentials.barriers])
    base = schedule.excitation.base
    x_base = None if base is None else base.value(schedule.times)
    start = np.stack([schedule.start for schedule in schedules], axis=1)[None]
    size = schedule.structure.size
    x_base_at_start = None if base is None else base.value(np.zeros(1))
    energy = (
        potentials.kinetic(start[:, size:])
        + potentials.stored(start[:, :size], x_base_at_start)
        + potentials.floor
    )
    d = elongations(potentials.structures, batch.x, x_base)
    crossed = []
    for run in range(len(schedules)):
        tops = potentials.tops(run)
        crossed.append(
            tuple(
                after_onset(distinct(times, schedule.end), batch.time, d[:, run, link], tops[link])
                for link, times in enumerate(batch.crossings[run])
            )
        )
    runs = Runs(batch.time, batch.x, batch.v, batch.dissipated, batch.work + energy, tuple(crossed))
    return runs, batch.completed


def _one_by_one(
    schedules: Sequence[RunSchedule], potentials: Potentials, powers: Mapping[str, Expression]
) -> tuple[Runs, Bools]:
    samples, structure = len(schedules[0].times), schedules[0].structure
    size, links, count = structure.size, len(structure.links), len(schedules)
    x, v = np.full((samples, size, count), np.nan), np.full((samples, size, count), np.nan)
    dissipated, supplied = np.full((samples, links, count), np.nan), np.full((samples, count), np.nan)
    delivered = {link: np.full(count, np.nan) for link in powers}
    crossed: list[tuple[Floats, ...]] = []
    completed = np.ones(count, dtype=bool)
    for number, schedule in enumerate(schedules):
        try:
            run = single_run(SimulatedMotion.of(schedule), potentials.tops(number), powers)
        except SimulationError:
            completed[number] = False
            crossed.append(tuple(np.empty(0) for _ in range(links)))
            continue
        x[..., number], v[..., number] = run.x[..., 0], run.v[..., 0]
        dissipated[..., number], supplied[:, number] = run.dissipated[..., 0], run.supplied[:, 0]
        crossed += run.crossings
        for link, energy in run.delivered.items():
            delivered[link][number] = energy[0]
    return Runs(schedules[0].times, x, v, dissipated, supplied, tuple(crossed), delivered), completed
