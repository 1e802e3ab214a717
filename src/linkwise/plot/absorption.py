"""What sinks do, on paper: primary masses with and without them (paper Figs. 3 and 5), energy, crossings."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from linkwise.absorption.decay import TAIL
from linkwise.absorption.result import Absorption, AbsorptionRun, MassChange
from linkwise.arrays import Bools, Floats
from linkwise.plot.downsample import envelope
from linkwise.plot.palette import IDENTIFIED, SEEN, SERIES, TRUE, VISITED, WELL, scale
from linkwise.plot.style import sheet

Bands = tuple[Floats, Floats]

MOST = 8  # strips that one page can hold
_SINKS, _OTHERS = 5, 4  # bands of links that can be told apart
_GREYS = ("#404040", "#6E6E6E", "#939393", "#B4B4B4", "#C8C8C8")
_PALE = "#EBEBEB"


def decay_figure(found: Absorption, bands: Bands | None = None) -> Figure:
    """Excursions of the primary masses with sinks and without, each under its envelope, and when they settle.

    `bands` are lower and upper ends (N, P) in m of what is known of the envelopes with sinks.
    """
    masses = found.masses[:MOST]
    with sheet(len(masses), height=1.3 + 1.25 * len(masses)) as (figure, strips):
        for number, (axes, mass) in enumerate(zip(strips, masses, strict=True)):
            _excursions(axes, found, mass, number)
            if bands is not None:
                _band(axes, found, mass, (bands[0][:, number], bands[1][:, number]))
            axes.tick_params(labelbottom=number == len(masses) - 1)
        strips[-1].set_xlabel("time, s")
        hidden = len(found.masses) - len(masses)
        more = f" ({hidden} more masses not shown)" if hidden else ""
        strips[0].set_title(f"{found.with_sinks.structure.name}, sinks {found.manner} for comparison{more}")
        figure.align_ylabels()
        _legend(figure, strips[0])
    return figure


def _excursions(axes: Axes, found: Absorption, mass: MassChange, number: int) -> None:
    largest = max(mass.with_sinks.peak, mass.without.peak)
    factor, unit = scale(largest, "m")
    sides = (
        (found.without, mass.without, SEEN, "without sinks"),
        (found.with_sinks, mass.with_sinks, IDENTIFIED, "with sinks"),
    )
    for side, numbers, color, label in sides:
        x = side.x[:, side.structure.mass_names.index(mass.name)] - numbers.rest
        axes.plot(*envelope(found.time, x * factor), color=color, linewidth=0.7, label=label)
    kept = _before_tail(found)
    for side, _, color, label in sides:
        line, shade = ("-", TRUE) if color == IDENTIFIED else ("--", "#555555")
        bound = side.envelope[kept, number] * factor
        axes.plot(found.time[kept], bound, line, color=shade, linewidth=0.9, label=f"envelope {label}")
    level = mass.level * factor
    axes.axhspan(-level, level, color=VISITED, zorder=0, label=f"settled: {100 * found.settle:g} %")
    if mass.with_sinks.settled is not None:
        axes.axvline(mass.with_sinks.settled, color=WELL, linewidth=1.0, label="settled with sinks")
    _shade_chaos(axes, found)
    axes.set_ylabel(f"{mass.name}\n{unit}")
    axes.yaxis.set_major_locator(MaxNLocator(4))
    axes.set_xlim(found.time[0], found.time[-1])
    axes.set_ylim(-1.08 * largest * factor, 1.08 * largest * factor)


def _band(axes: Axes, found: Absorption, mass: MassChange, ends: Bands) -> None:
    factor, _ = scale(max(mass.with_sinks.peak, mass.without.peak), "m")
    kept = _before_tail(found)
    lower, upper = (end[kept] * factor for end in ends)
    axes.fill_between(
        found.time[kept], lower, upper, color=WELL, alpha=0.35, linewidth=0, zorder=3, label="envelope, 95 % of draws"
    )  # fmt: skip


def _before_tail(found: Absorption) -> Bools:
    """Samples after which enough is to come for an envelope."""
    return np.asarray(found.time <= found.time[-1] - TAIL * (found.time[-1] - found.time[0]))


def energy_figure(found: Absorption) -> Figure:
    """Where the energy went: shares of what was put in, dissipated by each link and still there, over time."""
    with sheet(columns=2, height=3.4) as (figure, panels):
        for axes, side, title in zip(
            panels, (found.with_sinks, found.without), ("with sinks", f"sinks {found.manner}"), strict=True
        ):
            _stack(axes, found, side)
            axes.set_title(title)
            axes.set_xlabel("time, s")
        panels[0].set_ylabel("share of the energy put in, %")
        panels[1].tick_params(labelleft=False)
        _shade_chaos(panels[0], found, shaded=False)
        _legend(figure, *panels)
    return figure


def _stack(axes: Axes, found: Absorption, side: AbsorptionRun) -> None:
    """Sinks from below, then the other links, then what is left."""
    names = [link.name for link in side.structure.links]
    colors = {name: color for name, color in _colors(found).items() if name in names}
    shares = 100.0 * side.shares
    layers = [shares[:, names.index(name)] for name in colors]
    rest = [number for number, name in enumerate(names) if name not in colors]
    if rest and float(shares[-1, rest].sum()) > 0.0:
        layers.append(shares[:, rest].sum(axis=1))
        colors["other links"] = _GREYS[-1]
    thin = slice(None, None, max(1, len(found.time) // 1500))
    axes.stackplot(
        found.time[thin],
        *(layer[thin] for layer in [*layers, 100.0 * side.remaining]),
        labels=[*colors, "still there"],
        colors=[*colors.values(), _PALE],
        linewidth=0.0,
    )
    axes.set_xlim(found.time[0], found.time[-1])
    axes.set_ylim(0.0, max(100.0, float((shares.sum(axis=1) + 100.0 * side.remaining).max())))
    axes.grid(False)


def _colors(found: Absorption) -> dict[str, str]:
    """The links that get a band of their own in both panels: sinks in the colours of the series, the others in greys."""
    side = found.with_sinks
    names = [link.name for link in side.structure.links]
    by_share = sorted(names, key=lambda name: -side.share(name))
    most = [name for name in by_share if name in found.absorbing][:_SINKS]
    most += [name for name in by_share if name not in found.absorbing][:_OTHERS]
    sinks, others = iter(SERIES), iter(_GREYS)
    ordered = sorted((name for name in names if name in most), key=lambda name: name not in found.absorbing)
    return {name: next(sinks) if name in found.absorbing else next(others) for name in ordered}


def crossings_figure(found: Absorption) -> Figure:
    """Elongation of every sink over time, the tops between its wells, and its passages over them."""
    works = found.sinks[:MOST]
    with sheet(len(works), height=1.2 + 1.3 * len(works)) as (figure, strips):
        for number, (axes, work) in enumerate(zip(strips, works, strict=True)):
            d = work.elongation
            factor, unit = scale(float(np.abs(d).max()), "m")
            axes.plot(*envelope(found.time, d * factor), color=IDENTIFIED, linewidth=0.7, label="elongation")
            for top in work.tops:
                axes.axhline(
                    top * factor, color=TRUE, linewidth=0.6, linestyle=":", label="top between wells"
                )
            if len(work.crossings):
                axes.plot(
                    work.crossings, np.full(len(work.crossings), 1.04), "|", color=WELL, markersize=7, clip_on=False,
                    transform=axes.get_xaxis_transform(), label="crossing",
                )  # fmt: skip
            _shade_chaos(axes, found)
            count = f"{len(work.crossings)} crossings" if work.tops else "one well"
            axes.set_title(f"{work.sink.link}: {count}", pad=12)
            axes.set_ylabel(unit)
            axes.yaxis.set_major_locator(MaxNLocator(4))
            axes.set_xlim(found.time[0], found.time[-1])
            axes.tick_params(labelbottom=number == len(works) - 1)
        strips[-1].set_xlabel("time, s")
        figure.align_ylabels()
        _legend(figure, strips[0])
    return figure


def _shade_chaos(axes: Axes, found: Absorption, *, shaded: bool = True) -> None:
    """Mark where the motion with sinks is one of many."""
    horizon = found.with_sinks.horizon
    if horizon is None:
        return
    axes.axvline(horizon, color=TRUE, linewidth=0.8, linestyle=":", label="chaos: one motion of many")
    if shaded:
        axes.axvspan(horizon, found.time[-1], color="#F3EDE4", zorder=-1)


def _legend(figure: Figure, *panels: Axes) -> None:
    """One legend below all panels, every label once."""
    named: dict[str, Any] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            named.setdefault(label, handle)
    figure.legend(list(named.values()), list(named), loc="outside lower center", ncols=3)
