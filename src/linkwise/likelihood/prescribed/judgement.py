"""The verdict on a fit of links on a rig."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from linkwise.estimates.causes import Cause
from linkwise.likelihood.prescribed.fit import RigFit
from linkwise.verdict import Verdict

_LARGEST_ERROR = 0.1
"""Of the forces: the largest model error that is trusted, as for structures with masses."""


def judged(fit: RigFit, causes: Sequence[Cause]) -> tuple[Verdict, str, float]:
    """The verdict with its explanation, and the part of the forces that the laws leave beside noise."""
    if not fit.minimum.converged:
        return (
            Verdict.NOT_CONVERGED,
            "The search did not converge. The values are the best so far; give better starts, or a law whose force does not "
            "jump.",
            0.0,
        )
    share = _share(fit)
    explained = "The laws explain the forces to within the noise of force and displacement"
    if share > 0.0:
        explained = f"The laws explain the forces to within {100.0 * share:.2g} %"
    if not fit.determined:
        return (
            Verdict.HARDLY_DETERMINED,
            f"{explained}, but the forces do not determine all unknowns, so no interval is given: hold some at known "
            "values, or record another motion.",
            share,
        )
    if share > _LARGEST_ERROR:
        return (
            Verdict.UNEXPLAINED_FORCES,
            f"{explained}; that is too much for intervals: a term or a state is missing.",
            share,
        )
    if causes and not causes[0].is_instrument:
        return (
            Verdict.SYSTEMATIC_MISFIT,
            f"{explained}, but {causes[0].description} is missing: with it a coefficient would differ by "
            f"{causes[0].shift:.2g} of its standard errors, so no interval is given. Offer the term, or a law with memory.",
            share,
        )
    if causes:
        return (
            Verdict.MEASUREMENT_ERROR,
            f"{explained}, but {causes[0].description} would lower -2 log likelihood by {causes[0].gain:.3g}. Coefficients "
            "would be wrong by more than their intervals say, so none is given: correct it, or estimate it with the other "
            "unknowns.",
            share,
        )
    if share > 0.0:
        return (
            Verdict.MODEL_ERROR_NEEDED,
            f"{explained}, a model error that all intervals include; as it follows the motion, sums over periods of the "
            "motion are compared for that.",
            share,
        )
    return Verdict.CONVERGED, f"{explained}.", 0.0


def _share(fit: RigFit) -> float:
    """Model error over the root mean square of the forces about their mean."""
    if fit.model_force == 0.0:
        return 0.0
    measured = np.concatenate([fit.problem.cell(number) for number in range(len(fit.problem.states))])
    return fit.model_force / float(np.nanstd(measured))
