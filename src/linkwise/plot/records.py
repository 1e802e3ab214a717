"""Channels of a record over time and frequency, and displacements with the range of neighbouring orbits (paper Figs. 2 to
5).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from linkwise.errors import RecordError
from linkwise.estimates.estimate import Estimate
from linkwise.inspection.channel_signal import Coherence, Spectrogram
from linkwise.inspection.result import Inspection
from linkwise.plot.style import (
    IDENTIFIED,
    MEASURED,
    SERIES,
    TRUE,
    VISITED,
    WELL,
    On,
    axes_for,
    envelope,
    heading,
    label,
    legend_below,
    literal,
    log_scale,
    not_shown,
    over_time,
    picture,
    scale,
    sheet,
    strips,
)
from linkwise.records.channel import KINDS, Channel
from linkwise.records.record import Record

if TYPE_CHECKING:  # which takes a twentieth of a second to load
    from linkwise.simulation.simulate import OrbitEnvelope

_MOST = 10  # strips that still can be read on one page


@picture()
def histories(
    axes: Axes, record: Record | Estimate, channels: Sequence[str] | None = None, **on: Unpack[On]
) -> None:
    """Draw channels of a record over time.

    Gaps stay open; of a long record the extremes of every few samples are drawn, which looks the same.

    Parameters
    ----------
    record : Record or Estimate
        A record, or an estimate, whose record is drawn.
    channels : sequence of str, optional
        Names such as ``"x:m1"``. By default all, inputs first, at most 10.
    legend : bool, default True
        Add a legend to the axes where there are several channels.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: time in s; values in the unit on the axis or, where the channels have several, in the legend.

    Raises
    ------
    RecordError
        If there is no such channel, or none is given.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=1.0, rate=1000.0)
    >>> ax = lw.plot.histories(record, ["x:m1", "x:m2"])
    >>> ax.get_ylabel()
    'displacement, mm'
    """
    source = record.record if isinstance(record, Estimate) else record
    names = _shown(source) if channels is None else tuple(channels)
    if not names:
        raise RecordError(f"no channel to draw; choose from {', '.join(source.channels)}")
    alike = len({source.unit(name) for name in names}) == 1
    for name in names:
        factor, unit = scale(source.select(names if alike else [name]).values, source.unit(name))
        text = label(name if alike else f"{name}, {unit}") if len(names) > 1 else None
        color = SERIES[source.channels.index(name) % len(SERIES)]
        values = factor * source.channel(name)
        axes.plot(*envelope(source.time, values), color=color, lw=0.7, label=text)
    common = unit if alike else ""
    over_time(axes, source.time, _value_label(source.select(names).channels, common))


def histories_figure(record: Record) -> Figure:
    """Each channel over time in a strip of its own; of more than 10 channels the first."""
    channels = (*record.inputs, *record.responses)
    title = f"{record.source or 'record'}{not_shown(channels, _MOST, 'channels')}"
    draws = [partial(histories, record, [name]) for name in channels[:_MOST]]
    return strips(draws, (0.9, 0.95), title=title, legend=False)


def _shown(record: Record) -> tuple[str, ...]:
    """Inputs, then responses, as many as one page can hold."""
    return (*record.inputs, *record.responses)[:_MOST]


def _value_label(channels: Sequence[Channel], unit: str) -> str:
    """The name of one channel, the quantity of several, and the unit that they share."""
    if len(channels) == 1:
        return f"{literal(channels[0])}\n{unit}"
    quantities = {KINDS[channel.kind].quantity for channel in channels}
    return ", ".join(filter(None, [quantities.pop() if unit and len(quantities) == 1 else "value", unit]))


@picture()
def spectrum(axes: Axes, record: Record, name: str, noise: float | None = None, **on: Unpack[On]) -> None:
    """Draw the amplitude spectral density of a channel over frequency.

    Parameters
    ----------
    record : Record
        The record.
    name : str
        Name of the channel.
    noise : float, optional
        Standard deviation of its noise in its SI unit: the level of white noise is drawn.
    legend : bool, default True
        Add a legend to the axes where the noise is drawn.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: frequency in Hz, density per root Hz in the unit of the channel, with a prefix.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=1.0, rate=1000.0)
    >>> ax = lw.plot.spectrum(record, "x:m1")
    >>> ax.get_xlabel()
    'frequency, Hz'
    """
    spectrogram = Spectrogram.of(record.channel(name), record.rate)
    factor, unit = scale(record.channel(name), record.unit(name))
    density = np.sqrt(spectrogram.mean[1:-1]) * factor
    color = SERIES[record.channels.index(name) % len(SERIES)]
    noisy = noise is not None and noise > 0.0 and bool(density.any())
    if density.any():
        text = label(name) if noisy else None
        axes.plot(spectrogram.frequency[1:-1], density, color=color, lw=0.9, label=text)
        log_scale(axes, "y")
    if noise is not None and noisy:
        level = factor * noise * (2.0 / record.rate) ** 0.5
        axes.axhline(level, color=WELL if color != WELL else MEASURED, ls="--", lw=0.8, label="noise")
    axes.set(xlim=spectrogram.frequency[[1, -2]], xlabel="frequency, Hz")
    log_scale(axes, "x")
    axes.set_ylabel(f"{literal(name)}\n{unit}/√Hz")


def spectra_figure(inspection: Inspection, number: int = 0) -> Figure:
    """The spectrum of each channel of one record in a strip of its own, noise dashed; of more than 10 channels the first."""
    record = inspection.records[number]
    of = {summary.name: summary.noise for summary in inspection.channels_of(number)}
    draws = [partial(spectrum, record, name, of[name], legend=False) for name in _shown(record)]
    return strips(draws, (0.9, 1.1), legend=False)


_DECADES = 8.0  # of the power that colours tell apart, below its largest value


def spectrogram(record: Record, name: str, *, ax: Axes | None = None) -> Axes:
    """Draw the spectral density of a channel over time and frequency, dark where it is large.

    Parameters
    ----------
    record : Record
        The record.
    name : str
        Name of the channel.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: time in s, frequency in Hz; colours are logarithmic over eight decades at most.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=1.0, rate=1000.0)
    >>> lw.plot.spectrogram(record, "x:m1").get_xlabel()
    'time, s'
    """
    density = Spectrogram.of(record.channel(name), record.rate)
    largest = float(density.power.max(initial=0.0))
    with axes_for(ax) as axes:
        if largest > 0.0:
            power = np.maximum(density.power.T, largest * 10.0**-_DECADES)
            norm = LogNorm(max(float(np.quantile(power, 0.05)), largest * 10.0**-_DECADES), largest)
            time = record.start + density.time
            axes.pcolormesh(time, density.frequency, power, norm=norm, cmap="Greys", rasterized=True)
        axes.set(ylim=(0.0, 0.5 * record.rate), xlabel="time, s", ylabel=f"{literal(name)}\nHz")
    return axes


@picture()
def coherence(axes: Axes, record: Record, first: str, second: str, **on: Unpack[On]) -> None:
    """Draw the coherence of two channels over frequency: the part of the power of one that follows linearly from the other.

    Parameters
    ----------
    record : Record
        The record.
    first, second : str
        Names of the channels.
    legend : bool, default True
        Add a legend to the axes.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: frequency in Hz, coherence from 0 to 1, and what independent noise exceeds in one of 20 frequencies.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=1.0, rate=1000.0)
    >>> lw.plot.coherence(record, "x:m1", "x:m2").get_xlabel()
    'frequency, Hz'
    """
    estimate = Coherence.of(record.channel(first), record.channel(second), record.rate)
    axes.plot(estimate.frequency[1:], estimate.values[1:], color=SERIES[0], lw=0.9, label="coherence")
    axes.axhline(estimate.by_chance, color=MEASURED, ls="--", lw=0.8, label="noise")
    axes.set(xlim=(0.0, 0.5 * record.rate), ylim=(0.0, 1.0))
    axes.set(xlabel="frequency, Hz", ylabel=f"{literal(first)}\n{literal(second)}")


def spectrograms_figure(inspection: Inspection, number: int = 0) -> Figure:
    """Each channel of one record over time and frequency, in a strip of its own; of more than 10 channels the first."""
    record = inspection.records[number]
    return strips([partial(spectrogram, record, name) for name in _shown(record)], (0.9, 1.3), legend=False)


def coherences_figure(inspection: Inspection, number: int = 0) -> Figure:
    """The coherence of each channel of one record with the next; of more than 10 pairs the first."""
    record = inspection.records[number]
    pairs = list(pairwise((*record.inputs, *record.responses)))[:_MOST]
    return strips(
        [partial(coherence, record, *pair, legend=False) for pair in pairs], (0.9, 1.1), legend=False
    )


_PANEL_HEIGHT = 1.5  # inches
_BLOCK = 10  # samples of a range drawn as one: narrower than a line


@picture()
def displacement(
    axes: Axes, envelope: OrbitEnvelope, mass: str, *, without: OrbitEnvelope | None = None, **on: Unpack[On]
) -> None:
    """Draw the displacement of a mass after a release over time, with sinks and without them where both are given.

    Past the horizon of a chaotic motion the axes are shaded and the range of neighbouring orbits is shown: the curve is one
    of many there.

    Parameters
    ----------
    envelope : OrbitEnvelope
        What `linkwise.analysis.orbit_envelope` returned.
    mass : str
        Name of the mass.
    without : OrbitEnvelope, optional
        The motion of the same mass in the structure without its sinks, drawn beside.
    legend : bool, default True
        Add a legend to the axes.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: time in s, displacement in m, mm or um as the axis label says.

    Raises
    ------
    RecordError
        If there is no such mass.

    Examples
    --------
    >>> import linkwise as lw
    >>> motion = lw.analysis.orbit_envelope(lw.bnes_chain(2), {"v:m1": 1.0}, duration=1.0, rate=1000.0)
    >>> lw.plot.displacement(motion, "m1").get_ylabel()
    'x, mm'
    """
    for argument, given in (("envelope", envelope), ("without", without or envelope)):
        if mass not in given.masses:
            raise RecordError(f'{argument}: no mass "{mass}"; the masses are {", ".join(given.masses)}')
    channel, shown = f"x:{mass}", [("this orbit", IDENTIFIED, envelope.record)]
    if without is not None:
        shown = [("without sinks", MEASURED, without.record), ("with sinks", IDENTIFIED, envelope.record)]
    largest = max(float(np.abs(record.channel(channel)).max()) for _, _, record in shown)
    factor, unit = scale(largest, envelope.record.unit(channel))
    _draw_range(axes, envelope, mass, factor)
    for name, color, record in shown:
        x = record.channel(channel) * factor
        axes.plot(record.time, x, color=color, lw=0.8, zorder=3, label=name)
    over_time(axes, envelope.record.time, f"x, {unit}")


def displacements_figure(
    envelope: OrbitEnvelope,
    *,
    without: OrbitEnvelope | None = None,
    columns: int = 1,
    titles: Sequence[str] = (),
) -> Figure:
    """The displacement of every mass after a release in a panel of its own, lettered row by row."""
    masses = (without or envelope).masses
    rows = -(-len(masses) // columns)
    with sheet(rows, columns, height=0.8 + _PANEL_HEIGHT * rows) as (figure, panels):
        for number, (axes, mass) in enumerate(zip(panels, masses, strict=False)):
            displacement(envelope, mass, without=without, legend=False, ax=axes)
            letter = f"{'abcdefghijklmnopqrstuvwxyz'[number % 26]}  " if len(masses) > 1 else ""
            axes.set_title(literal(f"{letter}{(titles if len(titles) else masses)[number]}"))
            if number < len(masses) - columns:
                axes.set_xlabel("")
                axes.tick_params(labelbottom=False)
        for axes in panels[len(masses) :]:
            axes.set_visible(False)
        figure.align_ylabels()
        if len(panels[0].get_legend_handles_labels()[1]) > 1:
            legend_below(figure, panels[0], columns=4)
        if envelope.horizon is not None:
            told_apart = f"Past {envelope.horizon:.2f} s no orbit can be told apart from its neighbours"
            heading(figure, f"{told_apart}: the curve is one of many.", size=9.0)
    return figure


def _draw_range(axes: Axes, envelope: OrbitEnvelope, mass: str, factor: float) -> None:
    """Shade what lies past the horizon, and the range of neighbouring orbits there, in m times `factor`."""
    time, horizon = envelope.record.time, envelope.horizon
    if horizon is None or horizon >= time[-1]:
        return
    column = envelope.masses.index(mass)
    starts = np.arange(int(np.searchsorted(time, horizon)), len(time), _BLOCK)
    axes.axvspan(horizon, time[-1], color=VISITED, zorder=0, label="past the horizon")
    lower = np.minimum.reduceat(envelope.least[:, column], starts) * factor
    upper = np.maximum.reduceat(envelope.greatest[:, column], starts) * factor
    style: dict[str, Any] = {"color": IDENTIFIED, "alpha": 0.22, "lw": 0, "zorder": 1}
    axes.fill_between(time[starts], lower, upper, label="range of neighbouring orbits", **style)
    axes.axvline(horizon, color=TRUE, lw=0.7, ls=(0, (3, 2)), zorder=4)
