"""An optimum in longer segments, for what follows a search: the same motion at a part of the cost."""

from __future__ import annotations

from dataclasses import replace

from linkwise.likelihood.fit import LikelihoodFit, Optimum
from linkwise.likelihood.shooting.anneal import AnnealingSchedule
from linkwise.likelihood.shooting.longer_segments import LongerSegments
from linkwise.likelihood.shooting.residuals import Misfit, evaluate

_SAME = 1e-7  # of the cost, and the tolerance of a search: by how much the misfit to the samples may differ


def in_longer_segments(fit: LikelihoodFit) -> tuple[Optimum, Misfit]:
    """The optimum of a fit and its misfit, in longer segments where the motion is exactly that of the laws.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit.

    Returns
    -------
    tuple of (Optimum, Misfit)
        Those in longer segments, or, where these do not leave the same residuals, in the given ones.
    """
    optimum, misfit = fit.optimum, fit.misfit
    exact = optimum.q <= AnnealingSchedule.final_q and optimum.coloured is None
    longer = LongerSegments.of(optimum.segments) if exact else None
    if longer is None:
        return optimum, misfit
    inside = replace(optimum, segments=longer.segments, point=longer.point(optimum.point))
    of_longer = evaluate(inside.segments, inside.point, inside.scales, inside.loss)
    if not abs(of_longer.data - misfit.data) < AnnealingSchedule.tolerance + _SAME * misfit.data:
        return optimum, misfit
    return inside, of_longer
