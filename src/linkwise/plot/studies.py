"""What a study found: errors and times of every method, and how often methods have exactly the true links and terms."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from itertools import cycle
from string import ascii_lowercase
from typing import Any, Unpack

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from linkwise.arrays import Floats
from linkwise.errors import StudyError, require_known
from linkwise.plot.style import (
    MEASURED,
    SERIES,
    WELL,
    On,
    axes_for,
    label,
    literal,
    log_scale,
    picture,
    pictures,
    sheet,
)
from linkwise.study.subject import Row
from linkwise.study.summary import Cell, StudySummary, SuccessMap

QUANTITIES = {"nmse": "NMSE of the force, %", "seconds": "time of one estimate, s"}
_KNOWN = {"ml": (SERIES[0], "o"), "weak": (SERIES[4], "^"), "physics-informed": (SERIES[2], "D")}
_OTHERS, _MARKERS = (SERIES[1], SERIES[5], SERIES[3], MEASURED), "sv<>"


CurveStyle = Mapping[str, Any]
"""How the curve of a method is drawn, as keywords of `Axes.plot`; without a marker it stands behind others, with no spread."""


@picture()
def study(
    axes: Axes,
    result: StudySummary | Iterable[Row],
    quantity: str = "nmse",
    *,
    snr_db: float | None = None,
    **on: Unpack[On],
) -> None:
    """Draw the error, or the time, of every method of a study over its structures.

    A curve joins the medians over seeds; a band around it covers their 5 to 95 % quantiles, a failed case counting as worse
    than any answer.

    Parameters
    ----------
    result : StudySummary or iterable of Row
        What `linkwise.study.study_summary`, `linkwise.study.run_study` or `linkwise.study.read_rows` returns.
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
    ...     lw.study.Row("bnes-2", 2, 20.0, "ml", seed=1, status="converged", links={"nes1": 0.2}, seconds=0.9),
    ...     lw.study.Row("bnes-4", 4, 20.0, "ml", seed=1, status="converged", links={"nes1": 0.3}, seconds=1.8),
    ... ]
    >>> lw.plot.study(rows).get_xlabel()
    'degrees of freedom'
    """
    table = _summary_of(result)
    require_known("quantity", quantity, QUANTITIES, StudyError)
    level = table.decibels[-1] if snr_db is None else snr_db
    if level not in table.decibels:
        levels = ", ".join(f"{decibel:g}" for decibel in table.decibels)
        raise StudyError(f"no cell at {level:g} dB; choose from {levels} dB")
    draw_curves(axes, table, level, quantity, curve_styles(table.methods))
    axes.set_title(f"{level:g} dB")


def accuracy_figure(result: StudySummary | Iterable[Row]) -> Figure:
    """The error over the structures, a panel for each noise level, and the time of one estimate at the last of them."""
    table = _summary_of(result)
    shown = [("nmse", level, f"{level:g} dB") for level in table.decibels]
    shown.append(("seconds", table.decibels[-1], f"time of one estimate, {table.decibels[-1]:g} dB"))
    draws = [partial(study, table, quantity, snr_db=level) for quantity, level, _ in shown]
    titles = [f"{letter}  {title}" for letter, (*_, title) in zip(ascii_lowercase, shown, strict=False)]
    return pictures(draws, height=(0.9, 2.3), titles=titles)


def curve_styles(methods: Sequence[str]) -> dict[str, CurveStyle]:
    """A style for each method; linkwise's own estimators look the same in every figure, whatever stands beside them."""
    others = cycle(zip(_OTHERS, _MARKERS, strict=False))
    looks = {method: _KNOWN.get(method) or next(others) for method in methods}
    return {
        method: {"label": label(method), "color": color, "marker": marker, "ms": 4, "zorder": 3}
        for method, (color, marker) in looks.items()
    }


def draw_curves(
    axes: Axes, table: StudySummary, snr_db: float, quantity: str, styles: Mapping[str, CurveStyle]
) -> None:
    """Draw the medians of each method of `styles` over the structures, and the spread of errors."""
    for method, style in styles.items():
        cells = [table.cell(structure, snr_db, method) for structure in table.structures]
        values = _cell_values(cells, quantity)
        if np.isfinite(values).any():
            axes.plot(range(len(values)), values, **style)
        if quantity == "nmse" and "marker" in style:
            low, high = _cell_values(cells, "low"), _cell_values(cells, "high")
            axes.fill_between(range(len(cells)), low, high, color=style["color"], alpha=0.16, lw=0, zorder=2)
    counts = list(table.masses.values())
    distinct = len(set(counts)) == len(counts)
    ticks = [str(count) for count in counts] if distinct else [literal(name) for name in table.structures]
    slanted: dict[str, Any] = {} if distinct else {"rotation": 25, "ha": "right", "rotation_mode": "anchor"}
    axes.set_xticks(range(len(ticks)), ticks, **slanted)
    axes.set(xlim=(-0.3, len(ticks) - 0.7), xlabel="degrees of freedom" if distinct else "structure")
    if axes.lines:
        log_scale(axes, "y")
    axes.set_ylabel(QUANTITIES[quantity])


def _summary_of(result: StudySummary | Iterable[Row]) -> StudySummary:
    table = result if isinstance(result, StudySummary) else StudySummary.of_rows(result)
    if not table.cells:
        raise StudyError("nothing to draw: the study has no rows")
    return table


def _cell_values(cells: Iterable[Cell | None], name: str) -> Floats:
    """An attribute of the cells, with NaN, which leaves a gap, where there is none."""
    values = (None if cell is None else getattr(cell, name) for cell in cells)
    return np.array([np.nan if value is None else value for value in values])


_DARKEST = 1.6  # share that would have the darkest colour, so that black numbers are read on all
_NUMBER_SIZE, _SMALL_SIZE = 6.5, 5.5  # points
_NUMBERS = "per cent that have all true\nterms and no other; below it\nthe per cent trusted but wrong"
_CELL, _ROW = 0.26, 0.4  # inches that a line of cells takes, and what stands around those of a panel


def success_map(result: SuccessMap, *, ax: Axes | None = None) -> Axes:
    """Draw how often a method has the true terms over noise and samples a period.

    Parameters
    ----------
    result : SuccessMap
        One of those of `linkwise.study.success_maps`.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: signal-to-noise ratio in dB against samples a period (Hz where no frequency is stated), one cell
        each. A cell has the per cent of cases with exactly the true terms, and below it in red, where there are any, the per
        cent that are trusted though a term is missing or extra; it is empty where no case was run.

    Examples
    --------
    >>> import linkwise as lw
    >>> import numpy as np
    >>> one, decibels, rates = np.array([[1]]), np.array([20.0]), np.array([100.0])
    >>> result = lw.study.SuccessMap("chain", "discover", decibels, rates, 10.0, one, one, 0 * one, 0 * one)
    >>> lw.plot.success_map(result).get_ylabel()
    'samples a period'
    """
    with axes_for(ax, width=3.2, height=2.2) as axes:
        share = result.exact_share
        look: dict[str, Any] = {"cmap": "Blues", "edgecolors": "white", "lw": 1.0}
        axes.pcolormesh(np.ma.masked_invalid(share), vmin=0.0, vmax=_DARKEST, **look)
        for (row, column), value in np.ndenumerate(share):
            if np.isfinite(value):
                wrong = float(result.wrong_trusted_share[row, column])
                _write_shares(axes, row, column, 100.0 * float(value), 100.0 * wrong)
        axes.set_xticks(np.arange(len(result.snr_db)) + 0.5, [f"{level:g}" for level in result.snr_db])
        samples = [f"{float(f'{count:.3g}'):g}" for count in result.samples]
        axes.set_yticks(np.arange(len(samples)) + 0.5, samples)
        axes.grid(False)
        axes.tick_params(length=0)
        axes.spines[:].set_visible(False)
        axes.set_xlabel("signal-to-noise ratio, dB")
        axes.set_ylabel("sampling rate, Hz" if result.frequency is None else "samples a period")
        axes.set_title(literal(f"{result.name}: {result.method}"))
    return axes


def success_figure(results: Sequence[SuccessMap]) -> Figure:
    """A row of panels for each structure and length of the records, a panel for each method."""
    methods = list(dict.fromkeys(result.method for result in results))
    lines = [results[start : start + len(methods)] for start in range(0, len(results), len(methods))]
    height = 1.2 + sum(_ROW + _CELL * len(line[0].rates) for line in lines)
    width = 0.8 + 2.2 * len(methods)
    with sheet(len(lines), len(methods), width=width, height=height, share_time=True) as (figure, panels):
        for number, (axes, result) in enumerate(zip(panels, results, strict=True)):
            row, column = divmod(number, len(methods))
            success_map(result, ax=axes)
            name = "" if column else result.name
            axes.set_title(literal(name if row else f"{result.method}\n{name}"))
            if row < len(lines) - 1:
                axes.set_xlabel("")
            elif not column:
                axes.set_xlabel(f"{axes.get_xlabel()}\n{_NUMBERS}")
            if column:
                axes.set_ylabel("")
                axes.tick_params(labelleft=False)
    return figure


def _write_shares(axes: Axes, row: int, column: int, exact: float, wrong: float) -> None:
    """The per cent in a cell, and below it in red those that are wrong and trusted."""
    across, up = column + 0.5, row + (0.68 if wrong > 0.0 else 0.5)
    axes.text(across, up, f"{exact:.0f}", fontsize=_NUMBER_SIZE, ha="center", va="center")
    if wrong > 0.0:
        style: dict[str, Any] = {"fontsize": _SMALL_SIZE, "color": WELL, "ha": "center", "va": "center"}
        axes.text(across, row + 0.24, f"{wrong:.0f}", **style)
