"""Time histories of a record."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from linkwise.argument_types import checked
from linkwise.errors import RecordError
from linkwise.estimates.estimate import Estimate
from linkwise.plot.downsample import envelope
from linkwise.plot.palette import SERIES, scale
from linkwise.plot.style import axes_for, label, literal, sheet, wrap_title
from linkwise.records.record import Record

_MOST = 10  # strips that still can be read on one page
_KINDS = {"x": "displacement", "v": "velocity", "a": "acceleration", "force": "force"}


@checked
def histories(
    record: Record | Estimate,
    channels: Sequence[str] | None = None,
    *,
    legend: bool = True,
    ax: Axes | None = None,
) -> Axes:
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
    units = {source.unit(name) for name in names}
    together = _largest(source, names)
    with axes_for(ax, legend=legend and len(names) > 1) as axes:
        for name in names:
            values = source.channel(name)
            largest = together if len(units) == 1 else _largest(source, [name])
            factor, unit = scale(largest, source.unit(name))
            text = label(name if len(units) == 1 else f"{name}, {unit}")
            color = SERIES[source.channels.index(name) % len(SERIES)]
            axes.plot(*envelope(source.time, values * factor), color=color, linewidth=0.7, label=text)
        axes.set_ylabel(_value_label(names, scale(together, units.pop())[1] if len(units) == 1 else ""))
        axes.yaxis.set_major_locator(MaxNLocator(4))
        axes.set_xlim(source.time[0], source.time[-1])
        axes.set_xlabel("time, s")
    return axes


@checked
def histories_figure(record: Record) -> Figure:
    """Each channel over time in a strip of its own; of more than 10 channels the first.

    Parameters
    ----------
    record : Record
        The record.

    Returns
    -------
    matplotlib.figure.Figure
        A figure that no window shows; `save` writes it.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=1.0, rate=1000.0)
    >>> len(lw.plot.histories_figure(record).axes)
    2
    """
    names = _shown(record)
    with sheet(len(names), height=0.9 + 0.95 * len(names), share_time=True) as (figure, strips):
        for axes, name in zip(strips, names, strict=True):
            histories(record, [name], ax=axes)
            axes.label_outer()
        hidden = len(record.channels) - len(names)
        more = f" ({hidden} more channels not shown)" if hidden else ""
        wrap_title(strips[0], f"{record.source or 'record'}{more}")
        figure.align_ylabels()
    return figure


def _shown(record: Record) -> tuple[str, ...]:
    """Inputs, then responses, as many as one page can hold."""
    return (*record.inputs, *record.responses)[:_MOST]


def _largest(record: Record, names: Sequence[str]) -> float:
    """The largest absolute value of the channels, in their SI unit."""
    return max(float(np.nanmax(np.abs(record.channel(name)), initial=0.0)) for name in names)


def _value_label(names: Sequence[str], unit: str) -> str:
    """The name of one channel, the kind of several, and the unit that they share."""
    if len(names) == 1:
        return f"{literal(names[0])}\n{unit}"
    kinds = {name.partition(":")[0] for name in names}
    if not unit or len(kinds) > 1:
        return f"value, {unit}" if unit else "value"
    kind = kinds.pop()
    return f"{_KINDS.get(kind, kind)}, {unit}"
