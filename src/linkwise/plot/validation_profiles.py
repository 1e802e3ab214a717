"""Where in the motion a prediction fails: over elongation and velocity of the links, and over frequency."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from linkwise.argument_types import checked
from linkwise.display import near_miss
from linkwise.errors import RecordError
from linkwise.identification.validation.result import Validation
from linkwise.plot.palette import IDENTIFIED, MEASURED, WELL, scale
from linkwise.plot.style import axes_for, legend_below, literal, log_scale, sheet

_MOST = 4  # links or channels that still can be read on one page


@checked
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
    if quantity not in known:
        raise RecordError(
            f"unknown quantity {quantity!r}{near_miss(quantity, known)}; choose from {', '.join(known)}"
        )
    profile = known[quantity]
    factor, unit = scale(float(np.abs(profile.edges).max()), profile.unit)
    with axes_for(ax) as axes:
        axes.stairs(
            profile.error_percent, profile.edges * factor, color=IDENTIFIED, linewidth=1.4, baseline=None
        )
        axes.set_xlabel(f"{literal(quantity)}, {unit}")
        axes.set_ylabel("error, % of the motion")
        axes.set_xlim(profile.edges[0] * factor, profile.edges[-1] * factor)
        axes.set_ylim(bottom=0.0)
    return axes


@checked
def prediction_spectrum(
    validation: Validation, channel: str, *, legend: bool = True, ax: Axes | None = None
) -> Axes:
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
        The axes drawn on: frequency in Hz, and density in the square of the unit of the channel over Hz.

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
    if channel not in validation.spectra:
        raise RecordError(
            f"there is no spectrum of {channel!r}; choose from {', '.join(validation.spectra) or 'none'}"
        )
    spectrum, score = validation.spectra[channel], validation.channels[channel]
    noise = 2.0 * score.noise**2 / validation.record.rate
    with axes_for(ax, legend=legend) as axes:
        axes.plot(spectrum.frequency, spectrum.measured, color=MEASURED, linewidth=1.4, label="measured")
        axes.plot(spectrum.frequency, spectrum.error, color=IDENTIFIED, linewidth=1.0, label="error")
        axes.axhline(noise, color=WELL, linestyle=(0, (4, 3)), linewidth=1.0, label="noise")
        log_scale(axes, "y")
        axes.set_xlim(0.0, spectrum.frequency[-1])
        axes.set_xlabel("frequency, Hz")
        axes.set_ylabel(f"{literal(channel)}, ({score.unit})²/Hz")
    return axes


@checked
def prediction_profile_figure(validation: Validation) -> Figure:
    """The error over elongation and velocity of each link; of more than 4 links the first.

    Parameters
    ----------
    validation : Validation
        What `linkwise.validate` returned.

    Returns
    -------
    matplotlib.figure.Figure
        A figure that no window shows; `save` writes it.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 0.1}, duration=0.5, rate=500.0).with_noise(40.0, seed=1)
    >>> result = lw.validate(record, chain)
    >>> len(lw.plot.prediction_profile_figure(result).axes)
    4
    """
    links = [profile.quantity for profile in validation.profiles[1:]][: 2 * _MOST]
    rows = len(links) // 2
    with sheet(rows, 2, height=0.8 + 2.1 * rows) as (figure, panels):
        for axes, quantity in zip(panels, links, strict=True):
            prediction_profile(validation, quantity, ax=axes)
        for axes in panels[1::2]:
            axes.set_ylabel("")
    return figure


@checked
def prediction_spectrum_figure(validation: Validation) -> Figure:
    """The spectra of the channels; of more than 4 the first.

    Parameters
    ----------
    validation : Validation
        What `linkwise.validate` returned.

    Returns
    -------
    matplotlib.figure.Figure
        A figure that no window shows; `save` writes it.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 0.1}, duration=0.5, rate=500.0).with_noise(40.0, seed=1)
    >>> result = lw.validate(record, chain)
    >>> len(lw.plot.prediction_spectrum_figure(result).axes)
    2
    """
    names = list(validation.spectra)[:_MOST]
    with sheet(len(names), height=0.9 + 1.9 * len(names), share_time=True) as (figure, panels):
        for axes, name in zip(panels, names, strict=True):
            prediction_spectrum(validation, name, legend=False, ax=axes)
            axes.label_outer()
        legend_below(figure, panels[0])
    return figure
