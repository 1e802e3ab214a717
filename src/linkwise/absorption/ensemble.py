"""What sinks come to in many structures of one shape, as one number a structure: for maps and for intervals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from threading import Event
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from linkwise.absorption.comparison import Comparison
from linkwise.absorption.potentials import Potentials
from linkwise.absorption.quantities import BaselineQuantities, Quantity, quantities_of, quantity_values
from linkwise.absorption.rest_positions import RestPositions, rest_positions
from linkwise.absorption.runs import Runs, batch_runs
from linkwise.absorption.vibration import Vibration
from linkwise.arrays import Bools, Floats, Indices
from linkwise.progress import Progress, ProgressReport, part, silent
from linkwise.runtime import one_blas_thread, processors
from linkwise.simulation.batch import LANES
from linkwise.simulation.schedule import RunSchedule

T = TypeVar("T")

_TASK = 8 * LANES  # runs that one thread does before it asks for more


@dataclass(frozen=True, eq=False)
class Ensemble:
    """`values` (R, Q) of `quantities` in R structures, NaN where one is not there: a mass that does not settle, a run that
    did not come to its end. `alive` (R,) tells the runs that ended; `envelopes` (N, P, R) m with sinks are kept on request, in
    single precision for their size.
    """

    quantities: tuple[Quantity, ...]
    values: Floats
    alive: Bools
    envelopes: NDArray[np.float32] | None = None

    def column(self, name: str) -> Floats:
        """(R,) of the quantity of that name."""
        return self.values[:, [each.name for each in self.quantities].index(name)]


@dataclass(frozen=True)
class _Crew:
    """Who runs: so many threads, `alone` or side by side, telling `progress` what part of `activity` is done."""

    workers: int
    alone: bool
    progress: Progress
    activity: str

    def run(
        self,
        schedules: Sequence[RunSchedule],
        potentials: Potentials,
        note: Callable[[Runs, Indices], None],
    ) -> Bools:
        """Run all schedules and `note` what the living ones did; returns which are."""
        alive = np.zeros(len(schedules), dtype=bool)
        every = np.arange(len(schedules))
        stopped = Event()

        def task(which: Indices) -> int:
            for first in range(0, len(which), LANES):
                if stopped.is_set():
                    break
                group = which[first : first + LANES]
                runs, ended = batch_runs(
                    [schedules[run] for run in group], potentials.rows(group), self.alone
                )
                alive[group] = ended
                if ended.any():
                    note(runs if ended.all() else runs.only(np.flatnonzero(ended)), group[ended])
            return len(which)

        done = 0
        size = max(LANES, min(_TASK, -(-len(schedules) // (self.workers * LANES)) * LANES))
        pool = ThreadPoolExecutor(max(1, min(self.workers, -(-len(schedules) // LANES))))
        try:
            futures = [
                pool.submit(task, every[first : first + size]) for first in range(0, len(schedules), size)
            ]
            for future in as_completed(futures):
                done += future.result()
                self.progress(ProgressReport(done / len(schedules), self.activity))
        finally:  # Ctrl-C waits for the runs under way and starts no others
            stopped.set()
            pool.shutdown(wait=True, cancel_futures=True)
        return alive


def run_ensemble(
    trials: Sequence[Comparison],
    *,
    envelopes: bool = False,
    alone: bool = False,
    workers: int | None = None,
    progress: Progress = silent,
) -> Ensemble:
    """Ask the same question of structures of one shape, on `workers` threads (default: one a processor).

    Trials may share one object for the structure without sinks; it is run once. With `alone` each is run by itself and in the
    precision of `absorb`, so that chaos gives the same motion.
    """
    workers = workers or processors()
    bares, which_bare = _distinct([trial.baseline for trial in trials])
    owners = [int(np.argmax(which_bare == number)) for number in range(len(bares))]
    structures, which_structure = _distinct([trial.resting_structure for trial in trials])
    places = rest_positions(structures, trials[0].primaries)
    resting = [places[number] for number in which_structure]
    share = len(bares) / (len(bares) + len(trials))
    with one_blas_thread():
        reference = _reference(
            [trials[run] for run in owners],
            [resting[run] for run in owners],
            _Crew(workers, alone, part(progress, 0.0, share), "without sinks"),
        )
        return _with_sinks(
            trials, resting, reference.of(which_bare), envelopes,
            _Crew(workers, alone, part(progress, share, 1.0), f"{len(trials)} runs with sinks"),
        )  # fmt: skip


def _distinct(objects: Sequence[T]) -> tuple[list[T], Indices]:
    """The different objects in a sequence, and for each place which of them stands there."""
    found = {id(each): each for each in objects}
    order = {key: number for number, key in enumerate(found)}
    return list(found.values()), np.array([order[id(each)] for each in objects], dtype=np.intp)


def _reference(
    trials: Sequence[Comparison],
    resting: Sequence[RestPositions],
    crew: _Crew,
) -> BaselineQuantities:
    schedules = [trial.baseline_schedule for trial in trials]
    potentials = Potentials.of([schedule.structure for schedule in schedules])
    masses = len(trials[0].primaries)
    found = np.full((4, masses, len(trials)), np.nan)

    def note(runs: Runs, which: Indices) -> None:
        columns = [schedules[0].structure.mass_names.index(name) for name in trials[0].primaries]
        vibration = Vibration(runs, columns, [resting[run] for run in which])
        level = trials[0].options.settle * vibration.peak
        found[:, :, which] = [vibration.peak, vibration.rms, level, vibration.settled(level)]

    crew.run(schedules, potentials, note)
    return BaselineQuantities(*found)


def _with_sinks(
    trials: Sequence[Comparison],
    resting: Sequence[RestPositions],
    reference: BaselineQuantities,
    envelopes: bool,
    crew: _Crew,
) -> Ensemble:
    schedules = [trial.schedule for trial in trials]
    potentials = Potentials.of([trial.structure for trial in trials])
    quantities = quantities_of(trials[0])
    values = np.full((len(trials), len(quantities)), np.nan)
    bounds = (
        np.full((len(trials[0].times), len(trials[0].primaries), len(trials)), np.nan, np.float32)
        if envelopes
        else None
    )
    columns = [trials[0].structure.mass_names.index(name) for name in trials[0].primaries]

    def note(runs: Runs, which: Indices) -> None:
        vibration = Vibration(runs, columns, [resting[run] for run in which])
        told = quantity_values(trials[0], runs, vibration, potentials.rows(which), reference.of(which))
        values[which] = np.stack([told[each.name] for each in quantities], axis=1)
        if bounds is not None:
            bounds[:, :, which] = vibration.decay.envelope

    alive = crew.run(schedules, potentials, note)
    return Ensemble(quantities, values, alive, bounds)
