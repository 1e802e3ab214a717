"""Figures 8 and 9 of the paper: error and computing time over the degrees of freedom, ours beside the paper's."""

from __future__ import annotations

from matplotlib.figure import Figure

from linkwise.paper.published import DECIBELS, INFORMED_NMSE, INFORMED_SECONDS, TABLE_2
from linkwise.paper.subset import PaperStudy
from linkwise.plot.palette import MEASURED
from linkwise.plot.study_accuracy import CurveStyle, PublishedValues, curve_styles, draw_curves
from linkwise.plot.style import legend_below, sheet
from linkwise.study.cells import StudyTable


def figure_8(table: StudyTable, paper: PaperStudy, classical: str | None = None) -> Figure:
    """SINDy with all monomials: a to c the error at 40, 30 and 20 dB, d the time of one estimate at 20 dB.

    The paper's values are those of Table 2; it prints no times for d. linkwise's own estimators stand beside them, and other
    conventions than the one called `classical` behind them.
    """
    others = [method for method in paper.classical if method != classical]
    drawn = {
        **dict.fromkeys(others, CurveStyle("SINDy, other conventions", MEASURED, "", faint=True)),
        **curve_styles([method for method in table.methods if method not in (*others, *paper.informed)]),
    }
    with sheet(2, 2, height=5.9) as (figure, panels):
        for letter, axes, decibel in zip("abc", panels, DECIBELS, strict=False):
            printed = {name: TABLE_2[masses, decibel] for name, masses in paper.masses.items()}
            draw_curves(axes, table, decibel, "nmse", drawn, PublishedValues("paper, Table 2", printed))
            axes.set_title(f"{letter}  {decibel:g} dB")
        draw_curves(panels[3], table, DECIBELS[-1], "seconds", drawn)
        panels[3].set_title(f"d  time of one estimate, {DECIBELS[-1]:g} dB")
        legend_below(figure, *panels)
    return figure


def figure_9(table: StudyTable, paper: PaperStudy) -> Figure:
    """Physics-informed SINDy at 20 dB: a the error, b the time, with linkwise's own estimators beside it."""
    drawn = curve_styles([method for method in table.methods if method not in paper.classical])
    level = DECIBELS[-1]
    error = dict.fromkeys(paper.masses, INFORMED_NMSE)
    seconds = {name: INFORMED_SECONDS[masses] for name, masses in paper.masses.items()}
    with sheet(1, 2, height=3.3) as (figure, panels):
        draw_curves(panels[0], table, level, "nmse", drawn, PublishedValues("paper, physics-informed", error))
        panels[0].set_title(f"a  {level:g} dB")
        draw_curves(
            panels[1], table, level, "seconds", drawn, PublishedValues("paper, physics-informed", seconds)
        )
        panels[1].set_title(f"b  time of one estimate, {level:g} dB")
        legend_below(figure, *panels)
    return figure
