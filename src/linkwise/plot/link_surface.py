"""The restoring-force surface of a link: its force over elongation and rate, where the record visited it."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from linkwise.argument_types import checked
from linkwise.errors import StructureError
from linkwise.estimates.estimate import Estimate
from linkwise.plot.downsample import scattered
from linkwise.plot.palette import TRUE, scale
from linkwise.plot.style import axes_for, sheet, wrap_title
from linkwise.plot.titles import force_title

_GRID = 81  # points of the surface either way
_MARGIN = 0.05  # of the visited ranges, around them


@checked
def surface(estimate: Estimate, link: str, *, legend: bool = True, ax: Axes | None = None) -> Axes:
    """Draw the identified force of a link over its elongation and rate as a map, with the motion of the record.

    Where no sample lies near the law is an extrapolation.

    Parameters
    ----------
    estimate : Estimate
        An answer of `linkwise.identify`; of a discovery its ``estimate``.
    link : str
        Name of a link without memory.
    legend : bool, default True
        Add a legend to the axes.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes; a colour bar is set
        beside them.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: elongation in m and rate in m/s, or in thousands or thousandths of them as the axis labels say.

    Raises
    ------
    StructureError
        If there is no such link, or it has memory, so that its force is not a function of elongation and rate.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=1.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> fit = lw.identify(record, chain.unknown("nes"), method="weak")
    >>> ax = lw.plot.surface(fit, "nes1")
    >>> ax.get_xlabel(), ax.get_ylabel()
    ('elongation d, mm', 'rate v, m/s')
    """
    link_estimate = estimate.link(link)
    if link_estimate.link.law.states:
        raise StructureError(
            "has memory, so that its force is not a function of elongation and rate; draw its loops",
            f'link "{link}"',
        )
    index = [structure_link.name for structure_link in estimate.structure.links].index(link)
    ranges = [np.array(link_estimate.d_range), np.array(link_estimate.v_range)]
    widths = [_MARGIN * float(np.ptp(limits)) for limits in ranges]
    d, v = (
        np.linspace(limits[0] - width, limits[1] + width, _GRID)
        for limits, width in zip(ranges, widths, strict=True)
    )
    force = np.broadcast_to(link_estimate.link.force(*np.meshgrid(d, v)), (_GRID, _GRID))
    law = link_estimate.link.law
    to_d, unit_d = scale(float(np.abs(d).max()), law.motion_units[0])
    to_v, unit_v = scale(float(np.abs(v).max()), law.motion_units[1])
    largest = float(np.abs(force).max())
    to_f, unit_f = scale(largest, law.force_unit)
    some = scattered(len(estimate.motion.d))
    with axes_for(ax, legend=legend, colorbars=True) as axes:
        bound = max(largest * to_f, np.finfo(float).tiny)
        mesh = axes.pcolormesh(
            d * to_d, v * to_v, force * to_f, cmap="RdBu_r", vmin=-bound, vmax=bound, rasterized=True
        )
        axes.figure.colorbar(mesh, ax=axes, label=f"force, {unit_f}")
        if np.any(force > 0.0) and np.any(force < 0.0):
            axes.contour(d * to_d, v * to_v, force, levels=[0.0], colors=TRUE, linewidths=0.7)
        axes.plot(
            estimate.motion.d[some, index] * to_d,
            estimate.motion.v[some, index] * to_v,
            ".",
            color=TRUE,
            markersize=1.2,
            alpha=0.5,
            rasterized=True,
            label="motion of the record",
        )
        axes.set_xlabel(f"elongation d, {unit_d}")
        axes.set_ylabel(f"rate v, {unit_v}")
        wrap_title(axes, force_title(link_estimate.link))
    return axes


@checked
def surface_figure(estimate: Estimate, link: str) -> Figure:
    """The restoring-force surface of a link on a figure of its own.

    Parameters
    ----------
    estimate : Estimate
        What `linkwise.identify` returned.
    link : str
        Name of a link without memory.

    Returns
    -------
    matplotlib.figure.Figure
        A figure that no window shows; `save` writes it.

    Raises
    ------
    StructureError
        If there is no such link, or it has memory.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=1.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> fit = lw.identify(record, chain.unknown("nes"), method="weak")
    >>> len(lw.plot.surface_figure(fit, "nes1").axes)  # one for the colours
    2
    """
    with sheet(colorbars=True, height=4.2) as (figure, [axes]):
        surface(estimate, link, ax=axes)
    return figure
