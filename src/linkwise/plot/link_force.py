"""The force of a link: what was measured, what was identified, how certain it is."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from linkwise.argument_types import checked
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.force_curve import ForceCurve, force_curve
from linkwise.model.structure import Structure
from linkwise.plot.downsample import scattered
from linkwise.plot.palette import IDENTIFIED, MEASURED, TRUE, VISITED, WELL, scale
from linkwise.plot.style import axes_for, heading, legend_below, sheet, wrap_title, wrapped
from linkwise.plot.titles import force_title


@checked
def force(
    estimate: Estimate,
    link: str,
    *,
    truth: Structure | None = None,
    near_wells: bool = False,
    legend: bool = True,
    ax: Axes | None = None,
) -> Axes:
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
    with axes_for(ax, legend=legend) as axes:
        _draw(axes, curve)
        near = curve.between_wells
        if near_wells and near is not None:
            to_d, _, to_f, _ = _scales(curve)
            axes.set_xlim(near[0][0] * to_d, near[0][1] * to_d)
            axes.set_ylim(near[1][0] * to_f, near[1][1] * to_f)
        wrap_title(axes, force_title(curve.link))
    return axes


@checked
def force_figure(estimate: Estimate, link: str, *, truth: Structure | None = None) -> Figure:
    """The force of a link on a figure of its own, with a second panel near the wells where there are two or more.

    Parameters
    ----------
    estimate : Estimate
        What `linkwise.identify` returned.
    link : str
        Name of the link.
    truth : Structure, optional
        The true structure, to draw its force beside.

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
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=1.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> fit = lw.identify(record, chain.unknown("nes"), method="weak")
    >>> len(lw.plot.force_figure(fit, "nes1").axes)
    2
    """
    near = force_curve(estimate, link, truth).between_wells
    with sheet(columns=1 if near is None else 2) as (figure, panels):
        force(estimate, link, truth=truth, legend=False, ax=panels[0])
        if near is not None:
            force(estimate, link, truth=truth, near_wells=True, legend=False, ax=panels[1])
            panels[0].set_title("")
            panels[1].set_title("near the wells")
            title = wrapped(force_title(estimate.link(link).link), figure.get_figwidth())
            heading(figure, title)
        legend_below(figure, panels[0])
    return figure


def _scales(curve: ForceCurve) -> tuple[float, str, float, str]:
    """Factor and unit of the elongation, then of the force."""
    return (
        *scale(max(abs(end) for end in curve.visited), curve.link.law.motion_units[0]),
        *scale(max(abs(end) for end in curve.frame), curve.link.law.force_unit),
    )


def _draw(axes: Axes, curve: ForceCurve) -> None:
    to_d, unit_d, to_f, unit_f = _scales(curve)
    low, high = curve.visited
    inside = (curve.d >= low) & (curve.d <= high)
    d, elastic = curve.d * to_d, curve.force * to_f
    axes.axvspan(low * to_d, high * to_d, color=VISITED, zorder=0, label="range visited")
    if len(curve.sample_d):
        some = scattered(len(curve.sample_d))
        axes.plot(
            curve.sample_d[some] * to_d,
            curve.sample_force[some] * to_f,
            ".",
            color=MEASURED,
            markersize=1.5,
            rasterized=True,
            zorder=1,
            label=_samples_label(curve),
        )
    if curve.true is not None:
        axes.plot(d, curve.true * to_f, color=TRUE, linewidth=2.6, alpha=0.45, zorder=2, label="true")
    if curve.has_band:
        lower, upper = curve.lower * to_f, curve.upper * to_f
        axes.fill_between(
            d, lower, upper, color=IDENTIFIED, alpha=0.25, linewidth=0, zorder=3, label="95 % band"
        )
    axes.plot(d, elastic, color=IDENTIFIED, linestyle=(0, (4, 3)), linewidth=0.8, zorder=4)
    name = "identified" if curve.identified else "known"
    axes.plot(d[inside], elastic[inside], color=IDENTIFIED, zorder=5, label=name)
    if curve.wells:
        wells = [well * to_d for well in curve.wells]
        axes.plot(wells, [0.0] * len(wells), "o", color=WELL, markersize=5, zorder=6, label="wells")
    axes.set_xlim(d[0], d[-1])
    axes.set_ylim(curve.frame[0] * to_f, curve.frame[1] * to_f)
    axes.set_xlabel(f"elongation d, {unit_d}")
    at_rest = "v = 0 and states of 0" if curve.link.states else "v = 0"
    axes.set_ylabel(f"force at {at_rest}, {unit_f}")


def _samples_label(curve: ForceCurve) -> str:
    """What the samples are, and how many of them lie beyond the frame."""
    identified = "damping and memory" if curve.link.states else "damping"
    description = f"{'true' if curve.samples_are_true else 'measured'} minus {identified}"
    return f"{description} ({100 * curve.outside:.0f} % outside)" if curve.outside >= 0.005 else description
