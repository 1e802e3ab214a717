"""The numbers that runs come to, one a structure: what they are called, and how they follow from motions and energies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from linkwise.absorption.comparison import Comparison
from linkwise.absorption.harvesters import SUFFIX
from linkwise.absorption.potentials import Potentials
from linkwise.absorption.runs import Runs
from linkwise.absorption.vibration import Vibration, reduction, together
from linkwise.arrays import Floats, Indices


@dataclass(frozen=True)
class Quantity:
    """One number a structure: `name`, `unit` (none: a count, or a part of 1), what it is in words, and which end is best."""

    name: str
    unit: str
    title: str
    least_is_best: bool = False


@dataclass(frozen=True, eq=False)
class BaselineQuantities:
    """What the primary masses do without sinks, (P, R)."""

    peak: Floats
    rms: Floats
    level: Floats
    settled: Floats

    def of(self, which: Indices) -> BaselineQuantities:
        """That of some of the runs, or of some several times."""
        return BaselineQuantities(
            *(each[:, which] for each in (self.peak, self.rms, self.level, self.settled))
        )


def quantities_of(trial: Comparison) -> tuple[Quantity, ...]:
    """What `quantity_values` tells, in order."""
    percent = f"{100.0 * trial.options.settle:g} %"
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
        for link in trial.options.harvesters or ()
    ]
    return tuple(found)


def quantity_values(
    trial: Comparison, runs: Runs, vibration: Vibration, potentials: Potentials, reference: BaselineQuantities
) -> dict[str, Floats]:
    """(W,) of every quantity."""
    settled = vibration.settled(reference.level)
    base = trial.options.excitation.base
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
    found = {
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
        found[f"settled:{name}"] = settled[row]
        found[f"rms_reduction:{name}"] = single[row]
        found[f"peak_reduction:{name}"] = peaks[row]
    found |= {f"share:{name}": share for name, share in shares.items()}
    found |= {f"crossings:{name}": count for name, count in crossings.items()}
    end = runs.time[-1]
    return found | {
        f"power:{link}": shares[f"{link}{SUFFIX}"] * total / end for link in trial.options.harvesters or ()
    }
