"""The figures of a study's page: those of the paper in its order, then what the study has beyond it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from matplotlib.figure import Figure

from linkwise import plot
from linkwise.paper.captions import motion_captions
from linkwise.paper.figures_2_to_5 import figure_2, figure_3, figure_4, figure_5
from linkwise.paper.figures_6_7 import figure_6, figure_7
from linkwise.paper.figures_8_9 import figure_8, figure_9
from linkwise.registry import Registry
from linkwise.report.study_page import StudyReport

MOTION, FORCE, SUCCESS, ACCURACY = (
    "How the chains move",
    "What force is found",
    "Where the right links and terms are found",
    "Accuracy and time over structures",
)
_MOST_NAMED = 12  # structures whose names fit below a panel; without names, numbers of masses fit
_SPREAD = "Medians, and the range of the cycles (5 to 95 %)."


@dataclass(frozen=True)
class StudyFigure:
    """A figure that the page may have under `heading`; `draw` returns None where the study lacks what it would show."""

    heading: str
    title: str
    draw: Callable[[StudyReport], Figure | None]
    caption: Callable[[StudyReport], str]


def _motion(name: str, draw: Callable[[], Figure], title: str) -> StudyFigure:
    """A figure of the paper's chains, for studies that have one of them."""
    return StudyFigure(
        MOTION,
        title,
        lambda report: draw() if report.paper.masses else None,
        lambda report: motion_captions()[name],
    )


def _force(draw: Callable[..., Figure | None], title: str) -> StudyFigure:
    """A figure of the force identified by the convention that reproduces the paper best, for studies that have one."""

    def drawn(report: StudyReport) -> Figure | None:
        best = report.comparison.best
        return None if best is None else draw(report.study, report.table, report.paper, best)

    caption = (
        "In the cycle whose error is the median of its cell. The error is shown against the largest force."
    )
    return StudyFigure(FORCE, title, drawn, lambda report: caption)


def _figure_8(report: StudyReport) -> Figure | None:
    comparison = report.comparison
    return figure_8(report.table, report.paper, comparison.best) if comparison.cells else None


def _figure_9(report: StudyReport) -> Figure | None:
    return figure_9(report.table, report.paper) if report.comparison.cells else None


def _accuracy(report: StudyReport) -> Figure | None:
    counts = list(report.table.masses.values())
    readable = len(counts) <= _MOST_NAMED or len(set(counts)) == len(counts)
    return plot.accuracy_figure(report.table) if report.beyond and readable else None


def _success(report: StudyReport) -> Figure | None:
    return plot.success_figure(report.success) if report.success else None


def _success_caption(report: StudyReport) -> str:
    return (
        f"Per cent of {report.study.cycles} cycles in which a method has all true links and terms and no other. Below it in "
        "red, where there are any, the per cent that it trusts though a term is missing or extra. A case without an answer "
        "counts as neither, and empty cells were not run. A trusted discovery may name doubtful terms, which is not counted."
    )


def _without_times(report: StudyReport) -> str:
    return f"{_SPREAD} The paper prints no times for its Figure 8d, nor which machine it ran on."


def _with_times(report: StudyReport) -> str:
    """The least and the greatest median time of linkwise's own estimators at the last noise level, and what is compared."""
    level = report.table.decibels[-1]
    ranges = []
    for method in (*report.paper.informed, *report.paper.weak, *report.paper.likelihood):
        cells = [report.table.cell(name, level, method) for name in report.paper.masses]
        times = [cell.seconds for cell in cells if cell is not None and cell.seconds is not None]
        if times:
            ranges.append(f"{method} {min(times):.2g} to {max(times):.2g}")
    measured = f"Seconds for one estimate here: {', '.join(ranges)}. " if ranges else ""
    unsaid = "The paper does not say whether its times are for one cycle or for all 100."
    return f"{measured}Medians, and the range of the cycles. {unsaid}"


STUDY_FIGURES: Registry[StudyFigure] = Registry(
    "figure",
    {
        "figure_2": _motion("figure_2", figure_2, "Figure 2: responses of the chain of two masses"),
        "figure_3": _motion("figure_3", figure_3, "Figure 3: its primary mass with the sink and without"),
        "figure_4": _motion("figure_4", figure_4, "Figure 4: responses of the chain of eight masses"),
        "figure_5": _motion("figure_5", figure_5, "Figure 5: its primary masses with sinks and without"),
        "figure_6": _force(figure_6, "Figure 6: the force identified in the chain of two masses"),
        "figure_7": _force(figure_7, "Figure 7: the force identified in the chain of eight masses"),
        "success": StudyFigure(
            SUCCESS, "Success maps: noise and samples a period", _success, _success_caption
        ),
        "figure_8": StudyFigure(
            ACCURACY, "Figure 8: SINDy with all monomials up to the third order", _figure_8, _without_times
        ),
        "figure_9": StudyFigure(ACCURACY, "Figure 9: physics-informed SINDy", _figure_9, _with_times),
        "accuracy": StudyFigure(ACCURACY, "All structures of the study", _accuracy, lambda report: _SPREAD),
    },
)
"""The figures by the name of their files, in the order of the page."""
