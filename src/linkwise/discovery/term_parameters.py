"""Parameters inside terms, such as the rate at which friction saturates or a gap: their values link by link.

A term takes values on a grid over the motion of its link. At a fit, the local quadratic model of the cost says what each other
value would gain, and the search is repeated with the best ones until they stay. Then those of the terms that were kept join
the unknowns of the fit.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.discovery.candidates import Candidates, CandidateTerm
from linkwise.discovery.selection import QuadraticModel, Selection, TermSearch, best_of, select_structure
from linkwise.discovery.terms import Term
from linkwise.errors import IdentificationError, LinkwiseError
from linkwise.likelihood.shooting.minimise import AnnealingStatus
from linkwise.likelihood.tests.score_test import CandidateForce, local_quadratic
from linkwise.model.link import BASE, GROUND
from linkwise.model.structure import Structure
from linkwise.units import base_exponents
from linkwise.weak.displacements import MeasuredDisplacements

_FRACTIONS = (0.003, 0.01, 0.03, 0.1, 0.2, 0.35, 0.5, 0.7, 0.85)  # of the largest elongation, or rate
_FIRST = (0.2, 0.6, 0.03)  # of them, one after another until a fit leaves no more than noise
_EXPONENTS = (0.5, 1.5, 2.5, 3.5, 5.0)
_FIRST_EXPONENT = (1.5, 2.5, 0.5)
_PEAK = 99.0  # percentile that stands for the largest: the largest itself may be an outlier
_PER_PERIOD = 8.0  # of the fastest motion: samples over which a rate is a difference
_ROUNDS = 4
_ROUNDING = 1e-3  # of chi-square: by which one more unknown may seem to worsen it
_BETTER = 1.0  # of -2 log likelihood: a smaller gain changes no value


@dataclass(frozen=True)
class MotionRange:
    """The largest elongation in m and rate in m/s of a link."""

    elongation: float
    rate: float

    def scale(self, unit: str) -> float:
        """The size of a quantity with a unit of metres and seconds in this motion; 0 where it did not move."""
        kilogram, metre, second, ampere = (float(exponent) for exponent in base_exponents(unit))
        if kilogram or ampere or not (self.elongation > 0.0 and self.rate > 0.0):
            return 0.0
        return float(self.elongation**metre * (self.elongation / self.rate) ** second)


def first_values(
    motions: Sequence[MeasuredDisplacements],
    rates: Sequence[float],
    candidates: Candidates,
    attempt: int = 0,
) -> Candidates:
    """The candidates with a value for each parameter, from the motion of their links; rates of samples in Hz.

    Each `attempt` gives others. Raises IdentificationError for a parameter whose size the motion does not determine.
    """
    if not any(term.parameters for term in candidates.terms):
        return candidates
    ranges = _ranges(motions, rates, candidates)
    return replace(
        candidates,
        values={
            entry.name: {
                name: _grid(entry.offered, name, ranges[entry.pair])[1][attempt]
                for name in entry.offered.parameters
            }
            for entry in candidates.entries
            if entry.offered.parameters
        },
    )


def select_with_parameters(
    search: TermSearch,
    chosen: frozenset[str],
    motions: Sequence[MeasuredDisplacements],
    rates: Sequence[float],
) -> tuple[TermSearch, Selection]:
    """The subset that no candidate improves, with the values of parameters that the records prefer.

    The search has these values; where terms with parameters were kept, they are unknowns of the fit.
    """
    selection = select_structure(search, chosen)
    if not any(entry.offered.parameters for entry in search.candidates.entries):
        return search, selection
    ranges = _ranges(motions, rates, search.candidates)
    best = _freed(*_with_better_values(search, selection, ranges))
    for attempt in range(len(_FIRST)):
        if best[1].is_exact or _interrupted(best[1]):
            break
        candidates = first_values(motions, rates, search.candidates, attempt)
        trial_search = replace(search, candidates=candidates)
        try:
            trial = _freed_at_once(trial_search, chosen)
            if attempt > 0 and not trial[1].is_exact and not _interrupted(trial[1]):
                trial = _freed(
                    *_with_better_values(trial_search, select_structure(trial_search, chosen), ranges)
                )
        except IdentificationError:
            continue
        if _interrupted(trial[1]) or _is_better(trial[1], best[1]):
            best = trial
    return best


def _is_better(selection: Selection, reference: Selection) -> bool:
    """Whether a selection leaves only noise and the other does not, or has the lower criterion."""
    if selection.is_exact != reference.is_exact:
        return selection.is_exact
    return best_of([reference, selection]) is selection


def _with_better_values(
    search: TermSearch, selection: Selection, ranges: Sequence[MotionRange]
) -> tuple[TermSearch, Selection]:
    """The search and its selection once no other value of a parameter would be better."""
    for _ in range(_ROUNDS):
        if _interrupted(selection):
            break
        better = _better_values(search, selection, ranges)
        if not better:
            break
        changed = replace(
            search,
            candidates=replace(search.candidates, values={**search.candidates.values, **better}),
        )
        again = _attempted(changed, selection.chosen | better.keys())
        if again is not None and _interrupted(again):
            return changed, again
        if again is None or (selection.converged and not _is_better(again, selection)):
            break
        search, selection = changed, again
    return search, selection


def _ranges(
    motions: Sequence[MeasuredDisplacements], rates: Sequence[float], candidates: Candidates
) -> list[MotionRange]:
    """The largest elongations and rates of every pair, rates by differences over a fraction of the fastest period."""
    row = {name: number for number, name in enumerate((*(m.name for m in candidates.masses), BASE, GROUND))}
    ranges = []
    for pair in candidates.pairs:
        first, second = (row[end] for end in pair.between)
        elongation = rate = 0.0
        for motion, sampled in zip(motions, rates, strict=True):
            d = motion.displacements[first] - motion.displacements[second]
            lag = max(1, min(int(sampled / motion.bandwidth / _PER_PERIOD), len(d) // 2))
            change = (d[lag:] - d[:-lag]) * (sampled / lag)
            elongation = max(elongation, float(np.percentile(np.abs(d - np.median(d)), _PEAK)))
            rate = max(rate, float(np.percentile(np.abs(change), _PEAK)))
        ranges.append(MotionRange(elongation, rate))
    return ranges


def _grid(term: Term, parameter: str, motion: MotionRange) -> tuple[list[float], list[float]]:
    """Values of a parameter over a motion, and those to try first; IdentificationError if the motion determines none."""
    unit = term.parameter_units[parameter]
    if not unit:
        return list(_EXPONENTS), list(_FIRST_EXPONENT)
    try:
        scale = motion.scale(unit)
    except LinkwiseError:  # no unit, but any
        scale = 0.0
    if scale == 0.0:
        raise IdentificationError(
            f"the parameter {parameter!r} of the term {term.text!r} has the unit {unit}, whose size the motion does not "
            "determine; write a number in its place"
        )
    return _rounded(_FRACTIONS, scale), _rounded(_FIRST, scale)


def _rounded(fractions: Sequence[float], scale: float) -> list[float]:
    """Fractions of a scale as numbers of three digits, which laws and figures show."""
    return [float(f"{fraction * scale:.3g}") for fraction in fractions]


def _better_values(
    search: TermSearch, selection: Selection, ranges: Sequence[MotionRange]
) -> dict[str, Mapping[str, float]]:
    """Other values of parameters that would lower the criterion, by candidate, as the local model at the fit predicts it."""
    offers = [
        (entry, values)
        for entry in search.candidates.entries
        if entry.offered.parameters and entry.name in search.tested
        for values in _alternatives(entry, search.candidates, ranges[entry.pair])
    ]
    index = selection.structure.topology.index
    forces = [
        CandidateForce(index[first], index[second], entry.offered.at(values).law)
        for entry, values in offers
        for first, second in (search.candidates.pairs[entry.pair].between,)
    ]
    p = len(selection.structure.parameters)
    try:
        local = local_quadratic(selection.fit.optimum, forces)
    except np.linalg.LinAlgError:
        return {}
    names = (*selection.quadratic.names[:p], *(str(number) for number in range(len(offers))))
    model = QuadraticModel(names, local.curvature, local.slope, local.scatter)
    best: dict[str, tuple[float, Mapping[str, float]]] = {}
    everything = list(range(p))
    reference = model.cost(everything)
    for number, (entry, values) in enumerate(offers):
        retained = [k for k in everything if names[k] != entry.name]
        needed = _BETTER if len(retained) < p else selection.penalty.term
        try:
            gain = reference - model.cost([*retained, p + number])
        except np.linalg.LinAlgError:
            continue
        if gain > max(needed, best.get(entry.name, (0.0, {}))[0]):
            best[entry.name] = (gain, values)
    return {name: values for name, (_, values) in best.items()}


def _alternatives(
    entry: CandidateTerm, candidates: Candidates, motion: MotionRange
) -> list[Mapping[str, float]]:
    """Other values of the parameters of a candidate, one parameter at a time."""
    current = candidates.values_of(entry.name, entry.offered)
    return [
        {**current, name: value}
        for name in entry.offered.parameters
        for value in _grid(entry.offered, name, motion)[0]
        if value != current[name]
    ]


def _freed(search: TermSearch, selection: Selection) -> tuple[TermSearch, Selection]:
    """The search and the selection with the parameters of the terms kept among the unknowns, those of the strongest first.

    A term on a wrong link may stand in for the wrong value of another, and goes once that has its own. Terms whose parameters
    no fit finds keep numbers.
    """
    tried: set[str] = set()
    while left := (_open_terms(search.candidates) & selection.chosen) - search.candidates.free - tried:
        strongest = _strongest(selection, left)
        tried.add(strongest)
        deviations = np.sqrt(np.maximum(selection.fit.covariance.diagonal(), 0.0))
        free = search.candidates.free | {strongest}
        freed = _from_values(search, free, selection.structure, selection.fit.values, deviations)
        for others in (left, {strongest}):
            fitted = _attempted(freed, selection.chosen - (left - others))
            if fitted is not None and _interrupted(fitted):
                return freed, fitted
            if fitted is not None and _explains_as_much(fitted, selection):
                search, selection = freed, fitted
                break
    return search, selection


def _interrupted(selection: Selection) -> bool:
    return selection.fit.status is AnnealingStatus.INTERRUPTED


def _attempted(search: TermSearch, chosen: frozenset[str]) -> Selection | None:
    """The subset searched from `chosen`; None if the records do not determine all its parameters."""
    try:
        return select_structure(search, chosen)
    except IdentificationError:
        return None


def _explains_as_much(trial: Selection, selection: Selection) -> bool:
    exact = trial.is_exact and trial.fit.chi_square < selection.fit.chi_square + _ROUNDING
    return exact or _is_better(trial, selection)


def _strongest(selection: Selection, names: Collection[str]) -> str:
    """Of some candidates that were chosen the one with the largest z score."""
    inside = list(range(len(selection.structure.parameters)))
    z = dict(zip(selection.quadratic.names, np.abs(selection.quadratic.solve(inside).z), strict=False))
    return max(sorted(names), key=lambda name: float(z[name]))


def _freed_at_once(search: TermSearch, chosen: frozenset[str]) -> tuple[TermSearch, Selection]:
    """The search and its selection from all terms with parameters on the links of `chosen`, these among the unknowns.

    For records that no set of terms explains before these have their values.
    """
    opened = _open_terms(search.candidates) & search.candidates.on_links_of(chosen)
    everything = chosen | opened
    structure = search.candidates.structure(everything)
    values, spread = search.start(structure)
    freed = _from_values(search, opened, structure, values, np.abs(values) if spread is None else spread)
    return freed, select_structure(freed, everything)


def without_values(candidates: Candidates, selection: Selection) -> tuple[str, ...]:
    """The candidates chosen whose parameters kept numbers of the grid, since no fit found them."""
    return tuple(sorted((_open_terms(candidates) & selection.chosen) - candidates.free))


def _open_terms(candidates: Candidates) -> frozenset[str]:
    return frozenset(entry.name for entry in candidates.entries if entry.offered.parameters)


def _from_values(
    search: TermSearch, free: frozenset[str], structure: Structure, values: Floats, spread: Floats
) -> TermSearch:
    """The search with the parameters of the `free` candidates unknown, from values (p,) and deviations (p,) of `structure`."""
    known = {
        parameter.name: pair
        for parameter, pair in zip(structure.parameters, zip(values, spread, strict=True), strict=True)
    }

    def start(trial_structure: Structure) -> tuple[Floats, Floats]:
        starts = [
            known.get(parameter.name, (parameter.start or 0.0, abs(parameter.start or 0.0)))
            for parameter in trial_structure.parameters
        ]
        begun, deviations = np.array(starts).T
        return begun, deviations

    return replace(search, candidates=replace(search.candidates, free=free), start=start)
