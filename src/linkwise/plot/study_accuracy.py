"""Error and time of every method of a study over its structures: medians, and the spread of the seeds."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from linkwise.arrays import Floats
from linkwise.plot.palette import SEEN, SERIES, TRUE
from linkwise.plot.style import sheet
from linkwise.study.cells import StudyTable

_KNOWN = {"ml": (SERIES[0], "o"), "weak": (SERIES[4], "^"), "physics-informed": (SERIES[2], "D")}
_REST, _MARKERS = (SERIES[1], SERIES[5], SERIES[3], SEEN), "sv<>"


@dataclass(frozen=True)
class Pen:
    """How a method is drawn and what the legend calls it."""

    label: str
    color: str
    marker: str
    faint: bool = False  # one of several that stand behind the others: no marker, no spread


@dataclass(frozen=True)
class Printed:
    """Numbers that a paper prints, by structure, to stand beside those of a study; `label` says which they are."""

    label: str
    values: Mapping[str, float] = field(default_factory=dict)


def pens(methods: Sequence[str]) -> dict[str, Pen]:
    """One pen a method. linkwise's own estimators look the same in every figure, whatever stands beside them."""
    rest = cycle(zip(_REST, _MARKERS, strict=False))
    return {method: Pen(method, *(_KNOWN.get(method) or next(rest))) for method in methods}


def accuracy_figure(table: StudyTable) -> Figure:
    """The error over the structures, a panel for each noise level, and the time of one estimate at the last of them."""
    drawn = pens(table.methods)
    count = len(table.decibels) + 1
    with sheet(-(-count // 2), 2, height=0.9 + 2.3 * -(-count // 2)) as (figure, panels):
        for number, (axes, decibel) in enumerate(zip(panels, table.decibels, strict=False)):
            draw_errors(axes, table, decibel, drawn)
            axes.set_title(f"{chr(ord('a') + number)}  {decibel:g} dB")
        draw_times(panels[count - 1], table, table.decibels[-1], drawn)
        panels[count - 1].set_title(
            f"{chr(ord('a') + count - 1)}  time of one estimate, {table.decibels[-1]:g} dB"
        )
        for axes in panels[count:]:
            axes.set_visible(False)
        name_curves(figure, panels[:count])
    return figure


def draw_errors(
    axes: Axes, table: StudyTable, snr_db: float, drawn: Mapping[str, Pen], printed: Printed | None = None
) -> None:
    """Medians over structures with the spread of the seeds, and the numbers that a paper prints."""
    for method, pen in drawn.items():
        cells = [table.cell(structure, snr_db, method) for structure in table.structures]
        _draw_curve(axes, pen, _numbers(None if cell is None else cell.nmse for cell in cells))
        low = _numbers(None if cell is None else cell.low for cell in cells)
        high = _numbers(None if cell is None else cell.high for cell in cells)
        if pen.faint:
            continue
        axes.fill_between(range(len(cells)), low, high, color=pen.color, alpha=0.16, linewidth=0, zorder=2)
    _finish(axes, table, printed, "NMSE of the force, %")


def draw_times(
    axes: Axes, table: StudyTable, snr_db: float, drawn: Mapping[str, Pen], printed: Printed | None = None
) -> None:
    """Median times of one estimate over structures, and the times that a paper prints."""
    for method, pen in drawn.items():
        cells = [table.cell(structure, snr_db, method) for structure in table.structures]
        _draw_curve(axes, pen, _numbers(None if cell is None else cell.seconds for cell in cells))
    _finish(axes, table, printed, "time, s")


def name_curves(figure: Figure, panels: Sequence[Axes]) -> None:
    """One legend for all panels, every name once."""
    named: dict[str, Artist] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            named.setdefault(label, handle)
    if named:
        figure.legend(list(named.values()), list(named), loc="outside lower center", ncols=3)


def _draw_curve(axes: Axes, pen: Pen, heights: Floats) -> None:
    if np.isfinite(heights).any():
        bold: dict[str, Any] = {"marker": pen.marker, "markersize": 4, "zorder": 3}
        faint: dict[str, Any] = {"linewidth": 0.6, "zorder": 1}
        axes.plot(
            range(len(heights)),
            heights,
            color=pen.color,
            label=pen.label,
            **(faint if pen.faint else bold),
        )


def _finish(axes: Axes, table: StudyTable, printed: Printed | None, label: str) -> None:
    structures = table.structures
    if printed is not None:
        at = [index for index, structure in enumerate(structures) if structure in printed.values]
        axes.plot(
            at,
            [printed.values[structures[index]] for index in at],
            color=TRUE,
            linestyle=(0, (4, 2)),
            marker="s",
            markersize=5.5,
            markerfacecolor="none",
            label=printed.label,
            zorder=4,
        )
    counts = list(table.masses.values())
    distinct = len(set(counts)) == len(counts)
    axes.set_xticks(range(len(structures)), [str(count) for count in counts] if distinct else structures)
    axes.set_xlim(-0.3, len(structures) - 0.7)
    axes.set_xlabel("degrees of freedom" if distinct else "structure")
    if axes.lines:
        axes.set_yscale("log")
    axes.set_ylabel(label)


def _numbers(values: Iterable[float | None]) -> Floats:
    """The values with NaN, which leaves a gap, for None."""
    return np.array([np.nan if value is None else value for value in values])
