"""Time histories of a record, one strip a channel."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from linkwise.plot.downsample import envelope
from linkwise.plot.palette import SERIES, scale
from linkwise.plot.style import sheet
from linkwise.records.record import Record

MOST = 10  # strips that still can be read on one page


def shown_channels(record: Record) -> tuple[str, ...]:
    """Inputs, then responses, as many as one page can hold."""
    return (*record.inputs, *record.responses)[:MOST]


def histories_figure(record: Record) -> Figure:
    """Each channel of `record` over time; gaps stay open, long records are drawn by their extremes."""
    names = shown_channels(record)
    with sheet(len(names), height=0.9 + 0.95 * len(names)) as (figure, strips):
        for number, (axes, name) in enumerate(zip(strips, names, strict=True)):
            values = record.channel(name)
            factor, unit = scale(float(np.nanmax(np.abs(values), initial=0.0)), record.unit(name))
            axes.plot(
                *envelope(record.time, values * factor), color=SERIES[number % len(SERIES)], linewidth=0.7
            )
            axes.set_ylabel(f"{name}\n{unit}")
            axes.yaxis.set_major_locator(MaxNLocator(4))
            axes.set_xlim(record.time[0], record.time[-1])
            axes.tick_params(labelbottom=number == len(names) - 1)
        strips[-1].set_xlabel("time, s")
        hidden = len(record.channels) - len(names)
        more = f" ({hidden} more channels not shown)" if hidden else ""
        strips[0].set_title(f"{record.source or 'record'}{more}")
        figure.align_ylabels()
    return figure
