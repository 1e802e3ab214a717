"""Displacements over time: every mass in its panel, or the same mass with and without its sinks (paper, Figs. 2 to 5)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from linkwise.plot.palette import IDENTIFIED, MEASURED, TRUE, VISITED, scale
from linkwise.plot.style import legend_below, literal, sheet
from linkwise.simulation.envelope import OrbitEnvelope

_PANEL_HEIGHT = 1.45  # inches
_BLOCK = 10  # samples of a range drawn as one: narrower than a line


def responses_figure(motion: OrbitEnvelope, *, columns: int = 1, titles: Sequence[str] = ()) -> Figure:
    """The displacement of every mass in a panel of its own, lettered row by row; `titles` name them, else the masses do.

    Past the horizon a panel is shaded and the range of neighbouring orbits shown: the curve is one of many there.
    """
    masses = motion.masses
    titles = titles or masses
    rows = -(-len(masses) // columns)
    with sheet(rows, columns, height=0.7 + _PANEL_HEIGHT * rows) as (figure, panels):
        for number, (axes, mass) in enumerate(zip(panels, masses, strict=False)):
            factor = _draw_range(axes, motion, mass)
            _draw_record(axes, motion, mass, factor, color=IDENTIFIED, label="this orbit")
            axes.set_title(literal(f"{_letter(number)}  {titles[number]}"))
        _finish(figure, panels, len(masses), columns, motion)
    return figure


def comparison_figure(
    motion: OrbitEnvelope, without: OrbitEnvelope, *, columns: int = 1, titles: Sequence[str] = ()
) -> Figure:
    """The masses of `without`, as they move with their sinks (`motion`) and without them, each in a panel of its own."""
    masses = without.masses
    titles = titles or masses
    rows = -(-len(masses) // columns)
    with sheet(rows, columns, height=0.9 + (_PANEL_HEIGHT + 0.15) * rows) as (figure, panels):
        for number, (axes, mass) in enumerate(zip(panels, masses, strict=False)):
            factor = _draw_range(axes, motion, mass, also=without)
            _draw_record(axes, without, mass, factor, color=MEASURED, label="without sinks")
            _draw_record(axes, motion, mass, factor, color=IDENTIFIED, label="with sinks")
            lettered = f"{_letter(number)}  " if len(masses) > 1 else ""
            axes.set_title(literal(f"{lettered}{titles[number]}"))
        _finish(figure, panels, len(masses), columns, motion)
    return figure


def _draw_range(axes: Axes, motion: OrbitEnvelope, mass: str, also: OrbitEnvelope | None = None) -> float:
    """Shade what lies past the horizon; returns the factor from m to the unit that the axes are labelled with."""
    column = motion.masses.index(mass)
    largest = float(np.abs(motion.record.channel(f"x:{mass}")).max())
    if also is not None:
        largest = max(largest, float(np.abs(also.record.channel(f"x:{mass}")).max()))
    factor, unit = scale(largest, "m")
    axes.set_ylabel(f"x, {unit}")
    time = motion.record.time
    if motion.horizon is not None and motion.horizon < time[-1]:
        starts = np.arange(int(np.searchsorted(time, motion.horizon)), len(time), _BLOCK)
        axes.axvspan(motion.horizon, time[-1], color=VISITED, zorder=0, label="past the horizon")
        axes.fill_between(
            time[starts],
            np.minimum.reduceat(motion.least[:, column], starts) * factor,
            np.maximum.reduceat(motion.greatest[:, column], starts) * factor,
            color=IDENTIFIED,
            alpha=0.22,
            linewidth=0,
            zorder=1,
            label="range of neighbouring orbits",
        )
        axes.axvline(motion.horizon, color=TRUE, linewidth=0.7, linestyle=(0, (3, 2)), zorder=4)
    return factor


def _draw_record(
    axes: Axes, motion: OrbitEnvelope, mass: str, factor: float, *, color: str, label: str
) -> None:
    axes.plot(
        motion.record.time,
        motion.record.channel(f"x:{mass}") * factor,
        color=color,
        linewidth=0.8,
        zorder=3,
        label=label,
    )


def _letter(number: int) -> str:
    return "abcdefghijklmnopqrstuvwxyz"[number % 26]


def _finish(figure: Figure, panels: list[Axes], count: int, columns: int, motion: OrbitEnvelope) -> None:
    time = motion.record.time
    for number, axes in enumerate(panels):
        axes.set_visible(number < count)
        axes.set_xlim(time[0], time[-1])
        axes.yaxis.set_major_locator(MaxNLocator(4))
        if number >= count - columns:
            axes.set_xlabel("time, s")
        else:
            axes.tick_params(labelbottom=False)
    figure.align_ylabels()
    if len(panels[0].get_legend_handles_labels()[1]) > 1:
        legend_below(figure, panels[0], columns=4)
    if motion.horizon is not None:
        figure.suptitle(
            f"Past {motion.horizon:.2f} s no orbit can be told apart from its neighbours: the curve is one of many.",
            x=0.01,
            horizontalalignment="left",
            fontsize=9,
        )
