"""Steady motion over frequency: branches at every level, unstable parts, bands, and what is not periodic."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import pairwise
from typing import Unpack

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from linkwise.arrays import Floats
from linkwise.plot.style import SERIES, On, label, not_shown, picture, place_of, scale, single, strips
from linkwise.records.channel_units import unit_in
from linkwise.response.backbone import Backbone
from linkwise.response.basins_of_attraction import Basins
from linkwise.response.measured_points import MeasuredPoints
from linkwise.response.result import FOLD, Branch, Response, ResponseLevel

_MOST = 6  # channels in a figure
_BAND, _PLANE = 0.2, 0.6  # opacity
_MARKERS = {FOLD: "o", "period doubling": "s", "Neimark-Sacker": "D", "branch point": "^"}


@picture()
def response(axes: Axes, result: Response, channel: str | None = None, **on: Unpack[On]) -> None:
    """Draw the amplitude of a channel over frequency: a colour for each level, unstable motion thin and dotted.

    Where a link leaves the range that the record visited a curve is dashed. Bars are ranges of motions that do not repeat.

    Parameters
    ----------
    result : Response
        An answer of `linkwise.respond`.
    channel : str, optional
        A channel of it, such as "x:m1". By default the first.
    legend : bool, default True
        Add a legend to the axes.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: frequency in Hz, and half of peak to peak.

    Raises
    ------
    StructureError
        If the response does not have the channel.

    Examples
    --------
    >>> import linkwise as lw
    >>> spring = lw.Link("spring", ("m1", "ground"), lw.Law.parse("k*d + c*v"), {"k": 400.0, "c": 2.0})
    >>> oscillator = lw.Structure("oscillator", (lw.Mass("m1", 1.0),), (spring,))
    >>> answer = lw.respond(oscillator, force={"m1": 1.0}, hz=(1.0, 5.0), starts=0)
    >>> lw.plot.response(answer).get_ylabel()
    'x:m1\\nmm'
    """
    column = place_of("channel", channel, result.channels)
    name = result.channels[column]
    sizes = [branch.amplitude[:, column].max() for level in result.levels for branch in level.branches]
    sizes += [0.5 * (m.upper - m.lower)[column] for level in result.levels for m in level.irregular]
    factor, unit = scale(sizes, unit_in(result.structure, name))
    for level, colour in zip(result.levels, _colours(len(result.levels)), strict=True):
        _draw_level(axes, level, column, factor, colour)
        axes.plot([], [], color=colour, label=f"{level.size:g} {result.drive.unit}")
    _draw_measured(axes, result.measured, column, factor)
    _explain_marks(axes, result)
    axes.set(xlabel="frequency, Hz", ylabel=f"{label(name)}\n{unit}")
    axes.set_ylim(bottom=0.0)


def _draw_measured(axes: Axes, measured: MeasuredPoints | None, column: int, factor: float) -> None:
    if measured is not None:
        values = factor * measured.amplitude[:, column]
        axes.plot(measured.hz, values, "o", mec="grey", mfc="none", ms=3.5, zorder=3, label="measured")


def _colours(count: int) -> list[str]:
    return [SERIES[number % len(SERIES)] for number in range(count)]


def _draw_level(axes: Axes, level: ResponseLevel, column: int, factor: float, colour: str) -> None:
    for branch in level.branches:
        values = factor * branch.amplitude[:, column]
        for part, stable, outside in _stretches_of(branch):
            line = "--" if outside else "-" if stable else ":"
            axes.plot(branch.hz[part], values[part], line, color=colour, lw=1.6 if stable else 0.8)
            if branch.lower is not None and branch.upper is not None:
                ends = factor * branch.lower[part, column], factor * branch.upper[part, column]
                axes.fill_between(branch.hz[part], *ends, color=colour, alpha=_BAND, lw=0)
        for name, marker in _MARKERS.items():
            at = [number for number, bifurcation in enumerate(branch.bifurcations) if bifurcation == name]
            axes.plot(branch.hz[at], values[at], marker, color=colour, ms=3.5, mfc="white")
    for motion in level.irregular:
        half = 0.5 * factor * (motion.upper[column] - motion.lower[column])
        axes.plot([motion.hz], [half], "x", color=colour, ms=4.5, mew=0.9)


def _stretches_of(branch: Branch) -> Iterator[tuple[slice, bool, bool]]:
    """Stretches of a branch, one point in common, and whether they are stable and outside the range of the record."""
    outside = np.array([bool(link) for link in branch.outside] or np.zeros(len(branch.hz), dtype=bool))
    kinds: Floats = branch.stable + 2.0 * outside
    edges = [0, *(np.flatnonzero(np.diff(kinds)) + 1).tolist(), len(kinds)]
    for first, last in pairwise(edges):
        yield slice(first, min(last + 1, len(kinds))), bool(branch.stable[first]), bool(outside[first])


def _explain_marks(axes: Axes, result: Response) -> None:
    """Entries of the legend for kinds of lines and marks that are there."""
    branches = [branch for level in result.levels for branch in level.branches]
    if any(not branch.stable.all() for branch in branches):
        axes.plot([], [], ":", color="black", lw=0.8, label="unstable")
    if any(any(branch.outside) for branch in branches):
        axes.plot([], [], "--", color="black", label="outside the range of the record")
    names = {name for branch in branches for name in branch.bifurcations}
    for name, marker in _MARKERS.items():
        if name in names:
            axes.plot([], [], marker, color="black", ms=3.5, mfc="white", label=name)
    if any(level.irregular for level in result.levels):
        axes.plot([], [], "x", color="black", ms=4.5, label="half of the range where not periodic")


@picture()
def backbone(axes: Axes, result: Backbone, channel: str | None = None, **on: Unpack[On]) -> None:
    """Draw the amplitude of a nonlinear mode over its frequency, dashed where a link leaves the range of the record.

    Parameters
    ----------
    result : Backbone
        An answer of `linkwise.backbone`.
    channel : str, optional
        A channel of it, such as "x:m1". By default the first.
    legend : bool, default True
        Add a legend to the axes.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: frequency in Hz, and half of peak to peak.

    Raises
    ------
    StructureError
        If the backbone does not have the channel.

    Examples
    --------
    >>> import linkwise as lw
    >>> curve = lw.backbone(lw.bnes_chain(2), 1, to_energy=1e-3)
    >>> lw.plot.backbone(curve, "x:m2").get_xlabel()
    'frequency, Hz'
    """
    column = place_of("channel", channel, result.channels)
    name = result.channels[column]
    values = result.amplitude[:, column]
    factor, unit = scale(values, unit_in(result.structure, name))
    outside = np.array([bool(link) for link in result.outside] or np.zeros(len(values), dtype=bool))
    _draw_measured(axes, result.measured, column, factor)
    inside = np.where(outside, np.nan, values)
    if result.lower is not None and result.upper is not None:
        ends = (result.lower, result.upper)
        axes.fill_betweenx(factor * values, *ends, color="black", alpha=_BAND, linewidth=0)
    axes.plot(result.hz, factor * inside, color="black", label=f"mode {result.mode}")
    if outside.any():
        beyond = factor * np.where(outside, values, np.nan)
        axes.plot(result.hz, beyond, "--", color="black", label="outside the range of the record")
    axes.set(xlabel="frequency, Hz", ylabel=f"{label(name)}\n{unit}")
    axes.set_ylim(bottom=0.0)


def _draw_damping(result: Backbone, ax: Axes) -> Axes:
    """Draw the damping ratio of a nonlinear mode over its frequency."""
    lowest = 100.0 * float(np.min(result.damping))
    if result.lower_damping is not None and result.upper_damping is not None:
        ends = 100.0 * result.lower_damping, 100.0 * result.upper_damping
        ax.fill_between(result.hz, *ends, color="black", alpha=_BAND, linewidth=0)
        lowest = min(lowest, *ends[0][np.isfinite(ends[0])].tolist())
    ax.plot(result.hz, 100.0 * result.damping, color="black")
    ax.set(xlabel="frequency, Hz", ylabel="damping\n%")
    if lowest >= 0.0:
        ax.set_ylim(bottom=0.0)
    return ax


def backbone_figure(result: Backbone) -> Figure:
    """The channels, each in a strip of its own, of more than 6 the first; and the damping."""
    what = "without damping" if result.force is None else f"in phase resonance with a force on {result.place}"
    title = f"{result.structure.name} {what}, mode {result.mode}: half of peak to peak"
    title += not_shown(result.channels, _MOST, "channels")

    draws = [partial(backbone, result, channel, legend=False) for channel in result.channels[:_MOST]]
    return strips([*draws, partial(_draw_damping, result)], (1.5, 1.7), title=title)


@picture()
def basins(axes: Axes, result: Basins, **on: Unpack[On]) -> None:
    """Draw the plane of initial states, a colour for each rest position where motion ends; white where that is not decided.

    Parameters
    ----------
    result : Basins
        An answer of `linkwise.response.basins`.
    legend : bool, default True
        Add a legend to the axes.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on.

    Examples
    --------
    >>> import linkwise as lw
    >>> plane = {"x:m2": (-0.02, 0.02), "v:m2": (-0.5, 0.5)}
    >>> basins(lw.response.basins(lw.bnes_chain(2), plane, points=4)).get_xlabel()
    'x:m2, mm'
    """
    grids, names = [], []
    for name, values in zip(result.plane, result.values, strict=True):
        factor, unit = scale(values, unit_in(result.structure, name))
        grids.append(factor * values)
        names.append(f"{label(name)}, {unit}")
    shades = [to_rgb(colour) for colour in _colours(len(result.rests))]
    colours = np.ones((*result.ends.shape, 3))
    for number, shade in enumerate(shades):
        colours[result.ends == number] = shade
        label_text = f"rest {number + 1}: {100 * result.shares[number]:.3g} %"
        axes.plot([], [], "s", color=shade, alpha=_PLANE, label=label_text)
    axes.pcolormesh(*grids, colours.transpose(1, 0, 2), shading="nearest", alpha=_PLANE)
    axes.set(xlabel=names[0], ylabel=names[1])
    axes.grid(visible=False)


def basins_figure(result: Basins) -> Figure:
    """The plane of initial states on a figure of its own."""
    return single(partial(basins, result))


def response_figure(result: Response) -> Figure:
    """The channels, each in a strip of its own; of more than 6 the first."""
    title = f"{result.structure.name}: half of peak to peak" + not_shown(result.channels, _MOST, "channels")
    draws = [partial(response, result, channel, legend=False) for channel in result.channels[:_MOST]]
    return strips(draws, (1.5, 1.7), title=title)
