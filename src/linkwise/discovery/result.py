"""The result of a discovery: a structure, and the evidence for every term kept and every candidate dropped."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from math import inf, isfinite, isnan, nan
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from linkwise.arrays import Floats
from linkwise.discovery.criterion import CERTAIN
from linkwise.discovery.model_average import ModelAverage
from linkwise.discovery.terms import Term
from linkwise.display import (
    JudgedView,
    align_columns,
    format_chi_square,
    format_duration,
    format_percent,
    format_value,
    paragraph,
    remark_lines,
    table,
    text_of,
)
from linkwise.estimates.causes import Cause
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.link_estimate import CoefficientEstimate, LinkEstimate, coefficient_row
from linkwise.model.structure import Structure
from linkwise.verdict import Decision, Grade, Verdict, admit_intervals

_SMALL, _SMALL_DAMPER = 0.01, 0.001  # of the force of a link: terms below them are as good as absent
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
MEMORY_HEAD = ("memory", "law", "over no memory", "over other links", "over other laws")


@dataclass(frozen=True)
class TermEvidence:
    """The evidence for one candidate term.

    Attributes
    ----------
    name : str
        The name of its coefficient, "m2-m1.k3".
    link : str
        The name of its link, "m2-m1".
    between : tuple of str
        The ends of the link.
    term : str
        The function of d and v, "d**3".
    unit : str
        The SI unit of the coefficient.
    kept : bool
        Whether the term is part of the discovered structure.
    identifiable : bool
        Whether the record determines the coefficient beside the terms kept.
    unambiguous : bool
        False where the fit is not to be trusted, where an exchange of this term for or with another one, or for an error of a
        stated value, raises the criterion by less than `CERTAIN`, or where an end of its link moved so much like another mass
        that the link may be that one's.
    value : float
        The coefficient, of a dropped term the one it would have if it were added.
    standard_error : float
        Its standard error, in `unit`; of a term kept one that allows for the terms dropped from the links found.
    z : float
        `value` over its standard error beside the terms kept alone, on which the selection was based.
    margin : float
        By how much the criterion rises if the decision is reversed.
    possible_share : float
        Of a term dropped from a link: the part of the force of the link, by root mean squares, that the far end of its 95 %
        interval would have; 0 for others.

    References
    ----------
    R. E. Kass and A. E. Raftery, "Bayes factors", J. Am. Stat. Assoc. 90 (1995), for the scale of `margin`.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=2.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> discovery = lw.discover(record, {"m1": 1.0, "m2": 0.01})
    >>> term = discovery.kept[0]
    >>> term.decision is lw.discovery.Decision.CERTAIN, term.z**2 > term.penalty
    (True, True)
    """

    name: str
    link: str
    between: tuple[str, str]
    term: str
    unit: str
    kept: bool
    identifiable: bool
    unambiguous: bool
    value: float
    standard_error: float
    z: float
    margin: float
    possible_share: float = 0.0

    @property
    def decision(self) -> Decision:
        """How firm the decision to keep or drop the term is by this record."""
        if not self.identifiable:
            return Decision.NOT_IDENTIFIABLE
        firm = self.unambiguous and self.margin > CERTAIN and not self.may_matter
        return Decision.CERTAIN if firm else Decision.DOUBTFUL

    @property
    def may_matter(self) -> bool:
        """Whether the term was dropped from a link and could be there with a force that matters, unseen.

        That is 1 % of the force of the link, or 0.1 % where the term depends on v: a small damper alone stops the motion.
        """
        limit = _SMALL if Term(self.term, "a").elastic else _SMALL_DAMPER
        return self.possible_share > limit

    @property
    def certain(self) -> bool:
        """Whether the decision is certain by this record."""
        return self.decision is Decision.CERTAIN

    @property
    def penalty(self) -> float:
        """The penalty on the term in the criterion: a term is kept if z**2 exceeds it."""
        return self.z**2 - self.margin if self.kept else self.z**2 + self.margin


@dataclass(frozen=True)
class PathPoint:
    """A model on the path: the best of its size, one term away from the one before.

    Costs are those of the quadratic model at the selected point: exact there, and rough far from it.

    Attributes
    ----------
    terms : int
        The number of terms.
    cost : float
        -2 log likelihood above that of the largest model on the path.
    criterion : float
        Cost plus penalty, above that of the selected model.
    step : str
        The term added ("+ m2-m1.k3") or dropped ("- m2-m1.c") on the way from the selected model.
    chosen : bool
        Whether this is the selected model.
    prediction : float
        What the model pays more than the selected one for pieces of the records that both were not fitted to, in -2 log
        likelihood: each of ten pieces is left out in turn. NaN where the records are too short.
    scatter : float
        Standard error of that, from how far the pieces disagree.
    share : float
        The force of the term of `step` over that of its link, as root mean squares along the motion; NaN where no such link
        was found.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=2.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> discovery = lw.discover(record, {"m1": 1.0, "m2": 0.01})
    >>> chosen = next(point for point in discovery.path if point.chosen)
    >>> chosen.terms == len(discovery.kept), chosen.criterion
    (True, 0.0)
    """

    terms: int
    cost: float
    criterion: float
    step: str
    chosen: bool
    prediction: float = nan
    scatter: float = nan
    share: float = nan


@dataclass(frozen=True)
class RunnerUp:
    """A model that differs from the selected one by one term.

    Attributes
    ----------
    change : str
        The difference in words, "without m2-m1.c".
    margin : float
        By how much its criterion is higher.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=2.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> discovery = lw.discover(record, {"m1": 1.0, "m2": 0.01})
    >>> margins = [model.margin for model in discovery.runners_up]
    >>> margins == sorted(margins)
    True
    """

    change: str
    margin: float


@dataclass(frozen=True)
class MemoryEvidence:
    """The evidence that a link has memory, by a named law.

    Margins are on the scale of -2 log likelihood. A fit that stops before it converges, since it leaves too much, gives a
    lower bound of one.

    Attributes
    ----------
    link : str
        The name of the link, "m2-m1".
    between : tuple of str
        Its ends.
    law : str
        The name of the law, "bouc-wen".
    kept : bool
        Whether the discovered structure has this law; the others explain the records as well.
    coefficients : tuple of str
        The names of the coefficients of the part with memory, "m2-m1.F".
    over_links : float
        By how much the criterion rises if the best other link has memory in its place; infinite if there is no other.
    over_laws : float
        By how much it rises with the best other law on this link; infinite if no other was tried, below zero for a law that
        was not kept.
    over_none : float
        By how much it rises if no link has memory, whatever usual forms of d and v this link has in place of it.
    unambiguous : bool
        Whether the fit can be trusted.

    References
    ----------
    R. E. Kass and A. E. Raftery, "Bayes factors", J. Am. Stat. Assoc. 90 (1995), for the scale of the margins.

    Examples
    --------
    >>> import linkwise as lw
    >>> evidence = lw.discovery.MemoryEvidence(
    ...     "m1-ground", ("m1", "ground"), "dahl", True, ("m1-ground.Fc",), 250.0, 3.0, 120.0, True
    ... )
    >>> evidence.decision is lw.discovery.Decision.CERTAIN, evidence.law_certain
    (True, False)
    """

    link: str
    between: tuple[str, str]
    law: str
    kept: bool
    coefficients: tuple[str, ...]
    over_links: float
    over_laws: float
    over_none: float
    unambiguous: bool

    @property
    def decision(self) -> Decision:
        """How firm it is that this link has memory, whatever the law."""
        firm = self.unambiguous and min(self.over_links, self.over_none) > CERTAIN
        return Decision.CERTAIN if firm else Decision.DOUBTFUL

    @property
    def certain(self) -> bool:
        """Whether it is certain that this link has memory."""
        return self.decision is Decision.CERTAIN

    @property
    def law_certain(self) -> bool:
        """Whether no other law that was tried explains the records as well."""
        return self.certain and self.over_laws > CERTAIN

    @property
    def margin(self) -> float:
        """The least of the margins over other links and over no memory."""
        return min(self.over_links, self.over_none)

    def to_dict(self) -> dict[str, Any]:
        """The evidence as plain data.

        Returns
        -------
        dict
            The attributes, and "decision".
        """
        plain = asdict(self)
        plain["between"], plain["coefficients"] = list(self.between), list(self.coefficients)
        return {**plain, "decision": self.decision.value, "law_certain": self.law_certain}


@dataclass(frozen=True, eq=False, repr=False)
class Discovery(JudgedView):
    """The result of `discover`; printed, a table of links and the evidence for their terms.

    Attributes
    ----------
    estimate : Estimate
        The discovered structure with intervals. They are wider than those of `identify`, since each term that was dropped
        from a link found may be there as large as the record lets it.
    terms : tuple of TermEvidence
        Every candidate that was tested by likelihood: those kept, the most certain first, then those dropped, the least
        certain first. Values are those on which the selection was based; a model error may change those of `estimate`.
    path : tuple of PathPoint
        The criterion against the number of terms.
    runners_up : tuple of RunnerUp
        The next best models, best first.
    average : ModelAverage
        The models that survive beside the selected one, with weights.
    remarks : tuple of str
        Sentences on what the records cannot show.
    verdicts : tuple of Verdict
        Those of the estimate and of the search.
    rounds : int
        Rounds of fit and selection.
    seconds : float
        Computing time in s.
    memory : tuple of MemoryEvidence
        The evidence for the law with memory of the link that has one, and for others that explain the records as well; empty
        where no link has memory.
    untested : tuple of str
        The names of the candidates that were dropped without a test by likelihood, since they were significant in the equation
        of neither of their masses; of more than 12 masses only.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=2.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> discovery = lw.discover(record, {"m1": 1.0, "m2": 0.01})
    >>> discovery.trusted
    True
    >>> [(term.name, term.term) for term in sorted(discovery.kept, key=lambda term: term.name)]
    [('m1-ground.c', 'v'), ('m1-ground.k', 'd'), ('m2-m1.c', 'v'), ('m2-m1.k', 'd'), ('m2-m1.k3', 'd**3')]
    >>> discovery.decision("m2-m1")
    <Decision.CERTAIN: 'certain'>
    """

    estimate: Estimate
    terms: tuple[TermEvidence, ...]
    path: tuple[PathPoint, ...]
    runners_up: tuple[RunnerUp, ...]
    average: ModelAverage
    remarks: tuple[str, ...]
    verdicts: tuple[Verdict, ...]
    rounds: int
    seconds: float
    memory: tuple[MemoryEvidence, ...] = ()
    untested: tuple[str, ...] = ()

    @property
    def diagnosis(self) -> tuple[Cause, ...]:
        """What would explain what the laws leave, as that of `estimate`."""
        return self.estimate.diagnosis

    @property
    def structure(self) -> Structure:
        """The discovered structure, every coefficient a number."""
        return self.estimate.structure

    @cached_property
    def kept(self) -> tuple[TermEvidence, ...]:
        """The terms that were kept, the most certain first."""
        return tuple(term for term in self.terms if term.kept)

    @cached_property
    def doubtful(self) -> tuple[TermEvidence, ...]:
        """The candidates, kept or dropped, whose decision is not certain, the least certain first."""
        return tuple(sorted((term for term in self.terms if not term.certain), key=lambda term: term.margin))

    @cached_property
    def in_doubt(self) -> tuple[str, ...]:
        """The discovered links, stated ones aside, without a certain term: other links may be there instead."""
        found = dict.fromkeys(term.link for term in self.kept)
        return tuple(link for link in found if self.decision(link) is not Decision.CERTAIN)

    @cached_property
    def inclusion(self) -> dict[str, float]:
        """The probability that each term tested is there, by name, among the terms on offer; NaN if it is not identifiable."""
        found = self.average.probabilities
        return {term.name: found[term.name] if term.identifiable else nan for term in self.terms}

    def force_band(self, link: str, d: ArrayLike, *, averaged: bool = True) -> tuple[Floats, Floats, Floats]:
        """Stiffness force of a link with its 95 % band, averaged over the models that survive, or of the selected one.

        Parameters
        ----------
        link : str
            Name of the link.
        d : array_like
            Elongations in m.
        averaged : bool, default True
            Average over the models. That band is wider where they differ; that of the selected model allows for each term
            that was dropped from the link as large as the record lets it be, however improbable.

        Returns
        -------
        force, lower, upper : array of the shape of `d`
            Force and ends of the band in N; NaN ends where no interval can be trusted.

        Raises
        ------
        StructureError
            If there is no such link.
        """
        estimate, elongations = self.estimate.link(link), np.asarray(d, dtype=float)
        if not averaged:
            return estimate.force_band(elongations)
        return self.average.force_band(estimate, elongations)

    def decision(self, link: str) -> Decision:
        """How firm it is that a link is there: certain if it was stated, or one of its terms is certain.

        Parameters
        ----------
        link : str
            Name of the link.

        Returns
        -------
        Decision
            `Decision.CERTAIN` or `Decision.DOUBTFUL`.

        Raises
        ------
        StructureError
            If there is no such link.
        """
        certain = any(each is None or each.certain for each in self._evidence(link))
        return Decision.CERTAIN if certain else Decision.DOUBTFUL

    def certainty(self, link: str) -> float:
        """By how much the criterion rises without the most certain term of a link.

        Parameters
        ----------
        link : str
            Name of the link.

        Returns
        -------
        float
            On the scale of -2 log likelihood (no unit); infinite if the link was stated.

        Raises
        ------
        StructureError
            If there is no such link.
        """
        return max((inf if each is None else each.margin for each in self._evidence(link)), default=inf)

    def _evidence(self, link: str) -> list[TermEvidence | MemoryEvidence | None]:
        """The evidence for each coefficient of a link; None for those that were stated."""
        evidence: dict[str, TermEvidence | MemoryEvidence] = {term.name: term for term in self.kept}
        evidence |= {name: law for law in self.memory for name in law.coefficients}
        return [evidence.get(f"{link}.{name}") for name in self.structure.link(link).coefficients]

    @cached_property
    def grade(self) -> Grade:
        """How far the answer goes: that of its estimate, and of what the search left."""
        search = (verdict.grade for verdict in self.verdicts if verdict not in self.estimate.verdicts)
        return Grade.worst((self.estimate.grade, *search))

    def __str__(self) -> str:
        return text_of(*_blocks(self))

    def to_dict(self) -> dict[str, Any]:
        """The result as plain data: that of the estimate, and the evidence.

        Returns
        -------
        dict
            The content of result.json: that of `Estimate.to_dict`, and "terms", "path", "runners_up", "memory",
            "untested" and "remarks".
        """
        return {
            **self.estimate.to_dict(),
            "seconds": self.seconds,
            "remarks": list(self.remarks),
            "links_in_doubt": list(self.in_doubt),
            **self._judgement(),
            "settled": Verdict.SEARCH_UNSETTLED not in self.verdicts,
            "seen": Verdict.DISPLACEMENTS_INTEGRATED not in self.verdicts,
            "exact": Verdict.TERMS_MAY_BE_MISSING not in self.verdicts,
            "terms": [{**_as_dict(term), "inclusion": self.inclusion[term.name]} for term in self.terms],
            "models": [
                {"terms": list(terms), "weight": float(weight)}
                for terms, weight in zip(self.average.models, self.average.weights, strict=True)
            ],
            "path": [asdict(point) for point in self.path],
            "runners_up": [asdict(model) for model in self.runners_up],
            "memory": [law.to_dict() for law in self.memory],
            "untested": list(self.untested),
        }


def _as_dict(term: TermEvidence) -> dict[str, Any]:
    plain = asdict(term) | {"between": list(term.between)}
    del plain["link"]
    plain["reliable"], plain["told"] = plain.pop("unambiguous"), plain.pop("identifiable")
    return {**plain, "certain": term.certain, "decision": term.decision.value}


Rows = list[tuple[str, ...]]


def _blocks(discovery: Discovery) -> Iterator[Iterable[str]]:
    """The lines of each part of the text."""
    first, *sentences = headline(discovery)
    yield [first, *map(paragraph, sentences)]
    links = links_by_certainty(discovery)
    modes = (coefficient for mode in discovery.estimate.modes for coefficient in mode.coefficients)
    masses = unknown_rows([*discovery.estimate.masses, *modes])
    terms = [row for link in links for row in term_rows(discovery, link)]
    rows = iter(align_columns([TERM_HEAD, *masses, *terms]))
    lines = [next(rows), *(next(rows) for _ in masses)]
    for link in links[:_LINKS]:
        title = f"{link.link.name}{doubt_mark(discovery, link)}, {link.kind}: {link.link.law.text}"
        lines += [title, *(next(rows) for _ in link.coefficients)]
    if len(links) > _LINKS:
        lines.append(f"... and {len(links) - _LINKS} less certain links; the result folder lists all")
    yield lines
    yield [*map(memory_sentence, discovery.memory), *table(memory_rows(discovery.memory))]
    yield table(doubtful_rows(discovery), doubtful_title(discovery), most=_DOUBTFUL)
    yield table(runner_up_rows(discovery)[: _RUNNERS_UP + 1], "the next best models")
    yield table(path_rows(discovery), PATH_TITLE)
    yield map(remark_lines, all_remarks(discovery))


def headline(discovery: Discovery) -> tuple[str, ...]:
    """The result in one line with whether to trust it, and a sentence on its certainty and cost."""
    estimate = discovery.estimate
    terms = sum(
        coefficient.value != 0.0
        for link in estimate.links
        for coefficient in link.coefficients
        if coefficient.name.key not in link.link.law.nonlinear
    )
    trust = discovery.grade.trust
    doubtful = discovery.in_doubt
    if admit_intervals(discovery.verdicts) and doubtful:
        trust += f", but for {_count(len(doubtful), 'link')} in doubt: {', '.join(doubtful)}"
    value = estimate.chi_square_per_sample
    chi_square = "" if value is None else f", chi-square {format_chi_square(value)}"
    of_search = (verdict.value for verdict in discovery.verdicts if verdict not in estimate.verdicts)
    search = "".join(f"{sentence} " for sentence in of_search)
    plain = f"{_count(len(estimate.masses), 'mass', 'masses')}, {_count(len(estimate.links), 'link')}"
    return (
        f"{estimate.structure.contents if estimate.structure.hosts else plain} with {_count(terms, 'term')}: {trust}",
        f"{search}{estimate.explanation} {certainty_sentence(discovery)} ({len(discovery.terms)} candidates tested, "
        f"{estimate.samples} samples{chi_square}, {_count(discovery.rounds, 'round')}, {format_duration(discovery.seconds)})",
    )


def certainty_sentence(discovery: Discovery) -> str:
    """How many decisions are not certain, in a sentence."""
    if not admit_intervals(discovery.verdicts):
        return "No decision is certain."
    if not discovery.doubtful:
        return "Every decision is certain."
    selected = sum(term.kept for term in discovery.doubtful)
    counts = {"the terms kept": selected, "those dropped": len(discovery.doubtful) - selected}
    return f"In doubt: {' and '.join(f'{count} of {terms}' for terms, count in counts.items() if count)}."


def links_by_certainty(discovery: Discovery) -> list[LinkEstimate]:
    """The links, the most certain first."""
    return sorted(discovery.estimate.links, key=lambda link: -discovery.certainty(link.link.name))


def doubt_mark(discovery: Discovery, link: LinkEstimate) -> str:
    """What follows the name of a link that is in doubt, in a result to be trusted."""
    certain = discovery.decision(link.link.name) is Decision.CERTAIN
    return "" if certain or not admit_intervals(discovery.verdicts) else " (in doubt)"


def unknown_rows(coefficients: Sequence[CoefficientEstimate]) -> Rows:
    """A row for every mass, or frequency and damping of a mode, that was not known exactly."""
    return [_row(each, each.name.removesuffix(".mass"), "") for each in coefficients if not each.known]


def term_rows(discovery: Discovery, link: LinkEstimate) -> Rows:
    """A row for every coefficient of a link, with its margin, or what it belongs to if it was not tested."""
    inside = (each for each in link.coefficients if each.name.key in link.link.law.nonlinear)
    margins: dict[str, str] = {each.name: "of a term" for each in inside if not each.known}
    margins |= {name: "of memory" for law in discovery.memory for name in law.coefficients}
    margins |= {term.name: rough(term.margin) for term in discovery.kept}
    marked = admit_intervals(discovery.verdicts)
    marks: dict[str, str] = {term.name: "  in doubt" for term in discovery.doubtful if marked and term.kept}
    return [
        _row(each, each.name.key, margins.get(each.name, "stated"), marks.get(each.name, ""))
        for each in link.coefficients
    ]


def _row(coefficient: CoefficientEstimate, label: str, margin: str, mark: str = "") -> tuple[str, ...]:
    """z is that of the numbers shown, which a model error may have widened since the selection."""
    _, value, error, _, unit = coefficient_row(coefficient, label)
    z = rough(coefficient.value / coefficient.standard_error) if coefficient.standard_error else ""
    return label, value, error, z, margin, f"{unit}{mark}"


def doubtful_title(discovery: Discovery) -> str:
    """The title of the table of doubtful terms."""
    reasons, trusted = "", admit_intervals(discovery.verdicts)
    if trusted and any(not term.unambiguous for term in discovery.doubtful):
        reasons += ", the interval contains zero, masses moved together, or another term would fit as well"
    if trusted and any(term.may_matter for term in discovery.doubtful):
        reasons += ", or the record would not show a term that matters"
    return f"in doubt: the margin is {CERTAIN:g} or less{reasons}"


def doubtful_rows(discovery: Discovery) -> Rows:
    """The terms whose decision is not certain; without trust, those with a small margin."""
    rows: Rows = [DOUBTFUL_HEAD]
    for term in discovery.doubtful:
        if not admit_intervals(discovery.verdicts) and term.identifiable and term.margin > CERTAIN:
            continue
        size = abs(term.standard_error) if isfinite(term.standard_error) else None
        value = f"{format_value(term.value, size)} {term.unit}" if term.identifiable else "not identifiable"
        decision = "kept" if term.kept else "dropped"
        probability = percentage(discovery.inclusion[term.name]) if term.identifiable else ""
        rows.append((term.link, term.term, decision, rough(term.z), rough(term.margin), probability, value))
    return rows


def runner_up_changes(discovery: Discovery) -> list[str]:
    """What the runners-up change, best first, with the functions of terms that no printed law has."""
    return [_with_functions(model.change, discovery) for model in discovery.runners_up]


def runner_up_rows(discovery: Discovery) -> Rows:
    """The runners-up, best first."""
    changes = runner_up_changes(discovery)
    margins = (rough(model.margin) for model in discovery.runners_up)
    return [RUNNER_UP_HEAD, *zip(changes, margins, strict=True)]


def path_rows(discovery: Discovery) -> Rows:
    """Models of sizes about that of the selected one, the smallest first, if pieces of the records were left out."""
    chosen = next((number for number, point in enumerate(discovery.path) if point.chosen), 0)
    near = discovery.path[max(0, chosen - _SIZES) : chosen + _SIZES + 1]
    rows: Rows = [PATH_HEAD]
    if all(isnan(point.prediction) for point in near):
        return rows
    for point in near:
        share = format_percent(point.share) if isfinite(point.share) else ""
        figures = rough(point.criterion), rough(point.prediction), rough(point.scatter), share
        step = _with_functions(point.step, discovery)
        rows.append((str(point.terms), *(("selected", *[""] * 4) if point.chosen else (step, *figures))))
    return rows


def _with_functions(change: str, discovery: Discovery) -> str:
    """A change of a model in words, with the functions of the terms that it names and no printed law has."""
    functions = {term.name: term.term for term in discovery.terms if not term.kept}
    return " ".join(f"{word} ({functions[word]})" if word in functions else word for word in change.split())


def all_remarks(discovery: Discovery) -> tuple[str, ...]:
    """What the records cannot show, each sentence once."""
    return tuple(dict.fromkeys((*discovery.remarks, *discovery.estimate.findings)))


def percentage(probability: float) -> str:
    """A probability, rounded to what is known of it."""
    if not 0.005 < probability < 0.995:
        return "> 99 %" if probability > 0.5 else "< 1 %"
    return f"{100.0 * probability:.0f} %"


def rough(value: float, infinite: str = "any") -> str:
    """A number to three digits."""
    if value == inf:
        return infinite
    return f"{value:.3g}" if abs(value) < 1e4 else f"{value:.1e}"


def _count(count: int, singular: str, plural: str = "") -> str:
    return f"{count} {singular if count == 1 else plural or singular + 's'}"


def memory_sentence(evidence: MemoryEvidence) -> str:
    """What was found of one law."""
    if not evidence.kept:
        return f"{evidence.law} in {evidence.link} explains the records as well."
    if evidence.certain:
        return f"{evidence.link} has memory: {evidence.law}."
    return f"{evidence.link} may have memory, which is in doubt: {evidence.law}."


def memory_rows(memory: Sequence[MemoryEvidence]) -> Rows:
    """By how much the criterion rises without memory, with it in another link, and with another law."""
    rows: Rows = [MEMORY_HEAD]
    for law in memory:
        margins = (law.over_none, law.over_links, law.over_laws)
        rows.append((law.link, law.law, *(rough(value, "none tried") for value in margins)))
    return rows
