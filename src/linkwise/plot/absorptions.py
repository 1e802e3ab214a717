"""What sinks do: motion with and without them (paper Figs. 3 and 5), where energy goes, crossings of wells, maps, and what a
search for the best ones tried.
"""

from __future__ import annotations

from functools import partial
from itertools import combinations
from typing import Any, Unpack

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter

from linkwise.absorption.design import Design
from linkwise.absorption.intervals import AbsorptionIntervals, Answer, without_intervals
from linkwise.absorption.map import AbsorptionMap, SweepAxis
from linkwise.absorption.result import Absorption
from linkwise.absorption.runs import TAIL
from linkwise.absorption.search import DesignAxis
from linkwise.arrays import Bools, Floats
from linkwise.errors import require_known
from linkwise.plot.style import (
    CHAOS,
    IDENTIFIED,
    MEASURED,
    SERIES,
    TRUE,
    VISITED,
    WELL,
    On,
    envelope,
    label,
    literal,
    log_scale,
    not_shown,
    over_time,
    picture,
    pictures,
    place_of,
    scale,
    single,
    strips,
    wrap_title,
)


@picture()
def absorption(axes: Axes, result: Answer, mass: str | None = None, **on: Unpack[On]) -> None:
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
    number = place_of("primary mass", mass, [change.name for change in plain.masses])
    largest = max(plain.masses[number].with_sinks.peak, plain.masses[number].without.peak)
    factor, unit = scale(largest, plain.unit(plain.masses[number].name))
    _draw_excursions(axes, plain, number, factor)
    if isinstance(result, AbsorptionIntervals):
        before_tail = _before_tail(plain)
        ends = (factor * end[before_tail, number] for end in (result.lower, result.upper))
        style: dict[str, Any] = {"color": WELL, "alpha": 0.35, "lw": 0, "zorder": 3}
        axes.fill_between(plain.time[before_tail], *ends, label="envelope, 95 % of draws", **style)
    mark_chaos(axes, plain)
    over_time(axes, plain.time, f"{literal(plain.masses[number].name)}\n{unit}")
    axes.set_ylim(-1.08 * largest * factor, 1.08 * largest * factor)
    wrap_title(axes, _removal_title(plain))


def decay_figure(result: Answer) -> Figure:
    """The primary masses, each in a strip of its own; of more than 8 the first."""
    plain = without_intervals(result)
    names = [mass.name for mass in plain.masses]
    title = _removal_title(plain) + not_shown(names, _MOST, "masses")
    draws = [partial(absorption, result, name, legend=False) for name in names[:_MOST]]
    return strips(draws, (1.3, 1.25), title=title)


def mark_chaos(axes: Axes, result: Absorption, *, shaded: bool = True) -> None:
    """Mark from when on the motion with sinks is one of many."""
    horizon = result.with_sinks.horizon
    if horizon is None:
        return
    axes.axvline(horizon, color=TRUE, lw=0.8, ls=":", label="chaos: one motion of many")
    if shaded:
        axes.axvspan(horizon, result.time[-1], color=CHAOS, zorder=-1)


def _removal_title(result: Absorption) -> str:
    name = result.with_sinks.structure.name
    return f"{f'{name}, sinks' if name else 'Sinks'} {result.removal} for comparison"


def _draw_excursions(axes: Axes, result: Absorption, number: int, factor: float) -> None:
    mass = result.masses[number]
    runs = (
        (result.without, mass.without, MEASURED, "without sinks"),
        (result.with_sinks, mass.with_sinks, IDENTIFIED, "with sinks"),
    )
    for run, decay, color, text in runs:
        x = run.displacement(mass.name) - decay.rest
        axes.plot(*envelope(result.time, x * factor), color=color, lw=0.7, label=text)
    before_tail = _before_tail(result)
    for (run, _, _, text), (line, shade) in zip(runs, (("--", "#555555"), ("-", TRUE)), strict=True):
        bound = run.envelope[before_tail, number] * factor
        axes.plot(result.time[before_tail], bound, line, color=shade, lw=0.9, label=f"envelope {text}")
    level = mass.level * factor
    axes.axhspan(-level, level, color=VISITED, zorder=0, label=f"settled: {100 * result.settle:g} %")
    if mass.with_sinks.settled is not None:
        axes.axvline(mass.with_sinks.settled, color=WELL, lw=1.0, label="settled with sinks")


def _before_tail(result: Absorption) -> Bools:
    """Samples after which enough is to come for an envelope."""
    start, end = result.time[0], result.time[-1]
    return np.asarray(result.time <= end - TAIL * (end - start))


SHOWN = ("settled", "sinks_share", "rms_reduction", "crossings")
_WIDE = 50.0  # largest over smallest from which colours go by ratio
_NEVER, _DIVERGED = "#D9D9D9", "#F2B8A0"


@picture(width=4.6, height=3.4)
def map(axes: Axes, result: AbsorptionMap, quantity: str = "settled", **on: Unpack[On]) -> None:
    """Draw a quantity over the swept parameters: colours over two, a curve over one.

    Parameters
    ----------
    result : AbsorptionMap
        An answer of `linkwise.absorption.absorption_map`.
    quantity : str, default "settled"
        Name of one of ``result.quantities``, such as ``"sinks_share"``, ``"rms_reduction"`` or ``"crossings"``.
    legend : bool, default True
        Add a legend to the axes where there are cells without a number.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on; a colour bar is put beside them. By default those of a new figure, which is ``ax.figure`` of the
        returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: the swept parameters in their SI units, parts of 1 in %.

    Raises
    ------
    LinkwiseError
        If there is no such quantity.

    Examples
    --------
    >>> import linkwise as lw
    >>> over = {"nes1.alpha": [-150.0, -100.0, -50.0]}
    >>> swept = lw.absorption.absorption_map(lw.bnes_chain(2), over, duration=0.5, rate=500.0, release={"v:m1": 1.0})
    >>> lw.plot.map(swept, "sinks_share").get_ylabel()
    '%'
    """
    values = result[quantity]
    shown = next(candidate for candidate in result.quantities if candidate.name == quantity)
    values, unit = (100.0 * values, "%") if shown.is_part else (values, shown.unit)  # parts of 1 in %
    if len(result.axes) == 2:
        _draw_map(axes, result, values, unit)
    else:
        _draw_curve(axes, result, values, unit)
    axes.set_title(literal(shown.title))
    if np.any(np.isnan(values) & result.completed):
        text = f"did not settle within {result.duration:g} s"
        axes.fill([], [], color=_NEVER if len(result.axes) == 2 else MEASURED, label=text)
    if not result.completed.all():
        color = _DIVERGED if len(result.axes) == 2 else WELL
        axes.fill([], [], color=color, label="the motion diverges")


def map_figure(result: AbsorptionMap) -> Figure:
    """One panel a quantity."""
    draws = [partial(map, result, name) for name in SHOWN]
    return pictures(draws, width=7.4, height=(0.7, 2.7), legend_columns=2)


def _draw_map(axes: Axes, result: AbsorptionMap, values: Floats, unit: str) -> None:
    across, up = result.axes
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    positive = finite[finite > 0.0]
    by_ratio = unit != "%" and positive.size == finite.size > 0 and high > _WIDE * low
    norm = LogNorm(low, high) if by_ratio else Normalize(low, high if high > low else low + 1.0)
    axes.set_facecolor(_NEVER)
    edges = _cell_edges(across), _cell_edges(up)
    mesh = axes.pcolormesh(*edges, values.T, norm=norm, cmap="viridis", rasterized=True)
    if not result.completed.all():
        diverged = np.where(result.completed, np.nan, 0.0)
        axes.pcolormesh(*edges, diverged.T, cmap=ListedColormap([_DIVERGED]), rasterized=True)
    _scale_axis(axes, "x", across, across.values[0])
    _scale_axis(axes, "y", up, up.values[0])
    if not (up.logarithmic and up.values[0] > 0.0) and np.abs(up.values).max() >= _MANY_DIGITS:
        axes.yaxis.set_major_formatter(EngFormatter(sep=""))  # a common factor would stand over the title
    axes.grid(False)
    if finite.size:  # a bar would show numbers that nothing has
        axes.figure.colorbar(mesh, ax=axes, label=unit or None)


def _draw_curve(axes: Axes, result: AbsorptionMap, values: Floats, unit: str) -> None:
    (across,) = result.axes
    axes.plot(across.values, values, ".-" if len(values) <= 60 else "-", color=IDENTIFIED, ms=4)
    for missing, color in ((~result.completed, WELL), (np.isnan(values) & result.completed, MEASURED)):
        if missing.any():
            heights = np.zeros(int(missing.sum()))
            along = axes.get_xaxis_transform()
            axes.plot(across.values[missing], heights, "x", color=color, ms=5, clip_on=False, transform=along)
    _scale_axis(axes, "x", across, across.values[0])
    edges = _cell_edges(across)
    axes.set(xlim=(min(edges), max(edges)), ylabel=unit or "number")


_MANY_DIGITS = 1e5


def _scale_axis(axes: Axes, which: str, axis: SweepAxis | DesignAxis, first: float) -> None:
    """Label an axis, "x" or "y", with a parameter, from its `first` value on."""
    name = f"{axis.name}, {axis.unit}" if axis.unit not in ("", "?") else axis.name
    axes.set(**{f"{which}label": literal(name)})
    if axis.logarithmic and first > 0.0:
        log_scale(axes, which)


def _cell_edges(axis: SweepAxis) -> Floats:
    """(K + 1,) edges of cells around the values."""
    values = axis.values
    if len(values) == 1:
        half = 0.5 * abs(values[0]) or 0.5
        return np.array([values[0] - half, values[0] + half])
    if axis.logarithmic and values[0] > 0.0:
        return np.asarray(np.exp(_edges_between(np.log(values))))
    return _edges_between(values)


def _edges_between(values: Floats) -> Floats:
    inner = 0.5 * (values[1:] + values[:-1])
    return np.concatenate([[2.0 * values[0] - inner[0]], inner, [2.0 * values[-1] - inner[-1]]])


_MOST = 8  # strips that one page can hold


@picture()
def crossings(axes: Axes, result: Answer, sink: str | None = None, **on: Unpack[On]) -> None:
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
    shown = plain.sinks[place_of("sink", sink, [entry.sink.link for entry in plain.sinks])]
    law = plain.with_sinks.structure.link(shown.sink.link).law
    factor, unit = scale(shown.elongation, law.motion_units[0])
    time, elongation = envelope(plain.time, shown.elongation * factor)
    axes.plot(time, elongation, color=IDENTIFIED, lw=0.7, label="elongation")
    for top in shown.tops:
        axes.axhline(top * factor, color=TRUE, lw=0.6, ls=":", label="top between wells")
    if len(shown.crossings):
        heights = np.full(len(shown.crossings), 0.97)
        across = axes.get_xaxis_transform()
        axes.plot(shown.crossings, heights, "|", color=WELL, ms=7, transform=across, label="crossing")
    mark_chaos(axes, plain)
    count = f"{len(shown.crossings)} crossings" if shown.tops else "one well"
    axes.set_title(literal(f"{shown.sink.link}: {count}"))
    over_time(axes, plain.time, unit)


def crossings_figure(result: Answer) -> Figure:
    """The sinks, each in a strip of its own; of more than 8 the first."""
    sinks = without_intervals(result).sinks[:_MOST]
    return strips([partial(crossings, result, sink.sink.link, legend=False) for sink in sinks], (1.2, 1.3))


_SINKS, _OTHERS = 5, 4  # bands of links that can be told apart
_GREYS = ("#404040", "#6E6E6E", "#939393", "#B4B4B4", "#C8C8C8")
_PALE = "#EBEBEB"
_POINTS = 1500  # of a band


@picture()
def energy(axes: Axes, result: Answer, *, with_sinks: bool = True, **on: Unpack[On]) -> None:
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
    _draw_bands(axes, plain, with_sinks=with_sinks)
    if with_sinks:
        mark_chaos(axes, plain, shaded=False)
    axes.set(title="with sinks" if with_sinks else literal(f"sinks {plain.removal}"), xlabel="time, s")
    axes.set_ylabel("share of the energy put in, %")


def energy_figure(result: Answer) -> Figure:
    """Where the energy went with the sinks and, beside it, without them."""
    draws = [partial(energy, result), partial(energy, result, with_sinks=False)]
    return pictures(draws, height=(0.0, 3.4), outer=True, legend_columns=4)


def _draw_bands(axes: Axes, result: Absorption, *, with_sinks: bool) -> None:
    """Sinks from below, then the other links, then what is left."""
    run = result.with_sinks if with_sinks else result.without
    remaining = 100.0 * run.remaining
    shares = {name: 100.0 * energy / run.total for name, energy in run.dissipated_by.items()}
    colors = {name: color for name, color in _band_colors(result).items() if name in shares}
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
        lw=0.0,
    )
    axes.set_xlim(result.time[0], result.time[-1])
    axes.set_ylim(0.0, max(100.0, float((sum(shares.values()) + remaining).max())))
    axes.grid(False)


def _band_colors(result: Absorption) -> dict[str, str]:
    """The links and hosts with a band of their own in both runs: sinks in the colours of the series, the others in greys."""
    run = result.with_sinks
    by_share, colors = sorted(run.dissipated_by, key=lambda name: -run.share(name)), dict[str, str]()
    for absorbing, most, series in ((True, _SINKS, SERIES), (False, _OTHERS, _GREYS)):
        largest = [name for name in by_share if (name in result.absorbing) is absorbing][:most]
        shown = (name for name in run.dissipated_by if name in largest)
        colors |= dict(zip(shown, series, strict=False))
    return colors


_MOST_PAIRS = 6  # of varied parameters


@picture(width=5.2, height=3.4)
def trade_off(axes: Axes, result: Design, **on: Unpack[On]) -> None:
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
    >>> from linkwise.plot.absorptions import trade_off
    >>> few = lw.absorption.DesignOptions(evaluations=24)
    >>> over = {"m2.mass": (0.002, 0.05)}
    >>> found = lw.design(lw.bnes_chain(2), over, "rms", few, duration=0.5, release={"v:m1": 1.0})
    >>> trade_off(found).get_xlabel()
    'mass of the sinks, kg'
    """
    values, title = _displayed_values(result)
    mass, best = np.array(result.trade_off).T
    usable = result.allowed & np.isfinite(values)
    axes.plot(result.added_mass[usable], values[usable], ".", color=MEASURED, ms=3, label="designs tried")
    factor, _ = _shown_in(result)
    axes.step(mass, factor * best, where="post", color=IDENTIFIED, lw=1.0)
    axes.plot(mass, factor * best, "o", color=IDENTIFIED, ms=4, label="no lighter one is as good")
    axes.set(xlabel="mass of the sinks, kg", ylabel=literal(title))


@picture(width=4.8, height=3.4)
def designs(axes: Axes, result: Design, across: str = "", up: str = "", **on: Unpack[On]) -> None:
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
    values, title = _displayed_values(result)
    order = np.argsort(values if result.options.maximise else -values)  # the best on top
    order = order[(result.allowed & np.isfinite(values))[order]]
    x = result.points[:, names.index(across)]
    _label_design_axis(axes, result, across, "x")
    if not up:
        axes.plot(x[order], values[order], ".", color=IDENTIFIED, ms=4)
        axes.plot(result.best[across], _shown_in(result)[0] * result.objective, "*", color=WELL, ms=12)
        axes.set_ylabel(literal(title))
        return
    y = result.points[:, names.index(up)]
    # most designs lie near the best, so that ranks tell colours apart where values crowd
    shares = [10.0, 100.0] if result.options.maximise else [0.0, 90.0]
    low, high = np.percentile(values[order], shares)
    cmap = "viridis" if result.options.maximise else "viridis_r"
    tried = axes.scatter(x[order], y[order], c=values[order], s=10, cmap=cmap, vmin=low, vmax=high)
    axes.plot(result.best[across], result.best[up], "*", color=WELL, ms=12, label="best")
    _label_design_axis(axes, result, up, "y")
    axes.figure.colorbar(tried, ax=axes, label=literal(title))


def _label_design_axis(axes: Axes, result: Design, name: str, which: str) -> None:
    """Label an axis with a parameter, between its bounds."""
    axis = next(axis for axis in result.axes if axis.name == name)
    _scale_axis(axes, which, axis, axis.low)
    axes.set(**{f"{which}lim": (axis.low, axis.high)})


def _shown_in(result: Design) -> tuple[float, str]:
    """The factor by which values are read, and their unit: parts of 1 in %."""
    if result.quantity.is_part:
        return 100.0, "%"
    return scale(result.objectives, result.quantity.unit)


def _displayed_values(result: Design) -> tuple[Floats, str]:
    """The values (E,) of all designs as they are read, and the quantity with its unit."""
    factor, unit = _shown_in(result)
    return factor * result.objectives, f"{result.quantity.title}, {unit}" if unit else result.quantity.title


def designs_figure(result: Design) -> Figure:
    """A panel for each pair of parameters, the first ones of many."""
    pairs = list(combinations([axis.name for axis in result.axes], 2))[:_MOST_PAIRS]
    if len(pairs) < 2:
        return single(partial(designs, result))
    return pictures([partial(designs, result, *pair) for pair in pairs], width=8.4, height=(0.4, 3.0))
