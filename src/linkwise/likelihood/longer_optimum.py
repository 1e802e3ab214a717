"""An optimum in longer segments, for what follows a search: the same motion at a part of the cost."""

from __future__ import annotations

from dataclasses import replace

from linkwise.likelihood.fit import LikelihoodFit, Optimum
from linkwise.likelihood.shooting.anneal import AnnealingSchedule
from linkwise.likelihood.shooting.longer_segments import LongerSegments
from linkwise.likelihood.shooting.residuals import Misfit

_LINKS = 0.25  # of -2 log likelihood, of which a coefficient gains 1 by chance: what links cost at most, and gains change by


def in_longer_segments(fit: LikelihoodFit) -> tuple[Optimum, Misfit]:
    """The optimum of a fit and its misfit, in longer segments where the motion is exactly that of the laws.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit.

    Returns
    -------
    tuple of (Optimum, Misfit)
        Those in longer segments; the given ones where the links between segments, which they leave out, cost anything.
    """
    optimum, misfit = fit.optimum, fit.misfit
    exact = optimum.q <= AnnealingSchedule.final_q and optimum.coloured is None
    if not exact or not misfit.continuity / optimum.q**2 < _LINKS * optimum.noise**2:
        return optimum, misfit
    longer = LongerSegments.of(optimum.segments)
    if longer is None:
        return optimum, misfit
    return replace(optimum, segments=longer.segments, point=longer.point(optimum.point)), longer.misfit(
        misfit
    )
