"""The weak screen: what stands above the noise when all candidates are regressed at once (METHODS section 9).

The equations of all masses are regressed together, where a link has one set of coefficients. For many masses a first sieve
comes before: every mass by itself, its own equation with all links that could end at it, which keeps the work linear in
the pairs. What stands there at either end of a link goes on.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats
from linkwise.discovery.candidates import Candidates
from linkwise.discovery.criterion import Penalty
from linkwise.discovery.stepwise import backward_elimination, best
from linkwise.discovery.weak_regression import WeakRegression
from linkwise.errors import IdentificationError
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.weak.displacements import MeasuredDisplacements
from linkwise.weak.equations import WeakEquations, weak_equations

_TOGETHER = 12  # masses whose candidates are regressed at once without the first sieve
_SIEVE = 2.5  # deviations that a term needs in the equation of one mass to be looked at again
_LIMIT = 4.0  # and in all equations together
_LONE = 8.0  # and a damper without a spring, which the weak form takes for another's easily
_BIAS = (
    0.0,
    0.03,
    0.1,
    0.3,
    1.0,
)  # shares of the noise bias to leave in until the sums of products are positive


@dataclass(frozen=True)
class ScreenResult:
    """The names of the candidates that `kept` their place, and of all that the likelihood should `test`."""

    kept: frozenset[str]
    tested: frozenset[str]


def screen(
    records: Sequence[Record], motions: Sequence[MeasuredDisplacements], candidates: Candidates
) -> ScreenResult:
    """What of `candidates` the weak equations of the records show.

    Raises IdentificationError where a mass is held by nothing that stands above the noise.
    """
    many = len(candidates.masses) > _TOGETHER
    tested = _one_by_one(records, motions, candidates) if many else frozenset(candidates.by_name)
    seen = _equations(records, motions, candidates.structure(candidates.sharing(tested)))
    regression = WeakRegression.of([(each.patches, each) for each in seen])
    names = regression.names
    springs = _relocated(regression, candidates, _standing(regression, candidates, _LIMIT))
    standing = _with_dampers(regression, candidates, springs)
    kept = frozenset(names[k] for k in _held(regression, candidates, standing))
    return ScreenResult(kept, tested | candidates.sharing(kept))


def z_scores(
    records: Sequence[Record], motions: Sequence[MeasuredDisplacements], candidates: Candidates
) -> dict[str, float]:
    """|z| of what stands when everything is regressed at once, by name; empty where the sums cannot be solved."""
    seen = _equations(records, motions, candidates.everything)
    regression = WeakRegression.of([(each.patches, each) for each in seen])
    standing = _standing(regression, candidates, _LIMIT)
    for share in _BIAS:
        try:
            z = regression.quadratic(share).solve(standing).z
        except np.linalg.LinAlgError:
            continue
        return {regression.names[k]: abs(float(each)) for k, each in zip(standing, z, strict=True)}
    return {}


def _one_by_one(
    records: Sequence[Record], motions: Sequence[MeasuredDisplacements], candidates: Candidates
) -> frozenset[str]:
    """What stands in the equation of one mass or another."""
    seen = _equations(records, motions, candidates.everything, together=1)
    found: set[str] = set()
    for patches in zip(*(equations.patches for equations in seen), strict=True):
        regression = WeakRegression.of([([patch], each) for patch, each in zip(patches, seen, strict=True)])
        found |= {regression.names[k] for k in _standing(regression, candidates, _SIEVE)}
    return frozenset(found & candidates.by_name.keys())


def _equations(
    records: Sequence[Record],
    motions: Sequence[MeasuredDisplacements],
    structure: Structure,
    *,
    together: int = _TOGETHER,
) -> list[WeakEquations]:
    return [
        weak_equations(record, structure, motion, together=together)
        for record, motion in zip(records, motions, strict=True)
    ]


def _standing(regression: WeakRegression, candidates: Candidates, limit: float) -> list[int]:
    """What stays above `limit` deviations when everything else is pruned, by number among the regression's names.

    Where the sums without bias are not positive some bias stays in until the weakest are gone, then it is taken out again.
    """
    always = frozenset(k for k, name in enumerate(regression.names) if name not in candidates.by_name)
    chosen = list(range(len(regression.names)))
    for share in _BIAS:
        try:
            chosen = backward_elimination(regression.quadratic(share), chosen, always, limit)
        except np.linalg.LinAlgError:
            continue
        break
    for less in sorted((each for each in _BIAS if each < share), reverse=True):
        try:
            chosen = backward_elimination(regression.quadratic(less), chosen, always, limit)
        except np.linalg.LinAlgError:
            break
    return chosen


def _relocated(regression: WeakRegression, candidates: Candidates, standing: list[int]) -> list[int]:
    """`standing` with terms exchanged while the sum of squares says so: a link for several that together do as it does.

    Only exchanges count that need no more links than there are. What fell with them but is on a link that stays, stays.
    """
    penalty = Penalty.of(candidates, regression.names, regression.rows)
    try:
        after = best(regression.squares(), penalty, standing)
    except np.linalg.LinAlgError:
        return standing
    pairs, before = _pairs(penalty, after), _pairs(penalty, standing)
    if len(pairs) > len(before):
        return standing
    return sorted({*after, *(k for k in standing if int(penalty.pair[k]) in {-1, *pairs})})


def _with_dampers(regression: WeakRegression, candidates: Candidates, standing: Sequence[int]) -> list[int]:
    """`standing` with a damper on every link, which the weak form cannot judge, and without what these make needless."""
    penalty = Penalty.of(candidates, regression.names, regression.rows)
    entries = [candidates.by_name.get(name) for name in regression.names]
    is_damper = np.array([entry is not None and entry.is_damper for entry in entries])
    sprung = _pairs(penalty, [k for k in standing if not is_damper[k]])
    dampers = {k for k in np.flatnonzero(is_damper).tolist() if int(penalty.pair[k]) in sprung}
    held = dampers | {k for k in standing if penalty.pair[k] < 0}
    quadratic = regression.quadratic(0.0)
    try:
        kept = backward_elimination(quadratic, sorted({*standing, *dampers}), frozenset(held), _LIMIT)
        lone = {k for k in kept if is_damper[k]} - dampers
        return backward_elimination(quadratic, kept, frozenset(set(kept) - lone), _LONE)
    except np.linalg.LinAlgError:
        return sorted({*standing, *dampers})


def _held(regression: WeakRegression, candidates: Candidates, standing: list[int]) -> list[int]:
    """`standing` with a spring and a damper for every mass that nothing holds, where they explain most.

    Between masses that move as one a stiff link does not stand above the noise, and yet there is none without it.
    """
    penalty = Penalty.of(candidates, regression.names, regression.rows)
    squares = regression.quadratic(
        1.0
    )  # all bias left in: even what is mostly noise has a positive sum of squares
    found = list(standing)
    for mass in candidates.masses:
        around = [number for number, pair in enumerate(candidates.pairs) if mass.name in pair.between]
        held = any(candidates.pairs[number].stated for number in around) or not _pairs(
            penalty, found
        ).isdisjoint(around)
        if held:
            continue
        others, _, z, _ = squares.outside(found)
        springs = [
            (abs(float(each)), int(number))
            for number, each in zip(others, z, strict=True)
            if penalty.pair[number] in around
            and candidates.by_name[regression.names[number]].term.text == "d"
        ]
        if springs:
            pair = int(penalty.pair[max(springs)[1]])
            here = np.flatnonzero(penalty.pair == pair).tolist()
            plain = [k for k in here if candidates.by_name[regression.names[k]].term.text in ("d", "v")]
            found = sorted({*found, *plain})
    return found


def weak_start(
    records: Sequence[Record], motions: Sequence[MeasuredDisplacements], structure: Structure
) -> tuple[Floats, Floats]:
    """The parameters (p,) of `structure` and their deviations by the weak form, with as little noise bias as can be."""
    regression = WeakRegression.of([(each.patches, each) for each in _equations(records, motions, structure)])
    for share in _BIAS:
        try:
            solved = regression.quadratic(share).solve(range(len(regression.names)))
        except np.linalg.LinAlgError:
            continue
        found = dict(zip(regression.names, zip(solved.values, solved.z, strict=True), strict=True))
        told = [found[parameter.name] for parameter in structure.parameters]
        return np.array([value for value, _ in told]), np.array([abs(value / z) for value, z in told])
    raise IdentificationError(
        "the record cannot tell the terms of the structure apart: they move together; record a motion that sets them apart"
    )


def _pairs(penalty: Penalty, chosen: Iterable[int]) -> set[int]:
    return {int(penalty.pair[k]) for k in chosen} - {-1}
