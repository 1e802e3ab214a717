"""A test at several levels: distortion, modes, response functions, ring-down, and the restoring force before any model."""

from __future__ import annotations

from functools import partial
from itertools import product
from typing import Any, Literal, Unpack

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import CenteredNorm, to_rgb
from matplotlib.figure import Figure

from linkwise.arrays import Indices
from linkwise.inspection.level_comparison import LevelComparison, ring_name
from linkwise.plot.style import (
    MEASURED,
    SERIES,
    On,
    error_bars,
    label,
    literal,
    log_scale,
    picture,
    pictures,
    scale,
    scattered,
    strips,
)

OfMode = Literal["frequency", "damping"]


@picture()
def distortion(axes: Axes, comparison: LevelComparison, **on: Unpack[On]) -> None:
    """Draw odd and even distortion, and the scatter of periods, over the level of a periodic force.

    Parameters
    ----------
    comparison : LevelComparison
        What `linkwise.inspection.compare_levels` returned.
    legend : bool, default True
        Add a legend to the axes.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: force in N, and power over that of the response in dB. Levels without a period are left out.

    Examples
    --------
    >>> import linkwise as lw
    >>> found = lw.inspection.compare_levels([lw.read_record("soft_sine.csv"), lw.read_record("hard_sine.csv")], modes=1)
    >>> [line.get_label() for line in lw.plot.distortion(found).lines]
    ['odd', 'even', 'scatter']
    """
    kinds = (("odd", SERIES[1], "s"), ("even", SERIES[0], "o"), ("noise", MEASURED, "x"))
    for name, colour, marker in kinds:
        powers = [measured and getattr(measured, name) for measured in comparison.distortions]
        pairs = zip(comparison.levels, powers, strict=True)
        points = [(level, power) for level, power in pairs if power is not None]
        text = "scatter" if name == "noise" else name
        if points:
            axes.plot(*np.array(points).T, color=colour, marker=marker, ms=4, lw=1.0, label=text)
    log_scale(axes, "x")
    axes.set_xlabel(literal(comparison.level_name))
    axes.set_ylabel(f"power over that of {literal(comparison.responses[0].response)}, dB")


@picture()
def level_modes(
    axes: Axes, comparison: LevelComparison, quantity: OfMode = "frequency", **on: Unpack[On]
) -> None:
    """Draw how the frequencies or the damping of modes move with the level, with two standard errors either way.

    Parameters
    ----------
    comparison : LevelComparison
        What `linkwise.inspection.compare_levels` returned.
    quantity : {"frequency", "damping"}, optional
        What is drawn.
    legend : bool, default True
        Add a legend to the axes.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: peak of the force or the motion, change of the frequency in %, or damping in % of critical.

    Examples
    --------
    >>> import linkwise as lw
    >>> found = lw.inspection.compare_levels([lw.read_record("soft_tap.csv"), lw.read_record("hard_tap.csv")])
    >>> lw.plot.level_modes(found).get_ylabel()
    'change of frequency, %'
    """
    values, errors = 100.0 * comparison.damping, 100.0 * comparison.damping_errors
    if quantity == "frequency":
        values = 100.0 * comparison.frequency_changes
        errors = 100.0 * comparison.frequency_errors / comparison.frequencies[0]
    values = np.where(comparison.lost, np.nan, values)
    for mode in range(values.shape[1]):
        text = f"mode {mode + 1}, {comparison.frequencies[0, mode]:.4g} Hz"
        error_bars(axes, mode, text, comparison.levels, values[:, mode], 2.0 * errors[:, mode])
    log_scale(axes, "x")
    axes.set_xlabel(literal(comparison.level_name))
    axes.set_ylabel("change of frequency, %" if quantity == "frequency" else "damping, % of critical")


def levels_figure(comparison: LevelComparison) -> Figure:
    """Changes of frequencies and damping of modes over the level."""
    frequency, damping = partial(level_modes, comparison), partial(level_modes, comparison, "damping")
    return pictures([frequency, damping], height=(0.0, 3.2))


_RANGE = (0.15, 1.0)  # of lightness, of the lowest and the highest level


@picture()
def level_response(
    axes: Axes,
    comparison: LevelComparison,
    quantity: Literal["magnitude", "coherence"] = "magnitude",
    **on: Unpack[On],
) -> None:
    """Draw the response function of every level, or its coherence; higher levels are darker.

    Parameters
    ----------
    comparison : LevelComparison
        What `linkwise.inspection.compare_levels` returned.
    quantity : {"magnitude", "coherence"}, optional
        What is drawn.
    legend : bool, default True
        Add a legend to the axes.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: frequency in Hz, and the response per N, or a part of 1.

    Examples
    --------
    >>> import linkwise as lw
    >>> found = lw.inspection.compare_levels([lw.read_record("soft_tap.csv"), lw.read_record("hard_tap.csv")])
    >>> lw.plot.level_response(found, "coherence").get_ylabel()
    'coherence'
    """
    first = comparison.responses[0]
    shades = np.linspace(*_RANGE, len(comparison.levels))
    for response, level, shade in zip(comparison.responses, comparison.levels, shades, strict=True):
        values = response.magnitude if quantity == "magnitude" else response.coherence
        colour = tuple(1.0 - shade * (1.0 - part) for part in to_rgb(SERIES[0]))  # from white on
        text = label(f"{level:.3g} {comparison.unit}")
        axes.plot(response.frequency, values, color=colour, lw=0.9, label=text)
    if quantity == "magnitude":
        log_scale(axes, "y")
        axes.set_ylabel(f"{literal(first.response)}\nper {literal(first.force)}")
    else:
        axes.set(ylabel="coherence", ylim=(-0.03, 1.03))
    highest = max(one.frequency[np.isfinite(one.magnitude)].max() for one in comparison.responses)
    axes.set(xlim=(0.0, float(highest)), xlabel="frequency, Hz")


def level_responses_figure(comparison: LevelComparison) -> Figure:
    """The response function of every level, and its coherence."""
    draw = partial(level_response, comparison, legend=False)
    return strips([draw, partial(draw, "coherence")], (0.0, 2.3), columns=4)


@picture()
def ring_down(
    axes: Axes,
    comparison: LevelComparison,
    quantity: OfMode = "frequency",
    *,
    number: int = 0,
    **on: Unpack[On],
) -> None:
    """Draw the frequency or the damping of a mode over its amplitude as it rings down, with two standard errors either way.

    Parameters
    ----------
    comparison : LevelComparison
        What `linkwise.inspection.compare_levels` returned.
    quantity : {"frequency", "damping"}, optional
        What is drawn.
    number : int, default 0
        Place of the mode in ``comparison.ring_downs``.
    legend : bool, default True
        Add a legend to the axes, which names the mode.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: amplitude in the unit of its channel, with a prefix as the label says, and Hz or %.

    Examples
    --------
    >>> import linkwise as lw
    >>> found = lw.inspection.compare_levels([lw.read_record("soft_tap.csv"), lw.read_record("hard_tap.csv")])
    >>> lw.plot.ring_down(found).get_ylabel()
    'frequency, Hz'
    """
    ring = comparison.ring_downs[number]
    values, errors = ring.frequency, ring.frequency_error
    if quantity == "damping":
        values, errors = 100.0 * ring.damping, 100.0 * ring.damping_error
    color = SERIES[(ring.mode - 1) % len(SERIES)]
    alike = [other.amplitude.max() for other in comparison.ring_downs if other.unit == ring.unit]
    times, unit = scale(alike, ring.unit)
    bars: dict[str, Any] = {"fmt": ".", "elinewidth": 0.8, "label": label(ring_name(ring))}
    axes.errorbar(times * ring.amplitude, values, 2.0 * errors, color=color, **bars)
    log_scale(axes, "x")
    axes.ticklabel_format(axis="y", useOffset=False)
    axes.set_xlabel(f"amplitude of {literal(ring.channel)}, {unit}")
    axes.set_ylabel("frequency, Hz" if quantity == "frequency" else "damping, %")


def ring_down_figure(comparison: LevelComparison) -> Figure:
    """Frequency and damping of each mode that rings down over its amplitude, in a row of its own."""
    shown: product[tuple[int, OfMode]] = product(range(len(comparison.ring_downs)), ("frequency", "damping"))
    draws = [partial(ring_down, comparison, quantity, number=number) for number, quantity in shown]
    titles = [text for ring in comparison.ring_downs for text in (ring_name(ring), "")]
    return pictures(draws, height=(0.6, 1.9), titles=titles, legend_columns=0)


_AT_REST = 0.05  # of the largest velocity: samples that show the force of the stiffness alone


@picture()
def acceleration_surface(
    axes: Axes, comparison: LevelComparison, *, number: int = 0, section: bool = False, **on: Unpack[On]
) -> None:
    """Draw the acceleration at a sensor, with the sign reversed, over displacement and velocity: restoring force per mass.

    Parameters
    ----------
    comparison : LevelComparison
        What `linkwise.inspection.compare_levels` returned.
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
    >>> found = lw.inspection.compare_levels([lw.read_record("soft_tap.csv"), lw.read_record("hard_tap.csv")])
    >>> lw.plot.acceleration_surface(found, section=True).get_ylabel()
    'restoring force per mass, m/s^2'
    """
    surface = comparison.surfaces[number]
    velocity, force = surface.velocity, -surface.acceleration
    to_d, unit_d = scale(surface.displacement, surface.unit)
    to_v, unit_v = scale(velocity, f"{surface.unit}/s")
    of_force = f"restoring force per mass, {surface.unit}/s^2"
    shown: slice | Indices = scattered(len(force))
    if section:
        shown = np.flatnonzero(np.abs(velocity) < _AT_REST * np.abs(velocity).max())
    axes.set_xlabel(f"displacement of {literal(surface.channel)}, {unit_d}")
    if section:
        displacement = surface.displacement[shown] * to_d
        axes.plot(displacement, force[shown], ".", color=SERIES[0], ms=2.0, label="at no velocity")
        axes.set_ylabel(of_force)
    else:
        even = CenteredNorm(halfrange=float(np.abs(force).max()))
        style: dict[str, Any] = {"s": 2.0, "cmap": "RdBu_r", "norm": even, "rasterized": True}
        places = surface.displacement[shown] * to_d, velocity[shown] * to_v
        points = axes.scatter(*places, c=force[shown], label="while no force acts", **style)
        axes.figure.colorbar(points, ax=axes, label=of_force)
        axes.set_ylabel(f"velocity, {unit_v}")


def acceleration_surfaces_figure(comparison: LevelComparison) -> Figure:
    """Restoring force per mass at each sensor that moves most, over displacement and velocity and at no velocity."""
    shown = product(range(len(comparison.surfaces)), (False, True))
    draws = [partial(acceleration_surface, comparison, number=n, section=section) for n, section in shown]
    return pictures(draws, height=(0.6, 2.4), legend_columns=0)
