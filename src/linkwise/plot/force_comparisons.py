"""The force of a link as several methods identified it, beside the true one, and the error of each (paper, Figs. 6 and 7)."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from linkwise.argument_types import checked
from linkwise.arrays import Floats
from linkwise.errors import LinkwiseError
from linkwise.model.structure import Link
from linkwise.plot.palette import SERIES, TRUE, scale
from linkwise.plot.style import axes_for, heading, label, legend_below, literal, log_scale, sheet

LineStyles = Mapping[str, Mapping[str, Any]]
_GRID = 801
_DEPTH = 1e-2  # of the best curve's largest error: curves that cross the true one go down to nothing there


@checked
def force_comparison(
    true: Link,
    identified: Mapping[str, Link],
    d_range: tuple[float, float],
    *,
    styles: LineStyles | None = None,
    legend: bool = True,
    ax: Axes | None = None,
) -> Axes:
    """Draw the elastic force of a link as several methods identified it, beside the true one.

    Parameters
    ----------
    true : Link
        The true link.
    identified : dict of str to Link
        Links as they were identified, by what the legend calls them.
    d_range : tuple of float, shape (2,)
        The least and the greatest elongation in m.
    styles : dict of str to dict, optional
        Properties of the line of a label, as ``Axes.plot`` of matplotlib takes them. By default solid lines, each in a colour
        of its own.
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
    LinkwiseError
        If the elongations do not begin below their end.

    Examples
    --------
    >>> import linkwise as lw
    >>> sink, stiffer = lw.bnes_chain(2).link("nes1"), lw.bnes_chain(2, beta=1.1e6).link("nes1")
    >>> ax = lw.plot.force_comparison(sink, {"weak form": stiffer}, (-0.02, 0.02))
    >>> [text.get_text() for text in ax.get_legend().get_texts()]
    ['theory', 'weak form']
    """
    d = _elongations(d_range)
    force = true.force(d)
    to_f, unit_f = scale(float(np.abs(force).max()), true.law.force_unit)
    lines = _lines(identified, styles)
    with axes_for(ax, legend=legend) as axes:
        shown = _over_elongation(axes, d, true.law.motion_units[0])
        axes.plot(shown, force * to_f, color=TRUE, linewidth=3.0, alpha=0.35, label="theory")
        for name, link in identified.items():
            axes.plot(shown, link.force(d) * to_f, **{"label": label(name), **lines[name]})
        axes.set_ylabel(f"force at v = 0, {unit_f}")
    return axes


@checked
def force_errors(
    true: Link,
    identified: Mapping[str, Link],
    d_range: tuple[float, float],
    *,
    styles: LineStyles | None = None,
    legend: bool = True,
    ax: Axes | None = None,
) -> Axes:
    """Draw the errors of forces that several methods identified over the elongation, in % of the largest true force.

    The paper divides by the force itself, which is zero at every equilibrium; by its largest value the error is finite
    everywhere.

    Parameters
    ----------
    true : Link
        The true link.
    identified : dict of str to Link
        Links as they were identified, by what the legend calls them.
    d_range : tuple of float, shape (2,)
        The least and the greatest elongation in m.
    styles : dict of str to dict, optional
        Properties of the line of a label, as ``Axes.plot`` of matplotlib takes them. By default solid lines, each in a colour
        of its own.
    legend : bool, default True
        Add a legend to the axes.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: elongation in m, or in mm or um as the axis label says, and % on a logarithmic axis.

    Raises
    ------
    LinkwiseError
        If the elongations do not begin below their end.

    Examples
    --------
    >>> import linkwise as lw
    >>> sink, stiffer = lw.bnes_chain(2).link("nes1"), lw.bnes_chain(2, beta=1.1e6).link("nes1")
    >>> lw.plot.force_errors(sink, {"weak form": stiffer}, (-0.02, 0.02)).get_ylabel()
    'error, % of the largest force'
    """
    d = _elongations(d_range)
    force = true.force(d)
    largest = max(float(np.abs(force).max()), np.finfo(float).tiny)
    errors = {name: 100.0 * np.abs(link.force(d) - force) / largest for name, link in identified.items()}
    lines = _lines(identified, styles)
    with axes_for(ax, legend=legend) as axes:
        shown = _over_elongation(axes, d, true.law.motion_units[0])
        for name, error in errors.items():
            axes.plot(shown, error, **{"label": label(name), **lines[name]})
        peaks = [float(error.max()) for error in errors.values() if error.any()]
        if peaks:
            log_scale(axes, "y")
            axes.set_ylim(bottom=_DEPTH * min(peaks))
        axes.set_ylabel("error, % of the largest force")
    return axes


@checked
def force_comparison_figure(
    true: Link,
    identified: Mapping[str, Link],
    d_range: tuple[float, float],
    *,
    styles: LineStyles | None = None,
    only_errors: Collection[str] = (),
    title: str = "",
) -> Figure:
    """The true force of a link with those identified in one panel, and their errors in another.

    Parameters
    ----------
    true : Link
        The true link.
    identified : dict of str to Link
        Links as they were identified, by what the legend calls them.
    d_range : tuple of float, shape (2,)
        The least and the greatest elongation in m.
    styles : dict of str to dict, optional
        Properties of the line of a label, as ``Axes.plot`` of matplotlib takes them.
    only_errors : collection of str, optional
        Labels whose forces are left out of the first panel.
    title : str, optional
        A title above both panels.

    Returns
    -------
    matplotlib.figure.Figure
        A figure that no window shows; `save` writes it.

    Examples
    --------
    >>> import linkwise as lw
    >>> sink, stiffer = lw.bnes_chain(2).link("nes1"), lw.bnes_chain(2, beta=1.1e6).link("nes1")
    >>> len(lw.plot.force_comparison_figure(sink, {"weak form": stiffer}, (-0.02, 0.02)).axes)
    2
    """
    styles = _lines(identified, styles)
    drawn = {name: link for name, link in identified.items() if name not in only_errors}
    with sheet(1, 2, height=3.7) as (figure, (left, right)):
        force_comparison(true, drawn, d_range, styles=styles, legend=False, ax=left)
        force_errors(true, identified, d_range, styles=styles, legend=False, ax=right)
        left.set_title("a  force")
        right.set_title("b  relative error")
        legend_below(figure, left, right)
        if title:
            heading(figure, literal(title), size=9.0)
    return figure


def _elongations(d_range: tuple[float, float]) -> Floats:
    """(G,) elongations in m over the range."""
    least, greatest = d_range
    if not (np.isfinite(least) and np.isfinite(greatest) and least < greatest):
        raise LinkwiseError(
            f"d_range must be the least and the greatest elongation in m, got {least} and {greatest}"
        )
    return np.linspace(least, greatest, _GRID)


def _over_elongation(axes: Axes, d: Floats, unit: str) -> Floats:
    """(G,) elongations in the unit of the axis, which is set up for them."""
    to_d, unit_d = scale(float(np.abs(d).max()), unit)
    axes.set_xlim(d[0] * to_d, d[-1] * to_d)
    axes.set_xlabel(f"elongation d, {unit_d}")
    return d * to_d


def _lines(identified: Mapping[str, Link], styles: LineStyles | None) -> LineStyles:
    """The properties of each line; colours go with the place among all that are identified."""
    given = styles or {}
    return {
        name: {"color": SERIES[number % len(SERIES)], **given.get(name, {})}
        for number, name in enumerate(identified)
    }
