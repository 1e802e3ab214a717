"""Success maps: how often methods of a study have exactly the true links and terms."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from linkwise.argument_types import checked
from linkwise.errors import StudyError
from linkwise.plot.palette import WELL
from linkwise.plot.style import axes_for, literal, sheet
from linkwise.study.success_map import SuccessMap

_DARKEST = 1.6  # share that would have the darkest colour, so that black numbers are read on all
_NUMBER_SIZE, _SMALL_SIZE = 6.5, 5.5  # points
_NUMBERS = "per cent that have all true\nterms and no other; below it\nthe per cent trusted but wrong"
_CELL, _ROW = 0.26, 0.4  # inches that a line of cells takes, and what stands around those of a panel


@checked
def success_map(result: SuccessMap, *, ax: Axes | None = None) -> Axes:
    """Draw how often a method has the true terms over noise and samples a period.

    Parameters
    ----------
    result : SuccessMap
        One of those of `linkwise.success_maps`.
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
    >>> one = np.array([[1]])
    >>> result = lw.SuccessMap("chain", "discover", np.array([20.0]), np.array([100.0]), 10.0, one, one, 0 * one, 0 * one)
    >>> lw.plot.success_map(result).get_ylabel()
    'samples a period'
    """
    with axes_for(ax, width=3.2, height=2.2) as axes:
        share = result.exact_share
        axes.pcolormesh(
            np.ma.masked_invalid(share),
            cmap="Blues",
            vmin=0.0,
            vmax=_DARKEST,
            edgecolors="white",
            linewidth=1.0,
        )
        for (row, column), value in np.ndenumerate(share):
            if np.isfinite(value):
                wrong = float(result.wrong_trusted_share[row, column])
                _write(axes, row, column, 100.0 * float(value), 100.0 * wrong)
        axes.set_xticks(np.arange(len(result.snr_db)) + 0.5, [f"{level:g}" for level in result.snr_db])
        axes.set_yticks(np.arange(len(result.rates)) + 0.5, [f"{count:.3g}" for count in result.samples])
        axes.grid(False)
        axes.tick_params(length=0)
        axes.spines[:].set_visible(False)
        axes.set_xlabel("signal-to-noise ratio, dB")
        axes.set_ylabel("sampling rate, Hz" if result.frequency is None else "samples a period")
        axes.set_title(literal(f"{result.name}: {result.method}"))
    return axes


@checked
def success_figure(results: Sequence[SuccessMap]) -> Figure:
    """A row of panels for each structure and length of the records, a panel for each method.

    Parameters
    ----------
    results : sequence of SuccessMap
        What `linkwise.success_maps` returned.

    Returns
    -------
    matplotlib.figure.Figure
        A figure that no window shows; `save` writes it.

    Raises
    ------
    StudyError
        If there is no map.

    Examples
    --------
    >>> import linkwise as lw
    >>> import numpy as np
    >>> one = np.array([[1]])
    >>> result = lw.SuccessMap("chain", "discover", np.array([20.0]), np.array([100.0]), 10.0, one, one, 0 * one, 0 * one)
    >>> len(lw.plot.success_figure([result]).axes)
    1
    """
    if not results:
        raise StudyError("nothing to draw: no method of the study looks for terms, or no case of one was run")
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


def _write(axes: Axes, row: int, column: int, exact: float, wrong: float) -> None:
    """The per cent in a cell, and below it in red those that are wrong and trusted."""
    across, up = column + 0.5, row + (0.68 if wrong > 0.0 else 0.5)
    axes.text(across, up, f"{exact:.0f}", fontsize=_NUMBER_SIZE, ha="center", va="center")
    if wrong > 0.0:
        axes.text(
            across, row + 0.24, f"{wrong:.0f}", fontsize=_SMALL_SIZE, color=WELL, ha="center", va="center"
        )
