"""The models that survive a selection: by how much their forces of a link depart from that of the selected one."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from linkwise.argument_types import checked
from linkwise.discovery.result import Discovery
from linkwise.plot.palette import IDENTIFIED, MEASURED, VISITED, WELL, scale
from linkwise.plot.style import axes_for, legend_below, literal, sheet

_POINTS = 201
_FAINTEST = 0.02  # of the weight of all models: others are not drawn


@checked
def departures(discovery: Discovery, link: str, *, legend: bool = True, ax: Axes | None = None) -> Axes:
    """Draw by how much the forces of a link depart from that of the selected model: of others that survive, and averaged.

    Each of the models is a line, the wider the more weight it has. The band is that of the force averaged over them.

    Parameters
    ----------
    discovery : Discovery
        An answer of `linkwise.discover`.
    link : str
        Name of the link.
    legend : bool, default True
        Add a legend to the axes.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: elongation and force in m and N, or in thousands or thousandths of them as the axis labels say.

    Raises
    ------
    StructureError
        If there is no such link.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=3.0, rate=1000.0).with_noise(30.0, seed=1)
    >>> found = lw.discover(record, {"m1": 1.0, "m2": 0.01})
    >>> lw.plot.departures(found, "m2-m1").get_xlabel()
    'elongation d, mm'
    """
    estimate, average = discovery.estimate.link(link), discovery.average
    d = np.linspace(*estimate.d_range, _POINTS)
    selected = estimate.force_band(d)[0]
    averaged, lower, upper = (force - selected for force in average.force_band(estimate, d))
    shifts = average.shifts(estimate, d)
    drawn = [lower, upper, shifts[average.weights >= _FAINTEST]]
    largest = max(
        (float(np.max(np.abs(forces[np.isfinite(forces)]), initial=0.0)) for forces in drawn), default=0.0
    )
    law, of_d = estimate.link.law, estimate.link.law.motion_units[0]
    (to_d, unit_d), (to_f, unit_f) = scale(float(np.max(np.abs(d))), of_d), scale(largest, law.force_unit)
    with axes_for(ax, legend=legend) as axes:
        if np.isfinite(lower).all():
            band = axes.fill_between(d * to_d, lower * to_f, upper * to_f, color=VISITED, linewidth=0)
            band.set_label("95 % band, averaged")
        others = [number for number in range(1, len(shifts)) if average.weights[number] >= _FAINTEST]
        for number in others:
            width = 0.5 + 2.5 * float(average.weights[number])
            label = "other models that survive" if number == others[0] else None
            axes.plot(d * to_d, shifts[number] * to_f, color=MEASURED, linewidth=width, label=label)
        axes.plot(d * to_d, averaged * to_f, color=WELL, linewidth=1.0, label="averaged")
        axes.axhline(0.0, color=IDENTIFIED, linewidth=0.5 + 2.5 * float(average.weights[0]), label="selected")
        axes.set_xlabel(f"elongation d, {unit_d}")
        axes.set_ylabel(f"force less that selected, {unit_f}")
        axes.set_title(
            literal(f"{link}: models that survive, the selected one with {average.weights[0]:.0%}")
        )
    return axes


@checked
def departures_figure(discovery: Discovery, link: str) -> Figure:
    """The departures of the models that survive on a figure of their own.

    Parameters
    ----------
    discovery : Discovery
        What `linkwise.discover` returned.
    link : str
        Name of the link.

    Returns
    -------
    matplotlib.figure.Figure
        A figure that no window shows; `save` writes it.

    Raises
    ------
    StructureError
        If there is no such link.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=3.0, rate=1000.0).with_noise(30.0, seed=1)
    >>> found = lw.discover(record, {"m1": 1.0, "m2": 0.01})
    >>> len(lw.plot.departures_figure(found, "m2-m1").axes)
    1
    """
    with sheet() as (figure, [axes]):
        departures(discovery, link, legend=False, ax=axes)
        legend_below(figure, axes)
    return figure
