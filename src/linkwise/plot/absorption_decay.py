"""Primary masses with their sinks and without (paper Figs. 3 and 5)."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from linkwise.absorption.decay import TAIL
from linkwise.absorption.intervals import AbsorptionIntervals, without_intervals
from linkwise.absorption.result import Absorption
from linkwise.argument_types import checked
from linkwise.arrays import Bools
from linkwise.errors import StructureError
from linkwise.plot.downsample import envelope
from linkwise.plot.palette import CHAOS, IDENTIFIED, MEASURED, TRUE, VISITED, WELL, scale
from linkwise.plot.style import axes_for, legend_below, literal, sheet, wrap_title

_MOST = 8  # strips that one page can hold


@checked
def absorption(
    result: Absorption | AbsorptionIntervals,
    mass: str | None = None,
    *,
    legend: bool = True,
    ax: Axes | None = None,
) -> Axes:
    """Draw the excursion of a primary mass with sinks and without, each under its envelope, and when it settles.

    Parameters
    ----------
    result : Absorption or AbsorptionIntervals
        An answer of `linkwise.absorb`; one with intervals has a band around the envelope.
    mass : str, optional
        Name of a primary mass. By default the first.
    legend : bool, default True
        Add a legend to the axes.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: time in s and excursion in m, or in thousands or thousandths of it as the axis label says.

    Raises
    ------
    StructureError
        If there is no such primary mass.

    Examples
    --------
    >>> import linkwise as lw
    >>> answer = lw.absorb(lw.bnes_chain(2), duration=1.0, rate=500.0, release={"v:m1": 1.0})
    >>> lw.plot.absorption(answer, "m1").get_ylabel()
    'm1\\nmm'
    """
    plain = without_intervals(result)
    number = _mass_number(plain, mass)
    with axes_for(ax, legend=legend) as axes:
        largest = max(plain.masses[number].with_sinks.peak, plain.masses[number].without.peak)
        factor, unit = scale(largest, plain.unit(plain.masses[number].name))
        _draw_excursions(axes, plain, number, factor)
        if isinstance(result, AbsorptionIntervals):
            _draw_band(axes, result, number, factor)
        mark_chaos(axes, plain)
        axes.set_xlabel("time, s")
        axes.set_ylabel(f"{literal(plain.masses[number].name)}\n{unit}")
        axes.yaxis.set_major_locator(MaxNLocator(4))
        axes.set_xlim(plain.time[0], plain.time[-1])
        axes.set_ylim(-1.08 * largest * factor, 1.08 * largest * factor)
        wrap_title(axes, _title(plain))
    return axes


@checked
def decay_figure(result: Absorption | AbsorptionIntervals) -> Figure:
    """The primary masses, each in a strip of its own; of more than 8 the first.

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
    >>> len(lw.plot.decay_figure(result).axes)
    1
    """
    plain = without_intervals(result)
    names = [mass.name for mass in plain.masses[:_MOST]]
    with sheet(len(names), height=1.3 + 1.25 * len(names), share_time=True) as (figure, strips):
        for axes, name in zip(strips, names, strict=True):
            absorption(result, name, legend=False, ax=axes)
            axes.set_title("")
            axes.label_outer()
        hidden = len(plain.masses) - len(names)
        more = f" ({hidden} more masses not shown)" if hidden else ""
        wrap_title(strips[0], _title(plain) + more)
        figure.align_ylabels()
        legend_below(figure, *strips)
    return figure


def mark_chaos(axes: Axes, result: Absorption, *, shaded: bool = True) -> None:
    """Mark from when on the motion with sinks is one of many."""
    horizon = result.with_sinks.horizon
    if horizon is None:
        return
    axes.axvline(horizon, color=TRUE, linewidth=0.8, linestyle=":", label="chaos: one motion of many")
    if shaded:
        axes.axvspan(horizon, result.time[-1], color=CHAOS, zorder=-1)


def _title(result: Absorption) -> str:
    name = result.with_sinks.structure.name
    return (
        f"{name}, sinks {result.removal} for comparison" if name else f"Sinks {result.removal} for comparison"
    )


def _mass_number(result: Absorption, mass: str | None) -> int:
    names = [change.name for change in result.masses]
    if mass is not None and mass not in names:
        raise StructureError(f"unknown primary mass {mass!r}; choose from {', '.join(names)}")
    return 0 if mass is None else names.index(mass)


def _draw_excursions(axes: Axes, result: Absorption, number: int, factor: float) -> None:
    mass = result.masses[number]
    runs = (
        (result.without, mass.without, MEASURED, "without sinks"),
        (result.with_sinks, mass.with_sinks, IDENTIFIED, "with sinks"),
    )
    for run, decay, color, text in runs:
        x = run.displacement(mass.name) - decay.rest
        axes.plot(*envelope(result.time, x * factor), color=color, linewidth=0.7, label=text)
    before_tail = _before_tail(result)
    for (run, _, _, text), (line, shade) in zip(runs, (("--", "#555555"), ("-", TRUE)), strict=True):
        bound = run.envelope[before_tail, number] * factor
        axes.plot(result.time[before_tail], bound, line, color=shade, linewidth=0.9, label=f"envelope {text}")
    level = mass.level * factor
    axes.axhspan(-level, level, color=VISITED, zorder=0, label=f"settled: {100 * result.settle:g} %")
    if mass.with_sinks.settled is not None:
        axes.axvline(mass.with_sinks.settled, color=WELL, linewidth=1.0, label="settled with sinks")


def _draw_band(axes: Axes, result: AbsorptionIntervals, number: int, factor: float) -> None:
    before_tail = _before_tail(result.absorption)
    axes.fill_between(
        result.absorption.time[before_tail],
        result.lower[before_tail, number] * factor,
        result.upper[before_tail, number] * factor,
        color=WELL,
        alpha=0.35,
        linewidth=0,
        zorder=3,
        label="envelope, 95 % of draws",
    )


def _before_tail(result: Absorption) -> Bools:
    """Samples after which enough is to come for an envelope."""
    start, end = result.time[0], result.time[-1]
    return np.asarray(result.time <= end - TAIL * (end - start))
