"""Terms that exact laws may lack without a sign in the records, though they would move coefficients out of their intervals.

Stated masses may be off likewise.

The score test of a term bounds its size. A term that resembles those of the law moves their coefficients by many standard
errors before its own score is significant, so that intervals hold for the law as stated only. No interval of reasonable width
could hold what no test of the records sees; it is reported instead.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from linkwise.arrays import Floats
from linkwise.estimates.causes import UnseenTerm
from linkwise.estimates.link_estimate import NORMAL_95
from linkwise.likelihood.damping_errors import largest_damping
from linkwise.likelihood.diagnosis import link_forces
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.held_errors import LARGEST_SHIFT
from linkwise.likelihood.hypotheses import BETWEEN_MODES, which_between_modes, which_usual
from linkwise.likelihood.stated_masses import LARGEST, beyond_white, which_stated
from linkwise.likelihood.tested_causes import TestedCauses
from linkwise.model.names import MASS
from linkwise.model.structure import Structure

_NEGLIGIBLE = 0.01
"""Of a coefficient: what the calibration of sensors leaves open anyway, and intervals do not hold unless it is stated. The
gain of an accelerometer is known to 1 % as a rule."""


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # a candidate that is infinite is not taken
def unseen_terms(
    fit: LikelihoodFit, identified: Structure, tested: TestedCauses | None, covariance: Floats, *, terms: bool
) -> tuple[UnseenTerm, ...]:
    """The usual terms, damping between modes and stated masses that the records do not bound well, the farthest move first.

    Parameters
    ----------
    fit : LikelihoodFit
        A fit that is trusted.
    identified : Structure
        The structure with the values of the fit.
    tested : TestedCauses or None
        What was tested at the fit, usual terms among it; None where nothing was.
    covariance : array of shape (p, p)
        That of the coefficients as it is reported.
    terms : bool
        Whether terms are looked for as well as masses: where the fit leaves only noise, without a significant cause.

    Returns
    -------
    tuple of UnseenTerm
        Those which, as large as the records let them be, would change a coefficient by more than an interval can hold, and
        by more than is negligible; of each term the coefficient that it would change most.
    """
    if tested is None:
        return ()
    optimum, p, tests = fit.optimum, len(fit.values), tested.tests
    deviations = np.sqrt(np.maximum(covariance.diagonal(), 0.0))
    beyond_noise = NORMAL_95 * optimum.noise * beyond_white(fit)
    numbers = which_stated(tested.hypotheses, fit.segments.system.parameters.names)
    if terms:
        usual = which_usual(tested.hypotheses, identified)
        numbers = usual + which_between_modes(tested.hypotheses) + numbers
    wholes = _wholes(fit, identified, tested, numbers)
    unseen = []
    for number, (whole, largest) in zip(numbers, wholes, strict=True):
        hypothesis, size = tested.hypotheses[number], float(tests.sizes[number])
        limit = min(abs(size) + beyond_noise * float(tests.deviations[number]), largest * whole)
        change = tests.changes[:, number] * optimum.scales.theta[:p] * np.divide(limit, abs(size))
        shifts, relative = np.abs(change) / deviations, np.abs(change / fit.values)
        beyond = fit.free & np.isfinite(shifts) & (shifts > LARGEST_SHIFT) & (relative > _NEGLIGIBLE)
        if not (beyond.any() and tests.gains[number] > 0.0 and whole > 0.0):
            continue
        farthest = int(np.argmax(np.where(beyond, shifts, 0.0)))
        unseen.append(
            UnseenTerm(
                link=hypothesis.where,
                term=MASS if hypothesis.kind == MASS else hypothesis.term or "v",
                share=float(limit / whole),
                coefficient=fit.segments.system.parameters.names[farthest],
                change=float(change[farthest]),
                standard_errors=float(shifts[farthest]),
                relative_change=float(relative[farthest]),
            )
        )
    return tuple(sorted(unseen, key=lambda term: -term.standard_errors))


def _wholes(
    fit: LikelihoodFit, identified: Structure, tested: TestedCauses, numbers: Sequence[int]
) -> Iterator[tuple[float, float]]:
    """Of each hypothesis of these numbers what its share is taken of, in its scale, and the largest share that is possible."""
    forces = dict(
        zip((link.name for link in identified.links), link_forces(fit.optimum, fit.misfit), strict=False)
    )
    damping = largest_damping(identified)
    for number in numbers:
        hypothesis, unit = tested.hypotheses[number], float(tested.units[number])
        if hypothesis.kind == BETWEEN_MODES:
            yield damping[hypothesis.where] / unit, 1.0
        elif hypothesis.kind == MASS:
            yield 1.0 / unit, LARGEST
        else:
            yield forces.get(hypothesis.where, 0.0), np.inf
