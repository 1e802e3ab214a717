"""An optimum in longer segments, for what follows a search: the same motion at a part of the cost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from linkwise.likelihood.block_scores import BLOCKS, EQUAL, FEWEST
from linkwise.likelihood.fit import LikelihoodFit, Optimum
from linkwise.likelihood.shooting.anneal import AnnealingSchedule
from linkwise.likelihood.shooting.halved_samples import halved
from linkwise.likelihood.shooting.longer_segments import LongerSegments
from linkwise.likelihood.shooting.loss import Gaussian
from linkwise.likelihood.shooting.neighbourhoods import MANY
from linkwise.likelihood.shooting.normal_equations import block_ends
from linkwise.likelihood.shooting.residuals import Misfit
from linkwise.likelihood.shooting.segments import Segments
from linkwise.likelihood.shooting.sensor_errors import SensorErrors

_LINKS = 0.25  # of -2 log likelihood, of which a coefficient gains 1 by chance: what links cost at most, and gains change by
_AMONG = 40  # masses that share this cost: of more of them it grows with their number, and of each it remains as small
_LONGEST = (8, 7, 6, 5, 4)  # short segments in one of the longest, the first that leaves blocks as they are
_LONGEST_OF_MANY = (4,)  # in longer ones an influence reaches too far
_SHIFTED = 1 / 30  # of a block, by which its ends are shifted at most


def in_longer_segments(fit: LikelihoodFit, *, longest: bool = False) -> tuple[Optimum, Misfit]:
    """The optimum of a fit and its misfit, in longer segments where the motion is exactly that of the laws.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit.
    longest : bool, optional
        Whether they may be longer still, so that sensitivities of few masses may grow a thousandfold in one.

    Returns
    -------
    tuple of (Optimum, Misfit)
        Those in longer segments; the given ones where the links inside these, which they leave out, cost anything.
    """
    optimum, misfit = fit.optimum, fit.misfit
    exact = optimum.q <= AnnealingSchedule.final_q and optimum.coloured is None
    most = _LINKS * max(1.0, len(optimum.segments.system.incidence) / _AMONG)
    tried = (_most_joined(optimum.segments), None) if longest else (None,)
    for joined in dict.fromkeys(tried if exact else ()):
        longer = LongerSegments.of(optimum.segments, joined)
        if longer is None:
            break
        of_longer = longer.misfit(misfit)
        left_out = (misfit.continuity - of_longer.continuity) / optimum.q**2
        if left_out < most * optimum.noise**2:
            return replace(optimum, segments=longer.segments, point=longer.point(optimum.point)), of_longer
    return optimum, misfit


def in_half_the_samples(
    optimum: Optimum, misfit: Misfit, filtered: SensorErrors
) -> tuple[Optimum, Misfit, SensorErrors]:
    """An optimum whose motion is continuous with every second sample, where what is tested is smooth; otherwise the given one.

    `filtered` is the roughest of the errors that sensors may have.
    """
    half = halved(optimum.segments, misfit, optimum.scales, optimum.loss, filtered.values)
    if half is None:
        return optimum, misfit, filtered
    every_second = replace(filtered, values=filtered.values[::2])
    return replace(optimum, segments=half[0], loss=Gaussian()), half[1], every_second


def blocks_in(longer: Segments, shorter: Segments) -> int:
    """The number of blocks in which longer segments scatter as the shorter ones do; 1 where they have no such blocks.

    Their ends are the same, or there are so many segments in each that one more or less hardly matters.
    """
    joined = len(longer.samples) // len(shorter.samples)
    many = longer.count >= EQUAL * BLOCKS[0]
    return BLOCKS[0] if many or _same_blocks(shorter.count, joined) else 1


def _most_joined(segments: Segments) -> int | None:
    """How many short segments are joined at most, so that blocks, where there are any, stay the same; None for as usual."""
    most = _LONGEST if len(segments.system.incidence) < MANY else _LONGEST_OF_MANY
    for joined in most:
        if _same_blocks(segments.count, joined):
            return joined
    if segments.count > most[-1] * (EQUAL * BLOCKS[0] - 1):
        return most[-1]
    return most[0] if len(segments.system.incidence) < MANY else None


def _same_blocks(count: int, joined: int) -> bool:
    """Whether blocks of so many segments `joined` to one end where those of `count` short ones do."""
    blocks, longer = BLOCKS[0], -(-count // joined)
    if longer < FEWEST * blocks:
        return False
    before, after = (np.array(block_ends(size, blocks))[:-1] for size in (count, longer))
    return bool(np.max(np.abs(joined * after - before)) <= _SHIFTED * count / blocks)
