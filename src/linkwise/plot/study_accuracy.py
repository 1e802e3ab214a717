"""Error and time of every method of a study over its structures: medians, and the spread of the seeds."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from linkwise.argument_types import checked
from linkwise.arrays import Floats
from linkwise.errors import StudyError
from linkwise.plot.palette import MEASURED, SERIES, TRUE
from linkwise.plot.style import axes_for, label, legend_below, literal, log_scale, sheet
from linkwise.study.cells import Cell, StudyTable
from linkwise.study.row import Row
from linkwise.study.summary import StudySummary

QUANTITIES = {"nmse": "NMSE of the force, %", "seconds": "time of one estimate, s"}
_KNOWN = {"ml": (SERIES[0], "o"), "weak": (SERIES[4], "^"), "physics-informed": (SERIES[2], "D")}
_OTHERS, _MARKERS = (SERIES[1], SERIES[5], SERIES[3], MEASURED), "sv<>"


@dataclass(frozen=True)
class CurveStyle:
    """How the curve of a method is drawn and what the legend calls it.

    A `faint` curve is one of several that stand behind the others: it has no marker and no spread.
    """

    label: str
    color: str
    marker: str
    faint: bool = False


@dataclass(frozen=True)
class PublishedValues:
    """Numbers that a paper prints, by structure, to stand beside those of a study; `label` says which they are."""

    label: str
    values: Mapping[str, float] = field(default_factory=dict)


@checked
def study(
    result: StudySummary | StudyTable | Iterable[Row],
    quantity: str = "nmse",
    *,
    snr_db: float | None = None,
    legend: bool = True,
    ax: Axes | None = None,
) -> Axes:
    """Draw the error, or the time, of every method of a study over its structures.

    A curve joins the medians over seeds; a band around it covers their 5 to 95 % quantiles, a failed case counting as worse
    than any answer.

    Parameters
    ----------
    result : StudySummary or StudyTable or iterable of Row
        What `linkwise.study_summary`, `linkwise.run_study` or `linkwise.read_rows` returns.
    quantity : {"nmse", "seconds"}, default "nmse"
        The error of the force in % (paper Eq. 8), or the time of one estimate in s.
    snr_db : float, optional
        The noise level in dB. By default the noisiest of the study.
    legend : bool, default True
        Add a legend to the axes.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: degrees of freedom, or names of structures where several have the same number, against % or s.

    Raises
    ------
    StudyError
        If the study has no cell, not this noise level, or there is no such quantity.

    Examples
    --------
    >>> import linkwise as lw
    >>> rows = [
    ...     lw.Row("bnes-2", 2, 20.0, "ml", seed=1, status="converged", links={"nes1": 0.2}, seconds=0.9),
    ...     lw.Row("bnes-4", 4, 20.0, "ml", seed=1, status="converged", links={"nes1": 0.3}, seconds=1.8),
    ... ]
    >>> lw.plot.study(rows).get_xlabel()
    'degrees of freedom'
    """
    table = _table(result)
    if quantity not in QUANTITIES:
        raise StudyError(f"unknown quantity {quantity!r}; choose from {', '.join(map(repr, QUANTITIES))}")
    level = table.decibels[-1] if snr_db is None else snr_db
    if level not in table.decibels:
        levels = ", ".join(f"{decibel:g}" for decibel in table.decibels)
        raise StudyError(f"no cell at {level:g} dB; choose from {levels} dB")
    with axes_for(ax, legend=legend) as axes:
        draw_curves(axes, table, level, quantity, curve_styles(table.methods))
        axes.set_title(f"{level:g} dB")
    return axes


@checked
def accuracy_figure(result: StudySummary | StudyTable | Iterable[Row]) -> Figure:
    """The error over the structures, a panel for each noise level, and the time of one estimate at the last of them.

    Parameters
    ----------
    result : StudySummary or StudyTable or iterable of Row
        What `linkwise.study_summary`, `linkwise.run_study` or `linkwise.read_rows` returned.

    Returns
    -------
    matplotlib.figure.Figure
        A figure that no window shows; `save` writes it.

    Examples
    --------
    >>> import linkwise as lw
    >>> len(lw.plot.accuracy_figure(lw.read_rows("results/mine")).axes)
    2
    """
    table = _table(result)
    count = len(table.decibels) + 1
    rows = -(-count // 2)
    with sheet(rows, 2, height=0.9 + 2.3 * rows) as (figure, panels):
        for letter, axes, decibel in zip("abcdefghijklmnopqrstuvwxyz", panels, table.decibels, strict=False):
            study(table, snr_db=decibel, legend=False, ax=axes)
            axes.set_title(f"{letter}  {decibel:g} dB")
        last = panels[count - 1]
        study(table, "seconds", snr_db=table.decibels[-1], legend=False, ax=last)
        last.set_title(f"{chr(ord('a') + count - 1)}  time of one estimate, {table.decibels[-1]:g} dB")
        for axes in panels[count:]:
            axes.set_visible(False)
        legend_below(figure, *panels[:count])
    return figure


def curve_styles(methods: Sequence[str]) -> dict[str, CurveStyle]:
    """A style for each method; linkwise's own estimators look the same in every figure, whatever stands beside them."""
    others = cycle(zip(_OTHERS, _MARKERS, strict=False))
    return {method: CurveStyle(method, *(_KNOWN.get(method) or next(others))) for method in methods}


def draw_curves(
    axes: Axes,
    table: StudyTable,
    snr_db: float,
    quantity: str,
    styles: Mapping[str, CurveStyle],
    published: PublishedValues | None = None,
) -> None:
    """Draw the medians of each method of `styles` over the structures, the spread of errors, and what a paper prints."""
    for method, style in styles.items():
        cells = [table.cell(structure, snr_db, method) for structure in table.structures]
        values = _values(cells, quantity)
        if np.isfinite(values).any():
            _draw_curve(axes, style, values)
        if quantity == "nmse" and not style.faint:
            low, high = _values(cells, "low"), _values(cells, "high")
            axes.fill_between(
                range(len(cells)), low, high, color=style.color, alpha=0.16, linewidth=0, zorder=2
            )
    if published is not None:
        _draw_published(axes, table, published)
    counts = list(table.masses.values())
    distinct = len(set(counts)) == len(counts)
    ticks = [str(count) for count in counts] if distinct else [literal(name) for name in table.structures]
    slanted: dict[str, Any] = {} if distinct else {"rotation": 25, "ha": "right", "rotation_mode": "anchor"}
    axes.set_xticks(range(len(ticks)), ticks, **slanted)
    axes.set_xlim(-0.3, len(ticks) - 0.7)
    axes.set_xlabel("degrees of freedom" if distinct else "structure")
    if axes.lines:
        log_scale(axes, "y")
    axes.set_ylabel(QUANTITIES[quantity])


def _table(result: StudySummary | StudyTable | Iterable[Row]) -> StudyTable:
    if isinstance(result, StudyTable):
        table = result
    elif isinstance(result, StudySummary):
        table = StudyTable(result.cells)
    else:
        table = StudyTable.of_rows(result)
    if not table.cells:
        raise StudyError("nothing to draw: the study has no rows")
    return table


def _draw_curve(axes: Axes, style: CurveStyle, values: Floats) -> None:
    bold: dict[str, Any] = {"marker": style.marker, "markersize": 4, "zorder": 3}
    faint: dict[str, Any] = {"linewidth": 0.6, "zorder": 1}
    axes.plot(
        range(len(values)),
        values,
        color=style.color,
        label=label(style.label),
        **(faint if style.faint else bold),
    )


def _draw_published(axes: Axes, table: StudyTable, published: PublishedValues) -> None:
    at = [index for index, structure in enumerate(table.structures) if structure in published.values]
    axes.plot(
        at,
        [published.values[table.structures[index]] for index in at],
        color=TRUE,
        linestyle=(0, (4, 2)),
        marker="s",
        markersize=5.5,
        markerfacecolor="none",
        label=published.label,
        zorder=4,
    )


def _values(cells: Iterable[Cell | None], name: str) -> Floats:
    """An attribute of the cells, with NaN, which leaves a gap, where there is none."""
    values = (None if cell is None else getattr(cell, name) for cell in cells)
    return np.array([np.nan if value is None else value for value in values])
