"""Frequencies and damping of modes over the level of a test."""

from __future__ import annotations

from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from linkwise.argument_types import checked
from linkwise.inspection.levels.result import LevelComparison
from linkwise.plot.palette import SERIES
from linkwise.plot.style import axes_for, label, legend_below, literal, log_scale, sheet


@checked
def level_modes(
    comparison: LevelComparison,
    quantity: Literal["frequency", "damping"] = "frequency",
    *,
    legend: bool = True,
    ax: Axes | None = None,
) -> Axes:
    """Draw how the frequencies or the damping of modes move with the level, with two standard errors either way.

    Parameters
    ----------
    comparison : LevelComparison
        What `linkwise.compare_levels` returned.
    quantity : {"frequency", "damping"}, optional
        What is drawn.
    legend : bool, default True
        Add a legend to the axes.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: peak of the force or the motion, change of the frequency in %, or damping in % of critical.

    Examples
    --------
    >>> import linkwise as lw
    >>> found = lw.compare_levels([lw.read_record("soft_tap.csv"), lw.read_record("hard_tap.csv")])
    >>> lw.plot.level_modes(found).get_ylabel()
    'change of frequency, %'
    """
    values, errors = 100.0 * comparison.damping, 100.0 * comparison.damping_errors
    if quantity == "frequency":
        values = 100.0 * comparison.frequency_changes
        errors = 100.0 * comparison.frequency_errors / comparison.frequencies[0]
    values = np.where(comparison.lost, np.nan, values)
    with axes_for(ax, legend=legend) as axes:
        for mode in range(values.shape[1]):
            axes.errorbar(
                comparison.levels,
                values[:, mode],
                2.0 * errors[:, mode],
                color=SERIES[mode % len(SERIES)],
                marker="o",
                markersize=3.5,
                linewidth=1.0,
                capsize=2.0,
                label=label(f"mode {mode + 1}, {comparison.frequencies[0, mode]:.4g} Hz"),
            )
        log_scale(axes, "x")
        axes.set_xlabel(literal(comparison.level_name))
        axes.set_ylabel("change of frequency, %" if quantity == "frequency" else "damping, % of critical")
    return axes


@checked
def levels_figure(comparison: LevelComparison) -> Figure:
    """Changes of frequencies and damping of modes over the level.

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
    >>> len(lw.plot.levels_figure(found).axes)
    2
    """
    with sheet(1, 2, height=3.2) as (figure, panels):
        level_modes(comparison, "frequency", legend=False, ax=panels[0])
        level_modes(comparison, "damping", legend=False, ax=panels[1])
        legend_below(figure, panels[0])
    return figure
