"""A record beside its prediction: over time, over elongation and velocity of the links, and over frequency."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Unpack

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from linkwise.errors import RecordError, require_known
from linkwise.identification.validation_result import Validation
from linkwise.plot.style import (
    IDENTIFIED,
    MEASURED,
    VISITED,
    WELL,
    On,
    axes_for,
    envelope,
    literal,
    log_scale,
    not_shown,
    over_time,
    picture,
    scale,
    sheet,
    strips,
)

_MOST = 6  # channels that still can be read on one page


@picture()
def prediction(axes: Axes, validation: Validation, channel: str, **on: Unpack[On]) -> None:
    """Draw a channel as measured and as predicted over time.

    Parameters
    ----------
    validation : Validation
        An answer of `linkwise.validate`.
    channel : str
        A response of its record.
    legend : bool, default True
        Add a legend to the axes.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: time in s, and the channel in the unit on the axis; the burn is shaded.

    Raises
    ------
    RecordError
        If there is no such channel.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 0.1}, duration=0.5, rate=500.0).with_noise(40.0, seed=1)
    >>> lw.plot.prediction(lw.validate(record, chain), "x:m1").get_xlabel()
    'time, s'
    """
    record = validation.record
    measured, predicted = record.channel(channel), validation.predicted.channel(channel)
    factor, unit = scale(measured, validation.channels[channel].unit)
    axes.plot(*envelope(record.time, measured * factor), color=MEASURED, lw=1.6, label="measured")
    axes.plot(*envelope(record.time, predicted * factor), color=IDENTIFIED, lw=0.7, label="predicted")
    _frame_over_time(axes, validation, f"{literal(channel)}\n{unit}")


@picture()
def prediction_error(axes: Axes, validation: Validation, channel: str, **on: Unpack[On]) -> None:
    """Draw measured less predicted over time, on a band of twice its expected standard deviation.

    Parameters
    ----------
    validation : Validation
        An answer of `linkwise.validate`.
    channel : str
        A response of its record.
    legend : bool, default True
        Add a legend to the axes.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: time in s, and the error in the unit on the axis; the burn is shaded.

    Raises
    ------
    RecordError
        If there is no such channel.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 0.1}, duration=0.5, rate=500.0).with_noise(40.0, seed=1)
    >>> lw.plot.prediction_error(lw.validate(record, chain), "x:m1").get_xlabel()
    'time, s'
    """
    record = validation.record
    error = record.channel(channel) - validation.predicted.channel(channel)
    deviation = validation.deviation.channel(channel)
    largest = float(np.nanmax(np.abs(error), initial=0.0))
    factor, unit = scale(largest, validation.channels[channel].unit)
    time, upper = envelope(record.time, 2.0 * deviation * factor)
    for side in (-upper, upper):
        axes.plot(time, side, color=WELL, lw=0.8, zorder=4, label="expected, 2 deviations")
    axes.plot(*envelope(record.time, error * factor), color=IDENTIFIED, lw=0.5, zorder=3, label="error")
    _frame_over_time(axes, validation, f"{literal(channel)}\n{unit}")
    span = 1.15 * max(largest * factor, float(np.nanmedian(upper)))
    axes.set_ylim(-span, span)


def prediction_figure(validation: Validation) -> Figure:
    """Measured and predicted channels over time, one below the other."""
    return _channel_strips(validation, prediction, "measured and predicted")


def prediction_error_figure(validation: Validation) -> Figure:
    """The errors of the channels over time, one below the other."""
    return _channel_strips(validation, prediction_error, "measured less predicted")


def _channel_strips(validation: Validation, draw: Callable[..., Axes], title: str) -> Figure:
    names = list(validation.channels)
    title += not_shown(names, _MOST, "channels")
    draws = [partial(draw, validation, name, legend=False) for name in names[:_MOST]]
    return strips(draws, (1.3, 1.15), title=title)


def _frame_over_time(axes: Axes, validation: Validation, name: str) -> None:
    time = validation.record.time
    axes.axvspan(time[0], time[0] + validation.burn, color=VISITED, zorder=0, label="not scored")
    over_time(axes, time, name)


_MOST_PROFILES = 4  # links or channels that still can be read on one page


def prediction_profile(validation: Validation, quantity: str, *, ax: Axes | None = None) -> Axes:
    """Draw the error of a prediction over time, or over the elongation or velocity of a link.

    Parameters
    ----------
    validation : Validation
        An answer of `linkwise.validate`.
    quantity : str
        The quantity of one of its profiles: ``"time"``, ``"d of LINK"`` or ``"v of LINK"``.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: the quantity in the unit on the axis, and the error in % of the RMS of the channels.

    Raises
    ------
    RecordError
        If there is no such quantity.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 0.1}, duration=0.5, rate=500.0).with_noise(40.0, seed=1)
    >>> lw.plot.prediction_profile(lw.validate(record, chain), "d of nes1").get_ylabel()
    'error, % of the motion'
    """
    known = {profile.quantity: profile for profile in validation.profiles}
    require_known("quantity", quantity, known, RecordError)
    profile = known[quantity]
    factor, unit = scale(profile.edges, profile.unit)
    with axes_for(ax) as axes:
        axes.stairs(profile.error_percent, profile.edges * factor, color=IDENTIFIED, lw=1.4, baseline=None)
        axes.set(xlabel=f"{literal(quantity)}, {unit}", ylabel="error, % of the motion")
        axes.set_xlim(profile.edges[0] * factor, profile.edges[-1] * factor)
        axes.set_ylim(bottom=0.0)
    return axes


@picture()
def prediction_spectrum(axes: Axes, validation: Validation, channel: str, **on: Unpack[On]) -> None:
    """Draw the power spectral density of a channel and of the error of its prediction.

    Parameters
    ----------
    validation : Validation
        An answer of `linkwise.validate`.
    channel : str
        A response of its record with a spectrum.
    legend : bool, default True
        Add a legend to the axes.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: frequency in Hz, and density over Hz in the square of the unit of the channel, with a prefix.

    Raises
    ------
    RecordError
        If the channel has no spectrum.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 0.1}, duration=0.5, rate=500.0).with_noise(40.0, seed=1)
    >>> lw.plot.prediction_spectrum(lw.validate(record, chain), "x:m1").get_xlabel()
    'frequency, Hz'
    """
    require_known("spectrum of", channel, validation.spectra, RecordError)
    spectrum, score = validation.spectra[channel], validation.channels[channel]
    noise = 2.0 * score.noise**2 / validation.record.rate
    factor, unit = scale(validation.record.channel(channel), score.unit)
    power = f"{unit}²" if unit.isalpha() else f"({unit})²"
    axes.plot(spectrum.frequency, factor**2 * spectrum.measured, color=MEASURED, lw=1.4, label="measured")
    axes.plot(spectrum.frequency, factor**2 * spectrum.error, color=IDENTIFIED, lw=1.0, label="error")
    axes.axhline(factor**2 * noise, color=WELL, ls=(0, (4, 3)), lw=1.0, label="noise")
    log_scale(axes, "y")
    axes.set(xlim=spectrum.frequency[[1, -1]], xlabel="frequency, Hz")
    log_scale(axes, "x")
    axes.set_ylabel(f"{literal(channel)}, {power}/Hz")


def prediction_profile_figure(validation: Validation) -> Figure:
    """The error over elongation and velocity of each link; of more than 4 links the first."""
    links = [profile.quantity for profile in validation.profiles[1:]][: 2 * _MOST_PROFILES]
    rows = len(links) // 2
    with sheet(rows, 2, height=0.8 + 2.1 * rows) as (figure, panels):
        for number, (axes, quantity) in enumerate(zip(panels, links, strict=True)):
            prediction_profile(validation, quantity, ax=axes)
            axes.set_ylabel("" if number % 2 else axes.get_ylabel())
    return figure


def prediction_spectrum_figure(validation: Validation) -> Figure:
    """The spectra of the channels; of more than 4 the first."""
    names = list(validation.spectra)[:_MOST_PROFILES]
    return strips(
        [partial(prediction_spectrum, validation, name, legend=False) for name in names], (0.9, 1.9)
    )
