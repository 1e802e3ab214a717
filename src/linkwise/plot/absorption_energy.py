"""Where the energy of a structure with sinks goes."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from linkwise.absorption.intervals import AbsorptionIntervals, without_intervals
from linkwise.absorption.result import Absorption
from linkwise.argument_types import checked
from linkwise.plot.absorption_decay import mark_chaos
from linkwise.plot.palette import SERIES
from linkwise.plot.style import axes_for, label, legend_below, literal, sheet

_SINKS, _OTHERS = 5, 4  # bands of links that can be told apart
_GREYS = ("#404040", "#6E6E6E", "#939393", "#B4B4B4", "#C8C8C8")
_PALE = "#EBEBEB"
_POINTS = 1500  # of a band


@checked
def energy(
    result: Absorption | AbsorptionIntervals,
    *,
    with_sinks: bool = True,
    legend: bool = True,
    ax: Axes | None = None,
) -> Axes:
    """Draw where the energy went: what each link has dissipated and what is still there, over time.

    Sinks lie below in colours, the other links above them in greys, what is left on top.

    Parameters
    ----------
    result : Absorption or AbsorptionIntervals
        An answer of `linkwise.absorb`.
    with_sinks : bool, default True
        Draw the run with the sinks, or the one without them.
    legend : bool, default True
        Add a legend to the axes.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: time in s, and parts of the energy put in, in %.

    Examples
    --------
    >>> import linkwise as lw
    >>> answer = lw.absorb(lw.bnes_chain(2), duration=1.0, rate=500.0, release={"v:m1": 1.0})
    >>> lw.plot.energy(answer).get_ylabel()
    'share of the energy put in, %'
    """
    plain = without_intervals(result)
    with axes_for(ax, legend=legend) as axes:
        _draw_bands(axes, plain, with_sinks=with_sinks)
        if with_sinks:
            mark_chaos(axes, plain, shaded=False)
        axes.set_title("with sinks" if with_sinks else literal(f"sinks {plain.removal}"))
        axes.set_xlabel("time, s")
        axes.set_ylabel("share of the energy put in, %")
    return axes


@checked
def energy_figure(result: Absorption | AbsorptionIntervals) -> Figure:
    """Where the energy went with the sinks and, beside it, without them.

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
    >>> len(lw.plot.energy_figure(result).axes)
    2
    """
    with sheet(columns=2, height=3.4) as (figure, panels):
        energy(result, legend=False, ax=panels[0])
        energy(result, with_sinks=False, legend=False, ax=panels[1])
        panels[1].set_ylabel("")
        panels[1].tick_params(labelleft=False)
        legend_below(figure, *panels, columns=4)
    return figure


def _draw_bands(axes: Axes, result: Absorption, *, with_sinks: bool) -> None:
    """Sinks from below, then the other links, then what is left."""
    run = result.with_sinks if with_sinks else result.without
    remaining = 100.0 * run.remaining
    shares = {name: 100.0 * energy / run.total for name, energy in run.dissipated_by.items()}
    colors = {name: color for name, color in _colors(result).items() if name in shares}
    bands = [shares[name] for name in colors]
    labels = [label(name) for name in colors]
    others = [share for name, share in shares.items() if name not in colors]
    if others and float(sum(share[-1] for share in others)) > 0.0:
        bands.append(np.sum(others, axis=0))
        labels.append("other links")
    thin = slice(None, None, max(1, len(result.time) // _POINTS))
    axes.stackplot(
        result.time[thin],
        *(band[thin] for band in [*bands, remaining]),
        labels=[*labels, "still there"],
        colors=[*colors.values(), *[_GREYS[-1]] * (len(labels) - len(colors)), _PALE],
        linewidth=0.0,
    )
    axes.set_xlim(result.time[0], result.time[-1])
    axes.set_ylim(0.0, max(100.0, float((sum(shares.values()) + remaining).max())))
    axes.grid(False)


def _colors(result: Absorption) -> dict[str, str]:
    """The links and hosts with a band of their own in both runs: sinks in the colours of the series, the others in greys."""
    run = result.with_sinks
    names = list(run.dissipated_by)
    by_share = sorted(names, key=lambda name: -run.share(name))
    largest = [name for name in by_share if name in result.absorbing][:_SINKS]
    largest += [name for name in by_share if name not in result.absorbing][:_OTHERS]
    sinks, others = iter(SERIES), iter(_GREYS)
    ordered = sorted(
        (name for name in names if name in largest), key=lambda name: name not in result.absorbing
    )
    return {name: next(sinks) if name in result.absorbing else next(others) for name in ordered}
