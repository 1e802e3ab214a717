"""The weak screen: what stands above the noise when all candidates are regressed at once (METHODS section 6).

The equations of all masses are regressed together, where a link has one set of coefficients. For many masses a first sieve
comes before: every mass by itself, its own equation with all links that could end at it, which keeps the work linear in
the pairs. What stands there at either end of a link goes on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array

from linkwise.discovery.candidates import Candidates
from linkwise.discovery.quadratic import Quadratic
from linkwise.discovery.stepwise import pruned
from linkwise.motion import SeenMotion
from linkwise.patch import Patch
from linkwise.record import Record
from linkwise.structure import Structure
from linkwise.weak import WeakEquations, weak_equations
from linkwise.weakfit import assembled, normal_equations, residual_power
from linkwise.weaknoise import Slopes, score_blocks

Floats = NDArray[np.float64]

_TOGETHER = 12  # masses whose candidates are regressed at once without the first sieve
_SIEVE = 2.5  # deviations that a term needs in the equation of one mass to be looked at again
_LIMIT = 4.0  # and in all equations together
_ROUNDS = 2  # of weighting the masses by what they leave
_LONE = 8.0  # and a damper without a spring, which the weak form takes for another's easily
_RIDGE = 1e-10
_BIAS = (0.0, 0.03, 0.1, 0.3, 1.0)  # shares of the noise bias to leave in until the sums of products are positive


@dataclass(frozen=True)
class Screened:
    """The names of the candidates that `kept` their place, and of those that stood in the first sieve."""

    kept: frozenset[str]
    looked_at: frozenset[str]


def screened(records: Sequence[Record], motions: Sequence[SeenMotion], candidates: Candidates) -> Screened:
    """What of `candidates` the weak equations of the records show.

    Raises IdentificationError where a mass is held by nothing that stands above the noise.
    """
    few = candidates.everything
    looked_at = set(candidates.by_name)
    if len(candidates.masses) > _TOGETHER:
        looked_at = _one_by_one(records, motions, candidates)
        few = candidates.structure(looked_at)
    seen = _equations(records, motions, few)
    regression = _Regression([(each.patches, each) for each in seen])
    standing = regression.standing(candidates, _LIMIT)
    kept = regression.with_dampers(candidates, standing)
    return Screened(frozenset(regression.names_of(kept)), frozenset(looked_at))


def _one_by_one(
    records: Sequence[Record], motions: Sequence[SeenMotion], candidates: Candidates
) -> set[str]:
    """What stands in the equation of one mass or another, and dampers on all links of which something does."""
    seen = _equations(records, motions, candidates.everything, together=1)
    found: set[str] = set()
    for patches in zip(*(equations.patches for equations in seen), strict=True):
        regression = _Regression([([patch], each) for patch, each in zip(patches, seen, strict=True)])
        found |= regression.names_of(regression.standing(candidates, _SIEVE))
    linked = {candidates.by_name[name].pair for name in found if name in candidates.by_name}
    return found | {entry.name for entry in candidates.entries if entry.pair in linked and entry.is_damper}


def _equations(
    records: Sequence[Record], motions: Sequence[SeenMotion], structure: Structure, *, together: int = _TOGETHER
) -> list[WeakEquations]:
    return [
        weak_equations(record, structure, motion, together=together)
        for record, motion in zip(records, motions, strict=True)
    ]


class _Regression:
    """Weak equations of some masses in all records, weighted by what they leave, and the choices that they support."""

    def __init__(self, pieces: Sequence[tuple[Sequence[Patch], WeakEquations]]) -> None:
        self.pieces = pieces
        self.parameters = pieces[0][1].parameters
        involved = [patch.layout.parameter for patches, _ in pieces for patch in patches]
        self.numbers = np.unique(np.concatenate(involved))
        self.weights = [[1.0 / patch.largest() for patch in patches] for patches, _ in pieces]
        for _ in range(_ROUNDS):
            values = np.zeros(len(self.parameters))
            h, g = self._normal(1.0)
            values[self.numbers] = _ridged(h, g)
            self.weights = [
                [1.0 / residual_power(patch, values) for patch in patches] for patches, _ in pieces
            ]
        self.scatter = self._scatter(values)

    def names_of(self, chosen: Sequence[int]) -> set[str]:
        """The names of the parameters at places among `numbers`."""
        return {self.parameters[self.numbers[place]] for place in chosen}

    def standing(self, candidates: Candidates, limit: float) -> list[int]:
        """What stays above `limit` deviations when everything else is pruned, by places among `numbers`."""
        always = frozenset(
            place
            for place, number in enumerate(self.numbers)
            if self.parameters[number] not in candidates.by_name
        )
        chosen = list(range(len(self.numbers)))
        for bias in _BIAS:
            try:
                chosen = pruned(self.quadratic(bias), chosen, always, limit)
            except np.linalg.LinAlgError:
                continue
            return chosen if bias == 0.0 else self._without_bias(chosen, always, limit)
        return chosen

    def _without_bias(self, chosen: list[int], always: frozenset[int], limit: float) -> list[int]:
        """Pruned once more with less and less of the bias left in, as far as that goes."""
        for bias in reversed(_BIAS):
            try:
                chosen = pruned(self.quadratic(bias), chosen, always, limit)
            except np.linalg.LinAlgError:
                break
        return chosen

    def with_dampers(self, candidates: Candidates, standing: Sequence[int]) -> list[int]:
        """`standing` with a damper on every link, which the weak form cannot judge, and without what these make needless."""
        names = [self.parameters[number] for number in self.numbers]
        linked = {candidates.by_name[names[k]].pair for k in standing if names[k] in candidates.by_name}
        dampers = {
            place
            for place, name in enumerate(names)
            if (entry := candidates.by_name.get(name)) and entry.pair in linked and entry.is_damper
        }
        held = dampers | {place for place in standing if names[place] not in candidates.by_name}
        lone = {
            place
            for place, name in enumerate(names)
            if place in dampers and not any(
                candidates.by_name[names[k]].pair == candidates.by_name[name].pair
                for k in standing if names[k] in candidates.by_name and not candidates.by_name[names[k]].is_damper
            )
        }
        quadratic = self.quadratic(0.0)
        try:
            kept = pruned(quadratic, sorted({*standing, *dampers}), frozenset(held), _LIMIT)
            return pruned(quadratic, kept, frozenset(set(kept) - lone), _LONE)
        except np.linalg.LinAlgError:
            return list(standing)

    def quadratic(self, bias: float) -> Quadratic:
        """The sums of products with this share of the noise bias left in."""
        h, g = self._normal(bias)
        return Quadratic(tuple(self.parameters[number] for number in self.numbers), h, g, self.scatter)

    def _normal(self, bias: float) -> tuple[Floats, Floats]:
        count, here = len(self.parameters), self.numbers
        h, g = np.zeros((len(here), len(here))), np.zeros(len(here))
        for (patches, _), weights in zip(self.pieces, self.weights, strict=True):
            one, right = normal_equations(patches, weights, count, bias=bias)
            h += _dense(one, here)
            g += right[here]
        return h, g

    def _scatter(self, values: Floats) -> Floats:
        count, here = len(self.parameters), self.numbers
        total = np.zeros((len(here), len(here)))
        for (patches, equations), weights in zip(self.pieces, self.weights, strict=True):
            noisy = [(patch, Slopes.along(patch, equations, values)) for patch in patches]
            total += _dense(assembled(score_blocks(noisy, weights, equations), count), here)
        return total


def _dense(matrix: Floats | csc_array, here: NDArray[np.intp]) -> Floats:
    """The rows and columns `here`."""
    if isinstance(matrix, np.ndarray):
        return np.asarray(matrix[np.ix_(here, here)])
    return np.asarray(matrix[here][:, here].toarray())


def _ridged(h: Floats, g: Floats) -> Floats:
    """Least squares with the smallest ridge that rounding asks for."""
    scale = 1.0 / np.sqrt(np.maximum(h.diagonal(), np.finfo(float).tiny))
    scaled = h * np.outer(scale, scale)
    return np.asarray(scale * np.linalg.solve(scaled + _RIDGE * np.eye(len(g)), scale * g))
