"""Forms of force that were not offered and explain the records better than terms that were found.

A selection takes the best of the terms on offer: v and sign(v) where the damping follows the square root of the rate. Their
margins against each other are large, and say nothing of forms that nobody offered. Here each of the usual forms joins each
link that was found, in the local quadratic model of the cost, and terms of the same kind give way to it: of stiffness to one
of stiffness, of damping to one of damping. Terms that the best form makes needless only stand in for it, where the criterion
is lower with it. A form of stiffness in whose place a term explains the records hardly better leaves it in doubt: which of the
two the link has cannot be decided.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from linkwise.arrays import Floats
from linkwise.discovery.candidates import Candidates
from linkwise.discovery.dropped_terms import widened
from linkwise.discovery.quadratic_model import QuadraticModel
from linkwise.discovery.selection import Selection, link_motions
from linkwise.discovery.terms import Term
from linkwise.estimates.estimate import Estimate
from linkwise.likelihood.tests.score_test import CandidateForce, local_quadratic

_STIFFNESS = ("d", "d*abs(d)", "d**3", "d**5", "d**2", "d**4")
_DAMPING = ("v", "sign(v)", "sign(v)*sqrt(abs(v))", "v*abs(v)", "v**3", "v*abs(d)", "v*d**2")
_SATURATING = (0.2, 0.7)  # times the root mean square rate of a link: where tanh turns
_STRONG = 10.0  # of the criterion: "very strong" evidence for the form (Kass and Raftery 1995)
_MOST_LINKS = 40
_MOST_TERMS = 4  # of one kind on a link, of which all subsets are tried
_NAMED = 3
_NOT_TESTED = (
    "With random forces it is not tested whether terms stand in for a form that was not offered, or for an error of what "
    "was stated."
)


@dataclass(frozen=True)
class RivalForm:
    """A `form` on a `link` beside which the `terms`, by number, are not needed, at a criterion that is lower by `gain`.

    With a `gain` up to 10 it only explains the records about as well.

    `moved` (p,) is by how much the parameters of the selection would change, those of the terms to zero.
    """

    link: str
    form: str
    terms: tuple[int, ...]
    gain: float
    moved: Floats

    @property
    def is_better(self) -> bool:
        """Whether the terms only stand in for it, by very strong evidence."""
        return self.gain > _STRONG

    def remark(self, names: Sequence[str]) -> str:
        """A sentence for the user; `names` are those of all terms by number."""
        terms = " and ".join(names[number] for number in self.terms)
        if not self.is_better:
            return (
                f"A force like {self.form} in {self.link}, which was not offered, explains the record as well as {terms} (the "
                f"criterion changes by {-self.gain:+.2g}). A wider range of motion, or less noise, would distinguish "
                f"them."
            )
        return (
            f"With a force like {self.form} in {self.link}, which was not offered, {terms} would not be needed and the "
            f"criterion would be {self.gain:.3g} lower: offer it."
        )


def rival_forms(selection: Selection, candidates: Candidates) -> tuple[RivalForm, ...]:
    """For each link and kind of term the form that replaces terms there best, the best of all first.

    Where none is better, of stiffness the one that explains the records about as well in place of nonlinear terms.
    """
    structure, p = selection.structure, len(selection.structure.parameters)
    places = [*_places(selection, candidates)][:_MOST_LINKS]
    rates = link_rates(selection) if places else {}
    tested = [
        (link, chosen, form)
        for link, pair, damping, chosen in places
        for form in _forms(candidates, pair, damping=damping, rate=rates[link])
    ]
    if not tested:
        return ()
    index = structure.topology.index
    ends = {link.name: link.between for link in structure.links}
    forces = [
        CandidateForce(index[ends[link][0]], index[ends[link][1]], form.law) for link, _, form in tested
    ]
    try:
        local = local_quadratic(selection.fit.optimum, forces)
        model = selection.quadratic_beside(local, [form.text for _, _, form in tested])
    except np.linalg.LinAlgError:
        return ()
    linear = {name for name, entry in candidates.by_name.items() if entry.term.text.replace(" ", "") == "d"}
    rivals = []
    for number, (link, chosen, form) in enumerate(tested):
        totals = _totals(selection, model, chosen, p + number, damping=form.is_damping)
        terms = min(totals, key=lambda dropped: totals[dropped], default=())
        if not (terms and totals[terms] < -_STRONG):
            curved = (
                ()
                if form.is_damping
                else (d for d in totals if d and linear.isdisjoint(model.names[k] for k in d))
            )
            terms = min(curved, key=lambda dropped: totals[dropped], default=())
        gain = -totals[terms] if terms in totals else 0.0
        rivals.append(RivalForm(link, form.text, terms, gain, _moved(model, terms, p + number, p)))
    return best_rivals(rivals, [tuple(chosen) for _, chosen, _ in tested])


def best_rivals(rivals: Sequence[RivalForm], replaceable: Sequence[tuple[int, ...]]) -> tuple[RivalForm, ...]:
    """Of forms that replace terms, and are better or about as good, the best for each link and its `replaceable` terms.

    A form that would only join the terms, however much it gains, says nothing of whether they stand in for another one.
    """
    best: dict[tuple[str, tuple[int, ...]], RivalForm] = {}
    for rival, chosen in zip(rivals, replaceable, strict=True):
        key = rival.link, chosen
        if rival.terms and rival.gain > -_STRONG and (key not in best or rival.gain > best[key].gain):
            best[key] = rival
    return tuple(sorted(best.values(), key=lambda rival: -rival.gain))


def rival_form_remarks(rivals: Sequence[RivalForm], selection: Selection) -> tuple[str, ...]:
    """Sentences on the first of the `rivals` of a `selection`, or that none was looked for."""
    if selection.fit.random_forces:
        return (_NOT_TESTED,)
    return tuple(rival.remark(selection.quadratic.names) for rival in rivals[:_NAMED])


def allowing_for(estimate: Estimate, rivals: Sequence[RivalForm]) -> Estimate:
    """The estimate with intervals that include the effect of the `rivals` on the coefficients."""
    for rival in (rival for rival in rivals if rival.is_better):
        estimate = widened(estimate, np.outer(rival.moved, rival.moved))
    return estimate


def _moved(model: QuadraticModel, dropped: Collection[int], form: int, parameters: int) -> Floats:
    """(p,) by how much the parameters change with a form, by its number in the model, in place of terms."""
    retained = [number for number in range(parameters) if number not in dropped]
    moved = np.zeros(parameters)
    try:
        moved -= model.solve(range(parameters)).values
        moved[retained] += model.solve([*retained, form]).values[:-1]
    except np.linalg.LinAlgError:
        return np.zeros(parameters)
    return moved


def _places(selection: Selection, candidates: Candidates) -> Iterator[tuple[str, int, bool, list[int]]]:
    """Links and, for each kind, whether it is damping, with the terms chosen of that kind, by number."""
    links = {frozenset(link.between): link.name for link in selection.structure.links}
    by_kind: dict[tuple[int, bool], list[int]] = {}
    for number in range(len(selection.structure.parameters)):
        entry = candidates.by_name.get(selection.quadratic.names[number])
        if entry is None or entry.offered.parameters:
            continue
        if entry.term.elastic or entry.term.is_damping:
            by_kind.setdefault((entry.pair, entry.term.is_damping), []).append(number)
    for (pair, damping), chosen in by_kind.items():
        if not candidates.pairs[pair].stated and len(chosen) <= _MOST_TERMS:
            yield links[frozenset(candidates.pairs[pair].between)], pair, damping, chosen


def link_rates(selection: Selection) -> dict[str, float]:
    """Root mean square rate of each link along the fitted motion, in m/s."""
    return {name: float(np.sqrt(np.mean(v**2))) for name, (_, v) in link_motions(selection).items()}


def _forms(candidates: Candidates, pair: int, *, damping: bool, rate: float) -> Iterator[Term]:
    """Forms of a kind that were not offered on a pair."""
    offered = {entry.term.text.replace(" ", "") for entry in candidates.entries if entry.pair == pair}
    texts = _DAMPING if damping else _STIFFNESS
    if damping and rate > 0.0:
        texts = (*texts, *(f"tanh(v/{part * rate:.2g})" for part in _SATURATING))
    for text in texts:
        if text not in offered:
            yield Term(text, "form")


def _totals(
    selection: Selection, model: QuadraticModel, chosen: list[int], form: int, *, damping: bool
) -> dict[tuple[int, ...], float]:
    """By how much the criterion is higher with a form, for all choices of terms among the `chosen` that give way to it."""
    penalty, every = selection.penalty, range(len(selection.structure.parameters))
    pair = np.append(
        penalty.pair[: len(every)], np.full(len(model.names) - len(every), penalty.pair[chosen[0]])
    )
    penalty = replace(penalty, pair=pair)
    totals: dict[tuple[int, ...], float] = {}
    try:
        selected = model.cost(every) + penalty.total(list(every))
        for count in range(len(chosen) + 1):
            for dropped in combinations(chosen, count):
                inside = [*(number for number in every if number not in dropped), form]
                values = model.solve(inside).values
                if not damping or values[-1] > 0.0:
                    totals[dropped] = penalty.total(inside) - float(model.g[inside] @ values) - selected
    except np.linalg.LinAlgError:
        return {}
    return totals
