"""How a discovery chose its terms: evidence, the path over model sizes, the next best models, and how they depart."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, Unpack

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from linkwise.discovery.criterion import CERTAIN
from linkwise.discovery.result import Discovery, TermEvidence, runner_up_changes
from linkwise.plot.style import (
    IDENTIFIED,
    MEASURED,
    TRUE,
    VISITED,
    WELL,
    On,
    axes_for,
    literal,
    log_scale,
    picture,
    pictures,
    scale,
    single,
)

_POINTS = 201
_FAINTEST = 0.02  # of the weight of all models: others are not drawn


@picture()
def departures(axes: Axes, discovery: Discovery, link: str, **on: Unpack[On]) -> None:
    """Draw by how much the forces of a link depart from that of the selected model: of others that survive, and averaged.

    Each of the models is a line, the wider the more weight it has. The band is that of the force averaged over them.

    Parameters
    ----------
    discovery : Discovery
        An answer of `linkwise.discover`.
    link : str
        Name of the link.
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
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=3.0, rate=1000.0).with_noise(30.0, seed=1)
    >>> found = lw.discover(record, {"m1": 1.0, "m2": 0.01})
    >>> lw.plot.departures(found, "m2-m1").get_xlabel()
    'elongation d, mm'
    """
    estimate, average = discovery.estimate.link(link), discovery.average
    d = np.linspace(*estimate.d_range, _POINTS)
    selected = estimate.force_band(d)[0]
    averaged, lower, upper = (force - selected for force in average.force_band(estimate, d))
    shifts = average.shifts(estimate, d)
    drawn = [lower, upper, shifts[average.weights >= _FAINTEST]]
    sizes = np.abs(np.concatenate([forces.ravel() for forces in drawn]))
    largest = float(np.max(sizes[np.isfinite(sizes)], initial=0.0))
    law, of_d = estimate.link.law, estimate.link.law.motion_units[0]
    (to_d, unit_d), (to_f, unit_f) = scale(d, of_d), scale(largest, law.force_unit)
    if np.isfinite(lower).all():
        band = axes.fill_between(d * to_d, lower * to_f, upper * to_f, color=VISITED, lw=0)
        band.set_label("95 % band, averaged")
    others = [number for number in range(1, len(shifts)) if average.weights[number] >= _FAINTEST]
    for number in others:
        width = 0.5 + 2.5 * float(average.weights[number])
        label = "other models that survive" if number == others[0] else None
        axes.plot(d * to_d, shifts[number] * to_f, color=MEASURED, lw=width, label=label)
    axes.plot(d * to_d, averaged * to_f, color=WELL, lw=1.0, label="averaged")
    axes.axhline(0.0, color=IDENTIFIED, lw=0.5 + 2.5 * float(average.weights[0]), label="selected")
    axes.set(xlabel=f"elongation d, {unit_d}", ylabel=f"force less that selected, {unit_f}")
    selected_one = f"the selected one with {average.weights[0]:.0%}"
    axes.set_title(literal(f"{link}: models that survive, {selected_one}"))


_SELECTED = 40  # terms that are drawn
_LONGEST = 20  # letters of a function that leave room for the bars
_DROPPED = 16  # and those below them
_ROW = 0.19  # inches


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
    selected, dropped = _evidence_rows(discovery)
    rows = [*selected, *dropped]
    with axes_for(ax, legend=legend, height=_height(len(rows))) as axes:
        _draw_bars(axes, selected, 0, IDENTIFIED, "kept")
        _draw_bars(axes, dropped, len(selected), MEASURED, "dropped")
        if rows:
            penalties = [term.penalty for term in rows]
            axes.plot(penalties, range(len(rows)), "|", color=WELL, ms=9, label="penalty of the term")
        names = [f"{term.name}: {_term_label(term)}{'' if term.certain else '  (in doubt)'}" for term in rows]
        axes.set_yticks(range(len(rows)), [literal(name) for name in names])
        axes.set_ylim(len(rows) - 0.4, -0.6)
        axes.grid(False, axis="y")
        log_scale(axes, "x", linear_to=10.0)
        axes.set(xlim=(0.0, None), xlabel="reduction of the misfit by the term, in -2 log likelihood")
        axes.set_title(f"evidence term by term{_not_drawn(discovery, len(selected), len(dropped))}")
        axes.axhline(len(selected) - 0.5, color=TRUE, lw=0.6)
    return axes


def evidence_figure(discovery: Discovery) -> Figure:
    """The evidence term by term on a figure of its own, as high as there are terms."""
    return single(partial(evidence, discovery), height=_height(sum(map(len, _evidence_rows(discovery)))))


def _evidence_rows(discovery: Discovery) -> tuple[Sequence[TermEvidence], Sequence[TermEvidence]]:
    """The terms kept that are drawn, the most certain first, and the dropped ones nearest to being kept."""
    nearest = sorted(_identifiable(discovery), key=lambda term: term.margin)
    return discovery.kept[:_SELECTED], nearest[:_DROPPED]


def _identifiable(discovery: Discovery) -> list[TermEvidence]:
    """The dropped terms that the record identifies beside those that were kept."""
    return [term for term in discovery.terms if not term.kept and term.identifiable]


def _not_drawn(discovery: Discovery, selected: int, dropped: int) -> str:
    """How many terms are not drawn, in brackets."""
    counts = ((len(discovery.kept) - selected, "kept"), (len(_identifiable(discovery)) - dropped, "dropped"))
    listed = ", ".join(f"{count} more {kind}" for count, kind in counts if count)
    return f" ({listed})" if listed else ""


def _height(rows: int) -> float:
    """Inches of a figure of so many rows."""
    return 1.5 + _ROW * max(rows, 4)


def _term_label(term: TermEvidence) -> str:
    """The function of a term, its beginning if it is long."""
    return term.term if len(term.term) <= _LONGEST else f"{term.term[: _LONGEST - 1]}…"


def _draw_bars(axes: Axes, terms: Sequence[TermEvidence], start: int, color: str, text: str) -> None:
    if terms:
        rows = range(start, start + len(terms))
        axes.barh(rows, [term.z**2 for term in terms], color=color, height=0.6, label=text)


_RUNNERS_UP = 10
_FAR = 100.0  # a margin from which a linear scale shows nothing of the others


@picture()
def path(axes: Axes, discovery: Discovery, **on: Unpack[On]) -> None:
    """Draw misfit and criterion against the number of terms, with the chosen model marked.

    Scales are linear to 10 and logarithmic beyond.

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
        The axes drawn on: numbers of terms, and -2 log likelihood (no unit).

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=3.0, rate=1000.0).with_noise(30.0, seed=1)
    >>> found = lw.discover(record, {"m1": 1.0, "m2": 0.01})
    >>> lw.plot.path(found).get_xlabel()
    'terms'
    """
    terms = [point.terms for point in discovery.path]
    costs, criteria = ([getattr(p, key) for p in discovery.path] for key in ("cost", "criterion"))
    axes.plot(terms, costs, "o-", color=MEASURED, ms=3, label="misfit, above the largest model's")
    axes.plot(terms, criteria, "o-", color=IDENTIFIED, ms=3, label="criterion, above the chosen model's")
    mark: dict[str, Any] = {"ms": 8, "zorder": 5, "clip_on": False, "label": "chosen"}
    for point in discovery.path:
        if point.chosen:
            axes.plot(point.terms, point.criterion, "o", color=WELL, **mark)
            axes.axvline(point.terms, color=WELL, lw=0.8, zorder=0)
    axes.axhspan(0.0, CERTAIN, color=VISITED, zorder=0, label=f"in doubt (to {CERTAIN:g})")
    log_scale(axes, "y", linear_to=10.0)
    axes.set_ylim(min(criteria, default=0.0) - 0.5, None)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set(xlabel="terms", ylabel="-2 log likelihood", title="models of all sizes")


@picture()
def runners_up(axes: Axes, discovery: Discovery, **on: Unpack[On]) -> None:
    """Draw how much worse the criterion of the next best models is.

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
        The axes drawn on: a bar for each of the ten best models, best first, in -2 log likelihood (no unit).

    Examples
    --------
    >>> import linkwise as lw
    >>> from linkwise.plot.discoveries import runners_up
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=3.0, rate=1000.0).with_noise(30.0, seed=1)
    >>> found = lw.discover(record, {"m1": 1.0, "m2": 0.01})
    >>> runners_up(found).get_title("left")
    'the next best models'
    """
    margins = [model.margin for model in discovery.runners_up[:_RUNNERS_UP]]
    rows = np.arange(len(margins))
    axes.axvspan(0.0, CERTAIN, color=VISITED, zorder=0)
    axes.barh(rows, margins, color=IDENTIFIED, height=0.6)
    axes.set_yticks(rows, [literal(change) for change in runner_up_changes(discovery)[:_RUNNERS_UP]])
    axes.invert_yaxis()
    axes.grid(False, axis="y")
    if max(margins, default=0.0) > _FAR:
        log_scale(axes, "x", linear_to=10.0)
    axes.set(xlabel="criterion above the chosen model's", title="the next best models")


def path_figure(discovery: Discovery) -> Figure:
    """The path and, beside it, the next best models."""
    draws = [partial(path, discovery), partial(runners_up, discovery)]
    return pictures(draws, width=8.0, legend_columns=4)
