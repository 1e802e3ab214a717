"""The same question over a grid of one or two parameters: thousands of runs, one map a quantity."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product
from math import prod
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike

from linkwise.absorption.comparison import Comparison
from linkwise.absorption.ensemble import run_ensemble
from linkwise.absorption.harvesters import SUFFIX, with_harvesters
from linkwise.absorption.options import AbsorptionKeywords, AbsorptionOptions
from linkwise.absorption.quantities import Quantity
from linkwise.absorption.result import closure_verdict
from linkwise.absorption.sinks import find_sinks
from linkwise.absorption.variants import Variants
from linkwise.arrays import Bools, Floats
from linkwise.errors import LinkwiseError, SimulationError, StructureError
from linkwise.model.structure import Structure
from linkwise.progress import Progress, ProgressReport, silent
from linkwise.runtime import available_memory
from linkwise.simulation.simulate import SimulatedMotion
from linkwise.text import as_text
from linkwise.verdict import Verdict, is_trusted

_RUN_BYTES, _MASS_BYTES = 4000, 1000  # of one run until the last has ended, and of each of its masses
_GEOMETRIC = 1e-6  # of a ratio: steps that are equal in ratio are drawn on a logarithmic axis


@dataclass(frozen=True, eq=False)
class SweepAxis:
    """A swept parameter: `name` of a coefficient ("nes1.alpha"), a mass ("m2.mass") or a release ("v:m1"), `values` (K,)."""

    name: str
    unit: str
    values: Floats

    @property
    def logarithmic(self) -> bool:
        """Whether its steps are equal in ratio and not in difference."""
        if len(self.values) < 3 or self.values[0] * self.values[-1] <= 0.0 or np.any(self.values == 0.0):
            return False
        ratios, steps = self.values[1:] / self.values[:-1], np.diff(self.values)
        even = np.ptp(steps) <= _GEOMETRIC * np.abs(steps).max()
        return bool(not even and np.ptp(ratios) <= _GEOMETRIC * np.abs(ratios).max())


@dataclass(frozen=True, eq=False)
class AbsorptionMap:
    """What the sinks of `structure` do over a grid of one or two `axes`; every quantity has the shape of the grid.

    NaN stands where a quantity is not there: a mass that does not settle, a motion that diverges. `alive` says which of the
    two: False where the run did not come to its end. `horizon` s is where chaos ends prediction in the middle of the grid,
    None where it does not.
    """

    structure: Structure
    manner: str
    settle: float
    duration: float
    axes: tuple[SweepAxis, ...]
    quantities: tuple[Quantity, ...]
    values: Floats
    alive: Bools
    horizon: float | None

    def __getitem__(self, name: str) -> Floats:
        """The map of one quantity, (K,) or (K, J); KeyError lists those there are."""
        names = [each.name for each in self.quantities]
        if name not in names:
            raise KeyError(f"{name!r} is not in this map; there are {', '.join(names)}")
        return np.ascontiguousarray(self.values[..., names.index(name)])

    @property
    def trusted(self) -> bool:
        """Whether no verdict forbids trust."""
        return is_trusted(self.verdicts)

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Whether the energy balance of every run that came to its end closes."""
        return (closure_verdict(float(np.nanmax(self["closure"]))),)

    @property
    def findings(self) -> tuple[str, ...]:
        """Sentences on what this map cannot tell."""
        if self.horizon is None:
            return ()
        return (
            f"In the middle of the grid the motion is chaotic past {self.horizon:.3g} s of {self.duration:g} s: from there on "
            "each cell is one run of many, and neighbouring cells differ by chance too.",
        )

    def best(self, name: str) -> dict[str, float] | None:
        """The parameters at which a quantity is best, as `Quantity` says; None where it has no value at all."""
        grid = self[name]
        if not np.isfinite(grid).any():
            return None
        least = next(each.least_is_best for each in self.quantities if each.name == name)
        flat = np.nanargmin(grid) if least else np.nanargmax(grid)
        place = np.unravel_index(int(flat), grid.shape)
        return {axis.name: float(axis.values[k]) for axis, k in zip(self.axes, place, strict=True)}

    def to_dict(self) -> dict[str, Any]:
        """Plain data: the axes, and each quantity over them, with its range and the place where it is best."""
        return {
            "method": "absorb",
            "without": self.manner,
            "duration": self.duration,
            "settle": self.settle,
            "runs": int(self.alive.size),
            "diverged": int(np.sum(~self.alive)),
            "horizon": self.horizon,
            "findings": list(self.findings),
            "verdicts": [verdict.name for verdict in self.verdicts],
            "trusted": self.trusted,
            "axes": [
                {"name": axis.name, "unit": axis.unit, "values": axis.values.tolist()} for axis in self.axes
            ],
            "quantities": {each.name: self._told(each) for each in self.quantities},
        }

    def _told(self, quantity: Quantity) -> dict[str, Any]:
        grid = self[quantity.name]
        there = grid[np.isfinite(grid)]
        ends = (float(there.min()), float(there.max())) if there.size else (None, None)
        told = {"title": quantity.title, "unit": quantity.unit, "least": ends[0], "largest": ends[1]}
        missing = int(grid.size - there.size)
        return {
            **told,
            "without_value": missing,
            "best_at": self.best(quantity.name),
            "values": grid.tolist(),
        }

    def __str__(self) -> str:
        return as_text(self)


def absorption_map(
    structure: Structure,
    over: Mapping[str, ArrayLike],
    options: AbsorptionOptions | None = None,
    *,
    workers: int | None = None,
    progress: Progress = silent,
    **keywords: Unpack[AbsorptionKeywords],
) -> AbsorptionMap:
    """Compare what a structure does with its sinks and without them over a grid of one or two of its parameters.

    Parameters
    ----------
    structure : Structure
        The structure. A swept coefficient may be unknown in it.
    over : mapping of str to array_like
        The values (K,) of one or two parameters by name: a coefficient ("nes1.alpha"), a mass ("m2.mass", kg) or a release
        ("x:m1", m; "v:m1", m/s).
    options : AbsorptionOptions, optional
        What is asked. Where it names no sinks they are those of `structure`, or of the middle of the grid where a swept
        coefficient is unknown.
    workers : int, optional
        Threads; by default one a processor.
    progress : Progress
        Called with a `ProgressReport` as runs end.
    **keywords
        In place of `options`: its fields and what drives the structure, as in `absorb`.

    Returns
    -------
    AbsorptionMap
        Every quantity over the grid.

    Raises
    ------
    StructureError
        If a parameter does not exist, and as `absorb` does.
    SimulationError
        If there is not enough memory for so many runs, and as `absorb` does.
    LinkwiseError
        If none of the runs comes to its end.
    """
    asked = AbsorptionOptions.given(options, keywords)
    equipped = with_harvesters(structure, asked.harvesters or {})
    axes = _axes(equipped, over)
    _require_room(axes, structure.size)
    points = list(product(*(axis.values.tolist() for axis in axes)))
    names = [axis.name for axis in axes]
    middle = {axis.name: float(axis.values[len(axis.values) // 2]) for axis in axes}
    trial = _trial(structure, middle, asked)
    progress(ProgressReport(0.0, f"preparing {len(points)} runs"))
    variants = Variants(equipped, trial, names)
    found = run_ensemble(
        [variants.at(dict(zip(names, point, strict=True))) for point in points],
        workers=workers,
        progress=progress,
    )
    if not found.alive.any():
        raise LinkwiseError(
            f"none of the {len(points)} runs came to its end: the motion diverges over the whole grid; check the ranges of "
            f"{' and '.join(over)}"
        )
    shape = tuple(len(axis.values) for axis in axes)
    return AbsorptionMap(
        structure=trial.structure,
        manner=trial.options.without,
        settle=trial.options.settle,
        duration=float(trial.times[-1]),
        axes=axes,
        quantities=found.quantities,
        values=found.values.reshape(*shape, -1),
        alive=found.alive.reshape(shape),
        horizon=_horizon(trial),
    )


def _horizon(trial: Comparison) -> float | None:
    """Of the run in the middle of the grid; None where that one diverges."""
    try:
        return SimulatedMotion.of(trial.schedule).horizon
    except SimulationError:
        return None


def _axes(structure: Structure, over: Mapping[str, ArrayLike]) -> tuple[SweepAxis, ...]:
    if not 1 <= len(over) <= 2:
        raise StructureError(f"a sweep goes over one parameter or two, not {len(over)}")
    axes = []
    for name, given in over.items():
        values = np.atleast_1d(np.asarray(given, dtype=float))
        if values.ndim != 1 or not values.size or not np.isfinite(values).all():
            raise StructureError("the values of a swept parameter are one row of finite numbers", name)
        axes.append(SweepAxis(name, _unit(structure, name), values))
    return tuple(axes)


def map_bytes(runs: int, masses: int) -> int:
    """Bytes that so many runs of a structure with so many masses take, their motion aside."""
    return runs * (_RUN_BYTES + _MASS_BYTES * masses)


def _require_room(axes: tuple[SweepAxis, ...], masses: int) -> None:
    runs = prod(len(axis.values) for axis in axes)
    needed, free = map_bytes(runs, masses), available_memory()
    if needed > free:
        raise SimulationError(
            f"a sweep of {runs} runs takes {needed / 1e9:.3g} GB, and {free / 1e9:.3g} GB are free; take fewer values of "
            f"{' and '.join(axis.name for axis in axes)}"
        )


def _unit(structure: Structure, name: str) -> str:
    """Of a parameter; raises StructureError for one that is not there."""
    kind, colon, _ = name.partition(":")
    if colon:
        if kind not in ("x", "v"):
            raise StructureError(
                "only a release can be swept beside coefficients and masses: x:MASS or v:MASS", name
            )
        return "m" if kind == "x" else "m/s"
    structure.coefficient(name)
    owner, _, key = name.rpartition(".")
    return "kg" if key == "mass" and owner in structure.mass_names else structure.link(owner).law.units[key]


def _trial(structure: Structure, middle: Mapping[str, float], options: AbsorptionOptions) -> Comparison:
    """The question at one point of the grid."""
    release = {name: value for name, value in middle.items() if ":" in name}
    numbers = {
        name: value
        for name, value in middle.items()
        if ":" not in name and not name.rpartition(".")[0].endswith(SUFFIX)
    }
    there = structure.with_values(numbers) if numbers else structure
    known = all(structure.coefficient(name).value is not None for name in numbers)
    sinks = options.sinks or [sink.link for sink in find_sinks(structure if known else there)]
    excitation = replace(options.excitation, release={**options.excitation.release, **release})
    return Comparison.of(there, replace(options, sinks=sinks, excitation=excitation))
