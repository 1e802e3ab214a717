"""The force of a link on paper: what was seen, what was identified, how sure it is."""

from __future__ import annotations

from textwrap import fill

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from linkwise.estimates.estimate import Estimate
from linkwise.model.structure import Link, Structure
from linkwise.plot.force_view import ForceView, force_view
from linkwise.plot.palette import IDENTIFIED, SEEN, TRUE, VISITED, WELL, scale
from linkwise.plot.style import sheet


def force_figure(estimate: Estimate, name: str, *, truth: Structure | None = None) -> Figure:
    """Elastic force of link `name` over its elongation, with 95 % band, wells and the range that the record visited."""
    view = force_view(estimate, name, truth)
    near = view.between_wells
    with sheet(columns=2 if near else 1) as (figure, panels):
        for axes in panels:
            draw_force(axes, view)
        figure.suptitle(fill(force_title(view.link), 84), x=0.01, horizontalalignment="left", fontsize=10)
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=3)
        if near:
            zoom_to_wells(panels[1], view)
            panels[1].set_title("near the wells")
    return figure


def force_scales(view: ForceView) -> tuple[float, str, float, str]:
    """Factor and unit of the elongation, then of the force."""
    return *scale(max(abs(end) for end in view.visited), "m"), *scale(
        max(abs(end) for end in view.frame), "N"
    )


def zoom_to_wells(axes: Axes, view: ForceView) -> None:
    """Narrow axes that show `view` to what lies between its wells, where it has two or more."""
    near = view.between_wells
    if near is not None:
        to_d, _, to_f, _ = force_scales(view)
        axes.set_xlim(near[0][0] * to_d, near[0][1] * to_d)
        axes.set_ylim(near[1][0] * to_f, near[1][1] * to_f)


def force_title(link: Link) -> str:
    """Name, ends and law of the link."""
    return f"{link.name} ({' – '.join(link.between)}):  {link.law.text}"


def draw_force(axes: Axes, view: ForceView) -> None:
    """Draw `view` into `axes`, with labels for a legend."""
    to_d, unit_d, to_f, unit_f = force_scales(view)
    low, high = view.visited
    inside = (view.d >= low) & (view.d <= high)
    d, force = view.d * to_d, view.force * to_f
    axes.axvspan(low * to_d, high * to_d, color=VISITED, zorder=0, label="range visited")
    if len(view.cloud):
        axes.plot(
            view.cloud_d * to_d,
            view.cloud * to_f,
            ".",
            color=SEEN,
            markersize=1.5,
            rasterized=True,
            zorder=1,
            label=cloud_label(view),
        )
    if view.true is not None:
        axes.plot(d, view.true * to_f, color=TRUE, linewidth=2.6, alpha=0.45, zorder=2, label="true")
    if view.has_band:
        lower, upper = view.lower * to_f, view.upper * to_f
        axes.fill_between(
            d, lower, upper, color=IDENTIFIED, alpha=0.25, linewidth=0, zorder=3, label="95 % band"
        )
    axes.plot(d, force, color=IDENTIFIED, linestyle=(0, (4, 3)), linewidth=0.8, zorder=4)
    axes.plot(d[inside], force[inside], color=IDENTIFIED, zorder=5, label=curve_label(view))
    if view.wells:
        wells = [well * to_d for well in view.wells]
        axes.plot(wells, [0.0] * len(wells), "o", color=WELL, markersize=5, zorder=6, label="wells")
    axes.set_xlim(d[0], d[-1])
    axes.set_ylim(view.frame[0] * to_f, view.frame[1] * to_f)
    axes.set_xlabel(f"elongation d, {unit_d}")
    axes.set_ylabel(f"force at v = 0, {unit_f}")


def curve_label(view: ForceView) -> str:
    """Whether the curve was found or was known before."""
    return "identified" if view.identified else "known"


def cloud_label(view: ForceView) -> str:
    """What the cloud is, and how much of it the frame leaves out."""
    what = f"{'true' if view.cloud_is_true else 'measured'} less damping"
    return f"{what} ({100 * view.outside:.0f} % outside)" if view.outside >= 0.005 else what
