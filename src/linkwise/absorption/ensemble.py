"""Comparisons of many structures of one shape, each reduced to scalar quantities: for maps and for intervals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from threading import Event
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from linkwise.absorption.comparison import Comparison
from linkwise.absorption.places import mean_host_energies
from linkwise.absorption.potentials import Potentials
from linkwise.absorption.quantities import (
    AbsorptionQuantity,
    BaselineQuantities,
    quantities_of,
    quantity_values,
)
from linkwise.absorption.rest_positions import RestPositions, rest_positions
from linkwise.absorption.runs import Runs, batch_runs
from linkwise.absorption.vibration import Vibration
from linkwise.arrays import Bools, Floats, Indices
from linkwise.errors import SimulationError
from linkwise.expression import Expression
from linkwise.progress import Progress, ProgressReport, part, silent
from linkwise.runtime import one_blas_thread, processors
from linkwise.simulation.batch import LANES
from linkwise.simulation.schedule import RunSchedule

T = TypeVar("T")

_TASK = 8 * LANES  # runs that a thread makes at a time


@dataclass(frozen=True, eq=False)
class Ensemble:
    """The `values` (R, Q) of `quantities` in R structures; NaN for a mass that does not settle and a run that diverges.

    `completed` (R,) are the runs that came to their end; `envelopes` (N, P, R) m of the primary masses with sinks are kept on
    request, in single precision to save memory.
    """

    quantities: tuple[AbsorptionQuantity, ...]
    values: Floats
    completed: Bools
    envelopes: NDArray[np.float32] | None = None

    def column(self, name: str) -> Floats:
        """The values (R,) of the quantity called `name`."""
        return self.values[:, [quantity.name for quantity in self.quantities].index(name)]


@dataclass(frozen=True)
class _Runner:
    """How runs are made: on `workers` threads, in batches or `one_by_one`, with reports on `activity`."""

    workers: int
    one_by_one: bool
    progress: Progress
    activity: str
    powers: Mapping[str, Expression] = field(default_factory=dict)

    def run(
        self,
        schedules: Sequence[RunSchedule],
        potentials: Potentials,
        collect: Callable[[Runs, Indices], None],
    ) -> Bools:
        """Run all schedules, `collect` the completed runs with their numbers, and return which were completed."""
        completed = np.zeros(len(schedules), dtype=bool)
        numbers = np.arange(len(schedules))
        stopped = Event()

        def task(some: Indices) -> int:
            for first in range(0, len(some), LANES):
                if stopped.is_set():
                    break
                group = some[first : first + LANES]
                runs, ended = batch_runs(
                    [schedules[run] for run in group],
                    potentials.of_runs(group),
                    self.powers,
                    one_by_one=self.one_by_one,
                )
                completed[group] = ended
                if ended.any():
                    collect(runs if ended.all() else runs.of_runs(np.flatnonzero(ended)), group[ended])
            return len(some)

        done = 0
        size = max(LANES, min(_TASK, -(-len(schedules) // (self.workers * LANES)) * LANES))
        pool = ThreadPoolExecutor(max(1, min(self.workers, -(-len(schedules) // LANES))))
        try:
            futures = [
                pool.submit(task, numbers[first : first + size]) for first in range(0, len(schedules), size)
            ]
            for future in as_completed(futures):
                done += future.result()
                self.progress(ProgressReport(done / len(schedules), self.activity))
        finally:  # an interrupt waits for the batches under way and starts no others
            stopped.set()
            pool.shutdown(wait=True, cancel_futures=True)
        return completed


def run_ensemble(
    comparisons: Sequence[Comparison],
    *,
    envelopes: bool = False,
    one_by_one: bool = False,
    workers: int | None = None,
    progress: Progress = silent,
) -> Ensemble:
    """Make comparisons of structures of one shape on `workers` threads (default: one for each processor).

    Comparisons may share one object for the structure without sinks, which is then run once. With `one_by_one` each run has
    the precision of `absorb`, so that a chaotic motion is the same.
    """
    if workers is not None and workers < 1:
        raise SimulationError(f"workers must be at least 1, got {workers}")
    workers = workers or processors()
    baselines, baseline_of = _distinct([comparison.baseline for comparison in comparisons])
    owners = [int(np.argmax(baseline_of == number)) for number in range(len(baselines))]
    structures, structure_of = _distinct([comparison.resting_structure for comparison in comparisons])
    distinct_positions = rest_positions(structures, comparisons[0].primaries)
    positions = [distinct_positions[number] for number in structure_of]
    share = len(baselines) / (len(baselines) + len(comparisons))
    with one_blas_thread():
        baseline = _baseline(
            [comparisons[run] for run in owners],
            [positions[run] for run in owners],
            _Runner(workers, one_by_one, part(progress, 0.0, share), "without sinks"),
        )
        return _with_sinks(
            comparisons,
            positions,
            baseline.of_runs(baseline_of),
            envelopes,
            _Runner(
                workers,
                one_by_one,
                part(progress, share, 1.0),
                f"{len(comparisons)} runs with sinks",
                comparisons[0].powers,
            ),
        )


def _distinct(objects: Sequence[T]) -> tuple[list[T], Indices]:
    """The distinct objects of a sequence, and the number among them of each of its members."""
    distinct = {id(member): member for member in objects}
    number = {key: place for place, key in enumerate(distinct)}
    return list(distinct.values()), np.array([number[id(member)] for member in objects], dtype=np.intp)


def _baseline(
    comparisons: Sequence[Comparison], positions: Sequence[RestPositions], runner: _Runner
) -> BaselineQuantities:
    """The vibration without sinks."""
    schedules = [comparison.baseline_schedule for comparison in comparisons]
    potentials = Potentials.of([schedule.structure for schedule in schedules])
    first = comparisons[0]
    values = np.full((4, len(first.primaries), len(comparisons)), np.nan)
    energy = np.full((len(first.structure.hosts), len(comparisons)), np.nan)

    def collect(runs: Runs, numbers: Indices) -> None:
        structures = [schedules[run].structure for run in numbers]
        vibration = Vibration(runs, structures, first.primaries, [positions[run] for run in numbers])
        level = first.options.settle * vibration.peak
        values[:, :, numbers] = [vibration.peak, vibration.rms, level, vibration.settled(level)]
        energy[:, numbers] = mean_host_energies(structures, runs.x, runs.v)

    runner.run(schedules, potentials, collect)
    peak, rms, level, settled = values
    return BaselineQuantities(peak, rms, level, settled, energy)


def _with_sinks(
    comparisons: Sequence[Comparison],
    positions: Sequence[RestPositions],
    baseline: BaselineQuantities,
    envelopes: bool,
    runner: _Runner,
) -> Ensemble:
    """The runs with sinks, and all quantities."""
    first = comparisons[0]
    schedules = [comparison.schedule for comparison in comparisons]
    potentials = Potentials.of([comparison.structure for comparison in comparisons])
    quantities = quantities_of(first)
    values = np.full((len(comparisons), len(quantities)), np.nan)
    all_envelopes = (
        np.full((len(first.times), len(first.primaries), len(comparisons)), np.nan, np.float32)
        if envelopes
        else None
    )

    def collect(runs: Runs, numbers: Indices) -> None:
        structures = [schedules[run].structure for run in numbers]
        vibration = Vibration(runs, structures, first.primaries, [positions[run] for run in numbers])
        by_name = quantity_values(
            first, runs, vibration, potentials.of_runs(numbers), baseline.of_runs(numbers)
        )
        values[numbers] = np.stack([by_name[quantity.name] for quantity in quantities], axis=1)
        if all_envelopes is not None:
            all_envelopes[:, :, numbers] = vibration.decay.envelope

    completed = runner.run(schedules, potentials, collect)
    return Ensemble(quantities, values, completed, all_envelopes)
