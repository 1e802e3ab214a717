"""A test at several levels: modes, response functions and distortion over the level, and modes as they ring down."""

from __future__ import annotations

from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from linkwise.inspection.levels.result import LevelComparison
from linkwise.plot.palette import MEASURED, SERIES
from linkwise.plot.style import axes_for, label, legend_below, literal, log_scale, sheet

_RANGE = (0.15, 1.0)  # of lightness, of the lowest and the highest level
_FORCE = "peak force, N"


def level_modes(
    comparison: LevelComparison,
    quantity: Literal["frequency", "damping"] = "frequency",
    *,
    legend: bool = True,
    ax: Axes | None = None,
) -> Axes:
    """Draw how the frequencies or the damping of modes move with the level, with two standard errors either way.

    Parameters
    ----------
    comparison : LevelComparison
        What `linkwise.compare_levels` returned.
    quantity : {"frequency", "damping"}, optional
        What is drawn.
    legend : bool, default True
        Add a legend to the axes.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: force in N, change of the frequency in %, or damping in % of the critical one.

    Examples
    --------
    >>> import linkwise as lw
    >>> number = lw.Coefficient.number
    >>> mode = lw.HostMode(number(20.0), number(0.005), {"tip": 1.0})
    >>> beam = lw.Structure("beam", (), (), (lw.Host("beam", (mode,)),))
    >>> taps = [
    ...     lw.simulate(beam, forces={"beam.tip": f"{size}*exp(-((t - 0.1)/0.01)**2)"}, duration=2.0, rate=200.0)
    ...     for size in (1.0, 2.0)
    ... ]
    >>> found = lw.compare_levels([tap.with_noise(40.0, seed=1) for tap in taps])
    >>> lw.plot.level_modes(found).get_ylabel()
    'change of frequency, %'
    """
    values, errors = 100.0 * comparison.damping, 100.0 * comparison.damping_errors
    if quantity == "frequency":
        values = 100.0 * comparison.frequency_changes
        errors = 100.0 * comparison.frequency_errors / comparison.frequencies[0]
    with axes_for(ax) as axes:
        for mode in range(values.shape[1]):
            axes.errorbar(
                comparison.levels,
                values[:, mode],
                2.0 * errors[:, mode],
                color=SERIES[mode % len(SERIES)],
                marker="o",
                markersize=3.5,
                linewidth=1.0,
                capsize=2.0,
                label=label(f"mode {mode + 1}, {comparison.frequencies[0, mode]:.4g} Hz"),
            )
        log_scale(axes, "x")
        axes.set_xlabel(_FORCE)
        axes.set_ylabel("change of frequency, %" if quantity == "frequency" else "damping, % of critical")
        if legend:
            axes.legend()
    return axes


def levels_figure(comparison: LevelComparison) -> Figure:
    """Changes of frequencies and damping of modes over the level.

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
    >>> number = lw.Coefficient.number
    >>> mode = lw.HostMode(number(20.0), number(0.005), {"tip": 1.0})
    >>> beam = lw.Structure("beam", (), (), (lw.Host("beam", (mode,)),))
    >>> taps = [
    ...     lw.simulate(beam, forces={"beam.tip": f"{size}*exp(-((t - 0.1)/0.01)**2)"}, duration=2.0, rate=200.0)
    ...     for size in (1.0, 2.0)
    ... ]
    >>> found = lw.compare_levels([tap.with_noise(40.0, seed=1) for tap in taps])
    >>> len(lw.plot.levels_figure(found).axes)
    2
    """
    with sheet(1, 2, height=3.2) as (figure, panels):
        level_modes(comparison, "frequency", legend=False, ax=panels[0])
        level_modes(comparison, "damping", legend=False, ax=panels[1])
        legend_below(figure, panels[0])
    return figure


def level_response(
    comparison: LevelComparison,
    quantity: Literal["magnitude", "coherence"] = "magnitude",
    *,
    legend: bool = True,
    ax: Axes | None = None,
) -> Axes:
    """Draw the response function of every level, or its coherence; higher levels are darker.

    Parameters
    ----------
    comparison : LevelComparison
        What `linkwise.compare_levels` returned.
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
    >>> number = lw.Coefficient.number
    >>> mode = lw.HostMode(number(20.0), number(0.005), {"tip": 1.0})
    >>> beam = lw.Structure("beam", (), (), (lw.Host("beam", (mode,)),))
    >>> taps = [
    ...     lw.simulate(beam, forces={"beam.tip": f"{size}*exp(-((t - 0.1)/0.01)**2)"}, duration=2.0, rate=200.0)
    ...     for size in (1.0, 2.0)
    ... ]
    >>> found = lw.compare_levels([tap.with_noise(40.0, seed=1) for tap in taps])
    >>> lw.plot.level_response(found, "coherence").get_ylabel()
    'coherence'
    """
    first = comparison.responses[0]
    with axes_for(ax) as axes:
        shades = np.linspace(*_RANGE, len(comparison.levels))
        for each, level, shade in zip(comparison.responses, comparison.levels, shades, strict=True):
            values = each.magnitude if quantity == "magnitude" else each.coherence
            colour = _lighter(SERIES[0], float(shade))
            axes.plot(each.frequency, values, color=colour, linewidth=0.9, label=label(f"{level:.3g} N"))
        if quantity == "magnitude":
            log_scale(axes, "y")
            axes.set_ylabel(f"{literal(first.response)}\nper {literal(first.force)}")
        else:
            axes.set_ylabel("coherence")
            axes.set_ylim(-0.03, 1.03)
        highest = max(each.frequency[np.isfinite(each.magnitude)].max() for each in comparison.responses)
        axes.set_xlim(0.0, float(highest))
        axes.set_xlabel("frequency, Hz")
        if legend:
            axes.legend()
    return axes


def level_responses_figure(comparison: LevelComparison) -> Figure:
    """The response function of every level, and its coherence.

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
    >>> number = lw.Coefficient.number
    >>> mode = lw.HostMode(number(20.0), number(0.005), {"tip": 1.0})
    >>> beam = lw.Structure("beam", (), (), (lw.Host("beam", (mode,)),))
    >>> taps = [
    ...     lw.simulate(beam, forces={"beam.tip": f"{size}*exp(-((t - 0.1)/0.01)**2)"}, duration=2.0, rate=200.0)
    ...     for size in (1.0, 2.0)
    ... ]
    >>> found = lw.compare_levels([tap.with_noise(40.0, seed=1) for tap in taps])
    >>> len(lw.plot.level_responses_figure(found).axes)
    2
    """
    with sheet(2, height=4.6, share_time=True) as (figure, panels):
        level_response(comparison, "magnitude", legend=False, ax=panels[0])
        level_response(comparison, "coherence", legend=False, ax=panels[1])
        panels[0].label_outer()
        figure.align_ylabels()
        legend_below(figure, panels[0], columns=4)
    return figure


def distortion(comparison: LevelComparison, *, legend: bool = True, ax: Axes | None = None) -> Axes:
    """Draw odd and even distortion, and the scatter of periods, over the level of a periodic force.

    Parameters
    ----------
    comparison : LevelComparison
        What `linkwise.compare_levels` returned.
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
    >>> number = lw.Coefficient.number
    >>> mode = lw.HostMode(number(20.0), number(0.005), {"tip": 1.0})
    >>> beam = lw.Structure("beam", (), (), (lw.Host("beam", (mode,)),))
    >>> runs = [
    ...     lw.simulate(beam, forces={"beam.tip": f"{size}*sin(2*pi*16*t)"}, duration=2.0, rate=320.0)
    ...     for size in (1.0, 2.0)
    ... ]
    >>> found = lw.compare_levels([run.with_noise(40.0, seed=1) for run in runs], modes=1)
    >>> [line.get_label() for line in lw.plot.distortion(found).lines]
    ['odd', 'even', 'scatter']
    """
    kinds = (("odd", SERIES[1], "s"), ("even", SERIES[0], "o"), ("noise", MEASURED, "x"))
    with axes_for(ax) as axes:
        for name, colour, marker in kinds:
            points = [
                (level, getattr(each, name))
                for level, each in zip(comparison.levels, comparison.distortions, strict=True)
                if each is not None and getattr(each, name) is not None
            ]
            text = "scatter" if name == "noise" else name
            if points:
                levels, powers = np.array(points).T
                axes.plot(
                    levels, powers, color=colour, marker=marker, markersize=4, linewidth=1.0, label=text
                )
        log_scale(axes, "x")
        axes.set_xlabel(_FORCE)
        axes.set_ylabel(f"power over that of {literal(comparison.responses[0].response)}, dB")
        if legend:
            axes.legend()
    return axes


def distortion_figure(comparison: LevelComparison) -> Figure:
    """Odd and even distortion, and the scatter of periods, over the level on a figure of its own.

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
    >>> number = lw.Coefficient.number
    >>> mode = lw.HostMode(number(20.0), number(0.005), {"tip": 1.0})
    >>> beam = lw.Structure("beam", (), (), (lw.Host("beam", (mode,)),))
    >>> runs = [
    ...     lw.simulate(beam, forces={"beam.tip": f"{size}*sin(2*pi*16*t)"}, duration=2.0, rate=320.0)
    ...     for size in (1.0, 2.0)
    ... ]
    >>> found = lw.compare_levels([run.with_noise(40.0, seed=1) for run in runs], modes=1)
    >>> len(lw.plot.distortion_figure(found).axes)
    1
    """
    with sheet() as (figure, [axes]):
        distortion(comparison, legend=False, ax=axes)
        legend_below(figure, axes)
    return figure


def ring_down(
    comparison: LevelComparison,
    quantity: Literal["frequency", "damping"] = "frequency",
    *,
    number: int = 0,
    legend: bool = True,
    ax: Axes | None = None,
) -> Axes:
    """Draw the frequency or the damping of a mode over its amplitude as it rings down.

    Parameters
    ----------
    comparison : LevelComparison
        What `linkwise.compare_levels` returned.
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
        The axes drawn on: amplitude in the unit of its channel, and Hz or %.

    Examples
    --------
    >>> import linkwise as lw
    >>> number = lw.Coefficient.number
    >>> mode = lw.HostMode(number(20.0), number(0.005), {"tip": 1.0})
    >>> beam = lw.Structure("beam", (), (), (lw.Host("beam", (mode,)),))
    >>> taps = [
    ...     lw.simulate(beam, forces={"beam.tip": f"{size}*exp(-((t - 0.1)/0.01)**2)"}, duration=2.0, rate=200.0)
    ...     for size in (1.0, 2.0)
    ... ]
    >>> found = lw.compare_levels([tap.with_noise(40.0, seed=1) for tap in taps])
    >>> lw.plot.ring_down(found).get_ylabel()
    'frequency, Hz'
    """
    each = comparison.ring_downs[number]
    values = each.frequency if quantity == "frequency" else 100.0 * each.damping
    with axes_for(ax) as axes:
        axes.plot(
            each.amplitude,
            values,
            ".",
            color=SERIES[(each.mode - 1) % len(SERIES)],
            label=label(f"mode {each.mode}"),
        )
        log_scale(axes, "x")
        axes.ticklabel_format(axis="y", useOffset=False)
        axes.set_xlabel(f"amplitude of {literal(each.channel)}, {each.unit}")
        axes.set_ylabel("frequency, Hz" if quantity == "frequency" else "damping, %")
        if legend:
            axes.legend()
    return axes


def ring_down_figure(comparison: LevelComparison) -> Figure:
    """Frequency and damping of each mode that rings down over its amplitude, in a row of its own.

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
    >>> number = lw.Coefficient.number
    >>> mode = lw.HostMode(number(20.0), number(0.005), {"tip": 1.0})
    >>> beam = lw.Structure("beam", (), (), (lw.Host("beam", (mode,)),))
    >>> taps = [
    ...     lw.simulate(beam, forces={"beam.tip": f"{size}*exp(-((t - 0.1)/0.01)**2)"}, duration=2.0, rate=200.0)
    ...     for size in (1.0, 2.0)
    ... ]
    >>> found = lw.compare_levels([tap.with_noise(40.0, seed=1) for tap in taps])
    >>> len(lw.plot.ring_down_figure(found).axes)
    2
    """
    rows = len(comparison.ring_downs)
    with sheet(rows, 2, height=0.6 + 1.9 * rows) as (figure, panels):
        for number, each in enumerate(comparison.ring_downs):
            ring_down(comparison, "frequency", number=number, legend=False, ax=panels[2 * number])
            ring_down(comparison, "damping", number=number, legend=False, ax=panels[2 * number + 1])
            panels[2 * number].set_title(f"mode {each.mode}", loc="left")
    return figure


def _lighter(colour: str, share: float) -> tuple[float, float, float]:
    """From white at 0 to the colour itself at 1."""
    red, green, blue = (int(colour[k : k + 2], 16) / 255.0 for k in (1, 3, 5))
    return 1.0 - share * (1.0 - red), 1.0 - share * (1.0 - green), 1.0 - share * (1.0 - blue)
