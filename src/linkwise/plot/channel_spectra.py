"""Spectra of the channels of a record."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from linkwise.argument_types import checked
from linkwise.inspection.result import Inspection
from linkwise.inspection.spectrum import Spectrogram
from linkwise.plot.palette import MEASURED, SERIES, WELL
from linkwise.plot.style import axes_for, label, literal, log_scale, sheet
from linkwise.records.record import Record

_MOST = 10  # strips that still can be read on one page


@checked
def spectrum(
    record: Record, name: str, noise: float | None = None, *, legend: bool = True, ax: Axes | None = None
) -> Axes:
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
        The axes drawn on: frequency in Hz, density in the unit of the channel per root Hz.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=1.0, rate=1000.0)
    >>> ax = lw.plot.spectrum(record, "x:m1")
    >>> ax.get_xlabel()
    'frequency, Hz'
    """
    spectrogram = Spectrogram.of(record.channel(name), record.rate)
    density = np.sqrt(spectrogram.mean[1:-1])
    color = SERIES[record.channels.index(name) % len(SERIES)]
    noisy = noise is not None and noise > 0.0 and bool(density.any())
    with axes_for(ax, legend=legend and noisy) as axes:
        if density.any():
            axes.plot(spectrogram.frequency[1:-1], density, color=color, linewidth=0.9, label=label(name))
            log_scale(axes, "y")
        if noise is not None and noisy:
            level = noise * (2.0 / record.rate) ** 0.5
            axes.axhline(
                level, color=WELL if color != WELL else MEASURED, linestyle="--", linewidth=0.8, label="noise"
            )
        axes.set_xlim(0.0, 0.5 * record.rate)
        axes.set_xlabel("frequency, Hz")
        axes.set_ylabel(f"{literal(name)}\n{record.unit(name)}/√Hz")
    return axes


@checked
def spectra_figure(inspection: Inspection, number: int = 0) -> Figure:
    """The spectrum of each channel of one record in a strip of its own, noise dashed; of more than 10 channels the first.

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
    >>> len(lw.plot.spectra_figure(lw.inspect(record)).axes)
    2
    """
    record = inspection.records[number]
    names = (*record.inputs, *record.responses)[:_MOST]
    of = {summary.name: summary.noise for summary in inspection.channels_of(number)}
    with sheet(len(names), height=0.9 + 1.1 * len(names), share_time=True) as (figure, strips):
        for axes, name in zip(strips, names, strict=True):
            spectrum(record, name, of[name], legend=False, ax=axes)
            axes.label_outer()
        figure.align_ylabels()
    return figure
