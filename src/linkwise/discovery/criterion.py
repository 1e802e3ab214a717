"""The criterion of a selection: the cost of a subset of coefficients by a quadratic model, plus the penalty on its size.

cost(c) = cost(0) - 2 g'c + c'H c over the p coefficients; those outside of a subset are zero. `scatter` is the covariance of
g: H itself for a likelihood, another matrix for equations whose columns are noisy (the weak form). Then

    z = c_j / deviation(c_j),   deviation^2 = diag(H^-1 scatter H^-1).

The subset with the least criterion is searched stepwise: coefficients are added, dropped or exchanged one at a time.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from linkwise.arrays import Floats, Indices
from linkwise.discovery.candidates import Candidates

#: Rise of the criterion, on the scale of -2 log likelihood, that makes a decision certain: the odds are exp(5) to 1 or better,
#: "very strong" evidence.
CERTAIN = 10.0

_DEPENDENT = 1e-9  # of a column's square: a column with a smaller residual depends on the others
_MOST_MOVES = 400  # far more than any search takes; a search that reaches it is in a cycle
_LEAST_GAIN = 1e-6  # of the criterion: less is rounding
_ELIMINATED = 3  # one in so many of the weak coefficients is eliminated in a round

#: Coefficients, by number.
Subset = Sequence[int] | Indices


@dataclass(frozen=True, eq=False)
class Penalty:
    """The penalties of a `term` and of a `link`, in units of -2 log likelihood: the extended Bayesian information criterion.

    Schwarz's criterion costs ln N for each coefficient (Ann. Statist. 6, 1978); with hundreds of candidates some false ones
    then enter by chance, so the extended one adds the cost of the choice itself (Chen and Chen, Biometrika 95, 2008). A term
    costs the choice of one among the terms of its link. A link costs, on top of its first term, another ln N and the choice of
    one among all pairs, so that a second term on a link costs less than a new link.

    `pair` (p,) is the number of the pair that each coefficient belongs to, -1 for coefficients that are not selected and cost
    nothing; the links of `stated` pairs cost nothing either.
    """

    term: float
    link: float
    pair: Indices
    stated: frozenset[int]

    @classmethod
    def of(cls, candidates: Candidates, names: Sequence[str], samples: int) -> Penalty:
        """The penalty for coefficients called `names` and records of `samples` samples in all."""
        by_name, ln_samples = candidates.by_name, np.log(max(samples, 2))
        pairs = [by_name[name].pair if name in by_name else -1 for name in names]
        return cls(
            term=float(ln_samples + 2.0 * np.log(max(len(candidates.terms), 1))),
            link=float(ln_samples + 2.0 * np.log(max(len(candidates.pairs), 1))),
            pair=np.array(pairs, dtype=np.intp),
            stated=candidates.stated_pairs,
        )

    def total(self, chosen: Subset) -> float:
        """The penalty of a model with the coefficients `chosen`."""
        terms = int(np.sum(self.pair[np.asarray(chosen, dtype=np.intp)] >= 0))
        return self.term * terms + self.link * len(self.pairs_of(chosen) - self.stated)

    def pairs_of(self, chosen: Iterable[int]) -> set[int]:
        """The numbers of the pairs that the coefficients `chosen` belong to."""
        return {int(self.pair[k]) for k in chosen} - {-1}

    def has_other_terms(self, chosen: Sequence[int]) -> list[bool]:
        """Which of the `chosen` are terms whose link would stay without them, as it was stated or has others."""
        pairs = self.pair[chosen].tolist()
        return [pair >= 0 and (pairs.count(pair) > 1 or pair in self.stated) for pair in pairs]

    def gains(self, numbers: Indices, z: Floats, beside: Indices) -> Floats:
        """By what adding each of some coefficients, of scores `z`, to those `beside` lowers the criterion; -inf if no term."""
        pairs = self.pair[numbers]
        linked = np.isin(pairs, [*self.pairs_of(beside), *self.stated])
        return np.where(pairs >= 0, z**2 - self.term - np.where(linked, 0.0, self.link), -np.inf)


class Solution(NamedTuple):
    """The values (s,) of the coefficients of a subset, and their z scores (s,)."""

    values: Floats
    z: Floats


class Additions(NamedTuple):
    """Each coefficient outside of a subset, added to it alone.

    `numbers` (r,) of the coefficients, their `values` and `z` scores (r,). Where what the subset leaves of a column is
    rounding, z is 0 and the value NaN.
    """

    numbers: Indices
    values: Floats
    z: Floats


class Move(NamedTuple):
    """A change of a subset that lowers the criterion by `gain`: coefficients `dropped` and `added`, by number, or None."""

    dropped: int | None
    added: int | None
    gain: float

    @property
    def exchanges(self) -> bool:
        """Whether one coefficient takes the place of another."""
        return self.dropped is not None and self.added is not None


@dataclass(frozen=True, eq=False)
class QuadraticModel:
    """H `h` (p, p) and g `g` (p,) for the coefficients `names` (p,) with a `penalty`; `scatter` (p, p), None if it equals `h`.

    `by_blocks`, of (p, p) each, are covariances of g from blocks of the records; no variance is less than theirs. All are
    divided by the `overdispersion` of these. Methods raise numpy.linalg.LinAlgError if the columns of the coefficients chosen
    are linearly dependent.
    """

    names: tuple[str, ...]
    h: Floats
    g: Floats
    penalty: Penalty
    scatter: Floats | None = None
    by_blocks: tuple[Floats, ...] = ()
    overdispersion: float = 1.0

    def solve(self, chosen: Subset) -> Solution:
        """The best values of the coefficients `chosen`."""
        inside = np.asarray(chosen, dtype=np.intp)
        inverse = inverse_of(self.h[np.ix_(inside, inside)])
        values = inverse @ self.g[inside]
        variance = self._spread(inverse, inside, self.scatter).diagonal()
        for blocks in self.by_blocks:
            variance = np.maximum(variance, self._spread(inverse, inside, blocks).diagonal())
        # negative where the noise of the columns explains more than there is
        return Solution(values, values / np.sqrt(np.where(variance < 0.0, np.nan, variance)))

    def covariance(self, chosen: Subset) -> Floats:
        """That of the values of the coefficients `chosen`."""
        inside = np.asarray(chosen, dtype=np.intp)
        return self._spread(inverse_of(self.h[np.ix_(inside, inside)]), inside, self.scatter)

    @staticmethod
    def _spread(inverse: Floats, inside: Indices, scatter: Floats | None) -> Floats:
        return inverse if scatter is None else inverse @ scatter[np.ix_(inside, inside)] @ inverse

    def among(self, numbers: Indices) -> QuadraticModel:
        """The model of some coefficients alone."""
        block, penalty = np.ix_(numbers, numbers), replace(self.penalty, pair=self.penalty.pair[numbers])
        scatter = None if self.scatter is None else self.scatter[block]
        names = tuple(self.names[k] for k in numbers)
        return QuadraticModel(names, self.h[block], self.g[numbers], penalty, scatter)

    def determines(self, chosen: Subset) -> bool:
        """Whether `solve` finds one best value of each coefficient: two points of a host may move alike to rounding."""
        try:
            self.solve(chosen)
        except np.linalg.LinAlgError:
            return False
        return True

    def cost(self, chosen: Subset) -> float:
        """The least cost of the coefficients `chosen`, relative to that of no coefficients."""
        return -float(self.g[np.asarray(chosen, dtype=np.intp)] @ self.solve(chosen).values)

    def criterion(self, chosen: Subset) -> float:
        """Cost plus penalty."""
        return self.cost(chosen) + self.penalty.total(chosen)

    def additions(self, chosen: Subset) -> Additions:
        """Every coefficient that is not `chosen`, added to the chosen ones alone."""
        inside, others, _, projection, gradient = self._beside(chosen)
        return self._added(inside, others, projection, gradient)

    def exchanges(self, chosen: Subset) -> list[Additions]:
        """Every coefficient that is not `chosen` in the place of each of the chosen ones, which differs by one rank."""
        inside, others, inverse, projection, gradient = self._beside(chosen)
        values = inverse @ self.g[inside]
        return [
            self._added(
                inside, others, projection - np.outer(column, row) / own, gradient + row * (value / own)
            )
            for column, row, own, value in zip(inverse.T, projection, inverse.diagonal(), values, strict=True)
        ]

    def _beside(self, chosen: Subset) -> tuple[Indices, Indices, Floats, Floats, Floats]:
        """The coefficients chosen (s,), others (r,), the inverse among the former, what they explain and leave of others."""
        inside = np.asarray(chosen, dtype=np.intp)
        others = np.setdiff1d(np.arange(len(self.g)), inside)
        cross, inverse = self.h[np.ix_(inside, others)], inverse_of(self.h[np.ix_(inside, inside)])
        return inside, others, inverse, inverse @ cross, self.g[others] - cross.T @ (inverse @ self.g[inside])

    def _added(self, inside: Indices, others: Indices, projection: Floats, gradient: Floats) -> Additions:
        """The others, of which the columns inside explain the `projection` (s, r) and leave the slopes `gradient` (r,)."""
        square = self.h[others, others]
        residual = square - np.einsum("ij,ij->j", self.h[np.ix_(inside, others)], projection)
        variance = residual
        for number, scatter in enumerate((self.scatter, *self.by_blocks)):
            if scatter is not None:
                middle = scatter[np.ix_(inside, inside)] @ projection - 2.0 * scatter[np.ix_(inside, others)]
                own = scatter[others, others] + np.einsum("ij,ij->j", projection, middle)
                variance = np.maximum(variance, own) if number else own
        determined = (residual > _DEPENDENT * square) & (variance > 0.0)
        return Additions(
            numbers=others,
            values=np.where(determined, gradient / np.where(determined, residual, 1.0), np.nan),
            z=np.where(determined, gradient / np.sqrt(np.where(determined, variance, 1.0)), 0.0),
        )

    def moves(self, chosen: Subset, *, swaps: bool) -> list[Move]:
        """All moves from the subset `chosen`, best first; with `swaps` also the best exchange for each one selected."""
        inside, penalty = np.asarray(chosen, dtype=np.intp), self.penalty
        numbers, _, z = self.additions(inside)
        gains = penalty.gains(numbers, z, inside)
        every = zip(numbers.tolist(), gains.tolist(), strict=True)
        moves = [Move(None, number, gain) for number, gain in every if gain > -np.inf]
        exchanges = self.exchanges(inside) if swaps and len(moves) else []
        whole, own = penalty.total(inside), self.solve(inside).z
        for place in np.flatnonzero(penalty.pair[inside] >= 0).tolist():
            dropped, remaining = int(inside[place]), np.delete(inside, place)
            saved = whole - penalty.total(remaining) - float(own[place] ** 2)
            moves.append(Move(dropped, None, saved))
            if exchanges:
                gains = penalty.gains(numbers, exchanges[place].z, remaining)
                best = int(np.argmax(gains))
                moves.append(Move(dropped, int(numbers[best]), saved + float(gains[best])))
        return sorted(moves, key=lambda move: -move.gain)

    def local_search(self, start: Subset) -> list[int]:
        """The subset, reached from `start`, at which no single addition, removal or exchange lowers the criterion."""
        chosen = sorted(start)
        for _ in range(_MOST_MOVES):
            move = self._best_move(chosen)
            if move is None:
                break
            chosen = sorted({*chosen, *([] if move.added is None else [move.added])} - {move.dropped})
        return chosen

    def _best_move(self, chosen: list[int]) -> Move | None:
        """The move that gains most, an exchange only if no other move gains; None if none does."""
        for swaps in (False, True):
            moves = self.moves(chosen, swaps=swaps)
            if moves and moves[0].gain > _LEAST_GAIN:
                return moves[0]
        return None

    def best_subset(self, start: Subset) -> list[int]:
        """The best result of local searches from three subsets: `start`, all terms of its links, and all coefficients.

        Where the columns of `start` are linearly dependent, as those of an offset and of all powers that it adds up to are,
        one is built up from nothing in its place. The second start finds dampers for which one on a false link may
        substitute, the third links that `start` lacks.
        """
        pair = self.penalty.pair
        linked = np.flatnonzero(np.isin(pair, [*self.penalty.pairs_of(start), *self.penalty.stated]))
        always = frozenset(np.flatnonzero(pair < 0).tolist())
        limit = float(np.sqrt(self.penalty.term))
        try:
            subsets = [self.local_search(start)]
        except np.linalg.LinAlgError:
            subsets = [self.local_search(self.forward_selection(always, limit))]
        for wide in ({*start, *linked.tolist()}, range(len(pair))):
            try:
                subsets.append(self.local_search(self.backward_elimination(wide, always, limit)))
            except np.linalg.LinAlgError:
                continue
        return min(subsets, key=self.criterion)

    def backward_elimination(self, start: Iterable[int], always: frozenset[int], limit: float) -> list[int]:
        """Drop coefficients with |z| below `limit` from `start`, the weakest third first, until none is left but `always`."""
        chosen = sorted(start)
        while True:
            z = np.abs(self.solve(chosen).z)
            weak = [k for k, number in enumerate(chosen) if z[k] < limit and number not in always]
            if not weak:
                return chosen
            weakest = sorted(weak, key=lambda k: z[k])[: max(1, len(weak) // _ELIMINATED)]
            chosen = np.delete(chosen, weakest).tolist()

    def forward_selection(self, always: frozenset[int], limit: float) -> list[int]:
        """Add the coefficient with the largest |z| to `always`, drop what it makes insignificant, until none is above `limit`.

        Each is added once: what a later one makes insignificant stays out. Of hundreds of columns that noise makes nearly
        dependent few are ever solved for together.
        """
        chosen, tried = sorted(always), list[int]()
        while True:
            additions = self.additions(chosen)
            z = np.where(np.isin(additions.numbers, tried), 0.0, np.abs(additions.z))
            if not np.max(z, initial=0.0) >= limit:
                return chosen
            tried.append(int(additions.numbers[int(np.argmax(z))]))
            with suppress(np.linalg.LinAlgError):
                chosen = self.backward_elimination([*chosen, tried[-1]], always, limit)


def inverse_of(matrix: Floats) -> Floats:
    """The inverse of a positive definite matrix, which is scaled to unit diagonal first."""
    if not len(matrix):
        return matrix
    diagonal = matrix.diagonal()
    if not np.all(diagonal > 0.0):
        raise np.linalg.LinAlgError("a column is zero")
    scale = 1.0 / np.sqrt(diagonal)
    factor = cho_factor(matrix * np.outer(scale, scale), lower=True, check_finite=False)
    return np.asarray(cho_solve(factor, np.eye(len(matrix))) * np.outer(scale, scale))
