"""How well models predict pieces of the records that they were not fitted to, and what part of the force a term makes.

Each block of the records has a parabola of its own about the fit. A model is fitted to all blocks but one, by the sum of their
parabolas, and pays what that of the block left out says. What it pays more than the selected model, in all blocks together,
is its `excess`; blocks that disagree give it a scatter (cross-validation over blocks; Geisser, J. Am. Stat. Assoc. 70, 1975).
States follow the unknowns as the whole record determines. What is known beforehand of the unknowns belongs to no block: every
fit has the whole of it, and pays an equal part of what it says with each block.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats
from linkwise.discovery.candidates import Candidates
from linkwise.discovery.selection import Selection
from linkwise.likelihood.search import FEWEST, block_scores
from linkwise.likelihood.shooting.normal_equations import add_prior
from linkwise.likelihood.shooting.residuals import evaluate
from linkwise.likelihood.tests.diagnosis import link_forces
from linkwise.likelihood.tests.score_test import CandidateForce, candidate_forces
from linkwise.runtime import one_blas_thread

_BLOCKS = 10  # long enough for what residuals remember


@dataclass(frozen=True)
class PredictionExcess:
    """The `excess` of a model over the selected one in -2 log likelihood of the blocks left out, and its `scatter`."""

    excess: float
    scatter: float

    @classmethod
    def of(cls, excesses: Floats) -> PredictionExcess:
        """That of the `excesses` (B,) of blocks."""
        return cls(float(excesses.sum()), float(np.sqrt(len(excesses)) * np.std(excesses, ddof=1)))


@dataclass(frozen=True, eq=False)
class BlockParabolas:
    """Slopes (B, u) and curvatures (B, u, u) of blocks in u scaled unknowns about a fit, where these have `values` (u,).

    The first of them belong to coefficients, in the places that `numbers` gives, and the first `selected` to those of the fit;
    the others are errors of sensors, which every model finds. `shares` are those of the force of its link that each term
    makes, by number. `prior` is the slope (u,) and the curvature (u, u) of what is known beforehand, which are in no block;
    `cost` is that of the fit.
    """

    slopes: Floats
    curvatures: Floats
    values: Floats
    numbers: dict[int, int]
    selected: int
    shares: dict[int, float]
    prior: tuple[Floats, Floats] | None = None
    cost: float = 0.0

    def prediction(self, chosen: Collection[int], than: Collection[int] | None = None) -> PredictionExcess:
        """That of the model with the coefficients `chosen`, by number; NaN where it is not determined without a block.

        Over the selected model, or over that with the coefficients `than`.
        """
        try:
            excess = self._paid(chosen) - self._paid(range(self.selected) if than is None else than)
        except np.linalg.LinAlgError:
            return PredictionExcess(np.nan, np.nan)
        return PredictionExcess.of(excess)

    def prediction_of(self, values: Floats) -> PredictionExcess:
        """That of other `values` (p,) of the coefficients of the fit, scaled, over the selected model."""
        move = np.zeros(len(self.values))
        move[: self.selected] = values - self.values[: self.selected]
        move[self.selected : len(self.numbers)] = -self.values[self.selected : len(self.numbers)]
        paid = self.curvatures @ move @ move - 2.0 * self.slopes @ move
        return PredictionExcess.of(paid - self._paid(range(self.selected)))

    def _paid(self, chosen: Collection[int]) -> Floats:
        """(B,) what the model pays for each block, fitted to the others."""
        places = {self.numbers[k] for k in chosen}
        free = np.flatnonzero([k in places or k >= len(self.numbers) for k in range(len(self.values))])
        move = -self.values
        move[free] = 0.0
        whole, slope = self.curvatures.sum(axis=0), self.slopes.sum(axis=0)
        known_slope, known = self.prior or (0.0 * slope, 0.0 * whole)
        slope, whole = slope + known_slope, whole + known
        paid = np.empty(len(self.slopes))
        for block, (own_slope, own) in enumerate(zip(self.slopes, self.curvatures, strict=True)):
            others = whole - own
            pull = slope - own_slope - others @ move
            moved = move.copy()
            moved[free] = np.linalg.solve(others[np.ix_(free, free)], pull[free])
            own_slope, own = own_slope + known_slope / len(paid), own + known / len(paid)
            paid[block] = moved @ own @ moved - 2.0 * own_slope @ moved
        return paid


@dataclass(frozen=True)
class TermWithoutGain:
    """A term, by number in `terms`, of a `share` of the force of its link, that predicts nothing, beside a `model_error`."""

    terms: tuple[int]
    share: float
    model_error: float

    def remark(self, names: Sequence[str]) -> str:
        """A sentence for the user; `names` are those of all terms by number."""
        return (
            f"{names[self.terms[0]]} makes {100.0 * self.share:.2g} % of the force of its link, less than the model error of "
            f"{100.0 * self.model_error:.2g} %, and pieces of the record that were left out are predicted as well without it."
        )


def terms_without_gain(
    selection: Selection, parabolas: BlockParabolas | None, model_error: float
) -> tuple[TermWithoutGain, ...]:
    """Terms that make less of the force of their link than the model error and by which no prediction gains measurably.

    `model_error` is the part of the forces that the laws leave unexplained. None where the selection is without one.
    """
    if parabolas is None or not selection.fit.model_error > 0.0:
        return ()
    every = range(len(selection.structure.parameters))
    small = [k for k in every if parabolas.shares.get(k, np.inf) < model_error]
    predictions = [parabolas.prediction([k for k in every if k != number]) for number in small]
    return tuple(
        TermWithoutGain((number,), parabolas.shares[number], model_error)
        for number, prediction in zip(small, predictions, strict=True)
        if prediction.excess <= prediction.scatter
    )


@np.errstate(over="ignore", invalid="ignore")  # a term may be infinite somewhere
def block_parabolas(
    selection: Selection, candidates: Candidates, added: Sequence[int]
) -> BlockParabolas | None:
    """Those of the blocks of the records, in the parameters of a selection and the terms `added`, by number.

    None where the records are too short for blocks, or random forces act.
    """
    optimum, structure = selection.fit.optimum, selection.structure
    segments, p = optimum.segments, len(structure.parameters)
    if segments.count < FEWEST * _BLOCKS or selection.fit.random_forces:
        return None
    names, index = selection.quadratic.names, structure.topology.index
    terms = [k for k in (*range(p), *added) if names[k] in candidates.by_name]
    entries = [candidates.by_name[names[k]] for k in terms]
    pairs = [candidates.pairs[entry.pair].between for entry in entries]
    forces = [
        CandidateForce(index[first], index[second], entry.term.law)
        for entry, (first, second) in zip(entries, pairs, strict=True)
    ]
    selected = len(terms) - len(added)
    with one_blas_thread():
        misfit = evaluate(segments, optimum.point, optimum.scales, optimum.loss)
        _, units = candidate_forces(optimum, misfit, forces)
        tested, _ = candidate_forces(optimum, misfit, forces[selected:])
        scores = block_scores(
            segments, misfit, optimum.scales, optimum.loss, optimum.q, _BLOCKS, candidates=tested
        )
        of_links = {
            frozenset(link.between): force
            for link, force in zip(structure.links, link_forces(optimum, misfit), strict=False)
        }
    if scores is None:
        return None
    own = p + len(added)
    values = np.zeros(scores.scores.shape[1])
    values[:p] = optimum.point.theta / optimum.scales.theta[:p]
    scale = optimum.noise**2 * _overdispersion(selection, scores.information, optimum.scales.theta[:p], own)
    shares = _shares(selection, terms, pairs, units, of_links)
    numbers = {k: place for place, k in enumerate((*range(p), *added))}
    slope, curvature = np.zeros_like(scores.scores[0]), np.zeros_like(scores.information[0])
    if segments.prior is not None:
        add_prior(curvature, slope, segments.prior, misfit.point, optimum.scales)
    slopes, curvatures = (
        np.concatenate([[parts[0] - known], parts[1:]])  # the first block has what is known beforehand
        for parts, known in ((scores.scores, slope), (scores.information, curvature))
    )
    prior = slope / scale, curvature / scale
    cost = misfit.cost(optimum.q) / scale
    return BlockParabolas(slopes / scale, curvatures / scale, values, numbers, p, shares, prior, cost)


def _shares(
    selection: Selection,
    terms: Sequence[int],
    pairs: Sequence[tuple[str, str]],
    units: Floats,
    of_links: Mapping[frozenset[str], float],
) -> dict[int, float]:
    """By number of the `terms` the parts that they make of the forces of their links; `units` (t,) are those of the terms."""
    p = len(selection.structure.parameters)
    sizes = selection.quadratic.solve(range(p)).values
    larger = selection.quadratic.additions(range(p))
    by_number = dict(zip(larger.numbers.tolist(), larger.values.tolist(), strict=True))
    return {
        k: float(abs(sizes[k] if k < p else by_number[k]) / unit / force)
        for k, unit, pair in zip(terms, units.tolist(), pairs, strict=True)
        if (force := of_links.get(frozenset(pair), 0.0)) > 0.0
    }


def _overdispersion(selection: Selection, curvatures: Floats, theta: Floats, own: int) -> float:
    """By what the curvature of the model of a selection is less than that of all blocks."""
    whole, p = curvatures.sum(axis=0), len(theta)
    beside = [*range(p), *range(own, len(whole))]
    inverse = np.linalg.inv(whole[np.ix_(beside, beside)])[:p, :p]
    h = selection.quadratic.h[:p, :p] * np.outer(theta, theta) * selection.fit.optimum.noise**2
    return float(p / np.trace(h @ inverse))
