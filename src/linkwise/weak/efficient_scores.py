"""Score tests of terms at the likeliest motion, where residuals have the weight that their covariance gives them.

The tests of `score_tests` weight every window alike. Where inertia and stiffness nearly cancel, as under a sine near a
resonance, most of what they sum is noise at frequencies that the motion does not contain: friction that moves a damping by
30 of its standard errors stays unseen. These tests lose nothing (Rao 1948), and bound the size of each term as closely as the
record does. They cost a few times as much and are made last, of structures of few masses.

Terms of which the record does not rule out a size that would move coefficients of the weak form out of their intervals.

They are reported as those of maximum likelihood are. Friction and quadratic damping take trust away besides, where they could
move a coefficient far: nearly every joint has some of both, and under a steady excitation both pass for a linear damper.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.errors import IdentificationError
from linkwise.estimates.causes import UnseenTerm
from linkwise.estimates.link_estimate import NORMAL_95
from linkwise.expression import differentiate, kinks, symbols
from linkwise.model.coefficient import Coefficient
from linkwise.model.link import Link
from linkwise.model.names import MASS
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.weak.equations import WeakEquations
from linkwise.weak.fit import WeakFit, residual_power
from linkwise.weak.likely_motion import LikelyMotion, columns_of, likely_motion, link_force
from linkwise.weak.tested_terms import SignificantScore, with_terms
from linkwise.weak.weak_form import PHI

TERMS = ("1", "d", "d**3", "d**5", "v", "v*abs(v)", "sign(v)")
ACCELERATION = "acceleration"
_LARGEST = 6  # masses of a structure that is tested: the cost grows with the third power of their number
_FEWEST = 50  # windows, of which scores are about normal
_COLLINEAR = 1e-6  # of its own moment: what is left of a term beside those of the laws
_CHANCE = 8.0  # with twice the logarithm of the number of scores: normal scores give one in 300 fits


@dataclass(frozen=True, eq=False)
class EfficientScores:
    """Tests of t terms, one at a time, with the p coefficients of the weak form fitted anew to first order.

    Attributes
    ----------
    places, terms : tuple of str
        The link of each, and its form; the mass that is stated, and "acceleration", for an error of that.
    scores : array of shape (t,)
        In standard errors, as the record alone shows them: a prior that is wrong is not told as a term.
    limits : array of shape (t,)
        What the size of each does not exceed: the end of its 95 % interval, with priors, that is farther from zero.
    changes : array of shape (p, t)
        What a term of the size of its limit makes of the coefficients of the weak form, joined with their priors.
    forces : array of shape (t,)
        Root mean square in N of a term of the size of its limit.
    """

    places: tuple[str, ...]
    terms: tuple[str, ...]
    scores: Floats
    limits: Floats
    changes: Floats
    forces: Floats

    def significant(self) -> SignificantScore | None:
        """The term with the largest score; None where chance explains it."""
        if not len(self.scores):
            return None
        largest = int(np.argmax(np.abs(self.scores)))
        score = float(self.scores[largest])
        if score**2 <= _CHANCE + 2.0 * float(np.log(len(self.scores))):
            return None
        place, term = self.places[largest], self.terms[largest]
        return SignificantScore(place, term, place if term == ACCELERATION else "", score)


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # a term may not be finite along the motion
def efficient_scores(
    record: Record, structure: Structure, equations: WeakEquations, fit: WeakFit
) -> EfficientScores | None:
    """Test the terms that links lack most often, and the masses that are stated.

    Parameters
    ----------
    record : Record
        The record.
    structure : Structure
        The structure with its unknowns.
    equations : WeakEquations
        Its equations on the record.
    fit : WeakFit
        Their solution.

    Returns
    -------
    EfficientScores or None
        None where the likeliest motion was not reached, the record is short or has no noise, or the structure has too many
        masses, hosts or links with states.
    """
    if (
        structure.size > _LARGEST
        or not equations.structure_layout.between_masses
        or equations.motion.noise_free
    ):
        return None
    wide, prefix = _with_tested(structure)
    known = dict(zip(equations.parameters, map(float, fit.values), strict=True))
    stated = {
        f"{mass.name}.{MASS}": float(mass.mass.value or 0.0) for mass in structure.masses if mass.mass.known
    }
    free = [name for name, is_free in zip(equations.parameters, fit.free, strict=True) if is_free]
    try:
        likely = likely_motion(record, wide, equations, known | stated, free)
    except (IdentificationError, np.linalg.LinAlgError, ValueError):
        return None
    if likely is None or likely.system.windows < _FEWEST:
        return None
    return _scores(likely, equations, fit, free, prefix)


@lru_cache(maxsize=32)
def _with_tested(structure: Structure) -> tuple[Structure, str]:
    """The structure with terms and masses as unknowns, and what the names of the coefficients of the terms begin with."""
    wide, prefix = with_terms(structure, TERMS)
    masses = tuple(
        replace(mass, mass=Coefficient.unknown()) if mass.mass.known else mass for mass in wide.masses
    )
    return replace(wide, masses=masses), prefix


def _scores(
    likely: LikelyMotion, equations: WeakEquations, fit: WeakFit, free: list[str], prefix: str
) -> EfficientScores:
    names = likely.system.parameters
    place = {name: number for number, name in enumerate(names)}
    own = np.array([place[name] for name in free], dtype=int)
    added = np.array([n for n, name in enumerate(names) if name not in equations.parameters], dtype=int)
    normal, slope, plain = _sums(likely, np.concatenate([own, added]), _weights(equations, fit))
    p = len(own)
    beside, left = _beside(normal, p)
    tested = left > _COLLINEAR
    scale = np.sqrt(np.where(tested, left, 1.0) * normal.diagonal()[p:])
    deviation = np.sqrt(max(likely.chi_square, 1.0))
    scores = np.where(tested, -(slope[p:] - slope[:p] @ beside) / (scale * deviation), 0.0)
    limits = np.where(tested, _limits(normal, slope, likely.priors[:, own], deviation), 0.0)
    changes = np.zeros((len(fit.values), len(added)))
    changes[fit.free] = _beside(plain, p)[0] * limits
    if fit.response is not None:
        changes = fit.response @ changes
    return EfficientScores(
        places=tuple(names[number].owner for number in added),
        terms=tuple(_term(names[number].key, prefix) for number in added),
        scores=scores,
        limits=limits,
        changes=changes,
        forces=limits * _sizes(likely, added),
    )


def _term(coefficient: str, prefix: str) -> str:
    """The term of a coefficient; that of a mass is its acceleration."""
    return TERMS[int(coefficient[len(prefix) :])] if coefficient.startswith(prefix) else ACCELERATION


def _weights(equations: WeakEquations, fit: WeakFit) -> Mapping[int, float]:
    """The weight of each mass in the weak form."""
    return {
        mass: weight
        for patch in equations.patches
        for mass, weight in zip(
            patch.masses.tolist(), (1.0 / residual_power(patch, fit.values)).tolist(), strict=True
        )
    }


def _sums(
    likely: LikelyMotion, numbers: Indices, weights: Mapping[int, float]
) -> tuple[Floats, Floats, Floats]:
    """Products (k, k) and slopes (k,) of some parameters by the covariance, and products as the weak form weights them."""
    normal, plain = np.zeros((2, len(numbers), len(numbers)))
    slope = np.zeros(len(numbers))
    for patch, noise, residual in zip(likely.system.patches, likely.noises, likely.residuals, strict=True):
        columns = columns_of(patch, numbers)
        columns = np.where(np.isfinite(columns).all(axis=(1, 2), keepdims=True), columns, 0.0)
        flat = columns.reshape(len(columns), -1)
        whitened = noise.whitened(columns)
        normal += whitened @ whitened.T
        slope += flat @ residual.ravel()
        by_mass = np.array([weights[mass] for mass in patch.masses.tolist()])
        plain += flat @ (columns * by_mass).reshape(flat.shape).T
    return normal, slope, plain


def _limits(normal: Floats, slope: Floats, priors: Floats, deviation: float) -> Floats:
    """(t,) what terms do not exceed, with `priors` (2, p) of the coefficients beside which they stand."""
    information, pull = priors
    p = len(pull)
    joined = normal.copy()
    joined[range(p), range(p)] += information
    beside, left = _beside(joined, p)
    scale = np.sqrt(np.maximum(left, _COLLINEAR) * normal.diagonal()[p:])
    scores = -(slope[p:] - (slope[:p] + pull) @ beside) / (scale * deviation)
    return np.asarray((np.abs(scores) + NORMAL_95) * deviation / scale)


def _beside(normal: Floats, own: int) -> tuple[Floats, Floats]:
    """What each further column makes of the `own` first ones (p, t), and the part (t,) of its moment that they leave."""
    scale = np.sqrt(np.maximum(normal.diagonal(), np.finfo(float).tiny))
    scaled = normal / np.outer(scale, scale)
    beside = np.linalg.lstsq(scaled[:own, :own], scaled[:own, own:], rcond=1e-12)[0]
    left = 1.0 - np.einsum("ij,ij->j", beside, scaled[:own, own:])
    return beside * scale[own:] / scale[:own, None], np.where(normal.diagonal()[own:] > 0.0, left, 0.0)


def _sizes(likely: LikelyMotion, numbers: Indices) -> Floats:
    """(t,) root mean squares of terms of size 1."""
    area, largest = np.abs(likely.system.window.kernels[PHI]).sum(), np.zeros(len(numbers))
    for patch in likely.system.patches:
        columns = columns_of(patch, numbers)
        power = np.sum(columns**2, axis=1) / max(patch.windows, 1.0)
        largest = np.fmax(largest, np.sqrt(power.max(axis=1)) / area)
    return largest


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
