"""Selection by likelihood: fit, test every candidate on a local quadratic model, change the subset, and fit again.

The penalty on the size of a model: the extended Bayesian information criterion, on links and terms.

Schwarz's criterion costs ln N for each coefficient; with hundreds of candidates some false ones then enter by chance, so the
extended criterion adds the cost of the choice itself. Here a term costs the choice of one among the terms of its link. A link
costs, on top of its first term, another ln N and the choice of one among all pairs, so that a second term on a link costs less
than a new link.

References
----------
G. Schwarz, "Estimating the dimension of a model", Ann. Statist. 6 (1978).
J. Chen and Z. Chen, "Extended Bayesian information criteria for model selection with large model spaces", Biometrika 95
(2008).

A quadratic model of the cost in all candidate coefficients, and the least cost of any subset of them.

cost(c) = cost(0) - 2 g'c + c'H c over the p coefficients; those outside of a subset are zero. `scatter` is the covariance of
g: H itself for a likelihood, another matrix for equations whose columns are noisy (the weak form). Then

    z = c_j / deviation(c_j),   deviation^2 = diag(H^-1 scatter H^-1).

Stepwise search for the subset of coefficients with the least criterion: cost plus penalty.

Coefficients are added, dropped or exchanged one at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from linkwise.arrays import Floats, Indices
from linkwise.discovery.candidates import Candidates
from linkwise.errors import IdentificationError
from linkwise.likelihood.fit import LikelihoodFit, likelihood_fit
from linkwise.likelihood.optima.restarts import fit_with_restarts
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.shooting.minimise import AnnealingStatus
from linkwise.likelihood.shooting.residuals import evaluate
from linkwise.likelihood.tests.score_test import CandidateForce, LocalQuadratic, local_quadratic
from linkwise.model.structure import Structure
from linkwise.progress import Progress, ProgressReport, part
from linkwise.records.record import Record


@dataclass(frozen=True, eq=False)
class Penalty:
    """The penalties of a `term` and of a `link`, in units of -2 log likelihood.

    `pair` (p,) is the number of the pair that each coefficient belongs to, -1 for coefficients that are not selected and cost
    nothing; the links of `stated` pairs cost nothing either.
    """

    term: float
    link: float
    pair: Indices
    stated: frozenset[int]

    @classmethod
    def of(cls, candidates: Candidates, names: tuple[str, ...], samples: int) -> Penalty:
        """The penalty for coefficients called `names` and records of `samples` samples in all."""
        by_name = candidates.by_name
        pairs = [by_name[name].pair if name in by_name else -1 for name in names]
        return cls(
            term=float(np.log(max(samples, 2)) + 2.0 * np.log(max(len(candidates.terms), 1))),
            link=float(np.log(max(samples, 2)) + 2.0 * np.log(max(len(candidates.pairs), 1))),
            pair=np.array(pairs, dtype=np.intp),
            stated=frozenset(number for number, pair in enumerate(candidates.pairs) if pair.stated),
        )

    def total(self, chosen: list[int]) -> float:
        """The penalty of a model with the coefficients `chosen`, by number."""
        pairs = self.pair[chosen]
        links = set(pairs.tolist()) - {-1} - self.stated
        return self.term * int(np.sum(pairs >= 0)) + self.link * len(links)

    def pairs_of(self, chosen: Iterable[int]) -> set[int]:
        """The numbers of the pairs that the coefficients `chosen` belong to."""
        return {int(self.pair[k]) for k in chosen} - {-1}


_DEPENDENT = 1e-9  # of a column's square: a column with a smaller residual depends on the others


class Solution(NamedTuple):
    """The values (s,) of the coefficients of a subset, and their z scores (s,)."""

    values: Floats
    z: Floats


class Additions(NamedTuple):
    """Each coefficient outside of a subset, added to it alone.

    `numbers` (r,) of the coefficients, their `values` and `z` scores (r,), and `independent` (r,), the part of each column's
    square that the subset does not explain. Where that part is rounding, z is 0 and the value NaN.
    """

    numbers: Indices
    values: Floats
    z: Floats
    independent: Floats


@dataclass(frozen=True, eq=False)
class QuadraticModel:
    """H `h` (p, p) and g `g` (p,) for the coefficients `names` (p,); `scatter` (p, p), None if it equals `h`.

    `by_blocks`, of (p, p) each, are covariances of g from blocks of the records; no variance is less than theirs.
    """

    names: tuple[str, ...]
    h: Floats
    g: Floats
    scatter: Floats | None = None
    by_blocks: tuple[Floats, ...] = ()

    def solve(self, chosen: Sequence[int] | Indices) -> Solution:
        """The best values of the coefficients `chosen`, by number.

        Raises numpy.linalg.LinAlgError if their columns are linearly dependent.
        """
        inside = np.asarray(chosen, dtype=np.intp)
        inverse = inverse_of(self.h[np.ix_(inside, inside)])
        values = inverse @ self.g[inside]
        covariance = (
            inverse if self.scatter is None else inverse @ self.scatter[np.ix_(inside, inside)] @ inverse
        )
        variance = (
            covariance.diagonal()
        )  # negative where the noise of the columns explains more than there is
        for blocks in self.by_blocks:
            variance = np.maximum(variance, (inverse @ blocks[np.ix_(inside, inside)] @ inverse).diagonal())
        return Solution(values, values / np.sqrt(np.where(variance < 0.0, np.nan, variance)))

    def determines(self, chosen: Sequence[int] | Indices) -> bool:
        """Whether `solve` finds one best value of each coefficient: two points of a host may move alike to rounding."""
        inside = np.asarray(chosen, dtype=np.intp)
        try:
            _factor_of(self.h[np.ix_(inside, inside)])
        except np.linalg.LinAlgError:
            return False
        return True

    def cost(self, chosen: Sequence[int] | Indices) -> float:
        """The least cost of the coefficients `chosen`, relative to that of no coefficients."""
        inside = np.asarray(chosen, dtype=np.intp)
        return -float(self.g[inside] @ self.solve(inside).values)

    def additions(self, chosen: Sequence[int] | Indices) -> Additions:
        """Every coefficient that is not `chosen`, added to the chosen ones alone."""
        inside = np.asarray(chosen, dtype=np.intp)
        others = np.setdiff1d(np.arange(len(self.g)), inside)
        cross = self.h[np.ix_(inside, others)]
        solved = inverse_of(self.h[np.ix_(inside, inside)]) @ np.column_stack([cross, self.g[inside]])
        projection, fitted = solved[:, :-1], solved[:, -1]
        gradient = self.g[others] - cross.T @ fitted
        square = self.h[others, others]
        residual = square - np.einsum("ij,ij->j", cross, projection)
        variance = residual
        if self.scatter is not None:
            variance = _left_of(self.scatter, inside, others, projection)
        for blocks in self.by_blocks:
            variance = np.maximum(variance, _left_of(blocks, inside, others, projection))
        determined = (residual > _DEPENDENT * square) & (variance > 0.0)
        return Additions(
            numbers=others,
            values=np.where(determined, gradient / np.where(determined, residual, 1.0), np.nan),
            z=np.where(determined, gradient / np.sqrt(np.where(determined, variance, 1.0)), 0.0),
            independent=residual / np.where(square > 0.0, square, 1.0),
        )

    def exchanges(self, chosen: Sequence[int] | Indices) -> tuple[Indices, Floats]:
        """The numbers (r,) of all coefficients that are not `chosen`, and the z scores (s, r) that each would have where it
        takes the place of each of the s chosen ones.

        That of one place differs from `additions` by one rank. Without `scatter` and blocks z scores are gains.
        """
        assert self.scatter is None and not self.by_blocks
        inside = np.asarray(chosen, dtype=np.intp)
        others = np.setdiff1d(np.arange(len(self.g)), inside)
        cross = self.h[np.ix_(inside, others)]
        inverse = inverse_of(self.h[np.ix_(inside, inside)])
        projection, values = inverse @ cross, inverse @ self.g[inside]
        own = inverse.diagonal()[:, None]
        gradient = self.g[others] - cross.T @ values + projection * (values[:, None] / own)
        square = self.h[others, others]
        residual = square - np.einsum("ij,ij->j", cross, projection) + projection**2 / own
        determined = residual > _DEPENDENT * square
        return others, np.where(determined, gradient / np.sqrt(np.where(determined, residual, 1.0)), 0.0)


def _left_of(scatter: Floats, inside: Indices, others: Indices, projection: Floats) -> Floats:
    """The variances (r,) of the slopes of the `others` less the `projection` (s, r) on those `inside`."""
    middle = scatter[np.ix_(inside, inside)] @ projection - 2.0 * scatter[np.ix_(inside, others)]
    return np.asarray(scatter[others, others] + np.einsum("ij,ij->j", projection, middle))


def inverse_of(matrix: Floats) -> Floats:
    """The inverse of a positive definite matrix, which is scaled to unit diagonal first."""
    if not len(matrix):
        return matrix
    factor, scale = _factor_of(matrix)
    return np.asarray(cho_solve((factor, True), np.eye(len(matrix))) * np.outer(scale, scale))


def _factor_of(matrix: Floats) -> tuple[Floats, Floats]:
    """The Cholesky factor, in the lower triangle, of a matrix scaled to unit diagonal, and the `scale` of its columns."""
    diagonal = matrix.diagonal()
    if not np.all(diagonal > 0.0):
        raise np.linalg.LinAlgError("a column is zero")
    scale = 1.0 / np.sqrt(diagonal)
    factor, _ = cho_factor(matrix * np.outer(scale, scale), lower=True, check_finite=False)
    return factor, scale


_MOST_MOVES = 400  # far more than any search takes; a search that reaches it is in a cycle
_LEAST_GAIN = 1e-6  # of the criterion: less is rounding
_MANY = 40  # coefficients from which all exchanges are tried at once, by one inverse
_ELIMINATED = 3  # one in so many of the weak coefficients is eliminated in a round


class MoveKind(Enum):
    """What a move does to a subset."""

    ADD = "add"
    DROP = "drop"
    SWAP = "swap"


@dataclass(frozen=True)
class Move:
    """A change of a subset that lowers the criterion by `gain`: coefficients `dropped` and `added`, by number, or None."""

    kind: MoveKind
    dropped: int | None
    added: int | None
    gain: float


def ranked_moves(
    quadratic: QuadraticModel, penalty: Penalty, chosen: Sequence[int], *, swaps: bool
) -> list[Move]:
    """All moves from the subset `chosen`, best first; with `swaps` also the best exchange for each selected coefficient."""
    inside = np.asarray(chosen, dtype=np.intp)
    z = quadratic.solve(inside).z
    moves = _additions(quadratic, penalty, list(chosen), None, 0.0)
    places = np.flatnonzero(penalty.pair[inside] >= 0)
    offered = np.delete(penalty.pair, inside) >= 0
    swaps = swaps and bool(offered.any())
    many = swaps and quadratic.scatter is None and not quadratic.by_blocks and len(inside) >= _MANY
    exchanged = _best_exchanges(quadratic, penalty, inside) if many else {}
    for place in places.tolist():
        remaining = np.delete(inside, place).tolist()
        saved = penalty.total(list(chosen)) - penalty.total(remaining) - float(z[place] ** 2)
        dropped = int(inside[place])
        moves.append(Move(MoveKind.DROP, dropped, None, saved))
        if place in exchanged:
            added, gain = exchanged[place]
            moves.append(Move(MoveKind.SWAP, dropped, added, saved + gain))
        elif swaps and not many:
            additions = _additions(quadratic, penalty, remaining, dropped, saved)
            others = [move for move in additions if move.added != dropped]
            moves += sorted(others, key=lambda move: -move.gain)[:1]
    return sorted(moves, key=lambda move: -move.gain)


def _additions(
    quadratic: QuadraticModel, penalty: Penalty, chosen: list[int], dropped: int | None, saved: float
) -> list[Move]:
    """Every coefficient added to `chosen`; `saved` is the gain of having dropped `dropped` before."""
    numbers, _, z, _ = quadratic.additions(chosen)
    pairs = penalty.pair[numbers]
    linked = np.isin(pairs, [*set(penalty.pair[chosen].tolist()), *penalty.stated])
    gains = saved + z**2 - penalty.term - np.where(linked, 0.0, penalty.link)
    kind = MoveKind.ADD if dropped is None else MoveKind.SWAP
    return [
        Move(kind, dropped, int(number), float(gain))
        for number, gain, pair in zip(numbers, gains, pairs, strict=True)
        if pair >= 0
    ]


def _best_exchanges(
    quadratic: QuadraticModel, penalty: Penalty, inside: Indices
) -> dict[int, tuple[int, float]]:
    """For each place among the chosen the best coefficient for it, and the gain of that with the place empty."""
    numbers, z = quadratic.exchanges(inside)
    offered = penalty.pair[numbers] >= 0
    if not offered.any():
        return {}
    numbers, z = numbers[offered], z[:, offered]
    pairs, own = penalty.pair[numbers], penalty.pair[inside]
    stated = np.isin(pairs, list(penalty.stated))
    best = {}
    for place in np.flatnonzero(own >= 0).tolist():
        linked = stated | np.isin(pairs, np.delete(own, place))
        gains = z[place] ** 2 - penalty.term - np.where(linked, 0.0, penalty.link)
        first = int(np.argmax(gains))
        best[place] = int(numbers[first]), float(gains[first])
    return best


def local_search(quadratic: QuadraticModel, penalty: Penalty, start: Sequence[int]) -> list[int]:
    """The subset, reached from `start`, at which no single addition, removal or exchange lowers the criterion."""
    chosen = sorted(start)
    for _ in range(_MOST_MOVES):
        move = _best_move(quadratic, penalty, chosen)
        if move is None or move.gain <= _LEAST_GAIN:
            break
        chosen = sorted({*chosen, *([] if move.added is None else [move.added])} - {move.dropped})
    return chosen


def _best_move(quadratic: QuadraticModel, penalty: Penalty, chosen: list[int]) -> Move | None:
    """The move that gains most, an exchange only if no other move gains; None if every coefficient was stated."""
    for swaps in (False, True):
        moves = ranked_moves(quadratic, penalty, chosen, swaps=swaps)
        if moves and (swaps or moves[0].gain > _LEAST_GAIN):
            return moves[0]
    return None


def best_subset(quadratic: QuadraticModel, penalty: Penalty, start: Sequence[int]) -> list[int]:
    """The best result of local searches from three subsets: `start`, all terms of its links, and all coefficients.

    Where the columns of `start` are linearly dependent, as those of an offset and of all powers that it adds up to are, one
    is built up from nothing in its place. The second start finds dampers for which one on a false link may substitute, the
    third links that `start` lacks.
    """
    linked = np.isin(penalty.pair, [*(set(penalty.pair[list(start)].tolist()) - {-1}), *penalty.stated])
    always = frozenset(np.flatnonzero(penalty.pair < 0).tolist())
    limit = float(np.sqrt(penalty.term))
    try:
        subsets = [local_search(quadratic, penalty, start)]
    except np.linalg.LinAlgError:
        subsets = [local_search(quadratic, penalty, forward_selection(quadratic, always, limit))]
    for wide in ({*start, *np.flatnonzero(linked).tolist()}, set(range(len(penalty.pair)))):
        try:
            reduced = backward_elimination(quadratic, sorted(wide), always, limit)
            subsets.append(local_search(quadratic, penalty, reduced))
        except np.linalg.LinAlgError:
            continue
    return min(subsets, key=lambda chosen: quadratic.cost(chosen) + penalty.total(chosen))


def backward_elimination(
    quadratic: QuadraticModel, start: Sequence[int], always: frozenset[int], limit: float
) -> list[int]:
    """Drop coefficients with |z| below `limit` from `start`, the weakest third of them first, until none is left.

    Those in `always` stay. Raises numpy.linalg.LinAlgError if the columns are linearly dependent.
    """
    chosen = sorted(start)
    while True:
        z = np.abs(quadratic.solve(chosen).z)
        weak = [k for k, number in enumerate(chosen) if z[k] < limit and number not in always]
        if not weak:
            return chosen
        weak.sort(key=lambda k: z[k])
        eliminated = set(weak[: max(1, len(weak) // _ELIMINATED)])
        chosen = [number for k, number in enumerate(chosen) if k not in eliminated]


def forward_selection(quadratic: QuadraticModel, always: frozenset[int], limit: float) -> list[int]:
    """Add the coefficient with the largest |z| to `always`, drop what it makes insignificant, until no |z| is above `limit`.

    Of hundreds of columns that the noise makes nearly dependent only a few are ever solved for together. Raises
    numpy.linalg.LinAlgError if the columns of `always` are linearly dependent.
    """
    chosen = sorted(always)
    visited: set[tuple[int, ...]] = set()
    refused: list[int] = []
    while True:
        additions = quadratic.additions(chosen)
        z = np.where(np.isin(additions.numbers, refused), 0.0, np.abs(additions.z))
        if not len(z) or not np.max(z) >= limit:
            return chosen
        added = int(additions.numbers[int(np.argmax(z))])
        try:
            after = backward_elimination(quadratic, [*chosen, added], always, limit)
        except np.linalg.LinAlgError:
            refused.append(added)
            continue
        if tuple(after) in visited:
            refused.append(added)
            continue
        visited.add(tuple(after))
        chosen = after


#: Start values (p,) of the parameters of a structure, and their standard deviations (p,) where they are known.
Start = Callable[[Structure], tuple[Floats, Floats | None]]

_ROUNDS = 12
_STEPS = 40  # of a fit whose laws may still be wrong; right ones take a quarter of it
_TIGHT = 1e-4  # q up to which the local quadratic model is exact; a looser one only ranks the next terms
# chi-square at which a fit stops tightening: a term is missing, and can already be identified
_CEILING = 1.05


@dataclass(frozen=True, eq=False)
class Selection:
    """The `structure` of the `chosen` candidates, its `fit`, and a local model of the cost in all candidates tested.

    `settled` is False if the search ended without a subset that no move improves, after `rounds` rounds. `needless` are the
    names of terms that the criterion would have and prediction has no need of, `of_departures` those, with their functions,
    that it would have only where the motion may depart from the laws.
    """

    chosen: frozenset[str]
    structure: Structure
    fit: LikelihoodFit
    quadratic: QuadraticModel
    penalty: Penalty
    settled: bool
    rounds: int
    needless: tuple[str, ...] = ()
    of_departures: tuple[str, ...] = ()

    @property
    def converged(self) -> bool:
        """Whether the fit converged at a q for which the local quadratic model is exact."""
        return _converged(self.fit)

    @property
    def is_exact(self) -> bool:
        """Whether the laws leave no more than noise, or the search was interrupted before that could be said."""
        return leaves_only_noise(self.fit) or self.fit.status is AnnealingStatus.INTERRUPTED

    def has_fewer_links(self, rival: Selection) -> bool:
        """Whether it settled on fewer links than another one, where links may stand in for terms that were not offered."""
        return self.settled and len(self.structure.links) < len(rival.structure.links)

    @cached_property
    def neighbours(self) -> tuple[Move, ...]:
        """All moves to other subsets, exchanges among them, the best first."""
        inside = list(range(len(self.structure.parameters)))
        return tuple(ranked_moves(self.quadratic, self.penalty, inside, swaps=True))

    def quadratic_beside(self, local: LocalQuadratic, names: Sequence[str]) -> QuadraticModel:
        """A model about the same fit in its parameters and in what `names` call, on the scale of `quadratic`.

        Raises numpy.linalg.LinAlgError where the latter is singular.
        """
        p = len(self.structure.parameters)
        ratios = local.curvature[:p, :p] @ np.linalg.inv(self.quadratic.h[:p, :p])
        factor = float(np.trace(ratios)) / p  # of overdispersion
        scatter = None if local.scatter is None else local.scatter / factor**2
        names = (*self.quadratic.names[:p], *names)
        return QuadraticModel(names, local.curvature / factor, local.slope / factor, scatter)

    @property
    def noise(self) -> Floats:
        """(C,) the standard deviations of the noise of the channels that the fit went by, which it may have lowered."""
        return self.fit.optimum.scales.sigma * self.fit.optimum.noise

    def criterion(self, noise: Floats) -> float:
        """Cost with a `noise` (C,) plus penalty; infinite if the fit did not converge."""
        if not self.converged:
            return np.inf
        return cost_of(self.fit, noise) + self.penalty.total(list(range(len(self.structure.parameters))))


def leaves_only_noise(fit: LikelihoodFit) -> bool:
    """Whether a fit converged at a tight q, and its residuals are no more than noise."""
    return _converged(fit) and not fit.chi_square_off


def cost_of(fit: LikelihoodFit, noise: Floats) -> float:
    """-2 log likelihood of a fit at the relaxation where it ended, if the channels have a `noise` (C,)."""
    misfit, optimum = fit.misfit, fit.optimum
    squares = np.sum(misfit.residuals**2, axis=(0, 2)) * (optimum.scales.sigma / noise) ** 2
    return float(np.sum(squares)) + (misfit.cost(optimum.q) - misfit.data) / optimum.noise**2


def best_of(selections: Sequence[Selection]) -> Selection:
    """The selection with the lowest criterion, the first of those that are as low.

    All are compared at the same noise, the least that any of them found: residuals are no less than noise, whatever the laws.
    Where none converged at a tight q, it is the first that converged at all, else the first.
    """
    converged = [selection for selection in selections if selection.converged]
    if converged:
        noise = np.min([selection.noise for selection in converged], axis=0)
        return min(converged, key=lambda selection: selection.criterion(noise))
    ended = (selection for selection in selections if selection.fit.status is AnnealingStatus.CONVERGED)
    return next(ended, selections[0])


def link_motions(selection: Selection) -> dict[str, tuple[Floats, Floats]]:
    """Elongations and rates of each link along the fitted motion, at the ends of the steps of the flow, in m and m/s."""
    optimum, structure = selection.fit.optimum, selection.structure
    misfit = evaluate(optimum.segments, optimum.point, optimum.scales, optimum.loss)
    order = optimum.segments.system.order.tolist()
    motion = misfit.trajectories.links
    return {structure.links[link].name: (motion[:, 0, k], motion[:, 1, k]) for k, link in enumerate(order)}


def _converged(fit: LikelihoodFit) -> bool:
    tight = fit.optimum.q <= _TIGHT or bool(fit.random_forces)  # beside which the flow is tight enough
    return fit.status is AnnealingStatus.CONVERGED and tight


def singular(names: Iterable[str]) -> IdentificationError:
    """The error of a search whose fit of the terms `names` does not tell them apart."""
    return IdentificationError(
        f"the fit of the terms {', '.join(sorted(names))} does not converge: its equations became singular. Sample faster, "
        "record for longer or with less noise, or state links that are known in a structure file"
    )


@dataclass(frozen=True, eq=False)
class TermSearch:
    """What all rounds share: the records, the candidates, the names of those `tested`, and where a fit starts.

    `sensors` has the errors of sensors that every fit finds beside the terms. `restarts` says that starting states follow from
    the laws, so that where a fit fails they are computed again from its values.
    """

    records: Sequence[Record]
    candidates: Candidates
    tested: frozenset[str]
    start: Start
    progress: Progress
    sensors: LikelihoodOptions
    restarts: bool = False

    def within(self, names: Collection[str]) -> TermSearch:
        """The same search among the candidates `names` only."""
        return replace(self, tested=self.tested & frozenset(names))

    def first_fit(
        self, structure: Structure, *, ceiling: float = _CEILING, steps: int = _STEPS
    ) -> LikelihoodFit:
        """A fit from the start that the search has for `structure`, as tight as its laws allow."""
        theta, spread = self.start(structure)
        options = replace(self.options(self.progress, self.sensors.nodes), ceiling=ceiling, steps=steps)
        return likelihood_fit(self.records, structure, theta, spread=spread, options=options)

    def options(self, progress: Progress, nodes: Floats | None) -> LikelihoodOptions:
        """Those of a fit that may lack terms and starts from `nodes`."""
        return replace(
            self.sensors, progress=progress, nodes=nodes, model_error=False, ceiling=_CEILING, steps=_STEPS
        )

    def fit(
        self, structure: Structure, theta: Floats, spread: Floats | None, options: LikelihoodOptions
    ) -> LikelihoodFit:
        """A fit from `theta`, or one from states that are computed again where that fails and they follow from the laws."""
        fitted = partial(likelihood_fit, self.records, structure)
        fit = fitted(theta, spread=spread, options=options)
        stopped = fit.status is AnnealingStatus.INTERRUPTED
        if not self.restarts or stopped or (_converged(fit) and not fit.chi_square_off):
            return fit
        again = fit_with_restarts(fitted, theta, replace(options, nodes=None))
        return again if again.chi_square < fit.chi_square else fit

    def additions(
        self, structure: Structure, chosen: frozenset[str]
    ) -> tuple[list[str], list[CandidateForce]]:
        """The names of the candidates tested beside the `chosen` ones, and their forces in `structure`."""
        index = structure.topology.index
        added = [entry for entry in self.candidates.entries if entry.name in self.tested - chosen]
        ends = [self.candidates.pairs[entry.pair].between for entry in added]
        return [entry.name for entry in added], [
            CandidateForce(index[first], index[second], entry.term.law)
            for entry, (first, second) in zip(added, ends, strict=True)
        ]

    def local_model(
        self, fit: LikelihoodFit, structure: Structure, chosen: frozenset[str]
    ) -> tuple[QuadraticModel, Penalty]:
        """The cost about the fit in its parameters and, after them, the other candidates tested; and the penalty."""
        added, forces = self.additions(structure, chosen)
        local = local_quadratic(fit.optimum, forces)
        names = (*(p.name for p in structure.parameters), *added)
        samples = sum(
            int(np.isfinite(record.select(record.responses).values).sum()) for record in self.records
        )
        model = QuadraticModel(names, local.curvature, local.slope, local.scatter)
        return model, Penalty.of(self.candidates, names, samples)


def select_structure(search: TermSearch, chosen: Collection[str]) -> Selection:
    """The subset, searched from `chosen`, that no candidate tested improves.

    If it has links that `chosen` had not, the best subset on the links of `chosen` alone is searched as well, and the better
    of both is taken: terms on false links may substitute for a term that the local model did not show. If the rounds run out,
    or the search returns to a subset that it had left, `settled` is False and the result the best subset visited. The progress
    of `search` is called with the number of the round and each step of its fit. Beside hosts the search begins with the stated
    links alone where these leave only noise: a screen without displacements may take others for them.
    """
    stated = _fit_of_stated_links(search)
    if stated is not None and (leaves_only_noise(stated) or stated.status is AnnealingStatus.INTERRUPTED):
        return _descend(search, frozenset(), 1, stated)
    first = _descend(search, frozenset(chosen), 1)
    own = search.candidates.on_links_of(chosen)
    if first.fit.status is AnnealingStatus.INTERRUPTED or first.chosen <= own:
        return first
    second = _descend(search.within(own), own & search.tested, first.rounds + 1)
    if second.fit.status is AnnealingStatus.INTERRUPTED or best_of([first, second]) is first:
        return replace(first, rounds=second.rounds)
    quadratic, penalty = search.local_model(second.fit, second.structure, second.chosen)
    return replace(second, quadratic=quadratic, penalty=penalty)


def _fit_of_stated_links(search: TermSearch) -> LikelihoodFit | None:
    """The fit of the stated links of a structure with hosts; None where there are none, or they cannot be fitted alone."""
    if not (search.candidates.hosts and any(pair.stated for pair in search.candidates.pairs)):
        return None
    try:
        structure = search.candidates.structure(())
        theta, spread = search.start(structure)
        options = search.options(round_progress(search.progress, 1), search.sensors.nodes)
        return search.fit(structure, theta, spread, options)
    except (
        IdentificationError,
        np.linalg.LinAlgError,
    ):  # a mass without a link, or laws with which the motion runs away
        return None


def _descend(
    search: TermSearch, chosen: frozenset[str], number: int, known: LikelihoodFit | None = None
) -> Selection:
    """Rounds of fit and change, from the round `number` on, until the subset does not change.

    The fit of the `chosen` is made here unless it is `known`.
    """
    visited: dict[frozenset[str], Selection] = {}
    structure = search.candidates.structure(chosen)
    theta, spread = search.start(structure) if known is None else (known.values, None)
    nodes = search.sensors.nodes
    last = number + _ROUNDS - 1
    while True:
        inside = list(range(len(structure.parameters)))
        progress = round_progress(search.progress, number)
        try:
            fit = known or search.fit(structure, theta, spread, search.options(progress, nodes))
            progress(ProgressReport(1.0, f"testing {len(search.tested)} candidates"))
            quadratic, penalty = search.local_model(fit, structure, chosen)
            after = local_search(quadratic, penalty, inside) if fit.optimum.q > _TIGHT else inside
            if after == inside:
                after = best_subset(quadratic, penalty, inside)
            quadratic.solve(after)
        except (IdentificationError, np.linalg.LinAlgError) as error:
            # the motion runs away from where the last round led, or the fit to where the record says nothing of a parameter
            if visited:
                return replace(best_of([*visited.values()]), rounds=number)
            if isinstance(error, IdentificationError):
                raise
            raise singular(chosen) from None
        names = frozenset(quadratic.names[k] for k in after) & frozenset(search.candidates.by_name)
        selection = Selection(chosen, structure, fit, quadratic, penalty, names == chosen, number)
        if selection.settled or fit.status is AnnealingStatus.INTERRUPTED:
            return selection
        visited[chosen] = selection
        if names in visited or number == last:
            return replace(best_of([*visited.values()]), rounds=number)
        chosen, structure = names, search.candidates.structure(names)
        theta, spread = starts_of(quadratic, after, structure, fit)
        nodes, number, known = fit.optimum.point.nodes, number + 1, None


def starts_of(
    quadratic: QuadraticModel, chosen: Sequence[int], structure: Structure, fit: LikelihoodFit
) -> tuple[Floats, Floats]:
    """The parameters (p,) of `structure` that the model's coefficients `chosen` predict, and their deviations (p,).

    A mass that would not be positive stays as in the `fit` that the model is of.
    """
    solution = quadratic.solve(chosen)
    deviations = np.abs(solution.values / solution.z)
    starts = dict(
        zip([quadratic.names[k] for k in chosen], zip(solution.values, deviations, strict=True), strict=True)
    )
    for parameter in structure.parameters:  # those of terms have starts of their own
        if parameter.start is not None:
            starts.setdefault(parameter.name, (parameter.start, abs(parameter.start)))
    theta, spread = np.array([starts[p.name] for p in structure.parameters]).T
    fitted = dict(zip(quadratic.names, fit.values, strict=False))  # its parameters come first
    masses = {f"{mass.name}.mass" for mass in structure.masses}
    for number, parameter in enumerate(structure.parameters):
        if parameter.name in masses and theta[number] <= 0.0:
            theta[number] = fitted[parameter.name]
    return theta, spread


def round_progress(progress: Progress, number: int) -> Progress:
    """The progress of one round: each takes half of what is left."""
    start, stop = 1.0 - 0.5 ** (number - 1), 1.0 - 0.5**number

    def named(report: ProgressReport, /) -> None:
        progress(replace(report, activity=f"round {number}: {report.activity}"))

    return part(named, start, stop)
