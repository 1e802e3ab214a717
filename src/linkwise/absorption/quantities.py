"""The scalar quantities by which sinks are judged: what they are called, and how they follow from runs and energies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from linkwise.absorption.comparison import Comparison
from linkwise.absorption.harvesters import SUFFIX
from linkwise.absorption.places import dissipators, mean_host_energies
from linkwise.absorption.potentials import Potentials
from linkwise.absorption.runs import Runs
from linkwise.absorption.vibration import Vibration, comparable, reduction, root_sum_square
from linkwise.arrays import Floats, Indices
from linkwise.records.channel_units import unit_in


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
    >>> swept = lw.absorption_map(lw.bnes_chain(2), over, duration=1.0, release={"v:m1": 1.0})
    >>> settled = swept.quantities[0]
    >>> settled.name, settled.unit, settled.least_is_best
    ('settled', 's', True)
    """

    name: str
    unit: str
    title: str
    least_is_best: bool = False


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
        return BaselineQuantities(
            *(values[:, runs] for values in (self.peak, self.rms, self.level, self.settled, self.energy))
        )


def quantities_of(comparison: Comparison) -> tuple[AbsorptionQuantity, ...]:
    """The quantities that `quantity_values` returns, in order."""
    percent = f"{100.0 * comparison.options.settle:g} %"
    quantities = [
        AbsorptionQuantity("settled", "s", f"settling time (below {percent})", True),
        AbsorptionQuantity("settled_without", "s", f"settling time without sinks (below {percent})", True),
        AbsorptionQuantity("rms_reduction", "", "RMS reduction"),
        AbsorptionQuantity("peak_reduction", "", "peak reduction"),
        AbsorptionQuantity("sinks_share", "", "energy dissipated by the sinks"),
        AbsorptionQuantity("crossings", "", "well crossings"),
        AbsorptionQuantity("remaining", "", "energy left at the end", True),
        AbsorptionQuantity("closure", "", "error of the energy balance", True),
    ]
    if len(comparison.primaries) > 1:
        for name in comparison.primaries:
            quantities.append(AbsorptionQuantity(f"settled:{name}", "s", f"settling time of {name}", True))
            quantities.append(AbsorptionQuantity(f"rms_reduction:{name}", "", f"RMS reduction of {name}"))
            quantities.append(AbsorptionQuantity(f"peak_reduction:{name}", "", f"peak reduction of {name}"))
    quantities += [
        AbsorptionQuantity(
            f"energy_reduction:{host.name}", "", f"reduction of the mean energy in {host.name}"
        )
        for host in comparison.structure.hosts
    ]
    quantities += [
        AbsorptionQuantity(
            f"share:{name}",
            "",
            f"energy dissipated by {name}",
            name not in comparison.absorbing,
        )
        for name in dissipators(comparison.structure)
    ]
    quantities += [
        AbsorptionQuantity(f"crossings:{sink.link}", "", f"well crossings of {sink.link}")
        for sink in comparison.sinks
    ]
    quantities += [
        AbsorptionQuantity(f"power:{link}", "W", f"average power of the harvester on {link}")
        for link in comparison.options.harvesters or ()
    ]
    return tuple(quantities)


def quantity_values(
    comparison: Comparison,
    runs: Runs,
    vibration: Vibration,
    potentials: Potentials,
    baseline: BaselineQuantities,
) -> dict[str, Floats]:
    """The values (W,) of every quantity in W runs, by name."""
    settled = vibration.settled(baseline.level)
    base = comparison.options.excitation.base
    x_base = None if base is None else base.value(runs.time[-1:])
    remaining = (potentials.kinetic(runs.v[-1:]) + potentials.stored(runs.x[-1:], x_base))[0]
    supplied = runs.supplied - potentials.floor
    total, dissipated = supplied[-1], runs.dissipated[-1]
    names = [link.name for link in comparison.structure.links]
    shares = {
        name: dissipated[numbers].sum(axis=0) / total
        for name, numbers in dissipators(comparison.structure).items()
    }
    crossings = {
        sink.link: np.array([float(len(run[names.index(sink.link)])) for run in runs.crossings])
        for sink in comparison.sinks
    }
    units = [unit_in(comparison.structure, f"x:{name}") for name in comparison.primaries]
    of_rms, of_peak = (comparable(sizes, units) for sizes in (baseline.rms, baseline.peak))
    values = {
        "settled": settled.max(axis=0),
        "settled_without": baseline.settled.max(axis=0),
        "rms_reduction": reduction(
            root_sum_square(of_rms * vibration.rms), root_sum_square(of_rms * baseline.rms)
        ),
        "peak_reduction": reduction(
            (of_peak * vibration.peak).max(axis=0), (of_peak * baseline.peak).max(axis=0)
        ),
        "sinks_share": np.sum([shares[name] for name in comparison.absorbing], axis=0),
        "crossings": np.sum(list(crossings.values()), axis=0),
        "remaining": remaining / total,
        "closure": np.abs(total - remaining - dissipated.sum(axis=0)) / np.abs(supplied).max(axis=0),
    }
    rms, peaks = reduction(vibration.rms, baseline.rms), reduction(vibration.peak, baseline.peak)
    for row, name in enumerate(comparison.primaries):
        values[f"settled:{name}"] = settled[row]
        values[f"rms_reduction:{name}"] = rms[row]
        values[f"peak_reduction:{name}"] = peaks[row]
    energies = mean_host_energies(vibration.structures, runs.x, runs.v)
    for host, energy, without in zip(comparison.structure.hosts, energies, baseline.energy, strict=True):
        values[f"energy_reduction:{host.name}"] = reduction(energy, without)
    values |= {f"share:{name}": share for name, share in shares.items()}
    values |= {f"crossings:{name}": count for name, count in crossings.items()}
    duration = runs.time[-1]
    return values | {
        f"power:{link}": (
            runs.delivered[link] if isinstance(given, str) else shares[f"{link}{SUFFIX}"] * total
        )
        / duration
        for link, given in (comparison.options.harvesters or {}).items()
    }
