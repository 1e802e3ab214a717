"""What a search for the best sinks tried: mass against what was minimised, and where designs lie."""

from __future__ import annotations

from functools import partial
from itertools import combinations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from linkwise.absorption.design import Design
from linkwise.arrays import Floats
from linkwise.errors import require_known
from linkwise.plot.style import (
    IDENTIFIED,
    MEASURED,
    WELL,
    axes_for,
    literal,
    log_scale,
    pictures,
    scale,
    single,
)

_MOST = 6  # panels


def trade_off(result: Design, *, legend: bool = True, ax: Axes | None = None) -> Axes:
    """Draw the mass of the sinks against what was minimised: all designs, and those that no lighter one beats.

    Parameters
    ----------
    result : Design
        What `design` returned.
    legend : bool, default True
        Add a legend to the axes.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on; by default those of a new figure.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: mass in kg, the quantity in its SI unit or in %.

    Examples
    --------
    >>> import linkwise as lw
    >>> from linkwise.plot.design import trade_off
    >>> few = lw.absorption.DesignOptions(evaluations=24)
    >>> over = {"m2.mass": (0.002, 0.05)}
    >>> found = lw.design(lw.bnes_chain(2), over, "rms", few, duration=0.5, release={"v:m1": 1.0})
    >>> trade_off(found).get_xlabel()
    'mass of the sinks, kg'
    """
    values, title = _shown(result)
    mass, best = np.array(result.trade_off).T
    usable = result.allowed & np.isfinite(values)
    with axes_for(ax, legend=legend, width=5.2, height=3.4) as axes:
        axes.plot(result.added_mass[usable], values[usable], ".", color=MEASURED, ms=3, label="designs tried")
        factor, _ = _reading(result)
        axes.step(mass, factor * best, where="post", color=IDENTIFIED, lw=1.0)
        axes.plot(mass, factor * best, "o", color=IDENTIFIED, ms=4, label="no lighter one is as good")
        axes.set(xlabel="mass of the sinks, kg", ylabel=literal(title))
    return axes


def designs(
    result: Design, across: str = "", up: str = "", *, legend: bool = True, ax: Axes | None = None
) -> Axes:
    """Draw the designs that were tried over two of their parameters, coloured by what was minimised.

    Parameters
    ----------
    result : Design
        What `design` returned.
    across, up : str, optional
        The parameters; by default the first two. Of a single one, it is drawn against the quantity.
    legend : bool, default True
        Add a legend to the axes.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on; a colour bar is put beside them. By default those of a new figure.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on, in SI units, parts of 1 in %.

    Raises
    ------
    LinkwiseError
        If a parameter was not varied.

    Examples
    --------
    >>> import linkwise as lw
    >>> few = lw.absorption.DesignOptions(evaluations=8)
    >>> over = {"nes1.alpha": (-300.0, -20.0)}
    >>> found = lw.design(lw.bnes_chain(2), over, "rms", few, duration=0.5, release={"v:m1": 1.0})
    >>> lw.plot.designs(found).get_xlabel()
    'nes1.alpha, N/m'
    """
    names = [axis.name for axis in result.axes]
    across = across or names[0]
    up = up or (names[1] if len(names) > 1 else "")
    for name in (across, *([up] if up else [])):
        require_known("varied parameter", name, names)
    values, title = _shown(result)
    order = np.argsort(values if result.options.maximise else -values)  # the best on top
    order = order[(result.allowed & np.isfinite(values))[order]]
    x = result.points[:, names.index(across)]
    with axes_for(ax, legend=legend, width=4.8, height=3.4) as axes:
        _scaled(axes, result, across, "x")
        if not up:
            axes.plot(x[order], values[order], ".", color=IDENTIFIED, ms=4)
            axes.plot(result.best[across], _reading(result)[0] * result.objective, "*", color=WELL, ms=12)
            axes.set_ylabel(literal(title))
            return axes
        y = result.points[:, names.index(up)]
        # most designs lie near the best, so that ranks tell colours apart where values crowd
        shares = [10.0, 100.0] if result.options.maximise else [0.0, 90.0]
        low, high = np.percentile(values[order], shares)
        cmap = "viridis" if result.options.maximise else "viridis_r"
        tried = axes.scatter(x[order], y[order], c=values[order], s=10, cmap=cmap, vmin=low, vmax=high)
        axes.plot(result.best[across], result.best[up], "*", color=WELL, ms=12, label="best")
        _scaled(axes, result, up, "y")
        axes.figure.colorbar(tried, ax=axes, label=literal(title))
    return axes


def _scaled(axes: Axes, result: Design, name: str, which: str) -> None:
    """Label an axis with a parameter, between its bounds."""
    axis = next(own for own in result.axes if own.name == name)
    text = literal(f"{name}, {axis.unit}" if axis.unit not in ("", "?") else name)
    axes.set(**{f"{which}label": text, f"{which}lim": (axis.low, axis.high)})
    if axis.logarithmic and axis.low > 0.0:
        log_scale(axes, which)


def _reading(result: Design) -> tuple[float, str]:
    """The factor by which values are read, and their unit: parts of 1 in %."""
    if result.quantity.unit == "" and not result.quantity.name.startswith("crossings"):
        return 100.0, "%"
    return scale(float(np.nanmax(np.abs(result.objectives))), result.quantity.unit)


def _shown(result: Design) -> tuple[Floats, str]:
    """The values (E,) of all designs as they are read, and the quantity with its unit."""
    factor, unit = _reading(result)
    return factor * result.objectives, f"{result.quantity.title}, {unit}" if unit else result.quantity.title


def designs_figure(result: Design) -> Figure:
    """A panel for each pair of parameters, the first ones of many."""
    pairs = list(combinations([axis.name for axis in result.axes], 2))[:_MOST]
    if len(pairs) < 2:
        return single(partial(designs, result))
    return pictures([partial(designs, result, *pair) for pair in pairs], width=8.4, height=(0.4, 3.0))
