"""The result of `absorption_map` as rows of text, for print and for the page."""

from __future__ import annotations

import numpy as np

from linkwise.absorption.map_result import AbsorptionMap, SweepAxis
from linkwise.absorption.quantities import AbsorptionQuantity
from linkwise.absorption.text import percent
from linkwise.display import align_columns, as_text, paragraph, remark_lines

Rows = list[tuple[str, ...]]


@as_text.register
def map_text(map_: AbsorptionMap) -> str:
    """The map in a few lines: the grid, and where each quantity is best."""
    rows: Rows = [(*row, "") for row in map_rows(map_)]
    headline = paragraph(" ".join(map_headline(map_)))
    return "\n\n".join([headline, "\n".join(align_columns(rows)), *map(remark_lines, map_.findings)])


def map_headline(map_: AbsorptionMap) -> tuple[str, ...]:
    """The grid and the comparison, in sentences."""
    ranges = " and ".join(map(_range, map_.axes))
    diverged = int(np.sum(~map_.completed))
    ended = f"{diverged} diverged" if diverged else "all came to their end"
    return (
        f"{map_.completed.size} runs of {map_.duration:g} s over {ranges}: {ended}.",
        f"Reductions compare with the sinks {map_.removal}.",
    )


def _range(axis: SweepAxis) -> str:
    unit = "" if axis.unit in ("", "?") else f" {axis.unit}"
    return f"{axis.name} from {axis.values[0]:g} to {axis.values[-1]:g}{unit}"


def map_rows(map_: AbsorptionMap) -> Rows:
    """Least and largest value of each quantity, and the parameters at which it is best."""
    rows: Rows = [("quantity", "least", "largest", "without value", "best at")]
    for quantity in map_.quantities:
        if quantity.name == "closure":
            continue
        grid = map_[quantity.name]
        finite = grid[np.isfinite(grid)]
        ends = (
            [value_text(quantity, float(end)) for end in (finite.min(), finite.max())]
            if finite.size
            else ["-", "-"]
        )
        best = map_.best(quantity.name)
        point = "-" if best is None else ", ".join(f"{name} = {value:.4g}" for name, value in best.items())
        rows.append((quantity.title, *ends, f"{grid.size - finite.size}", point))
    return rows


def value_text(quantity: AbsorptionQuantity, value: float) -> str:
    """A value with its unit; parts of 1 in %."""
    if quantity.name.startswith("crossings"):
        return f"{value:.4g}"
    return percent(value) if not quantity.unit else f"{value:.4g} {quantity.unit}"
