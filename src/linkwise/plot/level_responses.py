"""Response functions and their coherence at every level of a test."""

from __future__ import annotations

from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from linkwise.argument_types import checked
from linkwise.inspection.levels.result import LevelComparison
from linkwise.plot.palette import SERIES
from linkwise.plot.style import axes_for, label, legend_below, literal, log_scale, sheet

_RANGE = (0.15, 1.0)  # of lightness, of the lowest and the highest level


@checked
def level_response(
    comparison: LevelComparison,
    quantity: Literal["magnitude", "coherence"] = "magnitude",
    *,
    legend: bool = True,
    ax: Axes | None = None,
) -> Axes:
    """Draw the response function of every level, or its coherence; higher levels are darker.

    Parameters
    ----------
    comparison : LevelComparison
        What `linkwise.compare_levels` returned.
    quantity : {"magnitude", "coherence"}, optional
        What is drawn.
    legend : bool, default True
        Add a legend to the axes.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: frequency in Hz, and the response per N, or a part of 1.

    Examples
    --------
    >>> import linkwise as lw
    >>> found = lw.compare_levels([lw.read_record("soft_tap.csv"), lw.read_record("hard_tap.csv")])
    >>> lw.plot.level_response(found, "coherence").get_ylabel()
    'coherence'
    """
    first = comparison.responses[0]
    with axes_for(ax, legend=legend) as axes:
        shades = np.linspace(*_RANGE, len(comparison.levels))
        for response, level, shade in zip(comparison.responses, comparison.levels, shades, strict=True):
            values = response.magnitude if quantity == "magnitude" else response.coherence
            colour = _lighter(SERIES[0], float(shade))
            axes.plot(
                response.frequency,
                values,
                color=colour,
                linewidth=0.9,
                label=label(f"{level:.3g} {comparison.unit}"),
            )
        if quantity == "magnitude":
            log_scale(axes, "y")
            axes.set_ylabel(f"{literal(first.response)}\nper {literal(first.force)}")
        else:
            axes.set_ylabel("coherence")
            axes.set_ylim(-0.03, 1.03)
        highest = max(
            response.frequency[np.isfinite(response.magnitude)].max() for response in comparison.responses
        )
        axes.set_xlim(0.0, float(highest))
        axes.set_xlabel("frequency, Hz")
    return axes


@checked
def level_responses_figure(comparison: LevelComparison) -> Figure:
    """The response function of every level, and its coherence.

    Parameters
    ----------
    comparison : LevelComparison
        What `linkwise.compare_levels` returned.

    Returns
    -------
    matplotlib.figure.Figure
        A figure that no window shows; `save` writes it.

    Examples
    --------
    >>> import linkwise as lw
    >>> found = lw.compare_levels([lw.read_record("soft_tap.csv"), lw.read_record("hard_tap.csv")])
    >>> len(lw.plot.level_responses_figure(found).axes)
    2
    """
    with sheet(2, height=4.6, share_time=True) as (figure, panels):
        level_response(comparison, "magnitude", legend=False, ax=panels[0])
        level_response(comparison, "coherence", legend=False, ax=panels[1])
        panels[0].label_outer()
        figure.align_ylabels()
        legend_below(figure, panels[0], columns=4)
    return figure


def _lighter(colour: str, share: float) -> tuple[float, float, float]:
    """From white at 0 to the colour itself at 1."""
    red, green, blue = (int(colour[k : k + 2], 16) / 255.0 for k in (1, 3, 5))
    return 1.0 - share * (1.0 - red), 1.0 - share * (1.0 - green), 1.0 - share * (1.0 - blue)
