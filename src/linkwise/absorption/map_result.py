"""The result of `absorption_map`: quantities over a grid of one or two parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from linkwise.absorption.quantities import AbsorptionQuantity
from linkwise.absorption.result import closure_verdict
from linkwise.argument_types import checked
from linkwise.arrays import Bools, Floats
from linkwise.deprecation import Deprecated, DeprecatedAttribute
from linkwise.display import JudgedView, as_text
from linkwise.errors import LinkwiseError
from linkwise.model.structure import Structure
from linkwise.verdict import Verdict

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
    >>> axis = lw.SweepAxis("nes1.beta", "N/m^3", np.geomspace(1e5, 1e7, 5))
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


@dataclass(frozen=True, eq=False)
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

    Examples
    --------
    >>> import linkwise as lw
    >>> over = {"nes1.alpha": [-150.0, -100.0, -50.0]}
    >>> swept = lw.absorption_map(lw.bnes_chain(2), over, duration=1.0, release={"v:m1": 1.0})
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

    manner = DeprecatedAttribute(Deprecated("removal", since="0.2.0", until="0.4.0"))
    alive = DeprecatedAttribute(Deprecated("completed", since="0.2.0", until="0.4.0"))

    def __getitem__(self, name: str) -> Floats:
        """The values (K,) or (K, J) of the quantity called `name`; LinkwiseError lists all."""
        names = [quantity.name for quantity in self.quantities]
        if name not in names:
            raise LinkwiseError(f"unknown quantity {name!r}; choose from {', '.join(names)}")
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

    @checked
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
            "axes": [
                {"name": axis.name, "unit": axis.unit, "values": axis.values.tolist()} for axis in self.axes
            ],
            "quantities": {quantity.name: self._quantity_dict(quantity) for quantity in self.quantities},
        }

    def _quantity_dict(self, quantity: AbsorptionQuantity) -> dict[str, Any]:
        grid = self[quantity.name]
        finite = grid[np.isfinite(grid)]
        least, largest = (float(finite.min()), float(finite.max())) if finite.size else (None, None)
        return {
            "title": quantity.title,
            "unit": quantity.unit,
            "least": least,
            "largest": largest,
            "without_value": int(grid.size - finite.size),
            "best_at": self.best(quantity.name),
            "values": grid.tolist(),
        }

    def __str__(self) -> str:
        return as_text(self)
