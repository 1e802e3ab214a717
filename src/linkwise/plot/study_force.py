"""The force of a link as several methods found it, beside the true one, and how far each is off (paper, Figs. 6 and 7)."""

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
from linkwise.plot.style import sheet

_GRID = 801
_DEPTH = 1e-2  # of the best curve's largest error: curves that cross the true one go down to nothing there


@dataclass(frozen=True)
class FoundForce:
    """A `link` as it was identified and how to draw it; `in_both` whether panel a shows it too."""

    link: Link
    label: str
    color: str
    dashed: bool = False
    in_both: bool = True


def relative_error(true: Link, found: Link, d: Floats) -> Floats:
    """(G,) difference of both forces at v = 0 and the elongations `d` (G,), in % of the largest true one."""
    force = true.force(d)
    return np.asarray(100.0 * np.abs(found.force(d) - force) / np.abs(force).max())


def found_forces_figure(
    true: Link, found: Sequence[FoundForce], visited: tuple[float, float], *, title: str = ""
) -> Figure:
    """a The true force of a link over the `visited` elongations in m, and what was found; b the error in % of the largest.

    The paper divides by the force itself, which has three zeros; by its largest value the error is finite everywhere.
    """
    d = np.linspace(*visited, _GRID)
    to_d, unit_d = scale(float(np.abs(d).max()), "m")
    with sheet(1, 2, height=3.7) as (figure, (left, right)):
        _draw_forces(left, true, [one for one in found if one.in_both], d, to_d)
        errors = [relative_error(true, one.link, d) for one in found]
        for one, error in zip(found, errors, strict=True):
            right.plot(d * to_d, error, label=one.label, **_line(one))
        right.set_yscale("log")
        right.set_ylim(bottom=_DEPTH * min(error.max() for error in errors))
        right.set_ylabel("error, % of the largest force")
        left.set_title("a  force")
        right.set_title("b  relative error")
        for axes in (left, right):
            axes.set_xlabel(f"elongation d, {unit_d}")
            axes.set_xlim(d[0] * to_d, d[-1] * to_d)
        named = {
            label: handle
            for axes in (left, right)
            for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
        }
        figure.legend(list(named.values()), list(named), loc="outside lower center", ncols=3)
        if title:
            figure.suptitle(title, x=0.01, horizontalalignment="left", fontsize=9)
    return figure


def _draw_forces(axes: Axes, true: Link, found: Sequence[FoundForce], d: Floats, to_d: float) -> None:
    force = true.force(d)
    to_f, unit_f = scale(float(np.abs(force).max()), "N")
    axes.plot(d * to_d, force * to_f, color=TRUE, linewidth=3.0, alpha=0.35, label="theory")
    for one in found:
        axes.plot(d * to_d, one.link.force(d) * to_f, label=one.label, **_line(one))
    axes.set_ylabel(f"force at v = 0, {unit_f}")


def _line(one: FoundForce) -> dict[str, Any]:
    return {"color": one.color, "linestyle": (0, (4, 2)) if one.dashed else "-"}
