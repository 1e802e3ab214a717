"""How the terms of a discovery were chosen: the path over model sizes, and the next best models."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from linkwise.argument_types import checked
from linkwise.discovery.result import CERTAIN, Discovery
from linkwise.discovery.text import runner_up_changes
from linkwise.plot.palette import IDENTIFIED, MEASURED, VISITED, WELL
from linkwise.plot.style import axes_for, legend_below, literal, log_scale, sheet

_RUNNERS_UP = 10
_FAR = 100.0  # a margin from which a linear scale shows nothing of the others


@checked
def path(discovery: Discovery, *, legend: bool = True, ax: Axes | None = None) -> Axes:
    """Draw misfit and criterion against the number of terms, with the chosen model marked.

    Scales are linear to 10 and logarithmic beyond.

    Parameters
    ----------
    discovery : Discovery
        An answer of `linkwise.discover`.
    legend : bool, default True
        Add a legend to the axes.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: numbers of terms, and -2 log likelihood (no unit).

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=3.0, rate=1000.0).with_noise(30.0, seed=1)
    >>> found = lw.discover(record, {"m1": 1.0, "m2": 0.01})
    >>> lw.plot.path(found).get_xlabel()
    'terms'
    """
    with axes_for(ax, legend=legend) as axes:
        terms = [point.terms for point in discovery.path]
        for values, color, text in (
            ([point.cost for point in discovery.path], MEASURED, "misfit, above the largest model's"),
            (
                [point.criterion for point in discovery.path],
                IDENTIFIED,
                "criterion, above the chosen model's",
            ),
        ):
            axes.plot(terms, values, "o-", color=color, markersize=3, label=text)
        for point in discovery.path:
            if point.chosen:
                axes.plot(
                    point.terms,
                    point.criterion,
                    "o",
                    color=WELL,
                    markersize=8,
                    zorder=5,
                    clip_on=False,
                    label="chosen",
                )
                axes.axvline(point.terms, color=WELL, linewidth=0.8, zorder=0)
        axes.axhspan(0.0, CERTAIN, color=VISITED, zorder=0, label=f"in doubt (to {CERTAIN:g})")
        log_scale(axes, "y", linear_to=10.0)
        axes.set_ylim(min((point.criterion for point in discovery.path), default=0.0) - 0.5, None)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_xlabel("terms")
        axes.set_ylabel("-2 log likelihood")
        axes.set_title("models of all sizes")
    return axes


@checked
def runners_up(discovery: Discovery, *, ax: Axes | None = None) -> Axes:
    """Draw how much worse the criterion of the next best models is.

    Parameters
    ----------
    discovery : Discovery
        An answer of `linkwise.discover`.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: a bar for each of the ten best models, best first, in -2 log likelihood (no unit).

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=3.0, rate=1000.0).with_noise(30.0, seed=1)
    >>> found = lw.discover(record, {"m1": 1.0, "m2": 0.01})
    >>> lw.plot.runners_up(found).get_title("left")
    'the next best models'
    """
    models = discovery.runners_up[:_RUNNERS_UP]
    with axes_for(ax) as axes:
        rows = np.arange(len(models))
        axes.axvspan(0.0, CERTAIN, color=VISITED, zorder=0)
        axes.barh(rows, [model.margin for model in models], color=IDENTIFIED, height=0.6)
        axes.set_yticks(rows, [literal(change) for change in runner_up_changes(discovery)[:_RUNNERS_UP]])
        axes.invert_yaxis()
        axes.grid(False, axis="y")
        if max((model.margin for model in models), default=0.0) > _FAR:
            log_scale(axes, "x", linear_to=10.0)
        axes.set_xlabel("criterion above the chosen model's")
        axes.set_title("the next best models")
    return axes


@checked
def path_figure(discovery: Discovery) -> Figure:
    """The path and, beside it, the next best models.

    Parameters
    ----------
    discovery : Discovery
        What `linkwise.discover` returned.

    Returns
    -------
    matplotlib.figure.Figure
        A figure that no window shows; `save` writes it.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=3.0, rate=1000.0).with_noise(30.0, seed=1)
    >>> discovery = lw.discover(record, {"m1": 1.0, "m2": 0.01})
    >>> len(lw.plot.path_figure(discovery).axes)
    2
    """
    with sheet(columns=2, width=8.0, height=3.6) as (figure, [left, right]):
        path(discovery, legend=False, ax=left)
        runners_up(discovery, ax=right)
        legend_below(figure, left, columns=4)
    return figure
