"""What a fit leaves of the channels, against time, frequency and the motion of links."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from linkwise.argument_types import checked
from linkwise.arrays import Floats
from linkwise.display import near_miss
from linkwise.errors import RecordError
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.mean_residuals import MeanResiduals
from linkwise.inspection.spectrum import Spectrogram
from linkwise.plot.downsample import envelope
from linkwise.plot.palette import IDENTIFIED, MEASURED, WELL, scale
from linkwise.plot.style import axes_for, literal, log_scale, sheet

_MOST = 4  # channels that still can be read on one page
_SHARED = 2  # first columns, with the same axis for all channels
_ORDINATES = ("", "density / white", "mean / noise")  # over time, over frequency, over the motion of a link


@checked
def residuals(
    estimate: Estimate, channel: str, quantity: str = "time", *, legend: bool = True, ax: Axes | None = None
) -> Axes:
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
        raise RecordError(
            f"there are no residuals of {channel!r}{near_miss(channel, left)}; choose from {known}"
        )
    quantities = ("time", "frequency", *(f"{kind} of {link}" for link in _links(estimate) for kind in "dv"))
    if quantity not in quantities:
        raise RecordError(
            f"unknown quantity {quantity!r}{near_miss(quantity, quantities)}; choose from {', '.join(quantities)}"
        )
    with axes_for(ax, legend=legend and quantity != "time") as axes:
        if quantity == "time":
            axes.plot(*envelope(estimate.motion.time, left[channel]), color=IDENTIFIED, linewidth=0.6)
            axes.set_xlabel("time, s")
        elif quantity == "frequency":
            _over_frequency(axes, left[channel], estimate.record.rate)
        else:
            _over_motion(axes, left[channel], estimate, quantity)
        axes.set_ylabel(f"{literal(channel)} / noise")
    return axes


def _links(estimate: Estimate) -> list[str]:
    return [link.name for link in estimate.structure.links]


def _over_frequency(axes: Axes, values: Floats, rate: float) -> None:
    """The spectral density in units of that of white noise."""
    spectrogram = Spectrogram.of(values, rate)
    density = spectrogram.mean[1:-1] * (0.5 * rate)
    axes.plot(spectrogram.frequency[1:-1], density, color=IDENTIFIED, linewidth=0.9, label="residuals")
    axes.axhline(1.0, color=WELL, linestyle="--", linewidth=0.8, label="white noise")
    if density.any():
        log_scale(axes, "y")
    axes.set_xlim(0.0, 0.5 * rate)
    axes.set_xlabel("frequency, Hz")


def _over_motion(axes: Axes, values: Floats, estimate: Estimate, quantity: str) -> None:
    """Means over parts of the range with equally many samples."""
    kind, _, link = quantity.partition(" of ")
    along = (estimate.motion.d if kind == "d" else estimate.motion.v)[:, _links(estimate).index(link)]
    means = MeanResiduals.along(along, values)
    of_d, of_v = estimate.structure.link(link).law.motion_units
    factor, unit = scale(float(np.max(np.abs(along))), of_d if kind == "d" else of_v)
    place, chance = factor * means.place, means.by_chance
    axes.fill_between(place, -chance, chance, color=MEASURED, alpha=0.3, linewidth=0.0, label="95 % of noise")
    axes.plot(place, means.mean, color=IDENTIFIED, linewidth=1.2, marker="o", markersize=2.5, label="mean")
    axes.set_xlabel(f"{literal(quantity)}, {unit}")


@checked
def residuals_figure(estimate: Estimate) -> Figure:
    """What a fit leaves of each channel over time, frequency and the motion of a link; of more than 4 channels the first.

    The link is one at the mass of the channel, the last of them.

    Parameters
    ----------
    estimate : Estimate
        An estimate by maximum likelihood.

    Returns
    -------
    matplotlib.figure.Figure
        A figure that no window shows; `save` writes it.

    Raises
    ------
    RecordError
        If the estimate has no residuals.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=1.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> len(lw.plot.residuals_figure(lw.identify(record, chain.unknown("nes"))).axes)
    8
    """
    names = list(estimate.motion.residuals or {})[:_MOST]
    if not names:
        raise RecordError("there are no residuals to draw: maximum likelihood alone tells them")
    with sheet(len(names), 4, width=11.0, height=0.9 + 1.6 * len(names)) as (figure, panels):
        for row, name in enumerate(names):
            link = _link_at(estimate, name)
            for column, quantity in enumerate(("time", "frequency", f"d of {link}", f"v of {link}")):
                axes = residuals(estimate, name, quantity, legend=False, ax=panels[4 * row + column])
                axes.locator_params(axis="x", nbins=4)
                if column:
                    axes.set_ylabel(_ORDINATES[min(column, _SHARED)])
                if column < _SHARED and row + 1 < len(names):
                    axes.set_xlabel("")
                    axes.tick_params(labelbottom=False)
    return figure


def _link_at(estimate: Estimate, channel: str) -> str:
    """The last link that ends at the place that a channel shows, or the last of all."""
    place = channel.rpartition(":")[2]
    links = estimate.structure.links
    return next(
        (link.name for link in reversed(links) if place in (*link.between, link.name)), links[-1].name
    )
