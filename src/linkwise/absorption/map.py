"""`absorb` over a grid of one or two parameters: thousands of runs, one map for each quantity."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from itertools import product
from math import prod
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike

from linkwise.absorption.absorb import AbsorptionKeywords, AbsorptionOptions, Comparison
from linkwise.absorption.ensemble import AbsorptionQuantity, run_ensemble, variants
from linkwise.absorption.result import Rows, closure_verdict
from linkwise.absorption.sinks import SUFFIX, find_sinks, with_harvesters
from linkwise.arrays import Bools, Floats
from linkwise.display import JudgedView, paragraph, remark_lines, table, text_of
from linkwise.errors import (
    LinkwiseError,
    SimulationError,
    StructureError,
    expect,
    options_given,
    require_known,
)
from linkwise.model.coefficient import Name
from linkwise.model.structure import Structure
from linkwise.progress import Progress, ProgressReport, silent
from linkwise.records.channel_units import unit_in
from linkwise.runtime import available_memory
from linkwise.simulation.simulate import SimulatedMotion
from linkwise.verdict import UNGRADED, Basis, Verdict

_EQUAL_RATIOS = 1e-6  # relative differences of ratios below it are rounding


@dataclass(frozen=True, eq=False)
class SweepAxis:
    """A swept parameter.

    Attributes
    ----------
    name : str
        A coefficient ("nes1.alpha"), a mass ("m2.mass") or a release ("v:m1").
    unit : str
        Its SI unit.
    values : (K,) ndarray
        Its values.

    Examples
    --------
    >>> import linkwise as lw
    >>> import numpy as np
    >>> axis = lw.absorption.SweepAxis("nes1.beta", "N/m^3", np.geomspace(1e5, 1e7, 5))
    >>> axis.logarithmic
    True
    """

    name: str
    unit: str
    values: Floats

    @property
    def logarithmic(self) -> bool:
        """Whether the values are a geometric series, and not an arithmetic one."""
        if len(self.values) < 3 or self.values[0] * self.values[-1] <= 0.0 or np.any(self.values == 0.0):
            return False
        ratios, steps = self.values[1:] / self.values[:-1], np.diff(self.values)
        arithmetic = np.ptp(steps) <= _EQUAL_RATIOS * np.abs(steps).max()
        return bool(not arithmetic and np.ptp(ratios) <= _EQUAL_RATIOS * np.abs(ratios).max())


@dataclass(frozen=True, eq=False, repr=False)
class AbsorptionMap(JudgedView):
    """The result of `absorption_map`; printed, a table of ranges and optima. ``map[name]`` is the grid of a quantity.

    Attributes
    ----------
    structure : Structure
        The structure in the middle of the grid.
    removal : str
        How the sinks are taken out for comparison, "removed" or "locked".
    settle : float
        The part of its peak without sinks below which a mass has settled.
    duration : float
        Simulated time in s.
    axes : tuple of SweepAxis
        One or two swept parameters, of K and J values.
    quantities : tuple of AbsorptionQuantity
        The Q quantities.
    values : (K, Q) or (K, J, Q) ndarray
        Their values; NaN for a mass that does not settle and a run that diverges.
    completed : (K,) or (K, J) ndarray of bool
        The runs that came to their end.
    horizon : float or None
        Time in s past which a chaotic motion cannot be predicted, in the middle of the grid; None if it can throughout.
    basis : Basis
        The answer that the structure comes from.

    Examples
    --------
    >>> import linkwise as lw
    >>> over = {"nes1.alpha": [-150.0, -100.0, -50.0]}
    >>> swept = lw.absorption.absorption_map(lw.bnes_chain(2), over, duration=1.0, release={"v:m1": 1.0})
    >>> swept["sinks_share"].shape, bool(swept.completed.all())
    ((3,), True)
    >>> list(swept.best("sinks_share"))
    ['nes1.alpha']
    """

    structure: Structure
    removal: str
    settle: float
    duration: float
    axes: tuple[SweepAxis, ...]
    quantities: tuple[AbsorptionQuantity, ...]
    values: Floats
    completed: Bools
    horizon: float | None
    basis: Basis = UNGRADED

    def __getitem__(self, name: str) -> Floats:
        """The values (K,) or (K, J) of the quantity called `name`; LinkwiseError lists all."""
        names = [quantity.name for quantity in self.quantities]
        require_known("quantity", name, names)
        return np.ascontiguousarray(self.values[..., names.index(name)])

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Whether the energy balance of every completed run closes."""
        return (closure_verdict(float(np.nanmax(self["closure"]))),)

    @property
    def findings(self) -> tuple[str, ...]:
        """Sentences on what this map cannot show."""
        lines = []
        diverged = int(np.sum(~self.completed))
        if diverged:
            lines.append(
                f"{diverged} of {self.completed.size} runs diverge: their cells have no value, and the best is "
                f"chosen among the others. Narrow the range of {' or '.join(axis.name for axis in self.axes)}."
            )
        if self.horizon is not None:
            lines.append(
                f"In the middle of the grid the motion is chaotic past {self.horizon:.3g} s of {self.duration:g} s: from "
                "there on each cell is one run of many, and neighbouring cells differ by chance too."
            )
        return tuple(lines)

    def extremes(self, name: str) -> tuple[float | None, float | None, int]:
        """The least and the largest value of a quantity.

        Parameters
        ----------
        name : str
            A quantity.

        Returns
        -------
        least, largest : float or None
            The values; None where no cell has one.
        missing : int
            The number of cells without a value.

        Raises
        ------
        LinkwiseError
            If there is none of this name.
        """
        grid = self[name]
        values = grid[np.isfinite(grid)]
        missing = int(grid.size - values.size)
        return (float(values.min()), float(values.max()), missing) if values.size else (None, None, missing)

    def best(self, name: str) -> dict[str, float] | None:
        """The values of the swept parameters at which a quantity is best.

        Parameters
        ----------
        name : str
            The quantity; `AbsorptionQuantity.least_is_best` says what is best.

        Returns
        -------
        dict of str to float or None
            Values by parameter; None if the quantity has no value anywhere.

        Raises
        ------
        LinkwiseError
            If there is no such quantity.
        """
        grid = self[name]
        if not np.isfinite(grid).any():
            return None
        least = next(quantity.least_is_best for quantity in self.quantities if quantity.name == name)
        flat = np.nanargmin(grid) if least else np.nanargmax(grid)
        index = np.unravel_index(int(flat), grid.shape)
        return {axis.name: float(axis.values[k]) for axis, k in zip(self.axes, index, strict=True)}

    def to_dict(self) -> dict[str, Any]:
        """The result as plain data: the axes, and each quantity over them with its range and optimum.

        Returns
        -------
        dict
            The content of absorption.json: the axes, and each quantity over them with its range and optimum; SI units.
        """
        return {
            "method": "absorb",
            "without": self.removal,
            "duration": self.duration,
            "settle": self.settle,
            "runs": int(self.completed.size),
            "diverged": int(np.sum(~self.completed)),
            "horizon": self.horizon,
            "findings": list(self.findings),
            **self._judgement(),
            "axes": [asdict(axis) | {"values": axis.values.tolist()} for axis in self.axes],
            "quantities": {quantity.name: self._quantity_document(quantity) for quantity in self.quantities},
        }

    def _quantity_document(self, quantity: AbsorptionQuantity) -> dict[str, Any]:
        least, largest, missing = self.extremes(quantity.name)
        return {
            "title": quantity.title,
            "unit": quantity.unit,
            "least": least,
            "largest": largest,
            "without_value": missing,
            "best_at": self.best(quantity.name),
            "values": self[quantity.name].tolist(),
        }

    def __str__(self) -> str:
        rows: Rows = [(*row, "") for row in map_rows(self)]
        findings = ([remark_lines(finding)] for finding in self.findings)
        return text_of([paragraph(" ".join(map_headline(self)))], table(rows), *findings)


_RUN_BYTES, _MASS_BYTES = 5000, 1200  # at most, until the last run has ended, for each run and mass


def absorption_map(
    structure: Structure,
    over: Mapping[str, ArrayLike],
    options: AbsorptionOptions | None = None,
    *,
    workers: int | None = None,
    progress: Progress = silent,
    **keywords: Unpack[AbsorptionKeywords],
) -> AbsorptionMap:
    """Compare the vibration of a structure with its sinks and without them over a grid of one or two parameters.

    Parameters
    ----------
    structure : Structure
        The structure; a swept coefficient may be unknown.
    over : mapping of str to array_like
        Values, in SI units, of one or two parameters: coefficients ("nes1.alpha"), masses ("m2.mass") and releases ("v:m1").
    options : AbsorptionOptions, optional
        What to simulate. Without names the sinks are those of `structure` or, if a swept coefficient is unknown, those in
        the middle of the grid.
    workers : int, optional
        Number of threads; by default one for each processor.
    progress : Progress
        Called with a `ProgressReport` as runs end.
    **keywords
        In place of `options`: its fields and the excitation, as in `absorb`.

    Returns
    -------
    AbsorptionMap
        Every quantity over the grid.

    Raises
    ------
    StructureError
        If a parameter does not exist, and as `absorb`.
    SimulationError
        If the runs need more memory than there is, and as `absorb`.
    LinkwiseError
        If no run comes to its end.
    TypeError
        If `structure` is no `Structure`.

    Examples
    --------
    >>> import linkwise as lw
    >>> over = {"nes1.alpha": [-150.0, -100.0, -50.0]}
    >>> found = lw.absorption.absorption_map(lw.bnes_chain(2), over, duration=1.0, release={"v:m1": 1.0})
    >>> found["sinks_share"].shape
    (3,)
    >>> found.best("sinks_share")
    {'nes1.alpha': -150.0}
    """
    expect("absorption_map(structure, over): structure", structure, Structure)
    expect("absorption_map(structure, over): over", over, Mapping)
    chosen = options_given(AbsorptionOptions.of, options, keywords)
    equipped = with_harvesters(structure, chosen.harvesters or {})
    axes = _swept_axes(equipped, over)
    _require_memory(axes, structure.size)
    points = list(product(*(axis.values.tolist() for axis in axes)))
    names = [axis.name for axis in axes]
    middle = {axis.name: float(axis.values[len(axis.values) // 2]) for axis in axes}
    comparison = comparison_at(structure, middle, chosen)
    progress(ProgressReport(0.0, f"preparing {len(points)} runs"))
    at = variants(equipped, comparison, names)
    comparisons = [at(dict(zip(names, point, strict=True))) for point in points]
    ensemble = run_ensemble(comparisons, workers=workers, progress=progress)
    if not ensemble.completed.any():
        raise LinkwiseError(
            f"none of the {len(points)} runs came to its end: the motion diverges over the whole grid; check the ranges of "
            f"{' and '.join(over)}"
        )
    shape = tuple(len(axis.values) for axis in axes)
    return AbsorptionMap(
        structure=comparison.structure,
        removal=comparison.options.without,
        settle=comparison.options.settle,
        duration=float(comparison.times[-1]),
        axes=axes,
        quantities=ensemble.quantities,
        values=ensemble.values.reshape(*shape, -1),
        completed=ensemble.completed.reshape(shape),
        horizon=_horizon(comparison),
    )


def _horizon(comparison: Comparison) -> float | None:
    """The predictability horizon in s of a run; None for a motion that diverges, too."""
    try:
        return SimulatedMotion.of(comparison.schedule).horizon
    except SimulationError:
        return None


def _swept_axes(structure: Structure, over: Mapping[str, ArrayLike]) -> tuple[SweepAxis, ...]:
    if not 1 <= len(over) <= 2:
        raise StructureError(f"a sweep takes one or two parameters, got {len(over)}")
    axes = []
    for name, given in over.items():
        values = np.atleast_1d(np.asarray(given, dtype=float))
        if values.ndim != 1 or not values.size or not np.isfinite(values).all():
            message = f"the values of a swept parameter must be a row of finite numbers, got {given!r}"
            raise StructureError(message, name)
        axes.append(SweepAxis(name, parameter_unit(structure, name), values))
    return tuple(axes)


def _require_memory(axes: tuple[SweepAxis, ...], masses: int) -> None:
    runs = prod(len(axis.values) for axis in axes)
    needed, free = runs * (_RUN_BYTES + _MASS_BYTES * masses), available_memory()
    if needed > free:
        raise SimulationError(
            f"a sweep of {runs} runs needs {needed / 1e9:.3g} GB, and {free / 1e9:.3g} GB are free; use fewer values of "
            f"{' and '.join(axis.name for axis in axes)}"
        )


def parameter_unit(structure: Structure, name: str) -> str:
    """The SI unit of a parameter; StructureError if it does not exist."""
    kind, colon, _ = name.partition(":")
    if colon and kind not in ("x", "v"):
        message = "a sweep takes coefficients, masses and releases; write a release as x:MASS or v:MASS"
        raise StructureError(message, name)
    return unit_in(structure, name) if colon else structure.unit_of(name)


def comparison_at(structure: Structure, point: Mapping[str, float], options: AbsorptionOptions) -> Comparison:
    """The comparison at one point of a grid; where sinks are not named, those of the structure are they."""
    release = {name: value for name, value in point.items() if ":" in name}
    coefficients = (name for name in point if ":" not in name and not Name.parse(name).owner.endswith(SUFFIX))
    numbers = {name: point[name] for name in coefficients}
    at_point = structure.with_values(numbers)
    known = all(structure.coefficient(name).value is not None for name in numbers)
    sinks = options.sinks or [sink.link for sink in find_sinks(structure if known else at_point)]
    excitation = replace(options.excitation, release={**options.excitation.release, **release})
    return Comparison.of(at_point, replace(options, sinks=sinks, excitation=excitation))


def map_headline(map_: AbsorptionMap) -> tuple[str, ...]:
    """The grid and the comparison, in sentences."""
    ranges = " and ".join(map(_axis_range, map_.axes))
    diverged = int(np.sum(~map_.completed))
    ended = f"{diverged} diverged" if diverged else "all came to their end"
    return (
        f"{map_.completed.size} runs of {map_.duration:g} s over {ranges}: {ended}.",
        f"Reductions compare with the sinks {map_.removal}.",
    )


def _axis_range(axis: SweepAxis) -> str:
    unit = "" if axis.unit in ("", "?") else f" {axis.unit}"
    return f"{axis.name} from {axis.values[0]:g} to {axis.values[-1]:g}{unit}"


def map_rows(map_: AbsorptionMap) -> Rows:
    """Least and largest value of each quantity, and the parameters at which it is best."""
    rows: Rows = [("quantity", "least", "largest", "without value", "best at")]
    for quantity in map_.quantities:
        if quantity.name == "closure":
            continue
        *ends, missing = map_.extremes(quantity.name)
        texts = ["-" if end is None else quantity.text(end) for end in ends]
        best = map_.best(quantity.name)
        point = "-" if best is None else ", ".join(f"{name} = {value:.4g}" for name, value in best.items())
        rows.append((quantity.title, *texts, str(missing), point))
    return rows
