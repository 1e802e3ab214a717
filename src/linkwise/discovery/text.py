"""The printed discovery: verdict, links by certainty with the evidence for every term, what was in doubt, what came next."""

from __future__ import annotations

from math import inf, isfinite
from textwrap import fill

from linkwise.discovery.result import CERTAIN, Discovery, TermEvidence
from linkwise.estimates.link_estimate import CoefficientEstimate, LinkEstimate
from linkwise.text import align_columns, as_text, format_error, format_value
from linkwise.verdict import Decision

Rows = list[tuple[str, ...]]

_LINKS = 24  # that are printed; a longer list is read in the result folder
_DOUBTS = 12
_NEXT = 5  # runners-up
_WIDTH = 100  # at which sentences are broken

TERM_HEAD = ("", "value", "std. error", "z", "margin", "unit")
DOUBT_HEAD = ("", "term", "now", "z", "margin", "would be")
NEXT_HEAD = ("model", "criterion above the chosen one")


@as_text.register
def text_table(found: Discovery) -> str:
    """The whole answer as text."""
    head, *told = headline(found)
    blocks = ["\n".join([head, *(fill(line, _WIDTH) for line in told)])]
    links = by_certainty(found)
    table = iter(align_columns([TERM_HEAD, *(row for link in links for row in term_rows(found, link))]))
    lines = [next(table)]
    for link in links[:_LINKS]:
        lines.append(link_title(found, link))
        lines += [next(table) for _ in link.coefficients]
    if len(links) > _LINKS:
        lines.append(
            f"... and {len(links) - _LINKS} less certain links; every one stands in the result folder"
        )
    blocks.append("\n".join(lines))
    doubted = doubt_rows(found, CERTAIN)
    if len(doubted) > 1:
        more = len(doubted) - 1 - _DOUBTS
        tail = [f"  ... and {more} more"] if more > 0 else []
        blocks.append("\n".join([doubt_title(found, CERTAIN), *align_columns(doubted[: _DOUBTS + 1]), *tail]))
    if found.runners_up:
        blocks.append("\n".join(["the next best models", *align_columns(next_rows(found)[: _NEXT + 1])]))
    remarks = all_remarks(found)
    if remarks:
        blocks.append("\n".join(fill(f"! {each}", _WIDTH, subsequent_indent="  ") for each in remarks))
    return "\n\n".join(blocks)


def headline(found: Discovery) -> tuple[str, ...]:
    """The answer in a line, whether to trust it, and what it took."""
    estimate = found.estimate
    terms = sum(each.value != 0.0 for link in estimate.links for each in link.coefficients)
    trust = "can be trusted" if found.trusted else "NOT to be trusted"
    if found.trusted and found.in_doubt:
        trust += f", but for {_counted(len(found.in_doubt), 'link')} in doubt: {', '.join(found.in_doubt)}"
    chi = (
        "" if estimate.chi_square_per_sample is None else f", chi-square {estimate.chi_square_per_sample:.3f}"
    )
    rounds = f"{found.rounds} round{'' if found.rounds == 1 else 's'}"
    search = "".join(f"{verdict.value} " for verdict in found.verdicts if verdict not in estimate.verdicts)
    return (
        f"{_counted(len(estimate.masses), 'mass', 'masses')}, {_counted(len(estimate.links), 'link')} with "
        f"{_counted(terms, 'term')}: {trust}",
        f"{search}{estimate.message} {doubts(found)} ({len(found.terms)} candidates tested, {estimate.samples} samples{chi}, "
        f"{rounds}, {found.seconds:.2g} s)",
    )


def doubts(found: Discovery) -> str:
    """How many decisions are not beyond doubt, in a sentence."""
    if not found.trusted:
        return "No decision is beyond doubt."
    kept = sum(term.kept for term in found.doubtful)
    dropped = len(found.doubtful) - kept
    if not found.doubtful:
        return "Every decision is beyond doubt."
    told = [f"{kept} of the terms found"] * (kept > 0) + [f"{dropped} of those dropped"] * (dropped > 0)
    return f"In doubt: {' and '.join(told)}."


def by_certainty(found: Discovery) -> list[LinkEstimate]:
    """The links, the most certain first."""
    return sorted(found.estimate.links, key=lambda each: -found.certainty(each.link.name))


def link_title(found: Discovery, each: LinkEstimate) -> str:
    """Name, kind, law and ends of a link."""
    mark = "" if found.decision(each.link.name) is Decision.CERTAIN or not found.trusted else " (in doubt)"
    return f"{each.link.name}{mark}, {each.kind}: {each.link.law.text}"


def term_rows(found: Discovery, each: LinkEstimate) -> Rows:
    """A row for every coefficient of a link."""
    evidence = {term.name: term for term in found.kept}
    return [
        _term_row(coefficient, evidence.get(coefficient.name), marked=found.trusted)
        for coefficient in each.coefficients
    ]


def _term_row(each: CoefficientEstimate, term: TermEvidence | None, *, marked: bool) -> tuple[str, ...]:
    """`z` is that of the numbers beside it: a model error widens them after the term was judged."""
    mark = "" if term is None or term.certain or not marked else "  in doubt"
    error = (
        "given"
        if each.known
        else "none"
        if each.standard_error is None
        else format_error(each.standard_error)
    )
    return (
        each.name.rpartition(".")[2],
        format_value(each.value, each.standard_error),
        error,
        rough(each.value / each.standard_error) if each.standard_error else "",
        "stated" if term is None else rough(term.margin),
        f"{each.unit}{mark}",
    )


def doubt_title(found: Discovery, certain: float) -> str:
    """What stands above the doubts."""
    more = found.trusted and any(not term.unambiguous for term in found.doubtful)
    return f"in doubt: the margin is {certain:g} or less{', masses moved alike, or another term would do' if more else ''}"


def doubt_rows(found: Discovery, certain: float) -> Rows:
    """What is not beyond doubt, the most doubtful first; of an answer that is not to be trusted, what is close besides."""
    rows: Rows = [DOUBT_HEAD]
    for term in found.doubtful:
        if not found.trusted and term.identifiable and term.margin > certain:
            continue
        size = abs(term.standard_error) if isfinite(term.standard_error) else None
        value = (
            f"{format_value(term.value, size)} {term.unit}"
            if term.identifiable
            else "not told beside what was kept"
        )
        rows.append(
            (
                term.link,
                term.term,
                "kept" if term.kept else "dropped",
                rough(term.z),
                rough(term.margin),
                value,
            )
        )
    return rows


def next_rows(found: Discovery) -> Rows:
    """The runners-up, best first."""
    return [NEXT_HEAD, *((each.change, rough(each.margin)) for each in found.runners_up)]


def all_remarks(found: Discovery) -> tuple[str, ...]:
    """What the record cannot tell, each once."""
    return tuple(dict.fromkeys((*found.remarks, *found.estimate.findings)))


def rough(value: float) -> str:
    """A number on which nothing is built, to three digits."""
    if value == inf:
        return "any"
    return f"{value:.3g}" if abs(value) < 1e4 else f"{value:.1e}"


def _counted(count: int, one: str, many: str = "") -> str:
    return f"{count} {one if count == 1 else many or one + 's'}"
