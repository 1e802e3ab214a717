"""How the terms of a discovery were chosen: the path over model sizes, what came next, and the evidence term by term."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from linkwise.discovery.result import CERTAIN, Discovery, RunnerUp, TermEvidence
from linkwise.plot.palette import IDENTIFIED, SEEN, TRUE, VISITED, WELL
from linkwise.plot.style import sheet

_RUNNERS_UP = 10
_DROPPED = 16  # that are drawn below the terms kept
_KEPT = 40
_FAR = 100.0  # a margin from which a linear scale shows nothing of the others
_ROW = 0.19  # inches


def path_figure(found: Discovery) -> Figure:
    """Misfit and criterion against the number of terms with the chosen point; beside it the next best models.

    Scales are linear to 10 and logarithmic beyond, where there is much beyond.
    """
    with sheet(columns=2, width=8.0, height=3.6) as (figure, [path, runners]):
        _draw_path(path, found)
        _draw_runners(runners, found.runners_up[:_RUNNERS_UP])
        figure.legend(*path.get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


def _draw_path(axes: Axes, found: Discovery) -> None:
    terms = [each.terms for each in found.path]
    curves = (
        ([each.cost for each in found.path], SEEN, "misfit, above the largest model's"),
        ([each.criterion for each in found.path], IDENTIFIED, "criterion, above the chosen model's"),
    )
    for values, color, label in curves:
        axes.plot(terms, values, "o-", color=color, markersize=3, label=label)
    for each in found.path:
        if each.chosen:
            axes.plot(
                each.terms,
                each.criterion,
                "o",
                color=WELL,
                markersize=8,
                zorder=5,
                clip_on=False,
                label="chosen",
            )
            axes.axvline(each.terms, color=WELL, linewidth=0.8, zorder=0)
    axes.axhspan(0.0, CERTAIN, color=VISITED, zorder=0, label=f"in doubt (to {CERTAIN:g})")
    axes.set_yscale("symlog", linthresh=10.0, linscale=0.6)
    axes.set_ylim(min((each.criterion for each in found.path), default=0.0) - 0.5, None)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlabel("terms")
    axes.set_ylabel("-2 log likelihood")
    axes.set_title("models of all sizes")


def _draw_runners(axes: Axes, runners: tuple[RunnerUp, ...]) -> None:
    rows = np.arange(len(runners))
    axes.axvspan(0.0, CERTAIN, color=VISITED, zorder=0)
    axes.barh(rows, [each.margin for each in runners], color=IDENTIFIED, height=0.6)
    axes.set_yticks(rows, [each.change for each in runners])
    axes.invert_yaxis()
    axes.grid(False, axis="y")
    if max((each.margin for each in runners), default=0.0) > _FAR:
        axes.set_xscale("symlog", linthresh=10.0, linscale=0.6)
    axes.set_xlabel("criterion above the chosen model's")
    axes.set_title("the next best models")


def evidence_figure(found: Discovery) -> Figure:
    """What each term kept explains, and each of the nearest dropped would: a bar for z**2, a stroke for its price."""
    kept = found.kept[:_KEPT]
    dropped = [term for term in found.terms if not term.kept and term.identifiable]
    near = sorted(dropped, key=lambda term: term.margin)[:_DROPPED]
    rows = [*kept, *near]
    with sheet(width=6.3, height=1.5 + _ROW * max(len(rows), 4)) as (figure, [axes]):
        _bars(axes, rows, 0, len(kept), IDENTIFIED, "kept")
        _bars(axes, rows, len(kept), len(rows), SEEN, "dropped")
        if rows:
            prices = [term.penalty for term in rows]
            axes.plot(prices, range(len(rows)), "|", color=WELL, markersize=9, label="price of the term")
        names = [f"{term.name}: {term.term}{'' if term.certain else '  (in doubt)'}" for term in rows]
        axes.set_yticks(range(len(rows)), names)
        axes.set_ylim(len(rows) - 0.4, -0.6)
        axes.grid(False, axis="y")
        axes.set_xscale("symlog", linthresh=10.0, linscale=0.6)
        axes.set_xlim(0.0, None)
        axes.set_xlabel("misfit that the term takes away, in -2 log likelihood")
        more = [f"{len(found.kept) - len(kept)} more kept"] if len(found.kept) > len(kept) else []
        more += [f"{len(dropped) - len(near)} more dropped"] if len(dropped) > len(near) else []
        listed = f" ({', '.join(more)})" if more else ""
        axes.set_title(f"evidence term by term{listed}")
        axes.axhline(len(kept) - 0.5, color=TRUE, linewidth=0.6)
        figure.legend(loc="outside lower center", ncols=3)
    return figure


def _bars(axes: Axes, rows: list[TermEvidence], start: int, stop: int, color: str, label: str) -> None:
    if stop > start:
        axes.barh(
            range(start, stop), [term.z**2 for term in rows[start:stop]], color=color, height=0.6, label=label
        )
