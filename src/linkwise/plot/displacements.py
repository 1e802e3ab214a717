"""Displacements of masses over time with the range of neighbouring orbits, with and without sinks (paper, Figs. 2 to 5)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from linkwise.argument_types import checked
from linkwise.errors import LinkwiseError, RecordError
from linkwise.plot.palette import IDENTIFIED, MEASURED, TRUE, VISITED, scale
from linkwise.plot.style import axes_for, heading, legend_below, literal, sheet
from linkwise.simulation.envelope import OrbitEnvelope

_PANEL_HEIGHT = 1.5  # inches
_BLOCK = 10  # samples of a range drawn as one: narrower than a line


@checked
def displacement(
    envelope: OrbitEnvelope,
    mass: str,
    *,
    without: OrbitEnvelope | None = None,
    legend: bool = True,
    ax: Axes | None = None,
) -> Axes:
    """Draw the displacement of a mass after a release over time, with sinks and without them where both are given.

    Past the horizon of a chaotic motion the axes are shaded and the range of neighbouring orbits is shown: the curve is one
    of many there.

    Parameters
    ----------
    envelope : OrbitEnvelope
        What `linkwise.orbit_envelope` returned.
    mass : str
        Name of the mass.
    without : OrbitEnvelope, optional
        The motion of the same mass in the structure without its sinks, drawn beside.
    legend : bool, default True
        Add a legend to the axes.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: time in s, displacement in m, mm or um as the axis label says.

    Raises
    ------
    RecordError
        If there is no such mass.

    Examples
    --------
    >>> import linkwise as lw
    >>> motion = lw.orbit_envelope(lw.bnes_chain(2), {"v:m1": 1.0}, duration=1.0, rate=1000.0)
    >>> lw.plot.displacement(motion, "m1").get_ylabel()
    'x, mm'
    """
    for argument, given in (("envelope", envelope), ("without", without or envelope)):
        if mass not in given.masses:
            raise RecordError(f'{argument}: no mass "{mass}"; the masses are {", ".join(given.masses)}')
    shown = [envelope] if without is None else [without, envelope]
    factor, unit = scale(
        max(float(np.abs(_displacement(motion, mass)).max()) for motion in shown),
        envelope.record.unit(f"x:{mass}"),
    )
    time = envelope.record.time
    names = [("this orbit", IDENTIFIED)]
    if without is not None:
        names = [("without sinks", MEASURED), ("with sinks", IDENTIFIED)]
    with axes_for(ax, legend=legend) as axes:
        _draw_range(axes, envelope, mass, factor)
        for motion, (name, color) in zip(shown, names, strict=True):
            x = _displacement(motion, mass) * factor
            axes.plot(motion.record.time, x, color=color, linewidth=0.8, zorder=3, label=name)
        axes.set_xlim(time[0], time[-1])
        axes.set_xlabel("time, s")
        axes.set_ylabel(f"x, {unit}")
        axes.yaxis.set_major_locator(MaxNLocator(4))
    return axes


@checked
def displacements_figure(
    envelope: OrbitEnvelope,
    *,
    without: OrbitEnvelope | None = None,
    columns: int = 1,
    titles: Sequence[str] = (),
) -> Figure:
    """The displacement of every mass after a release in a panel of its own, lettered row by row.

    Parameters
    ----------
    envelope : OrbitEnvelope
        What `linkwise.orbit_envelope` returned.
    without : OrbitEnvelope, optional
        The motion without sinks, drawn beside; its masses are those that have a panel.
    columns : int, default 1
        Number of panels side by side.
    titles : sequence of str, optional
        A title for every panel. By default the names of the masses.

    Returns
    -------
    matplotlib.figure.Figure
        A figure that no window shows; `save` writes it.

    Raises
    ------
    LinkwiseError
        If there is no column, or the number of titles is not that of the panels.

    Examples
    --------
    >>> import linkwise as lw
    >>> motion = lw.orbit_envelope(lw.bnes_chain(2), {"v:m1": 1.0}, duration=1.0, rate=1000.0)
    >>> len(lw.plot.displacements_figure(motion).axes)
    2
    """
    masses = (without or envelope).masses
    if columns < 1:
        raise LinkwiseError(f"columns must be at least 1, got {columns}")
    if len(titles) not in (0, len(masses)):
        raise LinkwiseError(
            f"titles must have one entry for each of the {len(masses)} panels, got {len(titles)}"
        )
    rows = -(-len(masses) // columns)
    with sheet(rows, columns, height=0.8 + _PANEL_HEIGHT * rows) as (figure, panels):
        for number, (axes, mass) in enumerate(zip(panels, masses, strict=False)):
            displacement(envelope, mass, without=without, legend=False, ax=axes)
            letter = f"{'abcdefghijklmnopqrstuvwxyz'[number % 26]}  " if len(masses) > 1 else ""
            axes.set_title(literal(f"{letter}{(titles if len(titles) else masses)[number]}"))
            if number < len(masses) - columns:
                axes.set_xlabel("")
                axes.tick_params(labelbottom=False)
        for axes in panels[len(masses) :]:
            axes.set_visible(False)
        figure.align_ylabels()
        if len(panels[0].get_legend_handles_labels()[1]) > 1:
            legend_below(figure, panels[0], columns=4)
        if envelope.horizon is not None:
            told_apart = f"Past {envelope.horizon:.2f} s no orbit can be told apart from its neighbours"
            heading(figure, f"{told_apart}: the curve is one of many.", size=9.0)
    return figure


def _displacement(envelope: OrbitEnvelope, mass: str) -> np.ndarray:
    return envelope.record.channel(f"x:{mass}")


def _draw_range(axes: Axes, envelope: OrbitEnvelope, mass: str, factor: float) -> None:
    """Shade what lies past the horizon, and the range of neighbouring orbits there, in m times `factor`."""
    time, horizon = envelope.record.time, envelope.horizon
    if horizon is None or horizon >= time[-1]:
        return
    column = envelope.masses.index(mass)
    starts = np.arange(int(np.searchsorted(time, horizon)), len(time), _BLOCK)
    axes.axvspan(horizon, time[-1], color=VISITED, zorder=0, label="past the horizon")
    axes.fill_between(
        time[starts],
        np.minimum.reduceat(envelope.least[:, column], starts) * factor,
        np.maximum.reduceat(envelope.greatest[:, column], starts) * factor,
        color=IDENTIFIED,
        alpha=0.22,
        linewidth=0,
        zorder=1,
        label="range of neighbouring orbits",
    )
    axes.axvline(horizon, color=TRUE, linewidth=0.7, linestyle=(0, (3, 2)), zorder=4)
