"""What terms that the laws lack make of the coefficients, where a model error stands for these terms.

The coefficients of a law that lacks a term make up for it, as far as they can, and do so alike in all parts of a record: no
scatter of blocks tells. Here terms are added to the linearised equations one at a time, always the one that explains most of
what those before it leave, while what it gains is significant. With values c_D of the terms D so found the coefficients move
by G c_D, and G c_D c_D' G' is added to their covariance: the second moment of the c_D about the zero that the laws as stated
give them, as for terms that a discovery dropped (Berk et al., Ann. Statist. 41, 2013).
"""

from __future__ import annotations

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.diagnosis import least_gain
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.hypotheses import missing_forces
from linkwise.likelihood.score_test import augmented_quadratic, candidate_forces
from linkwise.likelihood.shooting.residuals import evaluate
from linkwise.likelihood.single_tests import single_tests
from linkwise.model.structure import Structure
from linkwise.runtime import one_blas_thread

_SINGULAR = 1e-12
_MOST = 6  # terms; of more, each makes a small part of what the first ones do


@np.errstate(over="ignore", invalid="ignore")  # a candidate may be infinite somewhere; it is then not taken
def for_missing_terms(fit: LikelihoodFit, identified: Structure) -> Floats | None:
    """The covariance that missing terms of links, and missing links, add to that of the coefficients.

    Parameters
    ----------
    fit : LikelihoodFit
        A fit with a model error.
    identified : Structure
        The structure with the values of the fit.

    Returns
    -------
    array of shape (p, p) or None
        In SI units; None where no term explains what the laws leave.
    """
    optimum, p = fit.optimum, len(fit.values)
    hypotheses, forces = missing_forces(identified)
    limit = least_gain(len(hypotheses)) * optimum.noise**2
    try:
        with one_blas_thread():
            misfit = evaluate(optimum.segments, optimum.point, optimum.scales, optimum.loss)
            candidates, _ = candidate_forces(optimum, misfit, forces)
            quadratic = augmented_quadratic(optimum, misfit, candidates)
    except np.linalg.LinAlgError:
        return None
    scale = 1.0 / np.sqrt(np.maximum(quadratic.curvature.diagonal(), np.finfo(float).tiny))
    curvature, slope = quadratic.curvature * np.outer(scale, scale), quadratic.slope * scale
    order, added = np.arange(len(slope)), 0
    while added < min(_MOST, len(forces)):
        among = np.ix_(order, order)
        tests = single_tests(curvature[among], slope[order], curvature[among], p + added)
        best = int(np.argmax(np.where(np.isfinite(tests.gains), tests.gains, 0.0)))
        if not tests.gains[best] > limit:
            break
        position = p + added
        order[[position, position + best]] = order[[position + best, position]]
        added += 1
    if not added:
        return None
    own, terms = order[:p], order[p : p + added]
    both = order[: p + added]
    values = np.linalg.lstsq(curvature[np.ix_(both, both)], slope[both], rcond=_SINGULAR)[0][p:]
    beside = curvature[np.ix_(own, own)], curvature[np.ix_(own, terms)]
    moved = np.linalg.lstsq(*beside, rcond=_SINGULAR)[0] @ values
    moved = np.where(fit.free, moved * scale[:p] * optimum.scales.theta[:p], 0.0)
    return np.outer(moved, moved)
