"""Frequency and damping of modes over their amplitude as they ring down."""

from __future__ import annotations

from typing import Literal

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from linkwise.argument_types import checked
from linkwise.inspection.levels.result import LevelComparison
from linkwise.inspection.levels.text import ring_name
from linkwise.plot.palette import SERIES
from linkwise.plot.style import axes_for, label, literal, log_scale, sheet


@checked
def ring_down(
    comparison: LevelComparison,
    quantity: Literal["frequency", "damping"] = "frequency",
    *,
    number: int = 0,
    legend: bool = True,
    ax: Axes | None = None,
) -> Axes:
    """Draw the frequency or the damping of a mode over its amplitude as it rings down, with two standard errors either way.

    Parameters
    ----------
    comparison : LevelComparison
        What `linkwise.compare_levels` returned.
    quantity : {"frequency", "damping"}, optional
        What is drawn.
    number : int, default 0
        Place of the mode in ``comparison.ring_downs``.
    legend : bool, default True
        Add a legend to the axes, which names the mode.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: amplitude in the unit of its channel, and Hz or %.

    Examples
    --------
    >>> import linkwise as lw
    >>> found = lw.compare_levels([lw.read_record("soft_tap.csv"), lw.read_record("hard_tap.csv")])
    >>> lw.plot.ring_down(found).get_ylabel()
    'frequency, Hz'
    """
    ring = comparison.ring_downs[number]
    values, errors = ring.frequency, ring.frequency_error
    if quantity == "damping":
        values, errors = 100.0 * ring.damping, 100.0 * ring.damping_error
    with axes_for(ax, legend=legend) as axes:
        axes.errorbar(
            ring.amplitude,
            values,
            2.0 * errors,
            fmt=".",
            color=SERIES[(ring.mode - 1) % len(SERIES)],
            elinewidth=0.8,
            label=label(ring_name(ring)),
        )
        log_scale(axes, "x")
        axes.ticklabel_format(axis="y", useOffset=False)
        axes.set_xlabel(f"amplitude of {literal(ring.channel)}, {ring.unit}")
        axes.set_ylabel("frequency, Hz" if quantity == "frequency" else "damping, %")
    return axes


@checked
def ring_down_figure(comparison: LevelComparison) -> Figure:
    """Frequency and damping of each mode that rings down over its amplitude, in a row of its own.

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
    >>> len(lw.plot.ring_down_figure(found).axes)
    2
    """
    rows = len(comparison.ring_downs)
    with sheet(rows, 2, height=0.6 + 1.9 * rows) as (figure, panels):
        for number, ring in enumerate(comparison.ring_downs):
            ring_down(comparison, "frequency", number=number, legend=False, ax=panels[2 * number])
            ring_down(comparison, "damping", number=number, legend=False, ax=panels[2 * number + 1])
            panels[2 * number].set_title(ring_name(ring), loc="left")
    return figure
