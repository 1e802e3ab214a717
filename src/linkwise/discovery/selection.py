"""The likelihood decides: fit, look along the parabola at every candidate, change the choice, fit again."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from linkwise.arrays import Floats
from linkwise.discovery.candidates import Candidates
from linkwise.discovery.criterion import Penalty
from linkwise.discovery.quadratic_model import QuadraticModel
from linkwise.discovery.stepwise import Move, best, local_search, ranked_moves
from linkwise.likelihood.anneal import AnnealingStatus, AnnealingStep
from linkwise.likelihood.fit import LikelihoodFit, LikelihoodOptions, likelihood_fit
from linkwise.likelihood.score_test import CandidateForce, local_quadratic
from linkwise.model.link import BASE, GROUND
from linkwise.model.structure import Structure
from linkwise.records.record import Record

Start = Callable[[Structure], tuple[Floats, Floats | None]]
Report = Callable[[int, AnnealingStep], None]

_ROUNDS = 12
_STEPS = 40  # of a fit whose laws may still be wrong; right ones take a quarter of it
_EXACT = (
    1e-4  # q up to which a parabola tells the whole truth; a looser one serves for the next best terms only
)
_CEILING = 1.05  # chi-square at which a fit stops tightening: something is missing, and may be told already


@dataclass(frozen=True, eq=False)
class Selection:
    """The `structure` of the `chosen` candidates, its `fit`, and the cost around it in all candidates that were tested."""

    chosen: frozenset[str]
    structure: Structure
    fit: LikelihoodFit
    quadratic: QuadraticModel
    penalty: Penalty
    settled: bool
    rounds: int

    @property
    def exact(self) -> bool:
        """Whether the fit converged with a flow as tight as it should be."""
        return self.fit.status is AnnealingStatus.CONVERGED and self.fit.optimum.q <= _EXACT

    @cached_property
    def neighbours(self) -> tuple[Move, ...]:
        """All steps to other choices, exchanges among them, the best first."""
        inside = list(range(len(self.structure.parameters)))
        return tuple(ranked_moves(self.quadratic, self.penalty, inside, swaps=True))

    @property
    def criterion(self) -> float:
        """Misfit plus price; infinite where the laws did not allow an exact fit."""
        if not self.exact:
            return np.inf
        cost = self.fit.misfit.cost(self.fit.optimum.q) / self.fit.optimum.noise**2
        return cost + self.penalty.total(list(range(len(self.structure.parameters))))


@dataclass(frozen=True, eq=False)
class _Search:
    """What all rounds share: the records, what may be chosen and is `tested`, where a structure's fit starts."""

    records: Sequence[Record]
    candidates: Candidates
    tested: frozenset[str]
    start: Start
    report: Report

    def within(self, names: Collection[str]) -> _Search:
        """The same among the candidates of these names only."""
        return replace(self, tested=self.tested & frozenset(names))


def select_structure(
    records: Sequence[Record],
    candidates: Candidates,
    chosen: Collection[str],
    *,
    tested: Collection[str],
    start: Start,
    report: Report = lambda number, done: None,
) -> Selection:
    """The choice, from `chosen` on, that no candidate in `tested` improves; `start` tells theta and deviations.

    Where that has links which `chosen` had not, the best choice on the links of `chosen` alone is looked for as well, and the
    better of both is taken: terms on false links may stand in for a term that the parabola did not show. `settled` is False
    where the rounds ran out, or where the choice came back to one it had left; then it is the best that was visited. `report`
    is told the round and its steps.
    """
    search = _Search(records, candidates, frozenset(tested), start, report)
    first = _descent(search, frozenset(chosen), 1)
    own = candidates.sharing(chosen)
    if first.fit.status is AnnealingStatus.INTERRUPTED or first.chosen <= own:
        return first
    second = _descent(search.within(own), own & search.tested, first.rounds + 1)
    if second.fit.status is AnnealingStatus.INTERRUPTED or second.criterion >= first.criterion:
        return replace(first, rounds=second.rounds)
    seen = _seen(search, second.fit, second.structure, second.chosen)
    return replace(second, quadratic=seen, penalty=_price(search, seen))


def _descent(search: _Search, now: frozenset[str], number: int) -> Selection:
    """Rounds of fit and change, from the round `number` on, until nothing changes."""
    visited: dict[frozenset[str], Selection] = {}
    structure = search.candidates.structure(now)
    theta, spread = search.start(structure)
    nodes = None
    last = number + _ROUNDS - 1
    while True:
        fit = likelihood_fit(
            search.records,
            structure,
            theta,
            spread=spread,
            options=LikelihoodOptions(
                report=partial(search.report, number),
                nodes=nodes,
                model_error=False,
                ceiling=_CEILING,
                steps=_STEPS,
            ),
        )
        quadratic = _seen(search, fit, structure, now)
        penalty = _price(search, quadratic)
        inside = list(range(len(structure.parameters)))
        after = local_search(quadratic, penalty, inside) if fit.optimum.q > _EXACT else inside
        if after == inside:
            after = best(quadratic, penalty, inside)
        names = frozenset(quadratic.names[k] for k in after) & frozenset(search.candidates.by_name)
        here = Selection(now, structure, fit, quadratic, penalty, names == now, number)
        if here.settled or fit.status is AnnealingStatus.INTERRUPTED:
            return here
        visited[now] = here
        if names in visited or number == last:
            return replace(min(visited.values(), key=lambda each: each.criterion), rounds=number)
        solved = quadratic.solve(after)
        errors = np.abs(solved.values / solved.z)
        told = dict(
            zip([quadratic.names[k] for k in after], zip(solved.values, errors, strict=True), strict=True)
        )
        now, structure = names, search.candidates.structure(names)
        theta, spread = np.array([told[p.name] for p in structure.parameters]).T
        nodes, number = fit.optimum.point.nodes, number + 1


def _seen(
    search: _Search, fit: LikelihoodFit, structure: Structure, chosen: frozenset[str]
) -> QuadraticModel:
    """The cost about the fit, in its parameters and, behind them, the other candidates that are tested."""
    index = {name: number for number, name in enumerate(structure.mass_names)}
    index |= {GROUND: -1, BASE: -2}
    added = [entry for entry in search.candidates.entries if entry.name in search.tested - chosen]
    ends = [search.candidates.pairs[entry.pair].between for entry in added]
    forces = [
        CandidateForce(index[first], index[second], entry.term.law)
        for entry, (first, second) in zip(added, ends, strict=True)
    ]
    found = local_quadratic(fit.optimum, forces)
    names = (*(p.name for p in structure.parameters), *(entry.name for entry in added))
    return QuadraticModel(names, found.curvature, found.slope)


def _price(search: _Search, quadratic: QuadraticModel) -> Penalty:
    samples = sum(int(np.isfinite(record.select(record.responses).values).sum()) for record in search.records)
    return Penalty.of(search.candidates, quadratic.names, samples)
