"""The evidence for a selection, from the local quadratic model: term by term, along a path, and against other models.

A selection calls a term absent where the record does not show it, and the other coefficients then stand for what it did: their
errors beside the terms kept alone are too small. `DroppedTerms` is what those that were dropped add to them.
"""

from __future__ import annotations

from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.discovery.criterion import Move, QuadraticModel, inverse_of
from linkwise.discovery.data_checks import DataChecks
from linkwise.discovery.prediction import Excess, block_parabolas
from linkwise.discovery.result import PathPoint, RunnerUp, TermEvidence
from linkwise.discovery.selection import Selection, singular
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.link_estimate import NORMAL_95
from linkwise.likelihood.shooting.minimise import AnnealingStatus
from linkwise.model.link import BASE, GROUND

# of a column's square: what the terms kept and the other ones dropped leave of it is rounding
_DEPENDENT = 1e-9
_MUCH_WIDER = 3.0  # times the error beside the terms kept alone, from which a coefficient is named
_NAMED = 3
_LARGER = 8  # terms more than were selected, to show that the criterion rises again
_RUNNERS_UP = 10
_NEGATIVE = 2.0  # standard errors below zero from which a term of damping gives energy
# that damping gives energy: less is at the ends of a motion, where a sum of terms bends away
_OF_THE_TIME = 0.01


@dataclass(frozen=True, eq=False)
class DroppedTerms:
    """The terms dropped from the links found, by `names` (d,), and what they add to the errors of the p coefficients kept.

    Every candidate on a link that was found may still be there. With columns D of those dropped, the local quadratic model of
    the cost has the values c_D that they would have, with covariance C_D, and the coefficients kept move by -G c_D for G =
    H^-1 H_D. The second moment of the c_D about the zero that the selection gave them, c_D c_D' + C_D, is theirs without a
    prior: G (c_D c_D' + C_D) G' is added to the covariance (Berk, Brown, Buja, Zhang and Zhao, "Valid post-selection
    inference", Ann. Statist. 41, 2013).

    `covariance` (p, p) is to be added to that beside the terms kept alone; `shares` (p, d) are the parts of its diagonal that
    each term has by itself.
    """

    names: tuple[str, ...]
    covariance: Floats
    shares: Floats

    @classmethod
    def of(cls, quadratic: QuadraticModel, count: int) -> DroppedTerms:
        """Those of a model whose first `count` coefficients are those of the selection.

        Raises IdentificationError if the columns of the selection are linearly dependent, as those of the best that a search
        visited may be where nothing converged.
        """
        pair, inside = quadratic.penalty.pair, np.arange(count)
        linked = np.isin(pair, [*pair[:count], *quadratic.penalty.stated])
        dropped = count + np.flatnonzero(linked[count:])
        try:
            covariance = inverse_of(quadratic.h[:count, :count])
        except np.linalg.LinAlgError:
            raise singular(quadratic.names[:count]) from None
        follow = covariance @ quadratic.h[np.ix_(inside, dropped)]
        square = quadratic.h[dropped, dropped]
        scale = 1.0 / np.sqrt(np.where(square > 0.0, square, 1.0))
        left = quadratic.h[np.ix_(dropped, dropped)] - quadratic.h[np.ix_(dropped, inside)] @ follow
        scaled = np.linalg.pinv(left * np.outer(scale, scale), rcond=_DEPENDENT, hermitian=True)
        inverse = scaled * np.outer(scale, scale)
        values = inverse @ (quadratic.g[dropped] - follow.T @ quadratic.g[:count])
        spread = inverse
        if quadratic.scatter is not None:
            both = np.concatenate([inside, dropped])
            influence = inverse @ np.hstack([-follow.T, np.eye(len(dropped))])
            spread = influence @ quadratic.scatter[np.ix_(both, both)] @ influence.T
        moment = np.outer(values, values) + spread
        of_selected = follow @ moment @ follow.T
        return cls(
            names=tuple(quadratic.names[number] for number in dropped),
            covariance=0.5 * (of_selected + of_selected.T),
            shares=follow**2 * moment.diagonal(),
        )


def widened(estimate: Estimate, covariance: Floats) -> Estimate:
    """The estimate with a `covariance` (p, p) more for terms that it lacks, which a profile would not allow for."""
    before = 0.0 if estimate.for_dropped_terms is None else estimate.for_dropped_terms
    wider = estimate.covariance + covariance
    return replace(estimate, covariance=wider, for_dropped_terms=before + covariance, profile=None)


def dropped_terms_remark(dropped: DroppedTerms, estimate: Estimate, alone: Floats) -> tuple[str, ...]:
    """A sentence on the coefficients whose errors are mostly due to a term dropped; `alone` (p,) are those without them.

    Those of links in doubt have no errors.
    """
    added = np.maximum(dropped.covariance.diagonal(), 0.0)
    wider = np.sqrt(1.0 + np.where(alone > 0.0, added / np.where(alone > 0.0, alone, 1.0) ** 2, 0.0))
    names = [parameter.name for parameter in estimate.parameters]
    widest = [k for k in np.argsort(-wider).tolist() if wider[k] > _MUCH_WIDER]
    worst = [k for k in widest if estimate.coefficient(names[k]).standard_error is not None][:_NAMED]
    if not worst:
        return ()
    mostly = [dropped.names[int(np.argmax(dropped.shares[k]))] for k in worst]
    effects = [
        f"{names[k]} ({wider[k]:.2g} times as wide, mostly by {term})"
        for k, term in zip(worst, mostly, strict=True)
    ]
    return (
        "The intervals allow for terms that were dropped but could be there unseen; they are much wider for "
        f"{', '.join(effects)}. Excite these links more, record for longer, or state links that are known.",
    )


def term_evidence(
    selection: Selection,
    added: Floats,
    *,
    trusted: bool,
    checks: DataChecks,
    replaceable: Collection[int],
) -> tuple[TermEvidence, ...]:
    """Every candidate that was tested: first those kept, the most certain first, then those dropped, the least certain first.

    Terms of links to masses that are collinear by the `checks` are not unambiguous, nor those of a mass whose links are spread
    over several of them, or over the ground and one that moved in proportion to another, nor terms that are `replaceable`, by
    number, by something else; without a `trusted` fit no term is. Terms that were dropped
    add the variances `added` (p,) to the parameters.
    """
    candidates, count = selection.candidates, len(selection.inside)
    turning = {*selection.structure.rotations}
    single = (move for move in selection.neighbours if not move.exchanges)
    margins = {move.added if move.dropped is None else move.dropped: -move.gain for move in single}
    ambiguous = _ambiguous_masses(selection, checks)
    shares = selection.unit_shares if trusted else {}
    terms = []
    for k, entry in selection.entries.items():
        pair, kept, (value, z) = candidates.pairs[entry.pair], k < count, selection.coefficients[k]
        error = abs(value / z) if z else np.inf
        if kept:
            error = float(np.sqrt(error**2 + added[k]))
        share = 0.0 if kept else shares.get(k, 0.0)
        term = TermEvidence(
            name=entry.name,
            link=pair.name,
            between=pair.between,
            term=entry.written.text,
            unit=entry.term.angular_unit if turning & {*pair.between} else entry.term.unit,
            kept=kept,
            identifiable=bool(np.isfinite(value)),
            unambiguous=trusted and k not in replaceable and ambiguous.isdisjoint(pair.between),
            value=value,
            standard_error=error,
            z=z,
            margin=margins.get(k, np.inf),
            possible_share=(abs(value) + NORMAL_95 * error) * share,
        )
        terms.append(term)
    return tuple(sorted(terms, key=lambda term: (not term.kept, -term.margin if term.kept else term.margin)))


def opposed_damping(selection: Selection) -> tuple[str, ...]:
    """The links with terms of damping of which one gives energy: together they stand in for another form of damping.

    A negative term that makes damping smaller at larger elongations or rates does not, where all of them together take energy
    throughout the motion.
    """
    pairs, solution = selection.candidates.pairs, selection.quadratic.solve(selection.inside)
    damping: dict[int, list[int]] = {}
    for k, entry in selection.entries.items():
        if k < len(selection.inside) and entry.offered.is_damping:
            damping.setdefault(entry.pair, []).append(k)
    several = {pair: terms for pair, terms in damping.items() if len(terms) > 1}
    opposed = {pair: terms for pair, terms in several.items() if min(solution.z[terms]) < -_NEGATIVE}
    if not opposed:
        return ()
    motion, covariance = selection.link_motions(), selection.quadratic.covariance(selection.inside)
    feeding = []
    for pair, terms in opposed.items():
        d, v = (part.ravel() for part in motion[pairs[pair].name])
        laws = (selection.entries[k].term.law for k in terms)
        power = v * np.array([np.broadcast_to(law.force(d, v, {}), v.shape) for law in laws])
        error = np.sqrt(np.einsum("it,ij,jt->t", power, covariance[np.ix_(terms, terms)], power))
        if np.mean(solution.values[terms] @ power < -_NEGATIVE * error) > _OF_THE_TIME:
            feeding.append(pairs[pair].name)
    return tuple(feeding)


def _ambiguous_masses(selection: Selection, checks: DataChecks) -> frozenset[str]:
    """The collinear masses, and those that were found linked to several of them: what such links share may be wrong.

    A mass that moved in proportion to another moved as that one and the ground together do, so that a link to the ground may
    make up for a wrong share as well.
    """
    neighbours: dict[str, set[str]] = {}
    for link in selection.structure.links:
        for mass, neighbour in (link.between, link.between[::-1]):
            neighbours.setdefault(mass, set()).add(neighbour)
    supports = {GROUND, BASE}
    every = neighbours.items()
    spread = {mass for mass, others in every if len(others & checks.collinear) > 1}
    spread |= {mass for mass, others in every if others & supports and others & checks.in_proportion}
    return checks.collinear | (spread - supports)


def path_models(selection: Selection) -> list[tuple[list[int], int]]:
    """Models of all sizes around the selected one, each the best neighbour of the one before, with the term that differs.

    Up to `_LARGER` terms more, by numbers of coefficients, the smallest first.
    """
    quadratic, inside = selection.quadratic, selection.inside
    models, current = [(inside, -1)], inside
    while len(current) > 1 and np.any(is_term := quadratic.penalty.pair[current] >= 0):
        z = np.where(is_term, np.abs(quadratic.solve(current).z), np.inf)
        weakest = current[int(np.argmin(z))]
        current = [number for number in current if number != weakest]
        models.insert(0, (current, weakest))
    current = inside
    for _ in range(_LARGER):
        additions = quadratic.additions(current)
        place = int(np.argmax(np.abs(additions.z))) if len(additions.z) else None
        if place is None or not np.isfinite(additions.values[place]):  # all others depend on those there are
            break
        strongest = int(additions.numbers[place])
        current = sorted([*current, strongest])
        if not quadratic.determines(current):  # but for rounding
            break
        models.append((current, strongest))
    return models


def selection_path(selection: Selection) -> tuple[PathPoint, ...]:
    """The `path_models`, with how well each predicts blocks of the records that it is not fitted to."""
    quadratic, models, parabolas = selection.quadratic, path_models(selection), None
    if selection.fit.status is AnnealingStatus.CONVERGED:
        with suppress(np.linalg.LinAlgError):
            added = set().union(*(numbers for numbers, _ in models)) - set(selection.inside)
            parabolas = block_parabolas(selection, sorted(added))
    costs = [quadratic.cost(numbers) for numbers, _ in models]
    selected = quadratic.criterion(selection.inside)
    path = []
    for (numbers, term), cost in zip(models, costs, strict=True):
        prediction, share = Excess(np.nan, np.nan), np.nan
        if parabolas is not None:
            prediction = parabolas.prediction(numbers)
            if term in selection.unit_shares:
                share = abs(selection.coefficients[term][0]) * selection.unit_shares[term]
        chosen, sign = numbers == selection.inside, "+" if term in numbers else "-"
        path.append(
            PathPoint(
                terms=int(np.sum(quadratic.penalty.pair[numbers] >= 0)),
                cost=cost - min(costs),
                criterion=cost + quadratic.penalty.total(numbers) - selected,
                step="" if chosen else f"{sign} {quadratic.names[term]}",
                chosen=chosen,
                prediction=prediction.excess,
                scatter=prediction.scatter,
                share=share,
            )
        )
    return tuple(path)


def runners_up(selection: Selection) -> tuple[RunnerUp, ...]:
    """The models one move away whose criterion is nearest to that of the selected one, best first."""
    names = selection.quadratic.names

    def change(move: Move) -> str:
        if move.added is None:
            return f"without {names[move.dropped or 0]}"
        added = names[move.added]
        return f"with {added}" if move.dropped is None else f"{added} in place of {names[move.dropped]}"

    return tuple(RunnerUp(change(move), -move.gain) for move in selection.neighbours[:_RUNNERS_UP])
