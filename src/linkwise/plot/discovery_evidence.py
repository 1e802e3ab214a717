"""The evidence for every term of a discovery."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from linkwise.argument_types import checked
from linkwise.discovery.result import Discovery, TermEvidence
from linkwise.plot.palette import IDENTIFIED, MEASURED, TRUE, WELL
from linkwise.plot.style import axes_for, legend_below, literal, log_scale, sheet

_SELECTED = 40  # terms that are drawn
_LONGEST = 20  # letters of a function that leave room for the bars
_DROPPED = 16  # and those below them
_ROW = 0.19  # inches


@checked
def evidence(discovery: Discovery, *, legend: bool = True, ax: Axes | None = None) -> Axes:
    """Draw what each term kept explains, and what each of the nearest dropped terms would explain.

    A bar is the misfit that the term takes away, a stroke its penalty: a term belongs into the answer where the bar is longer.

    Parameters
    ----------
    discovery : Discovery
        An answer of `linkwise.discover`.
    legend : bool, default True
        Add a legend to the axes.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on. By default those of a new figure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on: -2 log likelihood (no unit), a row for every term.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=3.0, rate=1000.0).with_noise(30.0, seed=1)
    >>> found = lw.discover(record, {"m1": 1.0, "m2": 0.01})
    >>> len(lw.plot.evidence(found).get_yticklabels()) >= len(found.kept)
    True
    """
    selected, dropped = _rows(discovery)
    rows = [*selected, *dropped]
    with axes_for(ax, legend=legend, height=_height(len(rows))) as axes:
        _bars(axes, selected, 0, IDENTIFIED, "kept")
        _bars(axes, dropped, len(selected), MEASURED, "dropped")
        if rows:
            penalties = [term.penalty for term in rows]
            axes.plot(penalties, range(len(rows)), "|", color=WELL, markersize=9, label="penalty of the term")
        names = [f"{term.name}: {_label(term)}{'' if term.certain else '  (in doubt)'}" for term in rows]
        axes.set_yticks(range(len(rows)), [literal(name) for name in names])
        axes.set_ylim(len(rows) - 0.4, -0.6)
        axes.grid(False, axis="y")
        log_scale(axes, "x", linear_to=10.0)
        axes.set_xlim(0.0, None)
        axes.set_xlabel("reduction of the misfit by the term, in -2 log likelihood")
        axes.set_title(f"evidence term by term{_left_out(discovery, len(selected), len(dropped))}")
        axes.axhline(len(selected) - 0.5, color=TRUE, linewidth=0.6)
    return axes


@checked
def evidence_figure(discovery: Discovery) -> Figure:
    """The evidence term by term on a figure of its own, as high as there are terms.

    Parameters
    ----------
    discovery : Discovery
        What `linkwise.discover` returned.

    Returns
    -------
    matplotlib.figure.Figure
        A figure that no window shows; `save` writes it.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=3.0, rate=1000.0).with_noise(30.0, seed=1)
    >>> discovery = lw.discover(record, {"m1": 1.0, "m2": 0.01})
    >>> len(lw.plot.evidence_figure(discovery).axes)
    1
    """
    with sheet(height=_height(sum(map(len, _rows(discovery))))) as (figure, [axes]):
        evidence(discovery, legend=False, ax=axes)
        legend_below(figure, axes)
    return figure


def _rows(discovery: Discovery) -> tuple[Sequence[TermEvidence], Sequence[TermEvidence]]:
    """The terms kept that are drawn, the most certain first, and the dropped ones nearest to being kept."""
    return discovery.kept[:_SELECTED], sorted(_identifiable(discovery), key=lambda term: term.margin)[
        :_DROPPED
    ]


def _identifiable(discovery: Discovery) -> list[TermEvidence]:
    """The dropped terms that the record identifies beside those that were kept."""
    return [term for term in discovery.terms if not term.kept and term.identifiable]


def _left_out(discovery: Discovery, selected: int, dropped: int) -> str:
    """How many terms are not drawn, in brackets."""
    counts = ((len(discovery.kept) - selected, "kept"), (len(_identifiable(discovery)) - dropped, "dropped"))
    listed = ", ".join(f"{count} more {kind}" for count, kind in counts if count)
    return f" ({listed})" if listed else ""


def _height(rows: int) -> float:
    """Inches of a figure of so many rows."""
    return 1.5 + _ROW * max(rows, 4)


def _label(term: TermEvidence) -> str:
    """The function of a term, its beginning if it is long."""
    return term.term if len(term.term) <= _LONGEST else f"{term.term[: _LONGEST - 1]}…"


def _bars(axes: Axes, terms: Sequence[TermEvidence], start: int, color: str, text: str) -> None:
    if terms:
        rows = range(start, start + len(terms))
        axes.barh(rows, [term.z**2 for term in terms], color=color, height=0.6, label=text)
