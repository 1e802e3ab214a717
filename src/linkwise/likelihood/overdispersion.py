"""By how much evidence is overstated where the error of a law is taken for white noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from linkwise.likelihood.block_scores import BLOCKS, FEWEST, block_scores
from linkwise.likelihood.fit import Optimum
from linkwise.likelihood.score_test import CandidateForce, candidate_forces
from linkwise.likelihood.shooting.residuals import evaluate


@np.errstate(over="ignore", invalid="ignore")  # a candidate may be infinite somewhere
def overdispersion(optimum: Optimum, forces: Sequence[CandidateForce]) -> float | None:
    """By what factor the scores of blocks scatter more than their information says; at least 1, None for too few segments.

    The median over the parameters of `optimum` and candidate `forces`, by which log likelihoods are divided (quasi-likelihood:
    Wedderburn, Biometrika 61, 1974).
    """
    segments = optimum.segments
    if segments.count < FEWEST * BLOCKS[0]:
        return None
    misfit = evaluate(segments, optimum.point, optimum.scales, optimum.loss)
    candidates, _ = candidate_forces(optimum, misfit, forces)
    scores = block_scores(
        segments, misfit, optimum.scales, optimum.loss, optimum.q, BLOCKS[0], candidates=candidates
    )
    if scores is None:
        return None
    parameters, tested = segments.system.parameters.size, len(forces)
    ratios = [
        scores.merged(blocks).single_ratios(parameters)[: parameters + tested] / optimum.noise**2
        for blocks in BLOCKS
    ]
    return max(1.0, float(np.median(np.max(ratios, axis=0))))
