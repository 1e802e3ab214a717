"""The force of a link as several methods identified it, beside the true one, and the error of each (paper, Figs. 6 and 7)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from linkwise.arrays import Floats
from linkwise.model.structure import Link
from linkwise.plot.palette import TRUE, scale
from linkwise.plot.style import label, legend_below, literal, log_scale, sheet

_GRID = 801
_DEPTH = 1e-2  # of the best curve's largest error: curves that cross the true one go down to nothing there


@dataclass(frozen=True)
class IdentifiedForce:
    """A `link` as it was identified and how to draw it; `in_both` tells whether panel a shows it too."""

    link: Link
    label: str
    color: str
    dashed: bool = False
    in_both: bool = True


def relative_error(true: Link, identified: Link, d: Floats) -> Floats:
    """(G,) difference of both forces at v = 0 and the elongations `d` (G,), in % of the largest true one."""
    force = true.force(d)
    return np.asarray(100.0 * np.abs(identified.force(d) - force) / np.abs(force).max())


def identified_forces_figure(
    true: Link, identified: Sequence[IdentifiedForce], visited: tuple[float, float], *, title: str = ""
) -> Figure:
    """a The true force of a link over the `visited` elongations in m and those identified; b their errors in % of the largest.

    The paper divides by the force itself, which has three zeros; by its largest value the error is finite everywhere.
    """
    d = np.linspace(*visited, _GRID)
    to_d, unit_d = scale(float(np.abs(d).max()), "m")
    with sheet(1, 2, height=3.7) as (figure, (left, right)):
        _draw_forces(left, true, [curve for curve in identified if curve.in_both], d, to_d)
        errors = [relative_error(true, curve.link, d) for curve in identified]
        for curve, error in zip(identified, errors, strict=True):
            right.plot(d * to_d, error, label=label(curve.label), **_line(curve))
        log_scale(right, "y")
        right.set_ylim(bottom=_DEPTH * min(error.max() for error in errors))
        right.set_ylabel("error, % of the largest force")
        left.set_title("a  force")
        right.set_title("b  relative error")
        for axes in (left, right):
            axes.set_xlabel(f"elongation d, {unit_d}")
            axes.set_xlim(d[0] * to_d, d[-1] * to_d)
        legend_below(figure, left, right)
        if title:
            figure.suptitle(literal(title), x=0.01, horizontalalignment="left", fontsize=9)
    return figure


def _draw_forces(
    axes: Axes, true: Link, identified: Sequence[IdentifiedForce], d: Floats, to_d: float
) -> None:
    force = true.force(d)
    to_f, unit_f = scale(float(np.abs(force).max()), "N")
    axes.plot(d * to_d, force * to_f, color=TRUE, linewidth=3.0, alpha=0.35, label="theory")
    for curve in identified:
        axes.plot(d * to_d, curve.link.force(d) * to_f, label=label(curve.label), **_line(curve))
    axes.set_ylabel(f"force at v = 0, {unit_f}")


def _line(curve: IdentifiedForce) -> dict[str, Any]:
    return {"color": curve.color, "linestyle": (0, (4, 2)) if curve.dashed else "-"}
