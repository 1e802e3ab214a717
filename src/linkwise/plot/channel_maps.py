"""Channels of a record over time and frequency at once, and how they go together over frequency."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from linkwise.argument_types import checked
from linkwise.inspection.result import Inspection
from linkwise.inspection.spectrum import Coherence, Spectrogram
from linkwise.plot.palette import MEASURED, SERIES
from linkwise.plot.style import axes_for, literal, sheet
from linkwise.records.record import Record

_MOST = 10  # strips that still can be read on one page
_DECADES = 8.0  # of the power that colours tell apart, below its largest value


@checked
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
            axes.pcolormesh(
                record.start + density.time,
                density.frequency,
                power,
                norm=norm,
                cmap="Greys",
                rasterized=True,
            )
        axes.set_ylim(0.0, 0.5 * record.rate)
        axes.set_xlabel("time, s")
        axes.set_ylabel(f"{literal(name)}\nHz")
    return axes


@checked
def coherence(
    record: Record, first: str, second: str, *, legend: bool = True, ax: Axes | None = None
) -> Axes:
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
    with axes_for(ax, legend=legend) as axes:
        axes.plot(
            estimate.frequency[1:], estimate.values[1:], color=SERIES[0], linewidth=0.9, label="coherence"
        )
        axes.axhline(estimate.by_chance, color=MEASURED, linestyle="--", linewidth=0.8, label="noise")
        axes.set_xlim(0.0, 0.5 * record.rate)
        axes.set_ylim(0.0, 1.0)
        axes.set_xlabel("frequency, Hz")
        axes.set_ylabel(f"{literal(first)}\n{literal(second)}")
    return axes


@checked
def spectrograms_figure(inspection: Inspection, number: int = 0) -> Figure:
    """Each channel of one record over time and frequency, in a strip of its own; of more than 10 channels the first.

    Parameters
    ----------
    inspection : Inspection
        What `linkwise.inspect` returned.
    number : int, default 0
        Place of the record in ``inspection.records``, from 0.

    Returns
    -------
    matplotlib.figure.Figure
        A figure that no window shows; `save` writes it.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=1.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> len(lw.plot.spectrograms_figure(lw.inspect(record)).axes)
    2
    """
    record = inspection.records[number]
    names = (*record.inputs, *record.responses)[:_MOST]
    with sheet(len(names), height=0.9 + 1.3 * len(names), share_time=True) as (figure, strips):
        for axes, name in zip(strips, names, strict=True):
            spectrogram(record, name, ax=axes)
            axes.label_outer()
        figure.align_ylabels()
    return figure


@checked
def coherences_figure(inspection: Inspection, number: int = 0) -> Figure:
    """The coherence of each channel of one record with the next; of more than 10 pairs the first.

    Parameters
    ----------
    inspection : Inspection
        What `linkwise.inspect` returned.
    number : int, default 0
        Place of the record in ``inspection.records``, from 0.

    Returns
    -------
    matplotlib.figure.Figure
        A figure that no window shows; `save` writes it.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=1.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> len(lw.plot.coherences_figure(lw.inspect(record)).axes)
    1
    """
    record = inspection.records[number]
    pairs = list(pairwise((*record.inputs, *record.responses)))[:_MOST]
    with sheet(max(len(pairs), 1), height=0.9 + 1.1 * max(len(pairs), 1), share_time=True) as (
        figure,
        strips,
    ):
        for axes, (first, second) in zip(strips, pairs, strict=False):
            coherence(record, first, second, legend=False, ax=axes)
            axes.label_outer()
        figure.align_ylabels()
    return figure
