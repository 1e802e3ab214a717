"""A map of absorption as rows of text, for print and for the page."""

from __future__ import annotations

from textwrap import fill

import numpy as np

from linkwise.absorption.quantities import Quantity
from linkwise.absorption.sweep import AbsorptionMap
from linkwise.absorption.text import percent
from linkwise.text import align_columns, as_text

Rows = list[tuple[str, ...]]

_WIDTH = 100  # at which sentences are broken


@as_text.register
def map_text(found: AbsorptionMap) -> str:
    """The map in a few lines: what it went over, and where each quantity is best."""
    rows: Rows = [(*row, "") for row in map_rows(found)]
    told = [fill(f"! {each}", _WIDTH, subsequent_indent="  ") for each in found.findings]
    headline = fill(" ".join(map_headline(found)), _WIDTH)
    return "\n\n".join([headline, "\n".join(align_columns(rows)), *told])


def map_headline(found: AbsorptionMap) -> tuple[str, ...]:
    """What was done, in sentences."""
    ranges = " and ".join(
        f"{axis.name} from {axis.values[0]:g} to {axis.values[-1]:g}{'' if axis.unit in ('', '?') else ' ' + axis.unit}"
        for axis in found.axes
    )
    lost = int(np.sum(~found.alive))
    ended = "all came to their end" if not lost else f"{lost} diverged"
    return (
        f"{found.alive.size} runs of {found.duration:g} s over {ranges}: {ended}.",
        f"Reductions compare with the sinks {found.manner}.",
    )


def map_rows(found: AbsorptionMap) -> Rows:
    """Least and largest value of each quantity, and the parameters at which it is best."""
    rows: Rows = [("quantity", "least", "largest", "without value", "best at")]
    for quantity in found.quantities:
        if quantity.name == "closure":
            continue
        grid = found[quantity.name]
        there = grid[np.isfinite(grid)]
        ends = (
            [value_text(quantity, float(end)) for end in (there.min(), there.max())]
            if there.size
            else ["-", "-"]
        )
        best = found.best(quantity.name)
        place = "-" if best is None else ", ".join(f"{name} = {value:.4g}" for name, value in best.items())
        rows.append((quantity.title, *ends, f"{grid.size - there.size}", place))
    return rows


def value_text(quantity: Quantity, value: float) -> str:
    """A value with its unit; parts of 1 in %."""
    if quantity.name.startswith("crossings"):
        return f"{value:.4g}"
    return percent(value) if not quantity.unit else f"{value:.4g} {quantity.unit}"
