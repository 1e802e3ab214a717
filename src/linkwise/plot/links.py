"""The force of a link: measured, identified and how certain, as a curve, a loop or a surface, and by several methods
(paper Figs. 6 and 7).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from functools import partial
from itertools import cycle
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from linkwise.arrays import Floats
from linkwise.errors import LinkwiseError, StructureError
from linkwise.estimates.curves import ForceCurve, force_curve, force_loop
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.link_estimate import LinkEstimate
from linkwise.model.structure import Link, Structure
from linkwise.plot.style import (
    IDENTIFIED,
    MEASURED,
    SERIES,
    TRUE,
    VISITED,
    WELL,
    On,
    force_title,
    heading,
    label,
    legend_below,
    literal,
    log_scale,
    picture,
    pictures,
    scale,
    scattered,
    sheet,
    single,
    wrap_title,
)

if TYPE_CHECKING:
    from linkwise.identification.compare import Comparison


_SHOWN = 6  # links in one figure


@picture()
def force(
    axes: Axes,
    estimate: Estimate,
    link: str,
    *,
    truth: Structure | None = None,
    near_wells: bool = False,
    **on: Unpack[On],
) -> None:
    """Draw the elastic force of a link over its elongation.

    Shown are the identified curve with its 95 % band, the wells, the range of elongations that the record visited, samples of
    the record less the identified damping, and the true curve where it is known.

    Parameters
    ----------
    estimate : Estimate
        An answer of `linkwise.identify`; of a discovery its ``estimate``.
    link : str
        Name of the link.
    truth : Structure, optional
        The true structure, to draw its force beside. A simulated record knows its own.
    near_wells : bool, default False
        Show only what lies between the wells. A link with less than two wells is shown over its whole range.
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
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=1.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> fit = lw.identify(record, chain.unknown("nes"), method="weak")
    >>> ax = lw.plot.force(fit, "nes1")
    >>> ax.get_xlabel()
    'elongation d, mm'
    """
    curve = force_curve(estimate, link, truth)
    _draw(axes, curve)
    near = curve.between_wells
    if near_wells and near is not None:
        to_d, _, to_f, _ = _scales(curve)
        axes.set(xlim=(near[0][0] * to_d, near[0][1] * to_d), ylim=(near[1][0] * to_f, near[1][1] * to_f))
    wrap_title(axes, force_title(curve.link))


def force_figure(estimate: Estimate, link: str, *, truth: Structure | None = None) -> Figure:
    """The force of a link on a figure of its own, with a second panel near the wells where there are two or more."""
    draw = partial(force, estimate, link, truth=truth)
    if force_curve(estimate, link, truth).between_wells is None:
        return single(draw)
    title = force_title(estimate.link(link).link)
    return pictures([draw, partial(draw, near_wells=True)], titles=("", "near the wells"), title=title)


def forces_figure(estimate: Estimate) -> Figure:
    """The forces of the links that were identified, or of all where none was; of more than six the first."""
    shown = [link for link in estimate.links if link.free] or estimate.links
    draws = [partial(force, estimate, link.link.name) for link in shown[:_SHOWN]]
    return pictures(draws, height=(0.4, 2.6), columns=min(len(draws), 2))


def _scales(curve: ForceCurve) -> tuple[float, str, float, str]:
    """Factor and unit of the elongation, then of the force."""
    return (
        *scale(curve.visited, curve.link.law.motion_units[0]),
        *scale(curve.frame, curve.link.law.force_unit),
    )


def _draw(axes: Axes, curve: ForceCurve) -> None:
    to_d, unit_d, to_f, unit_f = _scales(curve)
    low, high = curve.visited
    inside = (curve.d >= low) & (curve.d <= high)
    d, elastic = curve.d * to_d, curve.force * to_f
    axes.axvspan(low * to_d, high * to_d, color=VISITED, zorder=0, label="range visited")
    if len(curve.sample_d):
        thinned = scattered(len(curve.sample_d))
        samples = curve.sample_d[thinned] * to_d, curve.sample_force[thinned] * to_f
        style: dict[str, Any] = {"color": MEASURED, "ms": 1.5, "rasterized": True, "zorder": 1}
        axes.plot(*samples, ".", label=_samples_label(curve), **style)
    if curve.true is not None:
        axes.plot(d, curve.true * to_f, color=TRUE, lw=2.6, alpha=0.45, zorder=2, label="true")
    if curve.has_band:
        lower, upper = curve.lower * to_f, curve.upper * to_f
        axes.fill_between(d, lower, upper, color=IDENTIFIED, alpha=0.25, lw=0, zorder=3, label="95 % band")
    axes.plot(d, elastic, color=IDENTIFIED, ls=(0, (4, 3)), lw=0.8, zorder=4)
    name = "identified" if curve.identified else "known"
    axes.plot(d[inside], elastic[inside], color=IDENTIFIED, zorder=5, label=name)
    if curve.wells:
        wells = [well * to_d for well in curve.wells]
        axes.plot(wells, [0.0] * len(wells), "o", color=WELL, ms=5, zorder=6, label="wells")
    axes.set(xlim=(d[0], d[-1]), ylim=(curve.frame[0] * to_f, curve.frame[1] * to_f))
    axes.set_xlabel(f"elongation d, {unit_d}")
    others = [kind for kind in ("states", "signals") if getattr(curve.link.law, kind)]
    at_rest = f"v = 0 and {' and '.join(others)} of 0" if others else "v = 0"
    axes.set_ylabel(f"force at {at_rest}, {unit_f}")


def _samples_label(curve: ForceCurve) -> str:
    """What the samples are, and how many of them lie beyond the frame."""
    identified = "damping and memory" if curve.link.states else "damping"
    description = f"{'true' if curve.samples_are_true else 'measured'} minus {identified}"
    return f"{description} ({100 * curve.outside:.0f} % outside)" if curve.outside >= 0.005 else description


@picture()
def loop(axes: Axes, estimate: Estimate, link: str, *, over: str = "d", **on: Unpack[On]) -> None:
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
    to_x, unit_x = scale(values, law.motion_units[("d", "v").index(over)])
    to_f, unit_f = scale(forces.largest, law.force_unit)
    shown, identified = values * to_x, forces.identified * to_f
    if forces.measured is not None:
        axes.plot(shown, forces.measured * to_f, color=MEASURED, lw=0.7, zorder=1, label="measured")
    axes.plot(shown, identified, color=IDENTIFIED, lw=0.9, zorder=2, label="identified")
    axes.set(xlabel=f"{quantity}, {unit_x}", ylabel=f"force, {unit_f}")
    wrap_title(axes, force_title(estimate.link(link).link))


def loop_figure(estimate: Estimate, link: str) -> Figure:
    """The force of a link over its elongation and over its rate, on a figure of its own."""
    title = f"{force_title(estimate.link(link).link)}; {force_loop(estimate, link).energy_text}"
    return pictures([partial(loop, estimate, link, over=over) for over in "dv"], titles=("", ""), title=title)


_SURFACE_POINTS = 81  # points of the surface either way
_MARGIN = 0.05  # of the visited ranges, around them


@picture()
def surface(axes: Axes, estimate: Estimate, link: str, **on: Unpack[On]) -> None:
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
    link_estimate, law = estimate.link(link), estimate.link(link).link.law
    if not law.is_plain:
        message = "has memory or takes a signal, so that its force is not a function of elongation and rate; draw its loops"
        raise StructureError(message, f'link "{link}"')
    index = [candidate.name for candidate in estimate.structure.links].index(link)
    ends = [(limits, _MARGIN * np.ptp(limits)) for limits in (link_estimate.d_range, link_estimate.v_range)]
    d, v = (np.linspace(low - margin, high + margin, _SURFACE_POINTS) for (low, high), margin in ends)
    force = np.broadcast_to(link_estimate.link.force(*np.meshgrid(d, v)), (_SURFACE_POINTS, _SURFACE_POINTS))
    to_d, unit_d = scale(d, law.motion_units[0])
    to_v, unit_v = scale(v, law.motion_units[1])
    largest = float(np.abs(force).max())
    to_f, unit_f = scale(largest, law.force_unit)
    thinned = scattered(len(estimate.motion.d))
    bound = max(largest * to_f, np.finfo(float).tiny)
    colors: dict[str, Any] = {"cmap": "RdBu_r", "vmin": -bound, "vmax": bound}
    mesh = axes.pcolormesh(d * to_d, v * to_v, force * to_f, rasterized=True, **colors)
    axes.figure.colorbar(mesh, ax=axes, label=f"force, {unit_f}")
    if np.any(force > 0.0) and np.any(force < 0.0):
        axes.contour(d * to_d, v * to_v, force, levels=[0.0], colors=TRUE, linewidths=0.7)
    visited = estimate.motion.d[thinned, index] * to_d, estimate.motion.v[thinned, index] * to_v
    style: dict[str, Any] = {"color": TRUE, "ms": 1.2, "alpha": 0.5, "rasterized": True}
    axes.plot(*visited, ".", label="motion of the record", **style)
    axes.set(xlabel=f"elongation d, {unit_d}", ylabel=f"rate v, {unit_v}")
    wrap_title(axes, force_title(link_estimate.link))


LineStyles = Mapping[str, Mapping[str, Any]]
_CURVE_POINTS = 801
_DEPTH = 1e-2  # of the best curve's largest error: curves that cross the true one go down to nothing there


@picture()
def force_comparison(
    axes: Axes,
    true: Link,
    identified: Mapping[str, Link],
    d_range: tuple[float, float],
    *,
    styles: LineStyles | None = None,
    **on: Unpack[On],
) -> None:
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
    to_f, unit_f = scale(force, true.law.force_unit)
    lines = _line_styles(identified, styles)
    shown = _over_elongation(axes, d, true.law.motion_units[0])
    axes.plot(shown, force * to_f, color=TRUE, lw=3.0, alpha=0.35, label="theory")
    for name, link in identified.items():
        axes.plot(shown, link.force(d) * to_f, **{"label": label(name), **lines[name]})
    axes.set_ylabel(f"force at v = 0, {unit_f}")


@picture()
def force_errors(
    axes: Axes,
    true: Link,
    identified: Mapping[str, Link],
    d_range: tuple[float, float],
    *,
    styles: LineStyles | None = None,
    **on: Unpack[On],
) -> None:
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
    lines = _line_styles(identified, styles)
    shown = _over_elongation(axes, d, true.law.motion_units[0])
    for name, error in errors.items():
        axes.plot(shown, error, **{"label": label(name), **lines[name]})
    peaks = [float(error.max()) for error in errors.values() if error.any()]
    if peaks:
        log_scale(axes, "y")
        axes.set_ylim(bottom=_DEPTH * min(peaks))
    axes.set_ylabel("error, % of the largest force")


def force_comparison_figure(
    true: Link,
    identified: Mapping[str, Link],
    d_range: tuple[float, float],
    *,
    styles: LineStyles | None = None,
    only_errors: Collection[str] = (),
    title: str = "",
) -> Figure:
    """The true force of a link with those identified in one panel, and their errors in another."""
    styles = _line_styles(identified, styles)
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


_MOST = 4  # links that are compared in one figure
_STYLES = ("-", "--", ":", "-.")


def comparison_figure(comparison: Comparison) -> Figure:
    """The force of each identified link by every method over the motion that the record visited, and less that of maximum
    likelihood: one row a link.

    It is that at v = 0 over the elongation, or at d = 0 over the rate of a law without an elastic force; the band is the 95 %
    interval of maximum likelihood.
    """
    links = [link for link in comparison.best.links if link.free][:_MOST]
    with sheet(max(len(links), 1), 2, height=0.8 + 2.5 * len(links)) as (figure, panels):
        for number, link in enumerate(links):
            _compare_link(panels[2 * number : 2 * number + 2], comparison, link)
        legend_below(figure, *panels, columns=4)
    return figure


def _compare_link(panels: Sequence[Axes], comparison: Comparison, link: LinkEstimate) -> None:
    """The two panels of a link."""
    name, law = link.link.name, link.link.law
    elastic = bool(np.any(link.link.force(np.linspace(*link.d_range, 9)) != link.link.force(0.0)))
    motion = np.linspace(*(link.d_range if elastic else link.v_range), _CURVE_POINTS)
    answers = {a.name: a.estimate.link(name).link for a in comparison.answers if a.estimate is not None}
    along = (motion,) if elastic else (0.0, motion)
    forces = {method: answer.force(*along) for method, answer in answers.items()}
    best = forces["ml"]
    band = link.force_band(motion)[1:] if elastic and link.covariance is not None else (best, best)
    to_x, unit_x = scale(motion, law.motion_units[0 if elastic else 1])
    of, still = ("elongation d", "v = 0") if elastic else ("rate v", "d = 0")
    for axes, less, title in zip(panels, (0.0 * best, best), (name, f"{name}, less ml"), strict=True):
        shown = {method: force - less for method, force in forces.items()}
        to_f, unit_f = scale(list(shown.values()), law.force_unit)
        lower, upper = ((end - less) * to_f for end in band)
        axes.fill_between(motion * to_x, lower, upper, color=SERIES[0], alpha=0.25, lw=0.0)
        for number, (method, force) in enumerate(shown.items()):
            style = _STYLES[number % len(_STYLES)]
            axes.plot(motion * to_x, force * to_f, color=SERIES[number], ls=style, label=label(method))
        axes.set(xlabel=f"{of}, {unit_x}", ylabel=f"force at {still}, {unit_f}", title=literal(title))


def _elongations(d_range: tuple[float, float]) -> Floats:
    """(G,) elongations in m over the range."""
    least, greatest = d_range
    if not -np.inf < least < greatest < np.inf:
        wanted = "the least and the greatest elongation in m"
        raise LinkwiseError(f"d_range must be {wanted}, got {least} and {greatest}")
    return np.linspace(least, greatest, _CURVE_POINTS)


def _over_elongation(axes: Axes, d: Floats, unit: str) -> Floats:
    """(G,) elongations in the unit of the axis, which is set up for them."""
    to_d, unit_d = scale(d, unit)
    axes.set(xlim=(d[0] * to_d, d[-1] * to_d), xlabel=f"elongation d, {unit_d}")
    return d * to_d


def _line_styles(identified: Mapping[str, Link], styles: LineStyles | None) -> LineStyles:
    """The properties of each line; colours go with the place among all that are identified."""
    given = styles or {}
    colors = dict(zip(identified, cycle(SERIES), strict=False))
    return {name: {"color": color, **given.get(name, {})} for name, color in colors.items()}
