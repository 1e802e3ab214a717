"""By how much evidence is overstated where the error of a law is taken for white noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.block_scores import BLOCKS, FEWEST, BlockScores, block_scores
from linkwise.likelihood.fit import Optimum
from linkwise.likelihood.score_test import CandidateForce, candidate_forces
from linkwise.likelihood.shooting.residuals import evaluate


@dataclass(frozen=True, eq=False)
class Overdispersion:
    """By what `factor` scores of blocks scatter more than their information says, at least 1, in the median of all.

    `scatters`, of (p + f, p + f) each, are the covariances of the slope by the parameters and the amplitudes of the candidates
    that they give, in the units of these.
    """

    factor: float
    scatters: tuple[Floats, ...]


@np.errstate(over="ignore", invalid="ignore")  # a candidate may be infinite somewhere
def overdispersion(optimum: Optimum, forces: Sequence[CandidateForce]) -> Overdispersion | None:
    """How scores by the parameters of `optimum` and by candidate `forces` scatter; None for too few segments.

    Log likelihoods are divided by the factor (quasi-likelihood: Wedderburn, Biometrika 61, 1974).
    """
    segments = optimum.segments
    if segments.count < FEWEST * BLOCKS[0]:
        return None
    misfit = evaluate(segments, optimum.point, optimum.scales, optimum.loss)
    candidates, units = candidate_forces(optimum, misfit, forces)
    scores = block_scores(
        segments, misfit, optimum.scales, optimum.loss, optimum.q, BLOCKS[0], candidates=candidates
    )
    if scores is None:
        return None
    parameters = segments.system.parameters.size
    own = parameters + len(forces)
    in_blocks = [scores.merged(blocks) for blocks in BLOCKS]
    ratios = [blocks.single_ratios(parameters)[:own] / optimum.noise**2 for blocks in in_blocks]
    unit = np.concatenate([optimum.scales.theta[:parameters], units]) * optimum.noise**2
    return Overdispersion(
        factor=max(1.0, float(np.median(np.max(ratios, axis=0)))),
        scatters=tuple(_scatter(blocks, own) / np.outer(unit, unit) for blocks in in_blocks),
    )


def _scatter(scores: BlockScores, own: int) -> Floats:
    """(own, own) covariance of the sum of the scores by the first `own` unknowns, the others following them."""
    whole, pull = scores.information.sum(axis=0), scores.scores
    follow = np.linalg.lstsq(whole[own:, own:], whole[own:, :own], rcond=None)[0]
    left = pull[:, :own] - pull[:, own:] @ follow
    left -= left.mean(axis=0)
    blocks = len(left)
    return np.asarray(left.T @ left * blocks / (blocks - 1))
