"""The weak screen: which candidates are significant when all of them are regressed at once (METHODS section 9).

The equations of all masses are regressed together, with one set of coefficients for each link. For many masses a first screen
regresses the equation of each mass by itself on all links that may end there, so that the work grows with the number of pairs;
what is significant at either end of a link is regressed again: mass by mass for what the likelihood should test, and together.

Weak equations of several masses in several records as one quadratic model of their coefficients.

Which candidate links of a structure with hosts exert forces, before anything is known of their laws.

The modes and the stated links with known linear laws are a linear system. A candidate link is a random force between its ends
(`likelihood.starts.hosts`), and a Kalman filter gives the likelihood of the samples with it. Links are added one at a time,
the likeliest first, as long as the likelihood rises by more than the penalty on a link.

The spanning tree of the most significant links, for searches that start without displacements, and for links with memory.

Integrals of velocities and accelerations lack their constants, and suggest false links beside true ones. On a tree,
accelerations determine the force of every link, and with it a start that does not need the constants
(`likelihood.starts.coefficients`). `force_tree` finds it from these forces themselves, where all masses are known.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse.csgraph import minimum_spanning_tree

from linkwise.arrays import Floats, Indices
from linkwise.discovery.candidates import Candidates
from linkwise.discovery.selection import (
    Penalty,
    QuadraticModel,
    backward_elimination,
    best_subset,
    forward_selection,
)
from linkwise.errors import IdentificationError
from linkwise.likelihood.starts.kalman import log_likelihood, tuned_modes
from linkwise.likelihood.starts.linear_part import LinearModel, LinearPart, inputs_of, samples_of
from linkwise.likelihood.starts.values import require_supported
from linkwise.model.link import BASE, GROUND
from linkwise.model.structure import Structure
from linkwise.progress import Progress, ProgressReport, part, silent
from linkwise.records.record import Record
from linkwise.signals.noise import channel_noise
from linkwise.weak.displacements import MeasuredDisplacements
from linkwise.weak.equations import WeakEquations, weak_equations
from linkwise.weak.fit import normal_blocks, residual_power
from linkwise.weak.patch import Patch
from linkwise.weak.scatter import SlopeStatistics, score_blocks

#: For each record, the patches to regress and the equations that they belong to.
RecordPatches = Sequence[tuple[Sequence[Patch], WeakEquations]]
Weights = tuple[tuple[Floats, ...], ...]

_REWEIGHTINGS = 2  # rounds of weighting the masses by their residuals
_RIDGE = 1e-10  # of the unit diagonal: just above rounding
_OVERLAP = 2.0  # windows overlap, so that sums of squares count every sample about twice


@dataclass(frozen=True, eq=False)
class WeakRegression:
    """The equations in `patches`, in which each mass is weighted by `weights`.

    `names` (p,) are the coefficients in the equations and `numbers` (p,) their numbers in the structure; `scatter` (p, p) is
    the covariance of the right-hand side of the normal equations due to noise.
    """

    patches: RecordPatches
    weights: Weights
    names: tuple[str, ...]
    numbers: Indices
    scatter: Floats

    @classmethod
    def of(cls, patches: RecordPatches) -> WeakRegression:
        """The equations weighted by the residuals of a fit of all coefficients.

        That fit leaves the noise bias in, so that its normal matrix is always positive definite.
        """
        parameters = patches[0][1].parameters
        numbers = np.unique(
            np.concatenate([patch.layout.free_parameters for some, _ in patches for patch in some])
        )
        weights: Weights = tuple(tuple(1.0 / patch.largest() for patch in some) for some, _ in patches)
        for _ in range(_REWEIGHTINGS):
            values = np.zeros(len(parameters))
            values[numbers] = _solve_with_ridge(*_normal_equations(patches, weights, numbers, 1.0))
            weights = tuple(
                tuple(1.0 / residual_power(patch, values) for patch in some) for some, _ in patches
            )
        names = tuple(parameters[number] for number in numbers)
        return cls(patches, weights, names, numbers, _scatter(patches, weights, numbers, values))

    def quadratic(self, bias: float) -> QuadraticModel:
        """The normal equations with the part `bias` of the noise bias left in; z scores by the noise."""
        h, g = _normal_equations(self.patches, self.weights, self.numbers, bias)
        return QuadraticModel(self.names, h, g, self.scatter)

    def squares(self) -> QuadraticModel:
        """The sum of squared residuals on about the scale of -2 log likelihood, to compare subsets."""
        h, g = _normal_equations(self.patches, self.weights, self.numbers, 0.0)
        overlap = _OVERLAP * max(equations.motion.density for _, equations in self.patches)
        return QuadraticModel(self.names, h / overlap, g / overlap)

    @property
    def rows(self) -> int:
        """The number of equations."""
        return int(sum(len(patch.masses) * patch.windows for some, _ in self.patches for patch in some))


def _normal_equations(
    patches: RecordPatches, weights: Sequence[Sequence[Floats]], numbers: Indices, bias: float
) -> tuple[Floats, Floats]:
    h, g = np.zeros((len(numbers), len(numbers))), np.zeros(len(numbers))
    for (some, equations), weight in zip(patches, weights, strict=True):
        blocks, right = normal_blocks(some, weight, len(equations.parameters), bias=bias)
        for which, block in blocks:
            _add(h, np.searchsorted(numbers, which), block)
        g += right[numbers]
    return h, g


def _scatter(
    patches: RecordPatches, weights: Sequence[Sequence[Floats]], numbers: Indices, values: Floats
) -> Floats:
    total = np.zeros((len(numbers), len(numbers)))
    for (some, equations), weight in zip(patches, weights, strict=True):
        slopes = [(patch, SlopeStatistics.along(patch, equations, values)) for patch in some]
        for which, block in score_blocks(slopes, weight, equations):
            _add(total, np.searchsorted(numbers, which), equations.motion.density * block)
    return total


def _add(total: Floats, which: Indices, block: Floats) -> None:
    """Add a block to the rows and columns `which` of a matrix, of which some may be repeated."""
    order = np.argsort(which, kind="stable")
    rows, starts = np.unique(which[order], return_index=True)
    if len(rows) < len(which):
        block = np.add.reduceat(block[order], starts, axis=0)
        block = np.add.reduceat(block[:, order], starts, axis=1)
        which = rows
    total[np.ix_(which, which)] += block


def _solve_with_ridge(h: Floats, g: Floats) -> Floats:
    """The solution of normal equations, scaled to unit diagonal, with the smallest ridge that rounding requires."""
    scale = 1.0 / np.sqrt(np.maximum(h.diagonal(), np.finfo(float).tiny))
    scaled = h * np.outer(scale, scale)
    return np.asarray(scale * np.linalg.solve(scaled + _RIDGE * np.eye(len(g)), scale * g))


_TRIED = 2000  # samples that decide which links there are
_CHANGES = 10.0 ** np.arange(
    -3.0, 2.0
)  # of a force over a sample, relative to its size: tried one after the other
_ALLOWED = 1e-3  # of the size of accelerations: white forces on the modes, which keep the filter steady
_MOST = 12  # links that are added


def screen_links(record: Record, candidates: Candidates) -> frozenset[str]:
    """The names of all candidates on the links whose forces a record shows; those of stated links are among them.

    Raises IdentificationError if the record determines the modes too poorly.
    """
    structure = candidates.full_structure
    require_supported(record, structure)
    noise = channel_noise(record)
    try:
        chosen = _added_links(_Filter.of(record, structure, noise), structure, candidates)
        free = [
            p.name
            for p in structure.parameters
            if p.name.owner in structure.mass_names and not p.name.is_shape
        ]
        if free:  # stated as they are known beforehand, which links may make up for
            names = _candidates_on(chosen, structure, candidates)
            tuned = tuned_modes(record, candidates.structure(names), noise)
            changed = structure.with_values({name: tuned[name] for name in free})
            chosen = _added_links(_Filter.of(record, changed, noise), structure, candidates)
    except np.linalg.LinAlgError:
        raise IdentificationError(
            "no links can be found: the record is too short, has too few samples, or its sensors do not show the modes of the "
            "host; give a longer record, or more sensors"
        ) from None
    return _candidates_on(chosen, structure, candidates)


def _candidates_on(links: Collection[int], structure: Structure, candidates: Candidates) -> frozenset[str]:
    """The names of the candidates on some `links` of the structure of all, and on stated ones."""
    names = {structure.links[number].name for number in links}
    return frozenset(
        entry.name
        for entry in candidates.entries
        if candidates.pairs[entry.pair].name in names or candidates.pairs[entry.pair].stated
    )


def _added_links(tried: _Filter, structure: Structure, candidates: Candidates) -> list[int]:
    """The links, by number, that raise the likelihood by more than their penalty, and one at least for every mass."""
    stated = {link.name for pair in candidates.pairs for link in pair.stated}
    chosen = [number for number in tried.linear.open if structure.links[number].name in stated]
    others = [number for number in tried.linear.open if number not in chosen]
    samples = int(np.isfinite(tried.samples).sum())
    least = 0.5 * Penalty.of(candidates, (), samples).link
    current = tried.evidence(chosen)
    while others and len(chosen) < _MOST:
        loose = _loose(chosen, structure, candidates)
        evidence_with = {number: tried.evidence((*chosen, number)) for number in others}
        best = max(evidence_with, key=lambda number: evidence_with[number])
        if evidence_with[best] < current + least:
            around = [number for number in others if not loose.isdisjoint(structure.links[number].between)]
            if not around:
                break
            best = max(around, key=lambda number: evidence_with[number])
        chosen.append(best)
        others.remove(best)
        current = evidence_with[best]
    return chosen


def _loose(chosen: Collection[int], structure: Structure, candidates: Candidates) -> set[str]:
    """The masses to which none of the `chosen` links goes, nor one whose law is known."""
    open_links = {pair.name for pair in candidates.pairs if not pair.stated}
    linked = {
        end
        for number, link in enumerate(structure.links)
        if number in chosen or link.name not in open_links
        for end in link.between
    }
    return {mass.name for mass in candidates.masses} - linked


@dataclass(frozen=True, eq=False)
class _Filter:
    """The linear system of all candidates with the forces of some as random inputs, and what it has to explain."""

    linear: LinearPart
    record: Record
    noise: Mapping[str, float]

    @classmethod
    def of(cls, record: Record, structure: Structure, noise: Mapping[str, float]) -> _Filter:
        """That of the first samples of a record."""
        return cls(LinearPart.of(structure), record[: min(_TRIED, len(record))], noise)

    @property
    def samples(self) -> Floats:
        """(N, C) samples of the record."""
        return samples_of(self.record, replace(self.linear, open=()))

    def evidence(self, links: Sequence[int]) -> float:
        """Log likelihood of the samples with random forces in `links` alone, of the likeliest rate of their change."""
        part = replace(self.linear, open=tuple(links))
        samples, inputs = samples_of(self.record, part), inputs_of(self.record)
        best = -np.inf
        for change in _CHANGES if links else _CHANGES[:1]:
            model = part.model(self.record, self.noise, float(change))
            model = _with_random_modes(model, self.linear.structure.size, self.record.step)
            bounds = model.noise[len(model.noise) - len(links) :]  # of elongations, which are no samples
            with np.errstate(all="ignore"):
                log_evidence = log_likelihood(model, samples, inputs) + 0.5 * len(samples) * float(
                    np.log(bounds).sum()
                )
            best = max(best, log_evidence) if np.isfinite(log_evidence) else best
        return best


def _with_random_modes(model: LinearModel, size: int, step: float) -> LinearModel:
    """A model with a small white random force on each of its `size` modes and masses, for what is wrong with the host."""
    x, v = np.sqrt(model.first.diagonal()[[0, size]])
    process = model.process.copy()
    rows = np.arange(size, 2 * size)
    process[rows, rows] += (_ALLOWED * v**2 / x * step) ** 2
    return replace(model, process=process)


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


_STATED = 1e12  # in place of |z| of a stated link: larger than any


def most_significant_tree(
    records: Sequence[Record], motions: Sequence[MeasuredDisplacements], candidates: Candidates
) -> frozenset[str]:
    """All candidates on the links of the tree that joins every mass to the ground with the largest |z|.

    The |z| of a link is that of its most significant elastic term. Empty if the significant links do not reach every mass.
    """
    chosen = _tree(records, motions, candidates, {})
    return frozenset(entry.name for entry in candidates.entries if entry.pair in chosen)


def skeleton(
    records: Sequence[Record], motions: Sequence[MeasuredDisplacements], candidates: Candidates
) -> frozenset[int]:
    """The numbers of the pairs with stated links, and of those of the tree of the most significant links beside them.

    Only the former if the significant links do not reach every mass.
    """
    stated = {number: _STATED for number, pair in enumerate(candidates.pairs) if pair.stated}
    return frozenset(stated) | _tree(records, motions, candidates, stated)


def _tree(
    records: Sequence[Record],
    motions: Sequence[MeasuredDisplacements],
    candidates: Candidates,
    stated: Mapping[int, float],
) -> frozenset[int]:
    """The numbers of the pairs of the tree with the largest |z|; those of the `stated` are given by number."""
    z = dict(stated)
    for name, score in z_scores(records, motions, candidates).items():
        entry = candidates.by_name.get(name)
        if entry is not None and entry.term.elastic:
            z[entry.pair] = max(score, z.get(entry.pair, 0.0))
    node = {mass.name: number for number, mass in enumerate(candidates.masses)}
    node |= {GROUND: len(node), BASE: len(node)}
    distance, pairs = np.zeros((len(candidates.masses) + 1,) * 2), {}
    for pair, score in z.items():
        ends = tuple(sorted(node[end] for end in candidates.pairs[pair].between))
        if distance[ends] == 0.0 or 1.0 / score < distance[ends]:
            distance[ends], pairs[ends] = 1.0 / score, pair
    tree = minimum_spanning_tree(distance).tocoo()
    if tree.nnz < len(candidates.masses):
        return frozenset()
    return frozenset(pairs[int(first), int(second)] for first, second in zip(tree.row, tree.col, strict=True))
