"""From the parabola at the chosen model: evidence term by term, the path around the choice, and the runners-up."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from linkwise.discovery.candidates import Candidates
from linkwise.discovery.criterion import Penalty
from linkwise.discovery.quadratic_model import QuadraticModel
from linkwise.discovery.result import CERTAIN, PathPoint, RunnerUp, TermEvidence
from linkwise.discovery.selection import Selection
from linkwise.discovery.stepwise import Move, MoveKind

_BEYOND = 8  # terms more than were chosen, to show that the criterion rises again
_RUNNERS_UP = 10
_NAMED = 6  # confusions that are told


def evidence(
    decided: Selection, candidates: Candidates, *, trusted: bool, alike: Collection[str] = ()
) -> tuple[TermEvidence, ...]:
    """Every candidate that was tested: those kept, the most certain first, then the dropped, the most doubtful first.

    `alike` are masses that moved so much like another one that their links may be the other's; terms that could be exchanged
    at little cost are not reliable either, and where the fit is not `trusted` nothing is.
    """
    quadratic = decided.quadratic
    inside = list(range(len(decided.structure.parameters)))
    solved = quadratic.solve(inside)
    numbers, values, z, _ = quadratic.outside(inside)
    margins = {
        (move.in_ if move.kind is MoveKind.ADD else move.out): -move.gain
        for move in decided.neighbours
        if move.kind is not MoveKind.SWAP
    }
    exchanged = {k for move in _exchanges(decided) for k in (move.in_, move.out)}
    told = [
        *zip(inside, solved.values, solved.z, strict=True),
        *zip(numbers.tolist(), values, z, strict=True),
    ]
    terms = []
    for k, value, each in told:
        if (entry := candidates.by_name.get(quadratic.names[k])) is not None:
            pair = candidates.pairs[entry.pair]
            term = TermEvidence(
                name=entry.name,
                link=pair.name,
                between=pair.between,
                term=entry.term.text,
                unit=entry.term.unit,
                kept=k < len(inside),
                identifiable=bool(np.isfinite(value)),
                unambiguous=trusted and k not in exchanged and set(alike).isdisjoint(pair.between),
                value=float(value),
                standard_error=abs(float(value / each)) if each else np.inf,
                z=float(each),
                margin=margins.get(k, np.inf),
            )
            terms.append(term)
    found = [term for term in terms if term.kept]
    dropped = [term for term in terms if not term.kept]
    return (
        *sorted(found, key=lambda term: -term.margin),
        *sorted(dropped, key=lambda term: term.margin),
    )


def path(decided: Selection) -> tuple[PathPoint, ...]:
    """Models of all sizes around the chosen one, the best neighbour each time, up to `_BEYOND` more terms."""
    quadratic, penalty = decided.quadratic, decided.penalty
    chosen = list(range(len(decided.structure.parameters)))
    points = [(chosen, "")]
    points = [*_shrunk(quadratic, penalty, chosen)[::-1], *points, *_grown(quadratic, penalty, chosen)]
    costs = [quadratic.cost(each) for each, _ in points]
    totals = [cost + penalty.total(each) for cost, (each, _) in zip(costs, points, strict=True)]
    here = quadratic.cost(chosen) + penalty.total(chosen)
    least = min(costs)
    return tuple(
        PathPoint(int(np.sum(penalty.pair[each] >= 0)), cost - least, total - here, step, each == chosen)
        for (each, step), cost, total in zip(points, costs, totals, strict=True)
    )


def _shrunk(quadratic: QuadraticModel, penalty: Penalty, chosen: list[int]) -> list[tuple[list[int], str]]:
    """Without its weakest term again and again; each with what it lacks beside the one before."""
    points: list[tuple[list[int], str]] = []
    current = list(chosen)
    while True:
        z = np.abs(quadratic.solve(current).z)
        free = [place for place in range(len(current)) if penalty.pair[current[place]] >= 0]
        if len(current) < 2 or not free:
            return points
        weakest = min(free, key=lambda place: z[place])
        step = f"- {quadratic.names[current[weakest]]}"
        current = [number for place, number in enumerate(current) if place != weakest]
        points.append((current, step))


def _grown(quadratic: QuadraticModel, penalty: Penalty, chosen: list[int]) -> list[tuple[list[int], str]]:
    """With the next best term again and again."""
    points: list[tuple[list[int], str]] = []
    current = list(chosen)
    for _ in range(_BEYOND):
        numbers, _, z, _ = quadratic.outside(current)
        if not len(numbers):
            break
        strongest = int(numbers[np.argmax(np.abs(z))])
        current = sorted([*current, strongest])
        points.append((current, f"+ {quadratic.names[strongest]}"))
    return points


def runners_up(decided: Selection) -> tuple[RunnerUp, ...]:
    """The models one step away that come nearest to the chosen one."""
    return tuple(
        RunnerUp(_words(move, decided.quadratic), -move.gain) for move in decided.neighbours[:_RUNNERS_UP]
    )


def _exchanges(decided: Selection) -> list[Move]:
    """A term kept for one that was dropped, where the record hardly tells them apart."""
    return [move for move in decided.neighbours if move.kind is MoveKind.SWAP and -move.gain < CERTAIN]


def exchange_remarks(decided: Selection) -> tuple[str, ...]:
    """Sentences on terms for which another would do nearly as well."""
    near = _exchanges(decided)
    names = decided.quadratic.names
    told = [
        f"This record hardly tells {names[move.out or 0]} from {names[move.in_ or 0]}: with the other in its place the "
        f"criterion is only {-move.gain:.1f} higher."
        for move in near[:_NAMED]
    ]
    if len(near) > _NAMED:
        told.append(f"{len(near) - _NAMED} more terms could be exchanged for others at as small a cost.")
    return tuple(told)


def _words(move: Move, quadratic: QuadraticModel) -> str:
    names = quadratic.names
    if move.kind is MoveKind.ADD:
        return f"with {names[move.in_ or 0]}"
    if move.kind is MoveKind.DROP:
        return f"without {names[move.out or 0]}"
    return f"{names[move.in_ or 0]} in place of {names[move.out or 0]}"
