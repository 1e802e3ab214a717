"""The printed discovery: verdict, links by certainty with the evidence for their terms, doubtful terms, next best models."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf, isfinite, isnan

from linkwise.discovery.memory_text import memory_rows, memory_sentence
from linkwise.discovery.result import CERTAIN, Discovery, TermEvidence
from linkwise.display import (
    align_columns,
    as_text,
    format_chi_square,
    format_duration,
    format_error,
    format_value,
    paragraph,
    remark_lines,
)
from linkwise.estimates.link_estimate import CoefficientEstimate, LinkEstimate
from linkwise.verdict import Decision

Rows = list[tuple[str, ...]]

_LINKS = 24  # that are printed; a longer list is in the result folder
_DOUBTFUL = 12
_RUNNERS_UP = 5
_SIZES = 3  # of models with fewer terms, and with more, beside the selected one

TERM_HEAD = ("", "value", "std. error", "z", "margin", "unit")
DOUBTFUL_HEAD = ("", "term", "now", "z", "margin", "probability", "would be")
PATH_TITLE = (
    "models of other sizes: criterion, and -2 log likelihood of pieces left out, above the selected one"
)
PATH_HEAD = ("terms", "step", "criterion", "prediction", "scatter", "share of force")
RUNNER_UP_HEAD = ("model", "criterion above the selected one")


@as_text.register
def discovery_text(discovery: Discovery) -> str:
    """The whole result as text."""
    first, *sentences = headline(discovery)
    blocks = ["\n".join([first, *(paragraph(sentence) for sentence in sentences)])]
    links = links_by_certainty(discovery)
    masses = [*mass_rows(discovery), *_mode_rows(discovery)]
    terms = [row for link in links for row in term_rows(discovery, link)]
    table = iter(align_columns([TERM_HEAD, *masses, *terms]))
    lines = [next(table), *(next(table) for _ in masses)]
    for link in links[:_LINKS]:
        lines.append(link_title(discovery, link))
        lines += [next(table) for _ in link.coefficients]
    if len(links) > _LINKS:
        lines.append(f"... and {len(links) - _LINKS} less certain links; the result folder lists all")
    blocks.append("\n".join(lines))
    if discovery.memory:
        memory = map(memory_sentence, discovery.memory)
        blocks.append("\n".join([*memory, *align_columns(memory_rows(discovery.memory))]))
    doubtful = doubtful_rows(discovery)
    if len(doubtful) > 1:
        more = len(doubtful) - 1 - _DOUBTFUL
        tail = [f"  ... and {more} more"] if more > 0 else []
        blocks.append(
            "\n".join([doubtful_title(discovery), *align_columns(doubtful[: _DOUBTFUL + 1]), *tail])
        )
    if discovery.runners_up:
        rows = runner_up_rows(discovery)[: _RUNNERS_UP + 1]
        blocks.append("\n".join(["the next best models", *align_columns(rows)]))
    if len(rows := path_rows(discovery)) > 1:
        blocks.append("\n".join([PATH_TITLE, *align_columns(rows)]))
    remarks = all_remarks(discovery)
    if remarks:
        blocks.append("\n".join(remark_lines(remark) for remark in remarks))
    return "\n\n".join(blocks)


def headline(discovery: Discovery) -> tuple[str, ...]:
    """The result in one line with whether to trust it, and a sentence on its certainty and cost."""
    estimate = discovery.estimate
    terms = sum(
        coefficient.value != 0.0
        for link in estimate.links
        for coefficient in link.coefficients
        if coefficient.name.key not in link.link.law.nonlinear
    )
    trust = "can be trusted" if discovery.trusted else "NOT to be trusted"
    if discovery.trusted and discovery.in_doubt:
        trust += (
            f", but for {_count(len(discovery.in_doubt), 'link')} in doubt: {', '.join(discovery.in_doubt)}"
        )
    value = estimate.chi_square_per_sample
    chi_square = "" if value is None else f", chi-square {format_chi_square(value)}"
    search = "".join(
        f"{verdict.value} " for verdict in discovery.verdicts if verdict not in estimate.verdicts
    )
    plain = f"{_count(len(estimate.masses), 'mass', 'masses')}, {_count(len(estimate.links), 'link')}"
    return (
        f"{estimate.structure.contents if estimate.structure.hosts else plain} with {_count(terms, 'term')}: {trust}",
        f"{search}{estimate.explanation} {certainty_sentence(discovery)} ({len(discovery.terms)} candidates tested, "
        f"{estimate.samples} samples{chi_square}, {_count(discovery.rounds, 'round')}, {format_duration(discovery.seconds)})",
    )


def certainty_sentence(discovery: Discovery) -> str:
    """How many decisions are not certain, in a sentence."""
    if not discovery.trusted:
        return "No decision is certain."
    selected = sum(term.kept for term in discovery.doubtful)
    dropped = len(discovery.doubtful) - selected
    if not discovery.doubtful:
        return "Every decision is certain."
    parts = [f"{selected} of the terms kept"] * (selected > 0) + [f"{dropped} of those dropped"] * (
        dropped > 0
    )
    return f"In doubt: {' and '.join(parts)}."


def links_by_certainty(discovery: Discovery) -> list[LinkEstimate]:
    """The links, the most certain first."""
    return sorted(discovery.estimate.links, key=lambda link: -discovery.certainty(link.link.name))


def doubt_mark(discovery: Discovery, link: LinkEstimate) -> str:
    """What follows the name of a link that is in doubt, in a result to be trusted."""
    certain = discovery.decision(link.link.name) is Decision.CERTAIN
    return "" if certain or not discovery.trusted else " (in doubt)"


def link_title(discovery: Discovery, link: LinkEstimate) -> str:
    """Name, kind and law of a link."""
    return f"{link.link.name}{doubt_mark(discovery, link)}, {link.kind}: {link.link.law.text}"


def mass_rows(discovery: Discovery) -> Rows:
    """A row for every mass that was unknown."""
    return [
        (mass.name.removesuffix(".mass"), *_term_row(mass, None, marked=False)[1:4], "", mass.unit)
        for mass in discovery.estimate.masses
        if not mass.known
    ]


def _mode_rows(discovery: Discovery) -> Rows:
    """A row for every frequency and damping of a mode that was not known exactly."""
    return [
        (coefficient.name, *_term_row(coefficient, None, marked=False)[1:4], "", coefficient.unit)
        for mode in discovery.estimate.modes
        for coefficient in mode.coefficients
        if not coefficient.known
    ]


def term_rows(discovery: Discovery, link: LinkEstimate) -> Rows:
    """A row for every coefficient of a link."""
    evidence = {term.name: term for term in discovery.kept}
    inside = {f"{link.link.name}.{name}" for name in link.link.law.nonlinear}
    remembering = {name for law in discovery.memory for name in law.coefficients}
    return [
        _term_row(
            coefficient,
            evidence.get(coefficient.name),
            marked=discovery.trusted,
            without="of memory"
            if coefficient.name in remembering
            else "of a term"
            if coefficient.name in inside and not coefficient.known
            else "stated",
        )
        for coefficient in link.coefficients
    ]


def _term_row(
    coefficient: CoefficientEstimate, evidence: TermEvidence | None, *, marked: bool, without: str = "stated"
) -> tuple[str, ...]:
    """`z` is that of the numbers shown, which a model error may have widened since the selection.

    `without` stands for the margin of what was not tested.
    """
    mark = "" if evidence is None or evidence.certain or not marked else "  in doubt"
    if coefficient.known:
        error = "given"
    elif coefficient.standard_error is None:
        error = "none"
    else:
        error = format_error(coefficient.standard_error)
    return (
        coefficient.name.key,
        format_value(coefficient.value, coefficient.standard_error),
        error,
        rough(coefficient.value / coefficient.standard_error) if coefficient.standard_error else "",
        without if evidence is None else rough(evidence.margin),
        f"{coefficient.unit}{mark}",
    )


def doubtful_title(discovery: Discovery) -> str:
    """The title of the table of doubtful terms."""
    ambiguous = discovery.trusted and any(not term.unambiguous for term in discovery.doubtful)
    reasons = (
        ", the interval contains zero, masses moved together, or another term would fit as well"
        if ambiguous
        else ""
    )
    if discovery.trusted and any(term.may_matter for term in discovery.doubtful):
        reasons += ", or the record would not show a term that matters"
    return f"in doubt: the margin is {CERTAIN:g} or less{reasons}"


def doubtful_rows(discovery: Discovery) -> Rows:
    """The terms whose decision is not certain; without trust, those with a small margin."""
    rows: Rows = [DOUBTFUL_HEAD]
    for term in discovery.doubtful:
        if not discovery.trusted and term.identifiable and term.margin > CERTAIN:
            continue
        size = abs(term.standard_error) if isfinite(term.standard_error) else None
        value = f"{format_value(term.value, size)} {term.unit}" if term.identifiable else "not identifiable"
        decision = "kept" if term.kept else "dropped"
        probability = percentage(discovery.inclusion[term.name]) if term.identifiable else ""
        rows.append((term.link, term.term, decision, rough(term.z), rough(term.margin), probability, value))
    return rows


def runner_up_changes(discovery: Discovery) -> list[str]:
    """What the runners-up change, best first, with the functions of terms that no printed law has."""
    functions = _functions_of_dropped(discovery)
    return [_with_functions(model.change, functions) for model in discovery.runners_up]


def runner_up_rows(discovery: Discovery) -> Rows:
    """The runners-up, best first."""
    changes = runner_up_changes(discovery)
    return [
        RUNNER_UP_HEAD,
        *((change, rough(model.margin)) for change, model in zip(changes, discovery.runners_up, strict=True)),
    ]


def path_rows(discovery: Discovery) -> Rows:
    """Models of sizes about that of the selected one, the smallest first, if pieces of the records were left out."""
    chosen = next((number for number, point in enumerate(discovery.path) if point.chosen), 0)
    near = discovery.path[max(0, chosen - _SIZES) : chosen + _SIZES + 1]
    rows: Rows = [PATH_HEAD]
    if all(isnan(point.prediction) for point in near):
        return rows
    functions = _functions_of_dropped(discovery)
    for point in near:
        share = _share(100.0 * point.share) if isfinite(point.share) else ""
        step = _with_functions(point.step, functions)
        figures = rough(point.criterion), rough(point.prediction), rough(point.scatter), share
        judged = ("selected", "", "", "", "") if point.chosen else (step, *figures)
        rows.append((str(point.terms), *judged))
    return rows


def _functions_of_dropped(discovery: Discovery) -> dict[str, str]:
    """The functions of d and v of terms that no printed law has, by name."""
    return {term.name: term.term for term in discovery.terms if not term.kept}


def _with_functions(change: str, functions: Mapping[str, str]) -> str:
    """A change of a model in words, with the functions of the terms that it names."""
    return " ".join(f"{word} ({functions[word]})" if word in functions else word for word in change.split())


def _share(percent: float) -> str:
    """A share to two digits, or to whole percents where it has more."""
    return f"{percent:.0f} %" if percent >= 10.0 else f"{percent:.2g} %"


def all_remarks(discovery: Discovery) -> tuple[str, ...]:
    """What the records cannot show, each sentence once."""
    return tuple(dict.fromkeys((*discovery.remarks, *discovery.estimate.findings)))


def percentage(probability: float) -> str:
    """A probability, rounded to what is known of it."""
    if not 0.005 < probability < 0.995:
        return "> 99 %" if probability > 0.5 else "< 1 %"
    return f"{100.0 * probability:.0f} %"


def rough(value: float) -> str:
    """A number to three digits."""
    if value == inf:
        return "any"
    return f"{value:.3g}" if abs(value) < 1e4 else f"{value:.1e}"


def _count(count: int, singular: str, plural: str = "") -> str:
    return f"{count} {singular if count == 1 else plural or singular + 's'}"
