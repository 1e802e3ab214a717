"""The evidence for a selection, from the local quadratic model: term by term, along a path, and against other models.

What the terms that were dropped from the links found add to the errors of those kept.

A selection calls a term absent where the record does not show it, and the other coefficients then stand for what it did: their
errors beside the terms kept alone are too small. Here every candidate on a link that was found may still be there. With
columns D of those dropped, the local quadratic model of the cost has the values c_D that they would have, with covariance
C_D, and the coefficients kept move by -G c_D for G = H^-1 H_D. The second moment of the c_D about the zero that the selection
gave them, c_D c_D' + C_D, is theirs without a prior: G (c_D c_D' + C_D) G' is added to the covariance.

References
----------
R. Berk, L. Brown, A. Buja, K. Zhang and L. Zhao, "Valid post-selection inference", Ann. Statist. 41 (2013).

What a record could not have shown: how large a term that was dropped may still be.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from linkwise.arrays import Floats
from linkwise.discovery.candidates import Candidates
from linkwise.discovery.model_average import PathPoint, RunnerUp
from linkwise.discovery.prediction import BlockParabolas, PredictionExcess, block_parabolas
from linkwise.discovery.result import CERTAIN, TermEvidence
from linkwise.discovery.selection import (
    Move,
    MoveKind,
    Penalty,
    QuadraticModel,
    Selection,
    inverse_of,
    link_motions,
    singular,
)
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.link_estimate import NORMAL_95
from linkwise.likelihood.shooting.minimise import AnnealingStatus
from linkwise.likelihood.shooting.residuals import evaluate
from linkwise.likelihood.tests.diagnosis import link_forces
from linkwise.likelihood.tests.score_test import CandidateForce, candidate_forces
from linkwise.model.link import BASE, GROUND
from linkwise.runtime import one_blas_thread

# of a column's square: what the terms kept and the other ones dropped leave of it is rounding
_DEPENDENT = 1e-9
_MUCH_WIDER = 3.0  # times the error beside the terms kept alone, from which a coefficient is named
_NAMED = 3


@dataclass(frozen=True, eq=False)
class DroppedTerms:
    """The terms dropped from the links found, by `names` (d,), and what they add to the errors of the p coefficients kept.

    `covariance` (p, p) is to be added to that beside the terms kept alone; `shares` (p, d) are the parts of its diagonal that
    each term has by itself.
    """

    names: tuple[str, ...]
    covariance: Floats
    shares: Floats

    @classmethod
    def of(cls, quadratic: QuadraticModel, penalty: Penalty, count: int) -> DroppedTerms:
        """Those of a model whose first `count` coefficients are those of the selection.

        Raises IdentificationError if the columns of the selection are linearly dependent, as those of the best that a search
        visited may be where nothing converged.
        """
        linked = set(penalty.pair[:count].tolist()) | penalty.stated
        others = range(count, len(quadratic.names))
        dropped = np.array([number for number in others if penalty.pair[number] in linked], dtype=np.intp)
        inside = np.arange(count)
        try:
            covariance = inverse_of(quadratic.h[:count, :count])
        except np.linalg.LinAlgError:
            raise singular(quadratic.names[:count]) from None
        follow = covariance @ quadratic.h[np.ix_(inside, dropped)]
        square = quadratic.h[dropped, dropped]
        scale = 1.0 / np.sqrt(np.where(square > 0.0, square, 1.0))
        left = quadratic.h[np.ix_(dropped, dropped)] - quadratic.h[np.ix_(dropped, inside)] @ follow
        size, vectors = np.linalg.eigh(left * np.outer(scale, scale))
        independent = size > _DEPENDENT
        root = scale[:, None] * vectors[:, independent] / np.sqrt(size[independent])
        values = root @ (root.T @ (quadratic.g[dropped] - follow.T @ quadratic.g[:count]))
        moment = np.outer(values, values)
        if quadratic.scatter is None:
            moment += root @ root.T
        else:
            both = np.concatenate([inside, dropped])
            influence = root @ (root.T @ np.hstack([-follow.T, np.eye(len(dropped))]))
            moment += influence @ quadratic.scatter[np.ix_(both, both)] @ influence.T
        of_selected = follow @ moment @ follow.T
        return cls(
            names=tuple(quadratic.names[number] for number in dropped),
            covariance=0.5 * (of_selected + of_selected.T),
            shares=follow**2 * moment.diagonal(),
        )


def widened(estimate: Estimate, covariance: Floats) -> Estimate:
    """The estimate with a `covariance` (p, p) more for terms that it lacks, which a profile would not allow for."""
    before = 0.0 if estimate.for_dropped_terms is None else estimate.for_dropped_terms
    return replace(
        estimate,
        covariance=estimate.covariance + covariance,
        for_dropped_terms=before + covariance,
        profile=None,
    )


def dropped_terms_remark(dropped: DroppedTerms, estimate: Estimate, alone: Floats) -> tuple[str, ...]:
    """A sentence on the coefficients whose errors are mostly due to a term dropped; `alone` (p,) are those without them.

    Those of links in doubt have no errors.
    """
    added = np.maximum(dropped.covariance.diagonal(), 0.0)
    wider = np.sqrt(1.0 + np.where(alone > 0.0, added / np.where(alone > 0.0, alone, 1.0) ** 2, 0.0))
    worst = [
        number
        for number in np.argsort(-wider).tolist()
        if wider[number] > _MUCH_WIDER
        and estimate.coefficient(estimate.parameters[number].name).standard_error is not None
    ][:_NAMED]
    if not worst:
        return ()
    effects = [
        f"{estimate.parameters[number].name} ({wider[number]:.2g} times as wide, mostly by "
        f"{dropped.names[int(np.argmax(dropped.shares[number]))]})"
        for number in worst
    ]
    return (
        "The intervals allow for terms that were dropped but could be there unseen; they are much wider for "
        f"{', '.join(effects)}. Excite these links more, record for longer, or state links that are known.",
    )


@np.errstate(over="ignore", invalid="ignore")  # a term may be infinite somewhere
def unit_shares(selection: Selection, candidates: Candidates) -> dict[str, float]:
    """The force of each candidate that was dropped from a link, per unit of its coefficient, over that of the link.

    Both are root mean squares along the fitted motion. Candidates on other pairs of masses are left out.

    Parameters
    ----------
    selection : Selection
        The selection.
    candidates : Candidates
        All candidates.

    Returns
    -------
    dict of str to float
        The ratios by name of the candidate, in the reciprocal of the unit of its coefficient.
    """
    structure, optimum = selection.structure, selection.fit.optimum
    index = structure.topology.index
    places: dict[frozenset[str], list[int]] = {}
    for number, link in enumerate(structure.links):
        places.setdefault(frozenset(link.between), []).append(number)
    tested = frozenset(selection.quadratic.names) - selection.chosen
    dropped = [
        (entry, candidates.pairs[entry.pair].between)
        for entry in candidates.entries
        if entry.name in tested and frozenset(candidates.pairs[entry.pair].between) in places
    ]
    with one_blas_thread():
        misfit = evaluate(optimum.segments, optimum.point, optimum.scales, optimum.loss)
        of_links = link_forces(optimum, misfit)
        forces = [
            CandidateForce(index[first], index[second], entry.term.law) for entry, (first, second) in dropped
        ]
        _, units = candidate_forces(optimum, misfit, forces)
    shares = {}
    for (entry, between), unit in zip(dropped, units, strict=True):
        force = sum(of_links[number] for number in places[frozenset(between)])
        shares[entry.name] = float(1.0 / (unit * force)) if force > 0.0 else np.inf
    return shares


_LARGER = 8  # terms more than were selected, to show that the criterion rises again
_RUNNERS_UP = 10
_EXCHANGES = 6  # exchanges that remarks name
_NEGATIVE = 2.0  # standard errors below zero from which a term of damping gives energy
_ROUNDING = 1e-9  # of a force that is linear in the rate: friction grows less than that
# that damping gives energy: less is at the ends of a motion, where a sum of terms bends away
_OF_THE_TIME = 0.01


def term_evidence(
    selection: Selection,
    candidates: Candidates,
    *,
    trusted: bool,
    collinear: Collection[str] = (),
    in_proportion: Collection[str] = (),
    replaceable: Collection[int] = (),
    shares: Mapping[str, float] = MappingProxyType({}),
    added: Floats | None = None,
) -> tuple[TermEvidence, ...]:
    """Every candidate that was tested: first those kept, the most certain first, then those dropped, the least certain first.

    Terms of links to `collinear` masses are not unambiguous, nor those of a mass whose links are spread over several of them,
    or over the ground and one that moved `in_proportion` to another, nor terms that can be exchanged at little cost or are
    `replaceable`, by number, by an error of a stated value; without a `trusted` fit no term is. `shares` are the `unit_shares`
    of those dropped, which add the variances `added` (p,) to the parameters.
    """
    quadratic = selection.quadratic
    inside = list(range(len(selection.structure.parameters)))
    solution, additions = quadratic.solve(inside), quadratic.additions(inside)
    margins = {
        (move.added if move.kind is MoveKind.ADD else move.dropped): -move.gain
        for move in selection.neighbours
        if move.kind is not MoveKind.SWAP
    }
    ambiguous = _ambiguous_masses(selection, collinear, in_proportion)
    exchanged = {k for move in _exchanges(selection) for k in (move.added, move.dropped)} | set(replaceable)
    coefficients = [
        *zip(inside, solution.values, solution.z, strict=True),
        *zip(additions.numbers.tolist(), additions.values, additions.z, strict=True),
    ]
    terms = []
    for k, value, z in coefficients:
        if (entry := candidates.by_name.get(quadratic.names[k])) is not None:
            pair = candidates.pairs[entry.pair]
            error = abs(float(value / z)) if z else np.inf
            if added is not None and k < len(inside):
                error = float(np.sqrt(error**2 + added[k]))
            term = TermEvidence(
                name=entry.name,
                link=pair.name,
                between=pair.between,
                term=(entry.offered if entry.name in candidates.free else entry.term).text,
                unit=entry.term.angular_unit if pair.turns(candidates.rotations) else entry.term.unit,
                kept=k < len(inside),
                identifiable=bool(np.isfinite(value)),
                unambiguous=trusted and k not in exchanged and ambiguous.isdisjoint(pair.between),
                value=float(value),
                standard_error=error,
                z=float(z),
                margin=margins.get(k, np.inf),
                possible_share=(abs(float(value)) + NORMAL_95 * error) * shares.get(entry.name, 0.0),
            )
            terms.append(term)
    selected = [term for term in terms if term.kept]
    dropped = [term for term in terms if not term.kept]
    return (
        *sorted(selected, key=lambda term: -term.margin),
        *sorted(dropped, key=lambda term: term.margin),
    )


def opposed_damping(selection: Selection, candidates: Candidates) -> tuple[str, ...]:
    """The links with terms of damping of which one gives energy: together they stand in for another form of damping.

    A negative term that makes damping smaller at larger elongations or rates does not, where all of them together take energy
    throughout the motion. Negative friction, which would give most at the smallest rates, does, except beside a model error,
    whose intervals include the effect of another form on it.
    """
    inside = list(range(len(selection.structure.parameters)))
    solution = selection.quadratic.solve(inside)
    damping: dict[int, list[int]] = {}
    for k in inside:
        entry = candidates.by_name.get(selection.quadratic.names[k])
        if entry is not None and entry.offered.is_damping:
            damping.setdefault(entry.pair, []).append(k)
    opposed = {
        pair: terms
        for pair, terms in damping.items()
        if len(terms) > 1 and min(solution.z[terms]) < -_NEGATIVE
    }
    if not opposed:
        return ()
    motion = link_motions(selection)
    links = {frozenset(link.between): link.name for link in selection.structure.links}
    covariance = inverse_of(selection.quadratic.h[np.ix_(inside, inside)])
    feeding = []
    for pair, terms in opposed.items():
        d, v = (part.ravel() for part in motion[links[frozenset(candidates.pairs[pair].between)]])
        laws = [candidates.by_name[selection.quadratic.names[k]].term.law for k in terms]
        forces, at_half = (
            np.stack([np.broadcast_to(law.force(d, rate, {}), v.shape) for law in laws])
            for rate in (v, 0.5 * v)
        )
        power = v * forces
        error = np.sqrt(np.einsum("it,ij,jt->t", power, covariance[np.ix_(terms, terms)], power))
        given = solution.values[terms] @ power < -_NEGATIVE * error
        of_friction = 2.0 * np.sum(np.abs(at_half), axis=1) > (1.0 + _ROUNDING) * np.sum(
            np.abs(forces), axis=1
        )
        negative_friction = selection.is_exact and np.any(of_friction & (solution.z[terms] < -_NEGATIVE))
        if negative_friction or np.mean(given) > _OF_THE_TIME:
            feeding.append(candidates.pairs[pair].name)
    return tuple(feeding)


def _ambiguous_masses(
    selection: Selection, collinear: Collection[str], in_proportion: Collection[str]
) -> frozenset[str]:
    """The `collinear` masses, and those that were found linked to several of them: what such links share may be wrong.

    A mass that moved `in_proportion` to another moved as that one and the ground together do, so that a link to the ground may
    make up for a wrong share as well.
    """
    if not collinear:
        return frozenset()
    neighbours: dict[str, set[str]] = {}
    for link in selection.structure.links:
        for mass, neighbour in (link.between, link.between[::-1]):
            neighbours.setdefault(mass, set()).add(neighbour)
    supports = {GROUND, BASE}
    spread = {
        mass
        for mass, others in neighbours.items()
        if len(others & set(collinear)) > 1 or (others & supports and others & set(in_proportion))
    }
    return frozenset(collinear) | (spread - supports)


def path_models(selection: Selection) -> list[tuple[list[int], str]]:
    """Models of all sizes around the selected one, each the best neighbour of the one before, with the step that leads to it.

    Up to `_LARGER` terms more, by numbers of coefficients, the smallest first.
    """
    quadratic, penalty = selection.quadratic, selection.penalty
    chosen = list(range(len(selection.structure.parameters)))
    return [
        *_smaller(quadratic, penalty, chosen)[::-1],
        (chosen, ""),
        *_larger(quadratic, chosen),
    ]


def path_parabolas(selection: Selection, candidates: Candidates) -> BlockParabolas | None:
    """The parabolas of blocks of the records in all terms of the `path_models`; None where there are none."""
    if selection.fit.status is not AnnealingStatus.CONVERGED:
        return None
    p = len(selection.structure.parameters)
    added = sorted({number for numbers, _ in path_models(selection) for number in numbers if number >= p})
    try:
        return block_parabolas(selection, candidates, added)
    except np.linalg.LinAlgError:
        return None


def selection_path(selection: Selection, parabolas: BlockParabolas | None = None) -> tuple[PathPoint, ...]:
    """The `path_models`, with what `parabolas` of blocks say of how well each predicts them."""
    quadratic, penalty = selection.quadratic, selection.penalty
    chosen = list(range(len(selection.structure.parameters)))
    models = path_models(selection)
    costs = [quadratic.cost(numbers) for numbers, _ in models]
    totals = [cost + penalty.total(numbers) for cost, (numbers, _) in zip(costs, models, strict=True)]
    predictions = [
        PredictionExcess(np.nan, np.nan) if parabolas is None else parabolas.prediction(numbers)
        for numbers, _ in models
    ]
    shares = {} if parabolas is None else parabolas.shares
    number_of = {name: number for number, name in enumerate(quadratic.names)}
    selected = quadratic.cost(chosen) + penalty.total(chosen)
    least = min(costs)
    return tuple(
        PathPoint(
            terms=int(np.sum(penalty.pair[numbers] >= 0)),
            cost=cost - least,
            criterion=total - selected,
            step=step,
            chosen=numbers == chosen,
            prediction=prediction.excess,
            scatter=prediction.scatter,
            share=shares.get(number_of[step[2:]], np.nan) if step else np.nan,
        )
        for (numbers, step), cost, total, prediction in zip(models, costs, totals, predictions, strict=True)
    )


def _smaller(quadratic: QuadraticModel, penalty: Penalty, chosen: list[int]) -> list[tuple[list[int], str]]:
    """The subsets after dropping the weakest term again and again, each with the step that leads to it."""
    models: list[tuple[list[int], str]] = []
    current = list(chosen)
    while True:
        z = np.abs(quadratic.solve(current).z)
        free = [place for place in range(len(current)) if penalty.pair[current[place]] >= 0]
        if len(current) < 2 or not free:
            return models
        weakest = min(free, key=lambda place: z[place])
        step = f"- {quadratic.names[current[weakest]]}"
        current = [number for place, number in enumerate(current) if place != weakest]
        models.append((current, step))


def _larger(quadratic: QuadraticModel, chosen: list[int]) -> list[tuple[list[int], str]]:
    """The subsets after adding the best other term again and again, each with the step that leads to it."""
    models: list[tuple[list[int], str]] = []
    current = list(chosen)
    for _ in range(_LARGER):
        additions = quadratic.additions(current)
        if not len(additions.numbers):
            break
        place = int(np.argmax(np.abs(additions.z)))
        if not np.isfinite(additions.values[place]):  # all others depend on those there are
            break
        strongest = int(additions.numbers[place])
        current = sorted([*current, strongest])
        if not quadratic.determines(current):  # but for rounding
            break
        models.append((current, f"+ {quadratic.names[strongest]}"))
    return models


def runners_up(selection: Selection) -> tuple[RunnerUp, ...]:
    """The models one move away whose criterion is nearest to that of the selected one, best first."""
    return tuple(
        RunnerUp(_description(move, selection.quadratic.names), -move.gain)
        for move in selection.neighbours[:_RUNNERS_UP]
    )


def exchange_remarks(selection: Selection) -> tuple[str, ...]:
    """Sentences on terms for which another one would fit nearly as well."""
    exchanges = _exchanges(selection)
    names = selection.quadratic.names
    remarks = [
        f"This record hardly distinguishes {names[move.dropped or 0]} from {names[move.added or 0]}: with the other in its "
        f"place the criterion is {f'only {-move.gain:.1f} higher' if move.gain <= 0.0 else 'no higher, to first order'}."
        for move in exchanges[:_EXCHANGES]
    ]
    if len(exchanges) > _EXCHANGES:
        remarks.append(
            f"{len(exchanges) - _NAMED} more terms could be exchanged for others at as small a cost."
        )
    return tuple(remarks)


def _exchanges(selection: Selection) -> list[Move]:
    """The exchanges of a term kept for one dropped that would raise the criterion by less than `CERTAIN`."""
    return [move for move in selection.neighbours if move.kind is MoveKind.SWAP and -move.gain < CERTAIN]


def _description(move: Move, names: Sequence[str]) -> str:
    if move.kind is MoveKind.ADD:
        return f"with {names[move.added or 0]}"
    if move.kind is MoveKind.DROP:
        return f"without {names[move.dropped or 0]}"
    return f"{names[move.added or 0]} in place of {names[move.dropped or 0]}"
