"""Terms that exact laws may lack without a sign in the records, though they would move coefficients out of their intervals.

The score test of a term bounds its size. A term that resembles those of the law moves their coefficients by many standard
errors before its own score is significant, so that intervals hold for the law as stated only. No interval of reasonable width
could hold what no test of the records sees; it is reported instead.
"""

from __future__ import annotations

import numpy as np

from linkwise.arrays import Floats
from linkwise.estimates.link_estimate import NORMAL_95
from linkwise.estimates.unseen_term import UnseenTerm
from linkwise.likelihood.damping_errors import largest_damping
from linkwise.likelihood.diagnosis import TestedCauses, link_forces
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.held_errors import LARGEST_SHIFT
from linkwise.likelihood.hypotheses import BETWEEN_MODES, which_between_modes, which_usual
from linkwise.model.structure import Structure

_NEGLIGIBLE = 0.01
"""Of a coefficient: what the calibration of sensors leaves open anyway, and intervals do not hold unless it is stated. The
gain of an accelerometer is known to 1 % as a rule."""


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # a candidate that is infinite is not taken
def unseen_terms(
    fit: LikelihoodFit, identified: Structure, tested: TestedCauses, covariance: Floats
) -> tuple[UnseenTerm, ...]:
    """The usual terms, and damping between modes, that the records do not bound well enough, the farthest move first.

    Parameters
    ----------
    fit : LikelihoodFit
        A fit that leaves only noise, without a significant cause.
    identified : Structure
        The structure with the values of the fit.
    tested : TestedCauses
        What was tested at the fit, usual terms among it.
    covariance : array of shape (p, p)
        That of the coefficients as it is reported.

    Returns
    -------
    tuple of UnseenTerm
        Those which, as large as the records let them be, would change a coefficient by more than an interval can hold, and
        by more than is negligible; of each term the coefficient that it would change most.
    """
    optimum, p, tests = fit.optimum, len(fit.values), tested.tests
    deviations = np.sqrt(np.maximum(covariance.diagonal(), 0.0))
    forces = dict(
        zip((link.name for link in identified.links), link_forces(optimum, fit.misfit), strict=False)
    )
    terms = []
    largest = largest_damping(identified)
    usual = which_usual(tested.hypotheses, identified)
    for number in usual + which_between_modes(tested.hypotheses):
        hypothesis, size = tested.hypotheses[number], float(tests.sizes[number])
        limit = abs(size) + NORMAL_95 * optimum.noise * float(tests.deviations[number])
        whole = forces.get(hypothesis.where, 0.0)
        if hypothesis.kind == BETWEEN_MODES:
            whole = largest[hypothesis.where] / float(tested.units[number])
            limit = min(limit, whole)
        change = tests.changes[:, number] * optimum.scales.theta[:p] * np.divide(limit, abs(size))
        shifts, relative = np.abs(change) / deviations, np.abs(change / fit.values)
        beyond = fit.free & np.isfinite(shifts) & (shifts > LARGEST_SHIFT) & (relative > _NEGLIGIBLE)
        if not (beyond.any() and tests.gains[number] > 0.0 and whole > 0.0):
            continue
        farthest = int(np.argmax(np.where(beyond, shifts, 0.0)))
        terms.append(
            UnseenTerm(
                link=hypothesis.where,
                term=hypothesis.term or "v",
                share=limit / whole,
                coefficient=fit.segments.system.parameters.names[farthest],
                change=float(change[farthest]),
                standard_errors=float(shifts[farthest]),
                relative_change=float(relative[farthest]),
            )
        )
    return tuple(sorted(terms, key=lambda term: -term.standard_errors))
