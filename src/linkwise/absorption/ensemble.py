"""Comparisons of many structures that differ in a few numbers, each reduced to the scalar quantities by which sinks are
judged.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from linkwise.absorption.absorb import Comparison, without_sinks
from linkwise.absorption.runs import (
    AbsorptionRun,
    Decay,
    comparable,
    decay_of,
    reduction,
    rest_positions,
    runs_of,
    stored_energy,
)
from linkwise.absorption.sinks import SUFFIX
from linkwise.arrays import Bools, Floats, Indices
from linkwise.errors import SimulationError
from linkwise.model.coefficient import Name
from linkwise.model.structure import Structure
from linkwise.progress import Progress, ProgressReport, silent
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


class BaselineQuantities(NamedTuple):
    """The vibration of the P primary masses without sinks: `peak`, `rms`, `level` m and `settled` s, (P,), and the mean
    `energy` (H,) J in H hosts; NaN of a run that did not come to its end.
    """

    peak: Floats
    rms: Floats
    level: Floats
    settled: Floats
    energy: Floats

    @classmethod
    def of(cls, run: AbsorptionRun, settle: float) -> BaselineQuantities:
        """Those of a run; a mass has settled below a part of its peak."""
        decay = decay_of(run)
        energies = [run.host_energy(host.name).mean() for host in run.structure.hosts]
        level = settle * decay.peak
        return cls(decay.peak, decay.rms, level, decay.settled(level), np.array(energies))


def _no_quantities(comparison: Comparison) -> BaselineQuantities:
    unknown = np.full(len(comparison.primaries), np.nan)
    energies = np.full(len(comparison.structure.hosts), np.nan)
    return BaselineQuantities(unknown, unknown, unknown, unknown, energies)


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
    for name in comparison.dissipators:
        least_is_best = name not in comparison.absorbing
        rows.append((f"share:{name}", "", f"energy dissipated by {name}", least_is_best))
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
    comparison: Comparison, run: AbsorptionRun, baseline: BaselineQuantities
) -> dict[str, float]:
    """The value of every quantity in a run with sinks, by name."""
    decay, schedule, structure = decay_of(run), comparison.schedule, run.structure
    settled, total, dissipated = decay.settled(baseline.level), run.total, run.dissipated[-1]
    remaining = float(stored_energy(structure, run.d[-1:], run.v[-1:])[0])
    names = [link.name for link in structure.links]
    shares = {name: dissipated[numbers].sum() / total for name, numbers in comparison.dissipators.items()}
    links = [names.index(sink.link) for sink in comparison.sinks]
    crossings = {names[link]: float(len(run.crossings[link])) for link in links}
    units = [unit_in(structure, f"x:{name}") for name in comparison.primaries]
    of_rms, of_peak = (comparable(sizes, units) for sizes in (baseline.rms, baseline.peak))
    joint_rms = (float(np.linalg.norm(of_rms * rms)) for rms in (decay.rms, baseline.rms))
    joint_peaks = (float((of_peak * peak).max()) for peak in (decay.peak, baseline.peak))
    values: dict[str, Any] = {
        "settled": settled.max(),
        "settled_without": baseline.settled.max(),
        "rms_reduction": reduction(*joint_rms),
        "peak_reduction": reduction(*joint_peaks),
        "sinks_share": sum(shares[name] for name in comparison.absorbing),
        "crossings": sum(crossings.values()),
        "remaining": remaining / total,
        "closure": abs(total - remaining - dissipated.sum()) / np.abs(run.supplied).max(),
        "peak": decay.peak.max(),
        "rms": np.linalg.norm(decay.rms),
    }
    rms, peaks = reduction(decay.rms, baseline.rms), reduction(decay.peak, baseline.peak)
    for row, name in enumerate(comparison.primaries):
        values[f"settled:{name}"] = settled[row]
        values[f"rms_reduction:{name}"] = rms[row]
        values[f"peak_reduction:{name}"] = peaks[row]
    for host, without in zip(structure.hosts, baseline.energy, strict=True):
        values[f"energy_reduction:{host.name}"] = reduction(run.host_energy(host.name).mean(), without)
    values |= {f"share:{name}": share for name, share in shares.items()}
    values |= {f"crossings:{name}": count for name, count in crossings.items()}
    base = schedule.excitation.base
    rates = structure.elongations(run.v, None if base is None else base.derivative(schedule.times))
    decays = Decay(schedule.times, run.d[:, links], rates[:, links])
    strokes = zip(comparison.sinks, decays.peak, strict=True)
    values |= {f"stroke:{sink.link}": peak for sink, peak in strokes}
    for link, load in (comparison.options.harvesters or {}).items():
        energy = run.delivered[link] if isinstance(load, str) else shares[f"{link}{SUFFIX}"] * total
        values[f"power:{link}"] = energy / schedule.end
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
        options, drive = comparison.options, comparison.options.excitation
        drive = replace(drive, release={**drive.release, **release}) if release else drive
        varied = structure.with_values(numbers) if numbers else comparison.structure
        baseline = comparison.baseline
        if changes:
            left = without_sinks(varied, comparison.sinks, drive, options.without)
            baseline = RunSchedule(*left, comparison.times)
        return replace(
            comparison, structure=varied, baseline=baseline, options=replace(options, excitation=drive)
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

    `completed` (R,) are the runs that came to their end; `envelopes` (R, N, P) m of the primary masses with sinks are kept on
    request, in single precision to save memory.
    """

    quantities: tuple[AbsorptionQuantity, ...]
    values: Floats
    completed: Bools
    envelopes: NDArray[np.float32] | None = None

    def column(self, name: str) -> Floats:
        """The values (R,) of the quantity called `name`."""
        return self.values[:, [quantity.name for quantity in self.quantities].index(name)]


def _in_batches(
    count: int, task: Callable[[range], object], workers: int, report: Callable[[float], object]
) -> None:
    """Do a task for so many runs, `LANES` at a time on `workers` threads."""
    groups = [range(count)[first : first + LANES] for first in range(0, count, LANES)]
    pool = ThreadPoolExecutor(min(workers, len(groups)))
    try:
        for done, future in enumerate(as_completed([pool.submit(task, group) for group in groups]), start=1):
            future.result()
            report(done / len(groups))
    finally:  # an interrupt waits for the batches under way and starts no others
        pool.shutdown(wait=True, cancel_futures=True)


def run_ensemble(
    comparisons: Sequence[Comparison],
    *,
    envelopes: bool = False,
    workers: int | None = None,
    progress: Progress = silent,
) -> Ensemble:
    """Make comparisons of structures of one shape on `workers` threads (default: one for each processor).

    Comparisons may share one object for the structure without sinks, which is then run once.
    """
    if workers is not None and workers < 1:
        raise SimulationError(f"workers must be at least 1, got {workers}")
    first, workers, primaries = comparisons[0], workers or processors(), comparisons[0].primaries
    baselines, baseline_of = _distinct([comparison.baseline for comparison in comparisons])
    owners = [int(np.argmax(baseline_of == number)) for number in range(len(baselines))]
    structures, structure_of = _distinct([comparison.resting_structure for comparison in comparisons])
    distinct_positions = [rest_positions(structure, primaries) for structure in structures]
    positions = [distinct_positions[number] for number in structure_of]
    quantities, without = quantities_of(first), [_no_quantities(first)] * len(baselines)
    values = np.full((len(comparisons), len(quantities)), np.nan)
    completed = np.zeros(len(comparisons), dtype=bool)
    shape = len(comparisons), len(first.times), len(primaries)
    all_envelopes = np.full(shape, np.nan, np.float32) if envelopes else None

    def run_without(numbers: range) -> None:
        schedules = [comparisons[owners[number]].baseline for number in numbers]
        rests = [positions[owners[number]] for number in numbers]
        for number, run in zip(numbers, runs_of(schedules, primaries, rests, {}), strict=True):
            if run is not None:
                without[number] = BaselineQuantities.of(run, first.options.settle)

    def run_with(numbers: range) -> None:
        schedules, rests = (
            [comparisons[number].schedule for number in numbers],
            [positions[n] for n in numbers],
        )
        for number, run in zip(numbers, runs_of(schedules, primaries, rests, first.powers), strict=True):
            if run is not None:
                by_name = quantity_values(first, run, without[baseline_of[number]])
                values[number] = [by_name[quantity.name] for quantity in quantities]
                completed[number] = True
                if all_envelopes is not None:
                    all_envelopes[number] = run.envelope

    def report(activity: str, first: float, last: float) -> Callable[[float], object]:
        return lambda done: progress(ProgressReport(first + (last - first) * done, activity))

    share = len(baselines) / (len(baselines) + len(comparisons))
    activity = f"{len(comparisons)} runs with sinks"
    with one_blas_thread():
        _in_batches(len(baselines), run_without, workers, report("without sinks", 0.0, share))
        _in_batches(len(comparisons), run_with, workers, report(activity, share, 1.0))
    return Ensemble(quantities, values, completed, all_envelopes)


def _distinct(objects: Sequence[T]) -> tuple[list[T], Indices]:
    """The distinct objects of a sequence, and the number among them of each of its members."""
    distinct = {id(member): member for member in objects}
    number = {key: place for place, key in enumerate(distinct)}
    return list(distinct.values()), np.array([number[id(member)] for member in objects], dtype=np.intp)
