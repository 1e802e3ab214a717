"""How sinks cross from well to well."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from linkwise.absorption.intervals import AbsorptionIntervals, without_intervals
from linkwise.absorption.result import Absorption
from linkwise.argument_types import checked
from linkwise.errors import StructureError
from linkwise.plot.absorption_decay import mark_chaos
from linkwise.plot.downsample import envelope
from linkwise.plot.palette import IDENTIFIED, TRUE, WELL, scale
from linkwise.plot.style import axes_for, legend_below, literal, sheet

_MOST = 8  # strips that one page can hold


@checked
def crossings(
    result: Absorption | AbsorptionIntervals,
    sink: str | None = None,
    *,
    legend: bool = True,
    ax: Axes | None = None,
) -> Axes:
    """Draw the elongation of a sink over time, the tops between its wells, and its passages over them.

    Parameters
    ----------
    result : Absorption or AbsorptionIntervals
        An answer of `linkwise.absorb`.
    sink : str, optional
        Name of the link that is the sink. By default the first.
    legend : bool, default True
        Add a legend to the axes.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: time in s and elongation in m, or in thousands or thousandths of it as the axis label says.

    Raises
    ------
    StructureError
        If there is no such sink.

    Examples
    --------
    >>> import linkwise as lw
    >>> answer = lw.absorb(lw.bnes_chain(2), duration=1.0, rate=500.0, release={"v:m1": 1.0})
    >>> lw.plot.crossings(answer, "nes1").get_xlabel()
    'time, s'
    """
    plain = without_intervals(result)
    names = [entry.sink.link for entry in plain.sinks]
    if sink is not None and sink not in names:
        raise StructureError(f"unknown sink {sink!r}; choose from {', '.join(names)}")
    shown = plain.sinks[0 if sink is None else names.index(sink)]
    law = plain.with_sinks.structure.link(shown.sink.link).law
    with axes_for(ax, legend=legend) as axes:
        factor, unit = scale(float(np.abs(shown.elongation).max()), law.motion_units[0])
        time, elongation = envelope(plain.time, shown.elongation * factor)
        axes.plot(time, elongation, color=IDENTIFIED, linewidth=0.7, label="elongation")
        for top in shown.tops:
            axes.axhline(top * factor, color=TRUE, linewidth=0.6, linestyle=":", label="top between wells")
        if len(shown.crossings):
            axes.plot(
                shown.crossings,
                np.full(len(shown.crossings), 0.97),
                "|",
                color=WELL,
                markersize=7,
                transform=axes.get_xaxis_transform(),
                label="crossing",
            )
        mark_chaos(axes, plain)
        count = f"{len(shown.crossings)} crossings" if shown.tops else "one well"
        axes.set_title(literal(f"{shown.sink.link}: {count}"))
        axes.set_xlabel("time, s")
        axes.set_ylabel(unit)
        axes.yaxis.set_major_locator(MaxNLocator(4))
        axes.set_xlim(plain.time[0], plain.time[-1])
    return axes


@checked
def crossings_figure(result: Absorption | AbsorptionIntervals) -> Figure:
    """The sinks, each in a strip of its own; of more than 8 the first.

    Parameters
    ----------
    result : Absorption or AbsorptionIntervals
        What `linkwise.absorb` or `linkwise.absorption_intervals` returned.

    Returns
    -------
    matplotlib.figure.Figure
        A figure that no window shows; `save` writes it.

    Examples
    --------
    >>> import linkwise as lw
    >>> result = lw.absorb(lw.bnes_chain(2), duration=1.0, rate=500.0, release={"v:m1": 1.0})
    >>> len(lw.plot.crossings_figure(result).axes)
    1
    """
    names = [entry.sink.link for entry in without_intervals(result).sinks[:_MOST]]
    with sheet(len(names), height=1.2 + 1.3 * len(names), share_time=True) as (figure, strips):
        for axes, name in zip(strips, names, strict=True):
            crossings(result, name, legend=False, ax=axes)
            axes.label_outer()
        figure.align_ylabels()
        legend_below(figure, *strips)
    return figure
