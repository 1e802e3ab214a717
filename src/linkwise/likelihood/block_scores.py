"""What separate blocks of the records say of the unknowns: their scores and information, the states eliminated.

Around an optimum each block b of segments pulls the unknowns by its score g_b (p,), with the information H_b (p, p), where
the states follow the unknowns as the whole record determines. The scores of all blocks sum to zero at the optimum. Where
the error of a law moves with the motion, they scatter more than the information says, which white noise would not do: the
variance of an unknown is then that of the estimates with one block left out (jackknife over blocks), as in the covariance of
White (1982) and its form for clustered data (Bell and McCaffrey, Survey Methodology 28, 2002).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from linkwise.arrays import Bools, Floats, Indices
from linkwise.likelihood.shooting.block_information import block_information
from linkwise.likelihood.shooting.linear_model import linear_model
from linkwise.likelihood.shooting.loss import Loss
from linkwise.likelihood.shooting.residuals import Misfit
from linkwise.likelihood.shooting.segments import Scales, Segments
from linkwise.likelihood.shooting.tangent_forces import CandidateForces

BLOCKS = (
    20,
    10,
)  # that are tried: short ones are many, long ones hold what residuals remember; each divides the one before
FEWEST = 5  # segments in the shortest block
EQUAL = 15  # segments in the shortest block, from which on one more or less hardly matters
_LEVEL = 0.975
_COLLINEAR = 1e-6  # of its own information: what is left of an unknown beside the others


@dataclass(frozen=True, eq=False)
class BlockScores:
    """`scores` (B, p) and `information` (B, p, p) of consecutive blocks, in scaled unknowns (theta, offsets, gains)."""

    scores: Floats
    information: Floats

    def merged(self, blocks: int) -> BlockScores:
        """The same in fewer blocks of about equal length."""
        label = np.arange(len(self.scores)) * blocks // len(self.scores)
        firsts = np.searchsorted(label, np.arange(blocks))
        return BlockScores(np.add.reduceat(self.scores, firsts), np.add.reduceat(self.information, firsts))

    def deviations(self, free: Bools) -> Floats:
        """(p,) standard errors by leaving out one block at a time, widened to normal quantiles; zero where not `free`."""
        chosen, blocks = np.flatnonzero(free), len(self.scores)
        moved = np.einsum("bij,bj->bi", self._inverses_without_each(chosen), self.scores[:, chosen])
        variance = np.sum((moved - moved.mean(axis=0)) ** 2, axis=0) * (blocks - 1) / blocks
        quantiles = scipy.special.stdtrit(blocks - 1, _LEVEL) / scipy.special.ndtri(_LEVEL)
        out = np.zeros(len(free))
        out[chosen] = quantiles * np.sqrt(variance)
        return out

    def chances(self, free: Bools, noise: float) -> Floats:
        """(p,) probabilities that noise alone scatters estimates without one block so far; 1 where not `free`.

        Scores of noise have the covariance that the information says, times `noise` squared, and sum to zero; the sum of
        squares is taken for a multiple of chi-square with its mean and variance (Satterthwaite, Biometrics Bulletin 2, 1946).
        """
        chosen = np.flatnonzero(free)
        inverses, parts = self._inverses_without_each(chosen), self.information[:, chosen][:, :, chosen]
        moved = np.einsum("bij,bj->bi", inverses, self.scores[:, chosen]) / noise
        squares = np.sum((moved - moved.mean(axis=0)) ** 2, axis=0)
        of_whole, out = np.linalg.inv(parts.sum(axis=0)), np.ones(len(free))
        # of each unknown c, from the scores of each block b
        followed = (parts @ inverses.transpose(0, 2, 1)).transpose(2, 0, 1)
        own = np.einsum("bcu,cbu->cb", inverses, followed)
        covariance = -(followed @ of_whole @ followed.transpose(0, 2, 1))
        covariance[:, np.arange(len(parts)), np.arange(len(parts))] += own
        covariance -= covariance.mean(axis=1, keepdims=True)
        covariance -= covariance.mean(axis=2, keepdims=True)
        mean = np.trace(covariance, axis1=1, axis2=2)
        degrees = mean**2 / np.sum(covariance**2, axis=(1, 2))
        out[chosen] = scipy.special.chdtrc(degrees, degrees * squares / mean)
        return out

    def _inverses_without_each(self, chosen: Indices) -> Floats:
        """(B, c, c) inverses of the information on the `chosen` unknowns with one block left out."""
        parts = self.information[:, chosen][:, :, chosen]
        return np.linalg.inv(parts.sum(axis=0) - parts)

    def single_ratios(self, parameters: int) -> Floats:
        """(p,) squared ratios of the scatter of the blocks to what the information says, one unknown at a time.

        The first `parameters` are tested beside each other, each other one beside these alone.
        """
        blocks, whole = len(self.scores), self.information.sum(axis=0)
        scale = 1.0 / np.sqrt(np.maximum(whole.diagonal(), np.finfo(float).tiny))
        scaled, scores = whole * np.outer(scale, scale), self.scores * scale
        own = np.arange(parameters)
        ratios = np.ones(len(whole))
        for number in range(len(whole)):
            beside = own[own != number]
            weights = np.linalg.lstsq(scaled[np.ix_(beside, beside)], scaled[beside, number], rcond=1e-12)[0]
            left = scaled[number, number] - scaled[number, beside] @ weights
            pull = scores[:, number] - scores[:, beside] @ weights
            if left > _COLLINEAR:
                ratios[number] = np.sum((pull - pull.mean()) ** 2) * blocks / (blocks - 1) / left
        return ratios


@dataclass(frozen=True, eq=False)
class BlockScatter:
    """How far blocks of the records disagree.

    Attributes
    ----------
    ratios : array of shape (p + o + g,)
        Standard errors by blocks over those of white noise, at least 1.
    chance : float
        The probability that noise alone scatters any parameter so far, in either number of blocks.
    """

    ratios: Floats
    chance: float


def block_scatter(
    segments: Segments,
    misfit: Misfit,
    scales: Scales,
    loss: Loss,
    *,
    q: float,
    noise: float,
    free: Bools,
    scores: BlockScores | None = None,
) -> BlockScatter | None:
    """How far the scatter of blocks exceeds what white noise gives them; None for too few segments.

    `noise` is the factor on the deviations in `scales`, `free` False where an unknown was stopped by its bound; `scores`, in
    `blocks_of_scatter`, are known of the optimum.
    """
    if blocks_of_scatter(segments) == 1:
        return None
    if scores is None:
        scores = block_scores(segments, misfit, scales, loss, q, BLOCKS[0])
    if scores is None:
        return None
    chosen, p = np.flatnonzero(free), segments.system.parameters.size
    ratios, chances = np.ones(len(free)), np.ones(len(free))
    try:
        inverse = np.linalg.inv(scores.information.sum(axis=0)[np.ix_(chosen, chosen)])
        white = noise * np.sqrt(np.maximum(inverse.diagonal(), np.finfo(float).tiny))
        for blocks in BLOCKS:
            merged = scores.merged(blocks)
            ratios[chosen] = np.maximum(ratios[chosen], merged.deviations(free)[chosen] / white)
            chances = np.fmin(chances, merged.chances(free, noise))
    except np.linalg.LinAlgError:
        return None
    tested = len(BLOCKS) * int(np.count_nonzero(free[:p]))
    return BlockScatter(ratios, min(1.0, tested * float(np.min(chances[:p], initial=1.0))))


def blocks_of_scatter(segments: Segments) -> int:
    """The blocks in which a linear model tells how far blocks scatter; 1 where there are too few segments."""
    return BLOCKS[0] if segments.count >= FEWEST * BLOCKS[0] else 1


def block_scores(
    segments: Segments,
    misfit: Misfit,
    scales: Scales,
    loss: Loss,
    q: float,
    blocks: int,
    candidates: CandidateForces | None = None,
) -> BlockScores | None:
    """Scores of `blocks` consecutive blocks of segments at the optimum `misfit`; None where its equations are singular.

    The amplitudes of `candidates` follow theta among the unknowns.
    """
    linear = linear_model(segments, misfit, scales, loss, candidates=candidates, blocks=blocks)
    of_blocks = block_information(linear, q)
    return None if of_blocks is None else BlockScores(*of_blocks)
