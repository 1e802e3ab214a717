"""What a fit leaves of the channels, against time, frequency and the motion of links; shapes of hosts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Unpack

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from linkwise.arrays import Floats
from linkwise.display import near_miss
from linkwise.errors import RecordError, StructureError, require_known
from linkwise.estimates.curves import MeanResiduals
from linkwise.estimates.estimate import Estimate
from linkwise.inspection.channel_signal import Spectrogram
from linkwise.model.host import Host
from linkwise.model.structure import Structure
from linkwise.plot.style import (
    IDENTIFIED,
    MEASURED,
    SERIES,
    TRUE,
    On,
    envelope,
    error_bars,
    label,
    legend_below,
    literal,
    log_scale,
    picture,
    scale,
    sheet,
    wrap_title,
)
from linkwise.records.record import Record

_MOST = 4  # channels that still can be read on one page
OVERLAID = 3  # channels of which measured and fitted are seen at a glance
_MEASURED: dict[str, Any] = {"color": MEASURED, "lw": 1.8, "label": "measured"}
_FITTED: dict[str, Any] = {"color": IDENTIFIED, "lw": 0.7, "label": "fitted"}
_APART = 8  # standard deviations of noise between the channels over time


@picture()
def residuals(axes: Axes, estimate: Estimate, channel: str, quantity: str = "time", **on: Unpack[On]) -> None:
    """Draw what a fit leaves of a channel, in standard deviations of its noise.

    Over time all of it; over frequency its spectral density beside that of white noise; over the motion of a link its mean
    in parts of the range, beside the band in which noise alone leaves 95 % of such means.

    Parameters
    ----------
    estimate : Estimate
        An estimate by maximum likelihood.
    channel : str
        A response of its record.
    quantity : str, default "time"
        ``"time"``, ``"frequency"``, ``"d of LINK"`` or ``"v of LINK"``.
    legend : bool, default True
        Add a legend to the axes where noise is drawn.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: the quantity in the unit on the axis, and residuals over the noise.

    Raises
    ------
    RecordError
        If the estimate has no residuals of such a channel, or there is no such quantity.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=1.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> lw.plot.residuals(lw.identify(record, chain.unknown("nes")), "x:m2", "d of nes1").get_ylabel()
    'x:m2 / noise'
    """
    left = estimate.motion.residuals or {}
    if channel not in left:
        known = ", ".join(left) or "none: maximum likelihood alone tells them"
        hint = near_miss(channel, left)
        raise RecordError(f"there are no residuals of {channel!r}{hint}; choose from {known}")
    quantities = ("time", "frequency", *(f"{kind} of {link}" for link in _links(estimate) for kind in "dv"))
    require_known("quantity", quantity, quantities, RecordError)
    if quantity == "time":
        axes.plot(*envelope(estimate.motion.time, left[channel]), color=IDENTIFIED, lw=0.6)
        axes.set_xlabel("time, s")
    elif quantity == "frequency":
        _over_frequency(axes, left[channel], estimate.record.rate, color=IDENTIFIED, label="residuals")
        _draw_white_noise(axes)
    else:
        kind, _, link = quantity.partition(" of ")
        along = _link_motion(estimate, kind, link)
        of_d, of_v = estimate.structure.link(link).law.motion_units
        factor, unit = scale(along, of_d if kind == "d" else of_v)
        band = _over_motion(axes, left[channel], along, factor, color=IDENTIFIED, label="mean")
        _draw_chance_band(axes, *band)
        axes.set_xlabel(f"{literal(quantity)}, {unit}")
    axes.set_ylabel(f"{literal(channel)} / noise")


def _links(estimate: Estimate) -> list[str]:
    return [link.name for link in estimate.structure.links]


def _over_frequency(axes: Axes, values: Floats, rate: float, **style: Any) -> None:
    """The spectral density in units of that of white noise."""
    spectrogram = Spectrogram.of(values, rate)
    density = spectrogram.mean[1:-1] * (0.5 * rate)
    axes.plot(spectrogram.frequency[1:-1], density, **{"lw": 0.9, **style})
    if density.any():
        log_scale(axes, "y")
    axes.set(xlim=spectrogram.frequency[[1, -2]], xlabel="frequency, Hz")
    log_scale(axes, "x")


def _over_motion(axes: Axes, values: Floats, along: Floats, factor: float, **style: Any) -> Floats:
    """Means over parts of the range with equally many samples, at the motion times `factor`; returns the band of noise."""
    means = MeanResiduals.along(along, values)
    axes.plot(factor * means.place, means.mean, **{"lw": 1.2, "marker": "o", "ms": 2.5, **style})
    return np.stack([factor * means.place, means.by_chance])


def _link_motion(estimate: Estimate, kind: str, link: str) -> Floats:
    """(N,) elongation or rate of a link."""
    along: Floats = (estimate.motion.d if kind == "d" else estimate.motion.v)[:, _links(estimate).index(link)]
    return along


def _draw_white_noise(axes: Axes) -> None:
    axes.axhline(1.0, color=TRUE, ls="--", lw=0.8, label="white noise")


def _draw_chance_band(axes: Axes, place: Floats, chance: Floats) -> None:
    axes.fill_between(place, -chance, chance, color=MEASURED, alpha=0.3, lw=0.0, label="95 % of noise")


def residuals_figure(estimate: Estimate) -> Figure:
    """What a fit leaves of its channels over time, frequency and the motion of links; of more than 4 channels the first.

    Over time the channels stand one below the other. The motion is that of a link at the mass of the channel, the last of
    them, as a part of its largest."""
    left = dict(list((estimate.motion.residuals or {}).items())[:_MOST])
    with sheet(2, 2, width=8.0, height=5.2) as (figure, (over_time, over_frequency, *over_motion)):
        for row, (name, values) in enumerate(left.items()):
            color, link = SERIES[row], _link_at(estimate, name)
            trace = envelope(estimate.motion.time, values - _APART * row)
            over_time.plot(*trace, color=color, lw=0.5)
            _over_frequency(over_frequency, values, estimate.record.rate, color=color)
            for axes, kind in zip(over_motion, "dv", strict=True):
                along = _link_motion(estimate, kind, link)
                largest = float(np.max(np.abs(along))) or 1.0
                text = f"{label(name)} over {literal(link)}"
                band = _over_motion(axes, values, along, 1.0 / largest, color=color, label=text)
                if row == 0:
                    _draw_chance_band(axes, *band)
                axes.set_xlabel(f"{kind} / largest {kind}")
        _draw_white_noise(over_frequency)
        over_time.set(xlabel="time, s", ylabel=f"residual / noise, {_APART} apart")
        over_time.set_yticks(-_APART * np.arange(len(left)), [literal(name) for name in left])
        over_frequency.set_ylabel("density / white")
        for axes in over_motion:
            axes.set_ylabel("mean / noise")
        legend_below(figure, over_motion[0], over_frequency, columns=3)
    return figure


def fit_figure(record: Record, channels: Mapping[str, tuple[Floats, Floats]]) -> Figure:
    """Channels (N,) of a record as measured over what a fit says they show, in time and frequency; of more than 3 the first
    ones."""
    overlaid = list(channels.items())[:OVERLAID]
    with sheet(len(overlaid), 2, height=1.0 + 1.3 * len(overlaid)) as (figure, panels):
        for row, (name, (measured, fitted)) in enumerate(overlaid):
            over_time, over_frequency = panels[2 * row : 2 * row + 2]
            factor, unit = scale(measured, record.unit(name))
            for shown, style in ((measured, _MEASURED), (fitted, _FITTED)):
                over_time.plot(*envelope(record.time, shown * factor, 1500), **style)
                spectrogram = Spectrogram.of(shown, record.rate)
                density = np.sqrt(spectrogram.mean[1:-1]) * factor
                over_frequency.plot(spectrogram.frequency[1:-1], density, **style)
            over_time.set(xlim=record.time[[0, -1]], ylabel=f"{literal(name)}, {unit}")
            over_frequency.set(xlim=spectrogram.frequency[[1, -2]], ylabel=f"{unit}/√Hz")
            log_scale(over_frequency, "x")
            log_scale(over_frequency, "y")
        for axes in panels[:-2]:  # whose range is that of the lowest
            axes.tick_params(which="both", labelbottom=False)
        panels[-2].set_xlabel("time, s")
        panels[-1].set_xlabel("frequency, Hz")
        legend_below(figure, panels[0])
    return figure


def _link_at(estimate: Estimate, channel: str) -> str:
    """The last link that ends at the place that a channel shows, or the last of all."""
    place, links = channel.rpartition(":")[2], estimate.structure.links
    at = [link.name for link in links if place in (*link.between, link.name)]
    return at[-1] if at else links[-1].name


_HEIGHT = 3.0  # inches of a panel


@picture()
def shapes(axes: Axes, host: Host, points: Sequence[str] = (), **on: Unpack[On]) -> None:
    """Draw the shapes of the modes of a host at its points, with two standard deviations either way where they are not known.

    A host has no geometry: the points stand side by side in its order, and the lines between them only guide the eye.

    Parameters
    ----------
    host : Host
        The host.
    points : sequence of str, optional
        Points that are shown. By default all.
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
    >>> wing = lw.Host("wing", (lw.model.HostMode(5.2, 0.01, {"tip": 1.0, "joint": 0.62}),))
    >>> [text.get_text() for text in lw.plot.shapes(wing).get_xticklabels()]
    ['tip', 'joint']
    """
    points = list(points or host.modes[0].shape)
    places = np.arange(len(points), dtype=float)
    axes.axhline(0.0, color="black", lw=0.6)
    for number, mode in enumerate(host.modes):
        hz = "" if mode.frequency.value is None else f", {mode.frequency.value:.4g} Hz"
        deviations = [mode.shape_sigma.get(point, 0.0) for point in points]
        bars = [2.0 * sigma if math.isfinite(sigma) else 0.0 for sigma in deviations]
        shape, ends = [mode.shape[point] for point in points], bars if any(deviations) else None
        error_bars(axes, number, f"mode {number + 1}{hz}", places, shape, ends)
    axes.set_xticks(places, [literal(point) for point in points])
    turning = len(host.modes[0].rotations.intersection(points))
    units = ["1/√kg"] * (turning < len(points)) + ["rad/(m √kg)"] * (turning > 0)
    axes.set_ylabel(f"shape, {' or '.join(units)}")


def shapes_figure(structure: Structure) -> Figure:
    """Shapes of the modes of every host of a structure, one below the other; points that turn in a panel of their own."""
    parts = [(host, points) for host in structure.hosts for points in _by_unit(host)]
    if not parts:
        raise StructureError("the structure has no host, whose shapes could be drawn")
    # beside which there is room
    with sheet(len(parts), height=_HEIGHT * len(parts)) as (figure, panels):
        for (host, points), axes in zip(parts, panels, strict=True):
            shapes(host, points, legend=False, ax=axes)
            axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
            wrap_title(axes, host.name)
    return figure


def _by_unit(host: Host) -> list[list[str]]:
    """The points that move along a line, and those that turn, whose shapes have another size."""
    turning = host.modes[0].rotations
    still = [point for point in host.modes[0].shape if point not in turning]
    return [points for points in (still, sorted(turning, key=list(host.modes[0].shape).index)) if points]
