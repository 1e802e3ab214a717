"""Comparisons of many structures that differ in a few numbers, each reduced to the scalar quantities by which sinks are
judged.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from linkwise.absorption.absorb import Comparison, without_sinks
from linkwise.absorption.motion import (
    Decay,
    Potentials,
    Vibration,
    batch_runs,
    comparable,
    elongations,
    reduction,
    rest_positions,
    root_sum_square,
)
from linkwise.absorption.sinks import SUFFIX, dissipators, mean_host_energies
from linkwise.arrays import Bools, Floats, Indices
from linkwise.errors import SimulationError
from linkwise.expression import Expression
from linkwise.model.coefficient import Name
from linkwise.model.structure import Structure
from linkwise.progress import Progress, ProgressReport, part, silent
from linkwise.records.channel_units import unit_in
from linkwise.runtime import one_blas_thread, processors
from linkwise.simulation.batch import LANES
from linkwise.simulation.run import RunSchedule


@dataclass(frozen=True)
class AbsorptionQuantity:
    """A scalar quantity of a comparison with and without sinks.

    Attributes
    ----------
    name : str
        Its name, "rms_reduction" or, of one mass, link or sink, "rms_reduction:m1".
    unit : str
        Its SI unit; empty for counts and for parts of 1.
    title : str
        Its description.
    least_is_best : bool
        Whether small values are good.

    Examples
    --------
    >>> import linkwise as lw
    >>> over = {"nes1.alpha": [-150.0, -50.0]}
    >>> swept = lw.absorption.absorption_map(lw.bnes_chain(2), over, duration=1.0, release={"v:m1": 1.0})
    >>> settled = swept.quantities[0]
    >>> settled.name, settled.unit, settled.least_is_best
    ('settled', 's', True)
    """

    name: str
    unit: str
    title: str
    least_is_best: bool = False

    def text(self, value: float) -> str:
        """A value with its unit; parts of 1 in %.

        Parameters
        ----------
        value : float
            The value in `unit`.

        Returns
        -------
        str
            Such as "0.31 s".
        """
        return f"{100.0 * value:.3g} %" if self.is_part else f"{value:.4g} {self.unit}".rstrip()

    @property
    def is_part(self) -> bool:
        """Whether it is a part of 1, which is read in %."""
        return not self.unit and not self.name.startswith("crossings")


@dataclass(frozen=True, eq=False)
class BaselineQuantities:
    """The vibration of the P primary masses without sinks in R runs: `peak`, `rms`, `level` m and `settled` s, (P, R), and the
    mean `energy` (H, R) J in H hosts.
    """

    peak: Floats
    rms: Floats
    level: Floats
    settled: Floats
    energy: Floats

    def of_runs(self, runs: Indices) -> BaselineQuantities:
        """Some of the runs, in any order and number."""
        return BaselineQuantities(*(values[:, runs] for values in vars(self).values()))


def quantities_of(comparison: Comparison) -> tuple[AbsorptionQuantity, ...]:
    """The quantities that `quantity_values` returns, in order."""
    structure, primaries = comparison.structure, comparison.primaries
    links = [sink.link for sink in comparison.sinks]
    below = f"(below {100.0 * comparison.options.settle:g} %)"
    rows = [
        ("settled", "s", f"settling time {below}", True),
        ("settled_without", "s", f"settling time without sinks {below}", True),
        ("rms_reduction", "", "RMS reduction", False),
        ("peak_reduction", "", "peak reduction", False),
        ("sinks_share", "", "energy dissipated by the sinks", False),
        ("crossings", "", "well crossings", False),
        ("remaining", "", "energy left at the end", True),
        ("closure", "", "error of the energy balance", True),
    ]
    for name in primaries if len(primaries) > 1 else ():
        rows.append((f"settled:{name}", "s", f"settling time of {name}", True))
        rows.append((f"rms_reduction:{name}", "", f"RMS reduction of {name}", False))
        rows.append((f"peak_reduction:{name}", "", f"peak reduction of {name}", False))
    for name in (host.name for host in structure.hosts):
        rows.append((f"energy_reduction:{name}", "", f"reduction of the mean energy in {name}", False))
    for name in dissipators(structure):
        others = name not in comparison.absorbing
        rows.append((f"share:{name}", "", f"energy dissipated by {name}", others))
    rows += [(f"crossings:{link}", "", f"well crossings of {link}", False) for link in links]
    for link in comparison.options.harvesters or ():
        rows.append((f"power:{link}", "W", f"average power of the harvester on {link}", False))
    if len(units := {unit_in(structure, f"x:{name}") for name in primaries}) == 1:
        (unit,) = units
        rows += [("peak", unit, "largest excursion", True), ("rms", unit, "RMS excursion", True)]
    for link in links:
        unit = structure.link(link).law.motion_units[0]
        rows.append((f"stroke:{link}", unit, f"largest elongation of {link}", True))
    return tuple(AbsorptionQuantity(*row) for row in rows)


def quantity_values(
    comparison: Comparison, vibration: Vibration, potentials: Potentials, baseline: BaselineQuantities
) -> dict[str, Floats]:
    """The values (W,) of every quantity in W runs, by name."""
    runs = vibration.runs
    settled = vibration.decay.settled(baseline.level)
    x_base = comparison.options.excitation.base_at(runs.time[-1:])
    remaining = (potentials.kinetic(runs.v[-1:]) + potentials.stored(runs.x[-1:], x_base))[0]
    supplied = runs.supplied - potentials.floor
    total, dissipated = supplied[-1], runs.dissipated[-1]
    names = [link.name for link in comparison.structure.links]
    by = dissipators(comparison.structure)
    shares = {name: dissipated[numbers].sum(axis=0) / total for name, numbers in by.items()}
    counts = np.array([[float(len(of_link)) for of_link in run] for run in runs.crossings])
    crossings = {sink.link: counts[:, names.index(sink.link)] for sink in comparison.sinks}
    units = [unit_in(comparison.structure, f"x:{name}") for name in comparison.primaries]
    of_rms, of_peak = (comparable(sizes, units) for sizes in (baseline.rms, baseline.peak))
    joint_rms = [root_sum_square(of_rms * one.rms) for one in (vibration, baseline)]
    joint_peaks = [(of_peak * peak).max(axis=0) for peak in (vibration.decay.peak, baseline.peak)]
    values = {
        "settled": settled.max(axis=0),
        "settled_without": baseline.settled.max(axis=0),
        "rms_reduction": reduction(*joint_rms),
        "peak_reduction": reduction(*joint_peaks),
        "sinks_share": np.sum([shares[name] for name in comparison.absorbing], axis=0),
        "crossings": np.sum(list(crossings.values()), axis=0),
        "remaining": remaining / total,
        "closure": np.abs(total - remaining - dissipated.sum(axis=0)) / np.abs(supplied).max(axis=0),
    }
    rms, peaks = reduction(vibration.rms, baseline.rms), reduction(vibration.decay.peak, baseline.peak)
    for row, name in enumerate(comparison.primaries):
        values[f"settled:{name}"] = settled[row]
        values[f"rms_reduction:{name}"] = rms[row]
        values[f"peak_reduction:{name}"] = peaks[row]
    energies = mean_host_energies(vibration.structures, runs.x, runs.v)
    for host, energy, without in zip(comparison.structure.hosts, energies, baseline.energy, strict=True):
        values[f"energy_reduction:{host.name}"] = reduction(energy, without)
    values |= {f"share:{name}": share for name, share in shares.items()}
    values |= {f"crossings:{name}": count for name, count in crossings.items()}
    values |= {"peak": vibration.decay.peak.max(axis=0), "rms": root_sum_square(vibration.rms)}
    base, structures = comparison.options.excitation.base, vibration.structures
    x, v = (None, None) if base is None else (base.value(runs.time), base.derivative(runs.time))
    links = [names.index(sink.link) for sink in comparison.sinks]
    d, rate = elongations(structures, runs.x, x)[..., links], elongations(structures, runs.v, v)[..., links]
    strokes = zip(comparison.sinks, Decay(runs.time, d, rate).peak.T, strict=True)
    values |= {f"stroke:{sink.link}": peak for sink, peak in strokes}
    for link, given in (comparison.options.harvesters or {}).items():
        energy = runs.delivered[link] if isinstance(given, str) else shares[f"{link}{SUFFIX}"] * total
        values[f"power:{link}"] = energy / runs.time[-1]
    return values


def variants(
    structure: Structure, comparison: Comparison, names: Sequence[str]
) -> Callable[[Mapping[str, float]], Comparison]:
    """What makes comparisons like `comparison` of structures that differ from `structure`, harvesters included, in the
    coefficients, masses and releases called `names`, of their values; they share the baseline that no such value changes.
    """
    changes = any(_changes_baseline(comparison, structure, name) for name in names)

    def at(values: Mapping[str, float]) -> Comparison:
        numbers = {name: value for name, value in values.items() if ":" not in name}
        release = {name: value for name, value in values.items() if ":" in name}
        own, drive = comparison.options, comparison.options.excitation
        drive = replace(drive, release={**drive.release, **release}) if release else drive
        varied = structure.with_values(numbers) if numbers else comparison.structure
        baseline = comparison.baseline
        if changes:
            baseline = without_sinks(varied, comparison.sinks, drive, own.without)
        return replace(
            comparison, structure=varied, baseline=baseline, options=replace(own, excitation=drive)
        )

    return at


def _changes_baseline(comparison: Comparison, structure: Structure, name: str) -> bool:
    """Whether a parameter may change the structure without sinks."""
    asked = Name.parse(name)
    coefficients = [mass.mass for mass in structure.masses]
    coefficients += [coefficient for link in structure.links for coefficient in link.coefficients.values()]
    if ":" in name or asked.is_shape or any(coefficient.same_as for coefficient in coefficients):
        return True
    baseline = comparison.baseline.structure
    if asked.owner in {link.name for link in structure.links}:
        return asked.owner in {link.name for link in baseline.links}
    return comparison.options.without != "removed" or asked.owner in baseline.mass_names


T = TypeVar("T")


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


Collect = Callable[[Vibration, Potentials, Indices], None]
"""Takes what completed runs did, with their numbers."""


@dataclass(frozen=True)
class _Runner:
    """How runs are made: on `workers` threads, in batches or `one_by_one`, with reports on `activity`; and their masses."""

    primaries: Sequence[str]
    workers: int
    one_by_one: bool
    progress: Progress
    activity: str
    powers: Mapping[str, Expression] = field(default_factory=dict)

    def run(self, schedules: Sequence[RunSchedule], positions: Sequence[Floats], collect: Collect) -> Bools:
        """Run all schedules, whose masses rest at `positions`, and return which were completed."""
        completed, numbers = np.zeros(len(schedules), dtype=bool), np.arange(len(schedules))
        potentials = Potentials.of([schedule.structure for schedule in schedules])

        def task(group: Indices) -> int:
            batch = [schedules[run] for run in group]
            own = potentials.of_runs(group)
            runs, ended = batch_runs(batch, own, self.powers, one_by_one=self.one_by_one)
            completed[group] = ended
            if runs is not None:
                kept = group[ended]
                structures = [schedules[run].structure for run in kept]
                rests = [positions[run] for run in kept]
                collect(Vibration(runs, structures, self.primaries, rests), potentials.of_runs(kept), kept)
            return len(group)

        done = 0
        groups = [numbers[first : first + LANES] for first in range(0, len(schedules), LANES)]
        pool = ThreadPoolExecutor(min(self.workers, len(groups)))
        try:
            for future in as_completed([pool.submit(task, group) for group in groups]):
                done += future.result()
                self.progress(ProgressReport(done / len(schedules), self.activity))
        finally:  # an interrupt waits for the batches under way and starts no others
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
    first, workers = comparisons[0], workers or processors()
    baselines, baseline_of = _distinct([comparison.baseline for comparison in comparisons])
    owners = [int(np.argmax(baseline_of == number)) for number in range(len(baselines))]
    structures, structure_of = _distinct([comparison.resting_structure for comparison in comparisons])
    distinct_positions = rest_positions(structures, first.primaries)
    positions = [distinct_positions[number] for number in structure_of]
    share = len(baselines) / (len(baselines) + len(comparisons))
    quantities = quantities_of(first)
    values = np.full((len(comparisons), len(quantities)), np.nan)
    shape = len(first.times), len(first.primaries), len(comparisons)
    all_envelopes = np.full(shape, np.nan, np.float32) if envelopes else None

    def collect(vibration: Vibration, potentials: Potentials, numbers: Indices) -> None:
        without = baseline.of_runs(baseline_of[numbers])
        by_name = quantity_values(first, vibration, potentials, without)
        values[numbers] = np.stack([by_name[quantity.name] for quantity in quantities], axis=1)
        if all_envelopes is not None:
            all_envelopes[:, :, numbers] = vibration.decay.envelope

    with one_blas_thread():
        baseline = _baseline(
            [comparisons[run] for run in owners],
            [positions[run] for run in owners],
            _Runner(first.primaries, workers, one_by_one, part(progress, 0.0, share), "without sinks"),
        )
        activity = f"{len(comparisons)} runs with sinks"
        rest = part(progress, share, 1.0)
        runner = _Runner(first.primaries, workers, one_by_one, rest, activity, first.powers)
        completed = runner.run([comparison.schedule for comparison in comparisons], positions, collect)
    return Ensemble(quantities, values, completed, all_envelopes)


def _distinct(objects: Sequence[T]) -> tuple[list[T], Indices]:
    """The distinct objects of a sequence, and the number among them of each of its members."""
    distinct = {id(member): member for member in objects}
    number = {key: place for place, key in enumerate(distinct)}
    return list(distinct.values()), np.array([number[id(member)] for member in objects], dtype=np.intp)


def _baseline(
    comparisons: Sequence[Comparison], positions: Sequence[Floats], runner: _Runner
) -> BaselineQuantities:
    """The vibration without sinks."""
    schedules = [comparison.baseline_schedule for comparison in comparisons]
    first, count = comparisons[0], len(comparisons)
    values = np.full((4, len(first.primaries), count), np.nan)
    energy = np.full((len(first.structure.hosts), count), np.nan)

    def collect(vibration: Vibration, potentials: Potentials, numbers: Indices) -> None:
        runs = vibration.runs
        level = first.options.settle * vibration.decay.peak
        values[:, :, numbers] = [vibration.decay.peak, vibration.rms, level, vibration.decay.settled(level)]
        energy[:, numbers] = mean_host_energies(vibration.structures, runs.x, runs.v)

    runner.run(schedules, positions, collect)
    peak, rms, level, settled = values
    return BaselineQuantities(peak, rms, level, settled, energy)
