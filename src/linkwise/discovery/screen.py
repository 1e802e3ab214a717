"""The weak screen: which candidates are significant when all of them are regressed at once (METHODS section 9).

The equations of all masses are regressed together, with one set of coefficients for each link. For many masses a first screen
regresses the equation of each mass by itself on all links that may end there, so that the work grows with the number of pairs;
what is significant at either end of a link is regressed again: mass by mass for what the likelihood should test, and together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats
from linkwise.discovery.candidates import Candidates
from linkwise.discovery.criterion import Penalty
from linkwise.discovery.stepwise import backward_elimination, best_subset, forward_selection
from linkwise.discovery.weak_regression import WeakRegression
from linkwise.errors import IdentificationError
from linkwise.model.structure import Structure
from linkwise.progress import Progress, ProgressReport, part, silent
from linkwise.records.record import Record
from linkwise.weak.displacements import MeasuredDisplacements
from linkwise.weak.equations import WeakEquations, weak_equations

_TOGETHER = 12  # masses up to which all candidates are regressed at once, without the first screen
_ALL_LINKS = 0.8  # of the screen mass by mass: the part in which all links are on offer
_FIRST_LIMIT = 2.5  # |z| in the equation of one mass above which a term is looked at again
# times as many as additions one by one select, and so many more, that elimination may leave where it has not failed
_MOST_LEFT, _FEW = 3, 10
_LIMIT = 4.0  # |z| in all equations above which a term is significant
# the same for a damper on a link without a spring: the weak form easily takes it for another's
_DAMPER_LIMIT = 8.0
_BIAS = (
    0.0,
    0.03,
    0.1,
    0.3,
    1.0,
)  # parts of the noise bias to leave in until the normal matrix is positive definite


@dataclass(frozen=True)
class ScreenResult:
    """The names of the candidates that are `significant`, and of all that the likelihood should test, `tested`."""

    significant: frozenset[str]
    tested: frozenset[str]


def screen(
    records: Sequence[Record],
    motions: Sequence[MeasuredDisplacements],
    candidates: Candidates,
    progress: Progress = silent,
) -> ScreenResult:
    """The candidates that are significant in the weak equations of the records.

    Raises IdentificationError if no link to some mass is.
    """
    near = tested = frozenset(candidates.by_name)
    if len(candidates.masses) > _TOGETHER:
        near, tested = _screen_mass_by_mass(records, motions, candidates, progress)
        progress(ProgressReport(1.0, f"screening {len(near)} candidates together"))
    equations = _equations(records, motions, candidates.structure(near))
    regression = WeakRegression.of([(equation.patches, equation) for equation in equations])
    springs = _exchanged(regression, candidates, _significant(regression, candidates, _LIMIT))
    damped = _with_dampers(regression, candidates, springs)
    significant = frozenset(regression.names[k] for k in _connected(regression, candidates, damped))
    return ScreenResult(significant, tested | candidates.on_links_of(significant))


def z_scores(
    records: Sequence[Record], motions: Sequence[MeasuredDisplacements], candidates: Candidates
) -> dict[str, float]:
    """|z| of the significant candidates when all are regressed at once, by name; empty if the equations are singular."""
    equations = _equations(records, motions, candidates.full_structure)
    regression = WeakRegression.of([(equation.patches, equation) for equation in equations])
    significant = _significant(regression, candidates, _LIMIT)
    for bias in _BIAS:
        try:
            z = regression.quadratic(bias).solve(significant).z
        except np.linalg.LinAlgError:
            continue
        return {regression.names[k]: abs(float(score)) for k, score in zip(significant, z, strict=True)}
    return {}


def weak_start(
    records: Sequence[Record], motions: Sequence[MeasuredDisplacements], structure: Structure
) -> tuple[Floats, Floats]:
    """The parameters (p,) of `structure` by the weak form and their standard deviations (p,), with the least noise bias."""
    equations = _equations(records, motions, structure)
    regression = WeakRegression.of([(equation.patches, equation) for equation in equations])
    for bias in _BIAS:
        try:
            solution = regression.quadratic(bias).solve(range(len(regression.names)))
        except np.linalg.LinAlgError:
            continue
        solved = dict(zip(regression.names, zip(solution.values, solution.z, strict=True), strict=True))
        pairs = [solved[parameter.name] for parameter in structure.parameters]
        return np.array([value for value, _ in pairs]), np.array([abs(value / z) for value, z in pairs])
    raise IdentificationError(
        "the terms of the structure cannot be separated: their motions are linearly dependent in this record; record a "
        "motion in which they differ"
    )


def _screen_mass_by_mass(
    records: Sequence[Record],
    motions: Sequence[MeasuredDisplacements],
    candidates: Candidates,
    progress: Progress = silent,
) -> tuple[frozenset[str], frozenset[str]]:
    """The candidates on links with one that is significant in the equation of a mass, and those significant among them.

    Each equation is at first that of a structure with no other links, so that memory grows with the masses alone.
    """
    around: dict[str, set[str]] = {mass.name: set() for mass in candidates.masses}
    for entry in candidates.entries:
        for end in around.keys() & candidates.pairs[entry.pair].between:
            around[end].add(entry.name)
    first, second = (part(progress, *ends) for ends in ((0.0, _ALL_LINKS), (_ALL_LINKS, 1.0)))
    names: set[str] = set()
    for number, (mass, links) in enumerate(around.items()):
        first(ProgressReport(number / len(around), f"screening the links of {mass}"))
        names |= _significant_at(number, records, motions, candidates.structure(links), candidates)
    near = candidates.on_links_of(names)
    structure, tested = candidates.structure(near), set()
    for number, mass in enumerate(around):
        second(ProgressReport(number / len(around), f"screening the links of {mass} again"))
        tested |= _significant_at(number, records, motions, structure, candidates)
    return near, frozenset(tested)


def _significant_at(
    number: int,
    records: Sequence[Record],
    motions: Sequence[MeasuredDisplacements],
    structure: Structure,
    candidates: Candidates,
) -> set[str]:
    """The names of the candidates that are significant in the equation of the mass of this number in a structure."""
    equations = _equations(records, motions, structure, only=(number,))
    regression = WeakRegression.of([(equation.patches, equation) for equation in equations])
    names = {regression.names[k] for k in _significant_in_one(regression, candidates)}
    return names & candidates.by_name.keys()


def _significant_in_one(regression: WeakRegression, candidates: Candidates) -> set[int]:
    """The coefficients that are significant in the equation of one mass, by number: added one by one, or left of all.

    Either way misses true links that the other one finds: additions where several motions together resemble another one, and
    elimination where the noise makes hundreds of columns dependent, so that it ends early with most of them. It does not count
    then.
    """
    added = _added(regression, _always(regression, candidates), _FIRST_LIMIT)
    left = _significant(regression, candidates, _FIRST_LIMIT)
    return {*added, *(left if len(left) <= _MOST_LEFT * len(added) + _FEW else ())}


def _added(regression: WeakRegression, always: frozenset[int], limit: float) -> list[int]:
    """The coefficients of a forward selection, by number; `always` alone where their columns are dependent.

    Some noise bias is left in where the normal matrix of `always` without it is not positive definite.
    """
    for bias in _BIAS:
        try:
            return forward_selection(regression.quadratic(bias), always, limit)
        except np.linalg.LinAlgError:
            continue
    return sorted(always)


def _equations(
    records: Sequence[Record],
    motions: Sequence[MeasuredDisplacements],
    structure: Structure,
    *,
    only: tuple[int, ...] | None = None,
) -> list[WeakEquations]:
    return [
        weak_equations(record, structure, motion, only=only)
        for record, motion in zip(records, motions, strict=True)
    ]


def _significant(regression: WeakRegression, candidates: Candidates, limit: float) -> list[int]:
    """The coefficients with |z| above `limit` after backward elimination, by number in the regression.

    If the normal matrix without noise bias is not positive definite, some bias is left in until the weakest coefficients are
    eliminated, and then reduced again.
    """
    always = _always(regression, candidates)
    chosen = list(range(len(regression.names)))
    for bias in _BIAS:
        try:
            chosen = backward_elimination(regression.quadratic(bias), chosen, always, limit)
        except np.linalg.LinAlgError:
            continue
        break
    for smaller in sorted((share for share in _BIAS if share < bias), reverse=True):
        try:
            chosen = backward_elimination(regression.quadratic(smaller), chosen, always, limit)
        except np.linalg.LinAlgError:
            break
    return chosen


def _always(regression: WeakRegression, candidates: Candidates) -> frozenset[int]:
    """The coefficients that are no candidates, by number."""
    return frozenset(k for k, name in enumerate(regression.names) if name not in candidates.by_name)


def _exchanged(regression: WeakRegression, candidates: Candidates, significant: list[int]) -> list[int]:
    """`significant` with terms exchanged where that lowers the criterion of the squared residuals.

    One link may then replace several that imitate it. The exchange counts only if it needs no more links; terms that it drops
    from links that stay are kept.
    """
    penalty = Penalty.of(candidates, regression.names, regression.rows)
    try:
        after = best_subset(regression.squares(), penalty, significant)
    except np.linalg.LinAlgError:
        return significant
    pairs = penalty.pairs_of(after)
    if len(pairs) > len(penalty.pairs_of(significant)):
        return significant
    return sorted({*after, *(k for k in significant if int(penalty.pair[k]) in {-1, *pairs})})


def _with_dampers(
    regression: WeakRegression, candidates: Candidates, significant: Sequence[int]
) -> list[int]:
    """`significant` with a damper on every link, which the weak form cannot judge, less what these make insignificant."""
    penalty = Penalty.of(candidates, regression.names, regression.rows)
    entries = [candidates.by_name.get(name) for name in regression.names]
    is_damper = np.array([entry is not None and entry.is_damper for entry in entries])
    sprung = penalty.pairs_of(k for k in significant if not is_damper[k])
    dampers = {k for k in np.flatnonzero(is_damper).tolist() if int(penalty.pair[k]) in sprung}
    always = dampers | {k for k in significant if penalty.pair[k] < 0}
    quadratic = regression.quadratic(0.0)
    try:
        retained = backward_elimination(
            quadratic, sorted({*significant, *dampers}), frozenset(always), _LIMIT
        )
        isolated = {k for k in retained if is_damper[k]} - dampers
        return backward_elimination(quadratic, retained, frozenset(set(retained) - isolated), _DAMPER_LIMIT)
    except np.linalg.LinAlgError:
        return sorted({*significant, *dampers})


def _connected(regression: WeakRegression, candidates: Candidates, significant: list[int]) -> list[int]:
    """`significant` with a spring and a damper for every mass without a link, where they explain most.

    A stiff link between masses that move as one is not significant, and yet needed.
    """
    penalty = Penalty.of(candidates, regression.names, regression.rows)
    squares = regression.quadratic(1.0)  # with all noise bias, which keeps even a column of noise positive
    chosen = list(significant)
    for mass in candidates.masses:
        around = [number for number, pair in enumerate(candidates.pairs) if mass.name in pair.between]
        stated = any(candidates.pairs[number].stated for number in around)
        if stated or not penalty.pairs_of(chosen).isdisjoint(around):
            continue
        additions = squares.additions(chosen)
        springs = [
            (abs(float(z)), int(number))
            for number, z in zip(additions.numbers, additions.z, strict=True)
            if penalty.pair[number] in around and _term(regression, candidates, number) == "d"
        ]
        if springs:
            pair = int(penalty.pair[max(springs)[1]])
            numbers = np.flatnonzero(penalty.pair == pair).tolist()
            linear = [k for k in numbers if _term(regression, candidates, k) in ("d", "v")]
            chosen = sorted({*chosen, *linear})
    return chosen


def _term(regression: WeakRegression, candidates: Candidates, number: int) -> str:
    """The text of the term that a coefficient of the regression multiplies."""
    return candidates.by_name[regression.names[number]].term.text
