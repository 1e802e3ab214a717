"""The screen: which candidates a record shows before any fit, by the weak form or, beside hosts, by a Kalman filter.

The weak equations of all masses are regressed together, with one set of coefficients for each link, and terms that are not
significant eliminated (METHODS section 9). For many masses a first screen regresses the equation of each mass by itself on all
links that may end there, so that the work grows with the number of pairs; what is significant at either end of a link is what
the likelihood should test, and all terms of its link are regressed together.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.discovery.candidates import Candidates
from linkwise.discovery.criterion import Penalty, QuadraticModel
from linkwise.errors import IdentificationError
from linkwise.likelihood.starts.kalman import CHANGES, LinearPart, likeliest_change, samples_of, tuned_modes
from linkwise.likelihood.starts.values import require_supported
from linkwise.model.structure import Structure
from linkwise.progress import Progress, ProgressReport
from linkwise.records.record import Record
from linkwise.signals.noise import channel_noise
from linkwise.weak.displacements import MeasuredDisplacements
from linkwise.weak.equations import WeakEquations, weak_equations
from linkwise.weak.fit import NoisyPatch, normal_equations, residual_power, score_blocks, summed_blocks

#: Records with the displacements of all masses.
Measured = Sequence[tuple[Record, MeasuredDisplacements]]
Result = TypeVar("Result")
Weights = list[list[Floats]]  # of the masses, by record and patch

_REWEIGHTINGS = 2  # rounds of weighting the masses by their residuals
_RIDGE = 1e-10  # of the unit diagonal: just above rounding
_OVERLAP = 2.0  # windows overlap, so that sums of squares count every sample about twice
_TRIED = 2000  # samples that decide which links there are
# of the size of accelerations: small white forces on modes and masses, for what is wrong with the host
_ALLOWED = 1e-2
_MOST = 12  # links that are added
_TOGETHER = 12  # masses up to which all candidates are regressed at once, without the first screen
_FIRST_LIMIT = 2.5  # |z| in the equation of one mass above which a term is looked at again
_LIMIT = 4.0  # |z| in all equations above which a term is significant
# parts of the noise bias to leave in until the normal matrix is positive definite
_BIAS = (0.0, 0.03, 0.1, 0.3, 1.0)


@dataclass(frozen=True, eq=False)
class WeakRegression:
    """The equations of `systems`, one a record, with masses weighted by `weights`, for `candidates` among the coefficients.

    `names` (p,) are the coefficients in the equations and `numbers` (p,) their numbers in the structure; `scatter` (p, p) is
    the covariance of the right-hand side of the normal equations due to noise.
    """

    candidates: Candidates
    systems: Sequence[WeakEquations]
    weights: Weights
    names: tuple[str, ...]
    numbers: Indices
    scatter: Floats

    @classmethod
    def of(
        cls,
        measured: Measured,
        candidates: Candidates,
        structure: Structure,
        only: tuple[int, ...] | None = None,
    ) -> WeakRegression:
        """The equations of all masses or `only` some, by number, weighted by the residuals of a fit of all coefficients.

        That fit leaves the noise bias in, so that its normal matrix is always positive definite.
        """
        systems = [weak_equations(record, structure, motion, only=only) for record, motion in measured]
        parameters = systems[0].parameters
        every = [patch.layout.free_parameters for system in systems for patch in system.patches]
        numbers, values = np.unique(np.concatenate(every)), np.zeros(len(parameters))
        weights = [[1.0 / patch.largest() for patch in system.patches] for system in systems]
        for _ in range(_REWEIGHTINGS):
            values[numbers] = _solve_with_ridge(*_normal_equations(systems, weights, numbers, 1.0))
            weights = [[1.0 / residual_power(own, values) for own in system.patches] for system in systems]
        scatter = np.zeros((len(numbers), len(numbers)))
        for system, weight in zip(systems, weights, strict=True):
            noisy = [NoisyPatch.of(patch, system, values) for patch in system.patches]
            scatter += system.motion.density * summed_blocks(score_blocks(noisy, weight), numbers)
        names = tuple(parameters[number] for number in numbers)
        return cls(candidates, systems, weights, names, numbers, scatter)

    def quadratic(self, bias: float) -> QuadraticModel:
        """The normal equations with the part `bias` of the noise bias left in; z scores by the noise."""
        h, g = _normal_equations(self.systems, self.weights, self.numbers, bias)
        return QuadraticModel(self.names, h, g, self.penalty, self.scatter)

    def squares(self) -> QuadraticModel:
        """The sum of squared residuals on about the scale of -2 log likelihood, to compare subsets."""
        h, g = _normal_equations(self.systems, self.weights, self.numbers, 0.0)
        overlap = _OVERLAP * max(system.motion.density for system in self.systems)
        return QuadraticModel(self.names, h / overlap, g / overlap, self.penalty)

    @cached_property
    def penalty(self) -> Penalty:
        """The penalty on the candidates, for the number of equations."""
        rows = sum(len(own.layout.masses) * own.windows for system in self.systems for own in system.patches)
        return Penalty.of(self.candidates, self.names, int(rows))

    @property
    def always(self) -> frozenset[int]:
        """The coefficients that are no candidates, by number."""
        return frozenset(k for k, name in enumerate(self.names) if name not in self.candidates.by_name)

    def least_biased(self, task: Callable[[QuadraticModel], Result]) -> tuple[float, Result] | None:
        """The result of a task on the equations with the least part of the noise bias that lets it finish, and that part."""
        for bias in _BIAS:
            try:
                return bias, task(self.quadratic(bias))
            except np.linalg.LinAlgError:
                continue
        return None

    def significant(self, limit: float) -> list[int]:
        """The coefficients with |z| above `limit` after backward elimination, by number.

        If the normal matrix without noise bias is not positive definite, some bias is left in until the weakest coefficients
        are eliminated, and then reduced again.
        """
        chosen = list(range(len(self.names)))
        found = self.least_biased(
            lambda quadratic: quadratic.backward_elimination(chosen, self.always, limit)
        )
        bias, chosen = found or (_BIAS[-1], chosen)
        for smaller in sorted((share for share in _BIAS if share < bias), reverse=True):
            try:
                chosen = self.quadratic(smaller).backward_elimination(chosen, self.always, limit)
            except np.linalg.LinAlgError:
                break
        return chosen


def _normal_equations(
    systems: Sequence[WeakEquations], weights: Weights, numbers: Indices, bias: float
) -> tuple[Floats, Floats]:
    h, g = np.zeros((len(numbers), len(numbers))), np.zeros(len(numbers))
    for system, weight in zip(systems, weights, strict=True):
        own = normal_equations(system.patches, weight, numbers, bias=bias)
        h, g = h + own[0], g + own[1]
    return h, g


def _solve_with_ridge(h: Floats, g: Floats) -> Floats:
    """The solution of normal equations, scaled to unit diagonal, with the smallest ridge that rounding requires."""
    scale = 1.0 / np.sqrt(np.maximum(h.diagonal(), np.finfo(float).tiny))
    scaled = h * np.outer(scale, scale)
    return np.asarray(scale * np.linalg.solve(scaled + _RIDGE * np.eye(len(g)), scale * g))


def screen_links(record: Record, candidates: Candidates) -> frozenset[str]:
    """The names of all candidates on the links whose forces a record shows; those of stated links are among them.

    The modes and the stated links with known linear laws are a linear system. A candidate link is a random force between its
    ends, and a Kalman filter gives the likelihood of the samples with it (`likelihood.starts.kalman`). Links are added one at
    a time, the likeliest first, as long as the likelihood rises by more than the penalty on a link.

    Raises IdentificationError if the record determines the modes too poorly.
    """
    structure, noise = candidates.full_structure, channel_noise(record)
    require_supported(record, structure)
    first = record[: min(_TRIED, len(record))]
    masses = structure.mass_names
    free = [p.name for p in structure.parameters if p.name.owner in masses and not p.name.is_shape]
    try:
        found = _shown_links(first, structure, candidates, noise)
        if free:  # stated as they are known beforehand, which links may make up for
            tuned = tuned_modes(record, candidates.structure(found), noise)
            tuned_structure = structure.with_values({name: tuned[name] for name in free})
            found = _shown_links(first, tuned_structure, candidates, noise)
    except np.linalg.LinAlgError:
        raise IdentificationError(
            "no links can be found: the record is too short, has too few samples, or its sensors do not show the modes of the "
            "host; give a longer record, or more sensors"
        ) from None
    return found


def _shown_links(
    record: Record, structure: Structure, candidates: Candidates, noise: Mapping[str, float]
) -> frozenset[str]:
    """The candidates on stated links, and on those that raise the likelihood by more than their penalty.

    There is one at least for every mass to which no link goes whose law is known.
    """
    linear, links = LinearPart.of(structure), structure.links
    stated = {link.name for pair in candidates.pairs for link in pair.stated}
    chosen = [number for number in linear.open if links[number].name in stated]
    others = [number for number in linear.open if number not in chosen]
    samples = int(np.isfinite(samples_of(record, replace(linear, open=()))).sum())
    least = 0.5 * Penalty.of(candidates, (), samples).link
    known = {end for link in links if link.name in stated for end in link.between}
    current = _evidence(record, linear, noise, chosen)
    while others and len(chosen) < _MOST:
        linked = known.union(*(links[number].between for number in chosen))
        loose = {mass.name for mass in candidates.masses} - linked
        evidence_with = {number: _evidence(record, linear, noise, (*chosen, number)) for number in others}
        best = max(others, key=lambda number: evidence_with[number])
        if not evidence_with[best] > current + least:  # as of filters that all diverge
            around = [number for number in others if not loose.isdisjoint(links[number].between)]
            if not around:
                break
            best = max(around, key=lambda number: evidence_with[number])
        chosen.append(best)
        others.remove(best)
        current = evidence_with[best]
    names = {links[number].name for number in chosen}
    shown = {number for number, pair in enumerate(candidates.pairs) if pair.stated or pair.name in names}
    return candidates.on_pairs(shown)


def _evidence(record: Record, linear: LinearPart, noise: Mapping[str, float], links: Sequence[int]) -> float:
    """Log likelihood of the samples with random forces in `links` alone, of the likeliest rate of their change."""
    part = replace(linear, open=tuple(links))
    with np.errstate(all="ignore"):
        return likeliest_change(record, part, noise, CHANGES[1:-1] if links else CHANGES[:1], _ALLOWED)[0]


# times as many as additions one by one select, and so many more, that elimination may leave where it has not failed
_MOST_LEFT, _FEW = 3, 10


def screen(
    measured: Measured, candidates: Candidates, progress: Progress
) -> tuple[frozenset[str], frozenset[str]]:
    """The candidates that are significant in the weak equations of the records, and all that the likelihood should test.

    Raises IdentificationError if no link to some mass is.
    """
    near = tested = frozenset(candidates.by_name)
    if len(candidates.masses) > _TOGETHER:
        tested = _significant_anywhere(measured, candidates, progress)
        near = candidates.on_links_of(tested)
        progress(ProgressReport(1.0, f"screening {len(near)} candidates together"))
    regression = WeakRegression.of(measured, candidates, candidates.structure(near))
    significant = {regression.names[k] for k in _exchanged(regression, regression.significant(_LIMIT))}
    linked = candidates.on_links_of(significant)
    # which weak equations hardly see
    dampers = {name for name in linked if candidates.by_name[name].term.text == "v"}
    return frozenset(dampers | (significant & linked)), tested | linked


def weak_start(measured: Measured, candidates: Candidates, structure: Structure) -> tuple[Floats, Floats]:
    """The parameters (p,) of `structure` by the weak form and their standard deviations (p,), with the least noise bias."""
    regression = WeakRegression.of(measured, candidates, structure)
    found = regression.least_biased(lambda quadratic: quadratic.solve(range(len(regression.names))))
    if found is None:
        raise IdentificationError(
            "the terms of the structure cannot be separated: their motions are linearly dependent in this record; record a "
            "motion in which they differ"
        )
    solved = dict(zip(regression.names, zip(*found[1], strict=True), strict=True))
    values, z = np.array([solved[parameter.name] for parameter in structure.parameters]).T
    return values, np.abs(values / z)


def _significant_anywhere(measured: Measured, candidates: Candidates, progress: Progress) -> frozenset[str]:
    """The candidates that are significant in the equation of one of their masses.

    Each equation is that of a structure with no other links, so that memory grows with the masses alone.
    """
    around: dict[str, set[str]] = {mass.name: set() for mass in candidates.masses}
    for entry in candidates.entries:
        for end in around.keys() & candidates.pairs[entry.pair].between:
            around[end].add(entry.name)
    names: set[str] = set()
    for number, (mass, links) in enumerate(around.items()):
        progress(ProgressReport(number / len(around), f"screening the links of {mass}"))
        names |= _significant_at(number, measured, candidates.structure(links), candidates)
    return frozenset(names)


def _significant_at(
    number: int, measured: Measured, structure: Structure, candidates: Candidates
) -> set[str]:
    """The names of the candidates that are significant in the equation of the mass of this number in a structure.

    Added one by one, or left of all: either way misses true links that the other one finds: additions where several motions
    together resemble another one, and elimination where the noise makes hundreds of columns dependent, so that it ends early
    with most of them. It does not count then.
    """
    regression = WeakRegression.of(measured, candidates, structure, (number,))
    found = regression.least_biased(
        lambda quadratic: quadratic.forward_selection(regression.always, _FIRST_LIMIT)
    )
    added = regression.always if found is None else found[1]
    left = regression.significant(_FIRST_LIMIT)
    chosen = {*added, *(left if len(left) <= _MOST_LEFT * len(added) + _FEW else ())}
    return {regression.names[k] for k in chosen} & candidates.by_name.keys()


def _exchanged(regression: WeakRegression, significant: list[int]) -> list[int]:
    """`significant` with terms exchanged where that lowers the criterion of the squared residuals.

    One link may then replace several that imitate it. The exchange counts only if it needs no more links; terms that it drops
    from links that stay are kept.
    """
    penalty = regression.penalty
    try:
        after = regression.squares().best_subset(significant)
    except np.linalg.LinAlgError:
        return significant
    pairs = penalty.pairs_of(after)
    if len(pairs) > len(penalty.pairs_of(significant)):
        return significant
    return sorted({*after, *(k for k in significant if int(penalty.pair[k]) in {-1, *pairs})})
