"""Terms of which the record does not rule out a size that would move coefficients of the weak form out of their intervals.

They are reported as those of maximum likelihood are. Friction and quadratic damping take trust away besides, where they could
move a coefficient far: nearly every joint has some of both, and under a steady excitation both pass for a linear damper.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from linkwise.estimates.causes import UnseenTerm
from linkwise.estimates.link_estimate import NORMAL_95
from linkwise.expression import differentiate, kinks, symbols
from linkwise.model.link import Link
from linkwise.model.structure import Structure
from linkwise.weak.efficient_scores import EfficientScores
from linkwise.weak.equations import WeakEquations
from linkwise.weak.fit import WeakFit
from linkwise.weak.link_forces import link_force

_DAMPING = ("v*abs(v)", "sign(v)")
_USUAL = ("d**3", "d**5", *_DAMPING)
_TOLD = 3.0, 0.01
"""Standard errors and part of a coefficient that a term would change it by at least, as of maximum likelihood."""
_TOO_FAR = 3.0 * NORMAL_95, 0.1
"""The same of damping that takes trust away: an interval three times as wide would not hold it, and it is beyond what is
expected of a damping coefficient, which hardly any test determines to 10 %."""


def unseen_terms(
    scores: EfficientScores, identified: Structure, equations: WeakEquations, fit: WeakFit
) -> tuple[UnseenTerm, ...]:
    """The usual terms that the record does not bound well enough, that which moves a coefficient farthest first.

    Parameters
    ----------
    scores : EfficientScores
        Tests of terms.
    identified : Structure
        The structure with the values of the fit.
    equations : WeakEquations
        Its equations on the record.
    fit : WeakFit
        Their solution.

    Returns
    -------
    tuple of UnseenTerm
        Of each term the coefficient that it would change most.
    """
    numbers = [number for number, term in enumerate(scores.terms) if term in _USUAL]
    terms = _beyond(numbers, _TOLD, scores, identified, equations, fit)
    return tuple(sorted(terms, key=lambda term: -term.standard_errors))


def undecided_damping(
    scores: EfficientScores, identified: Structure, equations: WeakEquations, fit: WeakFit
) -> UnseenTerm | None:
    """The damping that would change a coefficient so far that the answer cannot be trusted.

    Parameters
    ----------
    scores, identified, equations, fit
        As of `unseen_terms`.

    Returns
    -------
    UnseenTerm or None
        The term that would change one most; None without any, or where the law of the link is nonlinear in v as stated.
    """
    numbers = [
        number
        for number, (link, term) in enumerate(zip(scores.places, scores.terms, strict=True))
        if term in _DAMPING and not _is_nonlinear_in_rate(identified.link(link))
    ]
    terms = _beyond(numbers, _TOO_FAR, scores, identified, equations, fit)
    return max(terms, key=lambda term: term.standard_errors, default=None)


def _is_nonlinear_in_rate(link: Link) -> bool:
    """Whether the slope of the law changes with v, or the law is not smooth by v, as sign(v), of slope 0."""
    slope = differentiate(link.law.expression, "v")
    return any("v" in symbols(expression) for expression in (slope, *kinks(link.law.expression)))


def _beyond(
    numbers: list[int],
    least: tuple[float, float],
    scores: EfficientScores,
    identified: Structure,
    equations: WeakEquations,
    fit: WeakFit,
) -> Iterator[UnseenTerm]:
    """The terms of these numbers that would change a coefficient by more than `least` standard errors and parts of it."""
    deviations = np.sqrt(np.maximum(fit.covariance.diagonal(), np.finfo(float).tiny))
    with np.errstate(divide="ignore", invalid="ignore"):
        shifts, relative = np.abs(scores.changes.T) / deviations, np.abs(scores.changes.T / fit.values)
    beyond = fit.free & np.isfinite(shifts) & (shifts > least[0]) & (relative > least[1])
    for number in numbers:
        if not beyond[number].any():
            continue
        farthest = int(np.argmax(np.where(beyond[number], shifts[number], 0.0)))
        force = _force(identified, scores.places[number], equations)
        yield UnseenTerm(
            link=scores.places[number],
            term=scores.terms[number],
            share=float(scores.forces[number]) / force,
            coefficient=equations.parameters[farthest],
            change=float(scores.changes[farthest, number]),
            standard_errors=float(shifts[number, farthest]),
            relative_change=float(relative[number, farthest]),
        )


def _force(identified: Structure, name: str, equations: WeakEquations) -> float:
    """Root mean square in N of the force of a link along the motion."""
    number = [link.name for link in identified.links].index(name)
    force = link_force(identified, number, equations)
    known = force[np.isfinite(force)]
    return float(np.sqrt(known @ known / max(len(known), 1))) or float(np.finfo(float).tiny)
