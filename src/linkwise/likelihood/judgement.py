"""What may be said of a maximum-likelihood fit: whether it converged, and whether what it leaves is noise."""

from __future__ import annotations

import numpy as np

from linkwise.likelihood.anneal import AnnealingStatus
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.local_optima import is_regular
from linkwise.likelihood.missing_forces import MissingForce, missing_force
from linkwise.likelihood.whiteness import is_coloured
from linkwise.model.structure import Structure
from linkwise.verdict import Verdict

_LITTLE = 0.1  # of the forces on a mass: a model error beyond it is no small one
_CHANCE = 3.0  # standard deviations of chi-square within which what is left needs no second look


def judged(fit: LikelihoodFit, identified: Structure) -> tuple[Verdict, str]:
    """The verdict on a fit, and in words what it means for this one."""
    if fit.status is not AnnealingStatus.CONVERGED:
        reason = f"{fit.status.value.capitalize()}. The values are the best so far; give better starts, or a longer record."
        return Verdict.NOT_CONVERGED, reason
    if fit.chi_square_off:
        return Verdict.NOISE_MISMATCH, (
            f"The residuals are {np.sqrt(fit.chi_square):.3g} times the noise, so no interval is given: the noise is not what "
            "was stated or found, a term is missing from a law, or a link from the structure. The values are the best of "
            "these laws."
        )
    explained, share = "The laws explain the record to within its noise", 0.0
    if fit.model_error > 0.0:
        share = _share(fit, identified)
        explained = f"The structure explains the record to within {100.0 * share:.2g} % of its forces"
        if share > _LITTLE:
            reason = f"{explained}; that is too much for intervals: a term or a link is missing."
            return Verdict.UNEXPLAINED_FORCES, reason
    if fit.model_error > 0.0 or fit.chi_square > 1.0 + _CHANCE * np.sqrt(2.0 / fit.samples):
        missing = missing_force(fit.optimum, identified)
        if missing is not None:
            return Verdict.SYSTEMATIC_MISFIT, f"{explained}, but {_systematic(missing)}"
    if is_coloured(fit.misfit.residuals):
        return Verdict.COLOURED_RESIDUALS, (
            f"{explained}, but the residuals are not white, as the noise is taken to be: intervals would be too narrow, so "
            "none is given. A filter or a drift of a sensor, or a term that is missing, leaves such residuals."
        )
    if not is_regular(fit):
        return Verdict.SEVERAL_OPTIMA, (
            f"{explained}, but around the values found the likelihood has other optima or none of the shape that intervals "
            "assume, so no interval is given. Give starts that are nearer, a shorter piece of the record, or less noise."
        )
    if share > 0.0:
        return Verdict.MODEL_ERROR_NEEDED, f"{explained}, a model error that all intervals count in."
    return Verdict.CONVERGED, f"{explained}."


def _systematic(missing: MissingForce) -> str:
    return (
        f"what they leave follows the motion: a force like {missing.term} in {missing.link} would lower -2 log likelihood by "
        f"{missing.gain:.3g}. Intervals would count that as noise, so none is given; a term or a link is missing, or a sensor "
        "is not what it is taken for."
    )


def _share(fit: LikelihoodFit, identified: Structure) -> float:
    """Root mean square of the model's force error over that of the forces, the worst mass counting."""
    n = identified.size
    acceleration = fit.misfit.trajectories.accelerations.reshape(-1, n, fit.segments.count)
    forces = identified.mass_values * np.sqrt(np.mean(acceleration**2, axis=(0, 2)))
    return float(np.max(fit.force_error / np.maximum(forces, np.finfo(float).tiny)))
