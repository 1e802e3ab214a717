"""Odd and even distortion over the level of a periodic test."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from linkwise.argument_types import checked
from linkwise.inspection.levels.result import LevelComparison
from linkwise.plot.palette import MEASURED, SERIES
from linkwise.plot.style import axes_for, legend_below, literal, log_scale, sheet


@checked
def distortion(comparison: LevelComparison, *, legend: bool = True, ax: Axes | None = None) -> Axes:
    """Draw odd and even distortion, and the scatter of periods, over the level of a periodic force.

    Parameters
    ----------
    comparison : LevelComparison
        What `linkwise.compare_levels` returned.
    legend : bool, default True
        Add a legend to the axes.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: force in N, and power over that of the response in dB. Levels without a period are left out.

    Examples
    --------
    >>> import linkwise as lw
    >>> found = lw.compare_levels([lw.read_record("soft_sine.csv"), lw.read_record("hard_sine.csv")], modes=1)
    >>> [line.get_label() for line in lw.plot.distortion(found).lines]
    ['odd', 'even', 'scatter']
    """
    kinds = (("odd", SERIES[1], "s"), ("even", SERIES[0], "o"), ("noise", MEASURED, "x"))
    with axes_for(ax, legend=legend) as axes:
        for name, colour, marker in kinds:
            points = [
                (level, getattr(level_distortion, name))
                for level, level_distortion in zip(comparison.levels, comparison.distortions, strict=True)
                if level_distortion is not None and getattr(level_distortion, name) is not None
            ]
            text = "scatter" if name == "noise" else name
            if points:
                levels, powers = np.array(points).T
                axes.plot(
                    levels, powers, color=colour, marker=marker, markersize=4, linewidth=1.0, label=text
                )
        log_scale(axes, "x")
        axes.set_xlabel(literal(comparison.level_name))
        axes.set_ylabel(f"power over that of {literal(comparison.responses[0].response)}, dB")
    return axes


@checked
def distortion_figure(comparison: LevelComparison) -> Figure:
    """Odd and even distortion, and the scatter of periods, over the level on a figure of its own.

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
    >>> found = lw.compare_levels([lw.read_record("soft_sine.csv"), lw.read_record("hard_sine.csv")], modes=1)
    >>> len(lw.plot.distortion_figure(found).axes)
    1
    """
    with sheet() as (figure, [axes]):
        distortion(comparison, legend=False, ax=axes)
        legend_below(figure, axes)
    return figure
