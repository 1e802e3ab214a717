"""The force of a link with memory over its elongation and its rate: loops, and the energy that they dissipate."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from linkwise.argument_types import checked
from linkwise.errors import StructureError
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.force_loop import force_loop
from linkwise.plot.palette import IDENTIFIED, MEASURED, scale
from linkwise.plot.style import axes_for, heading, legend_below, sheet, wrap_title, wrapped
from linkwise.plot.titles import force_title


@checked
def loop(
    estimate: Estimate, link: str, *, over: str = "d", legend: bool = True, ax: Axes | None = None
) -> Axes:
    """Draw the force of a link over its elongation or its rate, along the motion of the record.

    Shown are the identified force, with the states of a link with memory, and that which a load cell showed.

    Parameters
    ----------
    estimate : Estimate
        An answer of `linkwise.identify`.
    link : str
        Name of the link.
    over : {"d", "v"}, default "d"
        What the force is drawn over.
    legend : bool, default True
        Add a legend to the axes.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on.

    Raises
    ------
    StructureError
        If there is no such link, or the force in it is not known.

    Examples
    --------
    >>> import linkwise as lw
    >>> law = lw.Law.parse("k*d + c*v")
    >>> damper = lw.Link("damper", ("base", "ground"), law, {"k": 400.0, "c": 20.0})
    >>> rig = lw.Structure("rig", (), (damper,))
    >>> record = lw.simulate(rig, duration=4.0, rate=100.0, base="0.01*sin(5*t)").with_noise(40.0, seed=1)
    >>> fit = lw.identify(record, rig.unknown("damper"))
    >>> lw.plot.loop(fit, "damper").get_ylabel()
    'force, N'
    """
    if over not in ("d", "v"):
        raise StructureError(f'a loop is drawn over "d" or "v", got "{over}"')
    forces = force_loop(estimate, link)
    values, quantity = (forces.d, "elongation d") if over == "d" else (forces.v, "rate v")
    law = estimate.link(link).link.law
    to_x, unit_x = scale(float(np.nanmax(np.abs(values))), law.motion_units[("d", "v").index(over)])
    to_f, unit_f = scale(forces.largest, law.force_unit)
    with axes_for(ax, legend=legend) as axes:
        if forces.measured is not None:
            axes.plot(
                values * to_x,
                forces.measured * to_f,
                color=MEASURED,
                linewidth=0.7,
                zorder=1,
                label="measured",
            )
        axes.plot(
            values * to_x,
            forces.identified * to_f,
            color=IDENTIFIED,
            linewidth=0.9,
            zorder=2,
            label="identified",
        )
        axes.set_xlabel(f"{quantity}, {unit_x}")
        axes.set_ylabel(f"force, {unit_f}")
        wrap_title(axes, force_title(estimate.link(link).link))
    return axes


@checked
def loop_figure(estimate: Estimate, link: str) -> Figure:
    """The force of a link over its elongation and over its rate, on a figure of its own.

    Parameters
    ----------
    estimate : Estimate
        What `linkwise.identify` returned.
    link : str
        Name of the link.

    Returns
    -------
    matplotlib.figure.Figure
        A figure that no window shows; `save` writes it.

    Raises
    ------
    StructureError
        If there is no such link, or the force in it is not known.

    Examples
    --------
    >>> import linkwise as lw
    >>> law = lw.Law.parse("k*d + c*v")
    >>> damper = lw.Link("damper", ("base", "ground"), law, {"k": 400.0, "c": 20.0})
    >>> rig = lw.Structure("rig", (), (damper,))
    >>> record = lw.simulate(rig, duration=4.0, rate=100.0, base="0.01*sin(5*t)").with_noise(40.0, seed=1)
    >>> fit = lw.identify(record, rig.unknown("damper"))
    >>> len(lw.plot.loop_figure(fit, "damper").axes)
    2
    """
    with sheet(columns=2) as (figure, panels):
        loop(estimate, link, legend=False, ax=panels[0])
        loop(estimate, link, over="v", legend=False, ax=panels[1])
        for panel in panels:
            panel.set_title("")
        title = f"{force_title(estimate.link(link).link)}; {force_loop(estimate, link).energy_text}"
        heading(figure, wrapped(title, figure.get_figwidth()))
        legend_below(figure, panels[0])
    return figure
