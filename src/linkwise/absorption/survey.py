"""What sinks come to in many structures of one shape, as one number a structure: for maps and for intervals."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from linkwise.absorption.harvesters import SUFFIX
from linkwise.absorption.potentials import Potentials
from linkwise.absorption.rest import RestingPlaces, resting_places
from linkwise.absorption.runs import Runs, runs_together
from linkwise.absorption.trial import Trial
from linkwise.absorption.vibration import Vibration, reduction, together
from linkwise.course import Course
from linkwise.ensemble import LANES
from linkwise.threads import one_blas_thread

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Progress = Callable[[float, str], object]

_TASK = 8 * LANES  # runs that one thread does before it asks for more


@dataclass(frozen=True)
class Quantity:
    """One number a structure: `name`, `unit` (none: a count, or a part of 1), what it is in words, and which end is best."""

    name: str
    unit: str
    title: str
    least_is_best: bool = False


@dataclass(frozen=True, eq=False)
class Survey:
    """`values` (R, Q) of `quantities` in R structures, NaN where one is not there: a mass that does not settle, a run that
    did not come to its end. `envelopes` (N, P, R) m with sinks are kept on request, `alive` (R,) tells the runs that ended.
    """

    quantities: tuple[Quantity, ...]
    values: Floats
    alive: Flags
    envelopes: Floats | None = None

    def column(self, name: str) -> Floats:
        """(R,) of the quantity of that name."""
        return self.values[:, [each.name for each in self.quantities].index(name)]


@dataclass(frozen=True, eq=False)
class _Reference:
    """What the primary masses do without sinks, (P, R)."""

    peak: Floats
    rms: Floats
    level: Floats
    settled: Floats

    def of(self, which: NDArray[np.intp]) -> _Reference:
        return _Reference(*(each[:, which] for each in (self.peak, self.rms, self.level, self.settled)))


def survey(
    trials: Sequence[Trial],
    *,
    envelopes: bool = False,
    workers: int | None = None,
    progress: Progress = lambda fraction, now: None,
) -> Survey:
    """Ask the same question of structures of one shape, on `workers` threads (default: one a processor)."""
    workers = workers or os.cpu_count() or 1
    places = list({id(trial.bare): trial.bare for trial in trials})
    number = {place: index for index, place in enumerate(places)}
    own = np.array([number[id(trial.bare)] for trial in trials])
    bares = list({id(trial.bare): trial for trial in trials}.values())
    weights = len(bares) / (len(bares) + len(trials))
    resting = _resting(trials)
    first = [int(np.flatnonzero(own == index)[0]) for index in range(len(bares))]
    with one_blas_thread():
        reference = _reference(
            bares,
            [resting[index] for index in first],
            workers,
            lambda part: progress(weights * part, "without sinks"),
        )
        return _with_sinks(
            trials, resting, reference.of(own), envelopes, workers,
            lambda part: progress(weights + (1.0 - weights) * part, f"{len(trials)} runs with sinks"),
        )  # fmt: skip


def _resting(trials: Sequence[Trial]) -> list[RestingPlaces]:
    structures = [trial.resting_structure for trial in trials]
    distinct = list({id(each): each for each in structures}.values())
    found = resting_places(distinct, trials[0].primaries)
    by_id = {id(each): place for each, place in zip(distinct, found, strict=True)}
    return [by_id[id(each)] for each in structures]


def _reference(
    trials: Sequence[Trial],
    resting: Sequence[RestingPlaces],
    workers: int,
    progress: Callable[[float], object],
) -> _Reference:
    courses = [trial.bare_course for trial in trials]
    potentials = Potentials.of([course.structure for course in courses])
    masses = len(trials[0].primaries)
    found = np.full((4, masses, len(trials)), np.nan)

    def note(runs: Runs, which: NDArray[np.intp]) -> None:
        columns = [courses[0].structure.mass_names.index(name) for name in trials[0].primaries]
        vibration = Vibration(runs, columns, [resting[run] for run in which])
        level = trials[0].settle * vibration.peak
        found[:, :, which] = [vibration.peak, vibration.rms, level, vibration.settled(level)]

    _run_all(courses, potentials, note, workers, progress)
    return _Reference(*found)


def _with_sinks(
    trials: Sequence[Trial],
    resting: Sequence[RestingPlaces],
    reference: _Reference,
    envelopes: bool,
    workers: int,
    progress: Callable[[float], object],
) -> Survey:
    courses = [trial.course for trial in trials]
    potentials = Potentials.of([trial.structure for trial in trials])
    quantities = _quantities(trials[0])
    values = np.full((len(trials), len(quantities)), np.nan)
    bounds = (
        np.full((len(trials[0].times), len(trials[0].primaries), len(trials)), np.nan) if envelopes else None
    )
    columns = [trials[0].structure.mass_names.index(name) for name in trials[0].primaries]

    def note(runs: Runs, which: NDArray[np.intp]) -> None:
        vibration = Vibration(runs, columns, [resting[run] for run in which])
        told = _told(trials[0], runs, vibration, potentials.rows(which), reference.of(which))
        values[which] = np.stack([told[each.name] for each in quantities], axis=1)
        if bounds is not None:
            bounds[:, :, which] = vibration.decay.envelope

    alive = _run_all(courses, potentials, note, workers, progress)
    return Survey(quantities, values, alive, bounds)


def _run_all(
    courses: Sequence[Course],
    potentials: Potentials,
    note: Callable[[Runs, NDArray[np.intp]], None],
    workers: int,
    progress: Callable[[float], object],
) -> Flags:
    """Run all courses and `note` what the living ones did; returns which are."""
    alive = np.zeros(len(courses), dtype=bool)
    every = np.arange(len(courses))

    def task(which: NDArray[np.intp]) -> int:
        for first in range(0, len(which), LANES):
            group = which[first : first + LANES]
            runs, ended = runs_together([courses[run] for run in group], potentials.rows(group))
            alive[group] = ended
            if ended.any():
                note(runs if ended.all() else runs.only(np.flatnonzero(ended)), group[ended])
        return len(which)

    done = 0
    pool = ThreadPoolExecutor(max(1, min(workers, -(-len(courses) // LANES))))
    try:
        size = max(LANES, min(_TASK, -(-len(courses) // (workers * LANES)) * LANES))
        futures = [pool.submit(task, every[first : first + size]) for first in range(0, len(courses), size)]
        for future in as_completed(futures):
            done += future.result()
            progress(done / len(courses))
    finally:
        pool.shutdown(
            wait=True, cancel_futures=True
        )  # Ctrl-C waits for the runs under way, a fraction of a second
    return alive


def _quantities(trial: Trial) -> tuple[Quantity, ...]:
    """What `_told` tells, in order."""
    percent = f"{100.0 * trial.settle:g} %"
    found = [
        Quantity("settled", "s", f"settling time (below {percent})", True),
        Quantity("settled_without", "s", f"settling time without sinks (below {percent})", True),
        Quantity("rms_reduction", "", "RMS reduction"),
        Quantity("peak_reduction", "", "peak reduction"),
        Quantity("sinks_share", "", "energy taken by the sinks"),
        Quantity("crossings", "", "well crossings"),
        Quantity("remaining", "", "energy left at the end", True),
        Quantity("closure", "", "error of the energy balance", True),
    ]
    if len(trial.primaries) > 1:
        for name in trial.primaries:
            found.append(Quantity(f"settled:{name}", "s", f"settling time of {name}", True))
            found.append(Quantity(f"rms_reduction:{name}", "", f"RMS reduction of {name}"))
            found.append(Quantity(f"peak_reduction:{name}", "", f"peak reduction of {name}"))
    found += [
        Quantity(f"share:{link.name}", "", f"energy taken by {link.name}", link.name not in trial.absorbing)
        for link in trial.structure.links
    ]
    found += [
        Quantity(f"crossings:{sink.link}", "", f"well crossings of {sink.link}") for sink in trial.sinks
    ]
    found += [
        Quantity(f"power:{link}", "W", f"average power of the harvester on {link}")
        for link in trial.harvesters
    ]
    return tuple(found)


def _told(
    trial: Trial, runs: Runs, vibration: Vibration, potentials: Potentials, reference: _Reference
) -> dict[str, Floats]:
    """(W,) of every quantity."""
    settled = vibration.settled(reference.level)
    base = trial.excitation.base
    where = None if base is None else base.value(runs.time[-1:])
    left = (potentials.kinetic(runs.v[-1:]) + potentials.stored(runs.x[-1:], where))[0]
    put_in = runs.put_in - potentials.floor
    total, heat = put_in[-1], runs.heat[-1]
    names = [link.name for link in trial.structure.links]
    shares = dict(zip(names, heat / total, strict=True))
    crossings = {
        sink.link: np.array([float(len(run[names.index(sink.link)])) for run in runs.passages])
        for sink in trial.sinks
    }
    told = {
        "settled": settled.max(axis=0),
        "settled_without": reference.settled.max(axis=0),
        "rms_reduction": reduction(together(vibration.rms), together(reference.rms)),
        "peak_reduction": reduction(vibration.peak.max(axis=0), reference.peak.max(axis=0)),
        "sinks_share": np.sum([shares[name] for name in trial.absorbing], axis=0),
        "crossings": np.sum(list(crossings.values()), axis=0),
        "remaining": left / total,
        "closure": np.abs(total - left - heat.sum(axis=0)) / np.abs(put_in).max(axis=0),
    }
    single, peaks = reduction(vibration.rms, reference.rms), reduction(vibration.peak, reference.peak)
    for row, name in enumerate(trial.primaries):
        told[f"settled:{name}"] = settled[row]
        told[f"rms_reduction:{name}"] = single[row]
        told[f"peak_reduction:{name}"] = peaks[row]
    told |= {f"share:{name}": share for name, share in shares.items()}
    told |= {f"crossings:{name}": count for name, count in crossings.items()}
    end = runs.time[-1]
    return told | {f"power:{link}": shares[f"{link}{SUFFIX}"] * total / end for link in trial.harvesters}
