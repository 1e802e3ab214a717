"""Scores of missing terms by the marginal likelihood, where random forces act: the part of the log determinant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.fit import Optimum
from linkwise.likelihood.random_forces import system_with
from linkwise.likelihood.score_test import CandidateForce
from linkwise.likelihood.shooting.normal_equations import linearise
from linkwise.likelihood.shooting.residuals import evaluate
from linkwise.model.law import Law
from linkwise.model.link import BASE, GROUND, Link
from linkwise.model.structure import Structure

_STEP = 0.5  # deviations of its size: for the difference of the log determinant


def determinant_slopes(
    optimum: Optimum,
    identified: Structure,
    masses: Sequence[str],
    candidates: Sequence[tuple[CandidateForce, float]],
) -> Floats:
    """What the log determinant of the equations of the states adds to the gradient J'r.

    Parameters
    ----------
    optimum : Optimum
        The optimum, with random forces.
    identified : Structure
        The structure with its values there.
    masses : sequence of str
        The masses that the random forces act on.
    candidates : sequence of (CandidateForce, float)
        The c candidate terms, and the standard deviations of their coefficients.

    Returns
    -------
    array of shape (c,)
        The addition for each candidate, by its coefficient.
    """
    # parts do not stand for the whole: log det with a term changes with the size of the motion
    whole = _without_unknowns(optimum)
    still = _log_determinant(whole, identified, masses)
    slopes = []
    for force, deviation in candidates:
        size = _STEP * deviation
        changed = _log_determinant(whole, _with_term(identified, force, size), masses)
        slopes.append(-0.5 * (changed - still) / size)
    return np.asarray(np.nan_to_num(np.array(slopes)))


def _without_unknowns(optimum: Optimum) -> Optimum:
    """The optimum with parameters that are numbers."""
    segments, p = optimum.segments, len(optimum.point.theta)
    assert segments.random is not None
    return replace(
        optimum,
        segments=replace(segments, prior=None, random=replace(segments.random, slope=None, origin=None)),
        point=replace(optimum.point, theta=np.zeros(0)),
        scales=replace(optimum.scales, theta=optimum.scales.theta[p:]),
    )


def _with_term(structure: Structure, force: CandidateForce, size: float) -> Structure:
    names = {**dict(enumerate(structure.mass_names)), -1: GROUND, -2: BASE}
    law = Law.parse(f"size*({force.law.text})")
    link_names, name = {link.name for link in structure.links}, "tested"
    while name in link_names:
        name += "_"
    ends = (names[force.first], names[force.second])
    link = Link(name, ends, law, {"size": size})
    return replace(structure, links=(*structure.links, link))


def _log_determinant(optimum: Optimum, structure: Structure, masses: Sequence[str]) -> float:
    sample = float(np.min(optimum.segments.step)) * optimum.segments.refine
    segments = replace(optimum.segments, system=system_with(structure, masses, sample))
    misfit = evaluate(segments, optimum.point, optimum.scales, optimum.loss)
    factor = linearise(segments, misfit, optimum.scales, optimum.loss).equations(optimum.q).factor()
    return float("nan") if factor is None else 2.0 * float(np.log(factor.chol[0]).sum())
