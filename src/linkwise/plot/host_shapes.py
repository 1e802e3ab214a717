"""Shapes of the modes of hosts at their points."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from linkwise.argument_types import checked
from linkwise.errors import StructureError
from linkwise.model.host import Host
from linkwise.model.structure import Structure
from linkwise.plot.palette import SERIES
from linkwise.plot.style import axes_for, label, literal, sheet, wrap_title

_STYLES = ("-", "--", ":", "-.")  # in this order once the colours are used up
_HEIGHT = 3.0  # inches of a panel


@checked
def shapes(host: Host, *, legend: bool = True, ax: Axes | None = None) -> Axes:
    """Draw the shapes of the modes of a host at its points, with two standard deviations either way where they are not known.

    A host has no geometry: the points stand side by side in its order, and the lines between them only guide the eye.

    Parameters
    ----------
    host : Host
        The host.
    legend : bool, default True
        Add a legend to the axes.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: mass-normalised shapes in 1/sqrt(kg), rad/(m sqrt(kg)) of points that turn.

    Examples
    --------
    >>> import linkwise as lw
    >>> wing = lw.Host("wing", (lw.HostMode(5.2, 0.01, {"tip": 1.0, "joint": 0.62}),))
    >>> [text.get_text() for text in lw.plot.shapes(wing).get_xticklabels()]
    ['tip', 'joint']
    """
    points = list(host.modes[0].shape)
    places = np.arange(len(points), dtype=float)
    with axes_for(ax, legend=legend) as axes:
        axes.axhline(0.0, color="black", linewidth=0.6)
        for number, mode in enumerate(host.modes):
            deviations = [mode.shape_sigma.get(point, 0.0) for point in points]
            axes.errorbar(
                places,
                [mode.shape[point] for point in points],
                [2.0 * sigma if math.isfinite(sigma) else 0.0 for sigma in deviations]
                if any(deviations)
                else None,
                color=SERIES[number % len(SERIES)],
                linestyle=_STYLES[number // len(SERIES) % len(_STYLES)],
                marker="o",
                markersize=3.5,
                linewidth=1.0,
                capsize=2.0,
                label=label(f"mode {number + 1}{_frequency(mode.frequency.value)}"),
            )
        axes.set_xticks(places, [literal(point) for point in points])
        turning = len(host.rotations)
        units = ["1/√kg"] * (turning < len(points)) + ["rad/(m √kg)"] * (turning > 0)
        axes.set_ylabel(f"shape, {' or '.join(units)}")
    return axes


@checked
def shapes_figure(structure: Structure) -> Figure:
    """Shapes of the modes of every host of a structure, one below the other; points that turn in a panel of their own.

    Parameters
    ----------
    structure : Structure
        The structure.

    Returns
    -------
    matplotlib.figure.Figure
        A figure that no window shows; `save` writes it.

    Raises
    ------
    StructureError
        If the structure has no host.

    Examples
    --------
    >>> import linkwise as lw
    >>> wing = lw.Host("wing", (lw.HostMode(5.2, 0.01, {"tip": 1.0, "joint": 0.62}),))
    >>> len(lw.plot.shapes_figure(lw.Structure("wing", (), (), (wing,))).axes)
    1
    """
    hosts = [part for host in structure.hosts for part in _by_unit(host)]
    if not hosts:
        raise StructureError("the structure has no host, whose shapes could be drawn")
    with sheet(len(hosts), height=_HEIGHT * len(hosts), colorbars=True) as (
        figure,
        panels,
    ):  # beside which there is room
        for host, axes in zip(hosts, panels, strict=True):
            shapes(host, legend=False, ax=axes)
            axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
            wrap_title(axes, host.name)
    return figure


def _by_unit(host: Host) -> list[Host]:
    """The host with the points that move along a line, and with those that turn, whose shapes have another size."""
    turning = host.modes[0].rotations
    still = [point for point in host.modes[0].shape if point not in turning]
    groups = [points for points in (still, sorted(turning, key=list(host.modes[0].shape).index)) if points]
    return [host] if len(groups) == 1 else [_at(host, points) for points in groups]


def _at(host: Host, points: list[str]) -> Host:
    """The host with some of its points."""
    modes = (
        replace(
            mode,
            shape={point: mode.shape[point] for point in points},
            shape_sigma={point: sigma for point, sigma in mode.shape_sigma.items() if point in points},
            rotations=mode.rotations & frozenset(points),
        )
        for mode in host.modes
    )
    return replace(host, modes=tuple(modes))


def _frequency(value: float | None) -> str:
    return "" if value is None else f", {value:.4g} Hz"
