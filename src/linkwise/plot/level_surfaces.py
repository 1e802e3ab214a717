"""Restoring force per mass at a sensor over displacement and velocity, before any model."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from linkwise.argument_types import checked
from linkwise.arrays import Indices
from linkwise.inspection.levels.result import LevelComparison
from linkwise.plot.downsample import scattered
from linkwise.plot.palette import SERIES, scale
from linkwise.plot.style import axes_for, literal, sheet

_AT_REST = 0.05  # of the largest velocity: samples that show the force of the stiffness alone


@checked
def acceleration_surface(
    comparison: LevelComparison,
    *,
    number: int = 0,
    section: bool = False,
    legend: bool = True,
    ax: Axes | None = None,
) -> Axes:
    """Draw the acceleration at a sensor, with the sign reversed, over displacement and velocity: restoring force per mass.

    Parameters
    ----------
    comparison : LevelComparison
        What `linkwise.compare_levels` returned.
    number : int, default 0
        Place of the sensor in ``comparison.surfaces``.
    section : bool, default False
        Draw the section at no velocity over displacement in place of the surface: a straight line where the stiffness is
        linear.
    legend : bool, default True
        Add a legend to the axes.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes; a colour bar is set
        beside those of a surface.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: displacement in m, and velocity in m/s or restoring force per mass in m/s^2, with prefixes as the
        labels say.

    Examples
    --------
    >>> import linkwise as lw
    >>> found = lw.compare_levels([lw.read_record("soft_tap.csv"), lw.read_record("hard_tap.csv")])
    >>> lw.plot.acceleration_surface(found, section=True).get_ylabel()
    'restoring force per mass, m/s^2'
    """
    surface = comparison.surfaces[number]
    velocity, force = surface.velocity, -surface.acceleration
    to_d, unit_d = scale(float(np.abs(surface.displacement).max()), surface.unit)
    to_v, unit_v = scale(float(np.abs(velocity).max()), f"{surface.unit}/s")
    of_force = f"restoring force per mass, {surface.unit}/s^2"
    some: slice | Indices = scattered(len(force))
    if section:
        some = np.flatnonzero(np.abs(velocity) < _AT_REST * np.abs(velocity).max())
    with axes_for(ax, legend=legend, colorbars=not section) as axes:
        axes.set_xlabel(f"displacement of {literal(surface.channel)}, {unit_d}")
        if section:
            axes.plot(
                surface.displacement[some] * to_d,
                force[some],
                ".",
                color=SERIES[0],
                markersize=2.0,
                label="at no velocity",
            )
            axes.set_ylabel(of_force)
        else:
            bound = float(np.abs(force).max())
            points = axes.scatter(
                surface.displacement[some] * to_d,
                velocity[some] * to_v,
                c=force[some],
                s=2.0,
                cmap="RdBu_r",
                vmin=-bound,
                vmax=bound,
                rasterized=True,
                label="while no force acts",
            )
            axes.figure.colorbar(points, ax=axes, label=of_force)
            axes.set_ylabel(f"velocity, {unit_v}")
    return axes


@checked
def acceleration_surfaces_figure(comparison: LevelComparison) -> Figure:
    """Restoring force per mass at each sensor that moves most, over displacement and velocity and at no velocity.

    Parameters
    ----------
    comparison : LevelComparison
        What `linkwise.compare_levels` returned.

    Returns
    -------
    matplotlib.figure.Figure
        A figure that no window shows; `save` writes it.

    Examples
    --------
    >>> import linkwise as lw
    >>> found = lw.compare_levels([lw.read_record("soft_tap.csv"), lw.read_record("hard_tap.csv")])
    >>> len(lw.plot.acceleration_surfaces_figure(found).axes)  # one for the colours
    3
    """
    rows = len(comparison.surfaces)
    with sheet(rows, 2, height=0.6 + 2.4 * rows, colorbars=True) as (figure, panels):
        for number in range(rows):
            acceleration_surface(comparison, number=number, legend=False, ax=panels[2 * number])
            acceleration_surface(
                comparison, number=number, section=True, legend=False, ax=panels[2 * number + 1]
            )
    return figure
