"""What the laws leave of the forces, tested against the motion of every link: a score test for terms that a law lacks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from linkwise.likelihood.fit import Optimum
from linkwise.likelihood.score_test import CandidateForce, LocalQuadratic, local_quadratic
from linkwise.model.law import Law
from linkwise.model.structure import Structure

_TERMS = tuple(
    map(Law.parse, ("1", "d", "d**2", "d**3", "d**5", "v", "v*abs(v)", "v**3", "sign(v)", "v*d**2"))
)
_COLLINEAR = 1e-6  # of its own curvature: what is left of a term beside the coefficients of the laws
_LINKS = 40  # that are tested, in the structure's order
_CHANCE = 25.0  # square of the standard errors that one term reaches by chance once in 1.7 million


@dataclass(frozen=True)
class MissingForce:
    """A force of the form `term` in `link` that would lower -2 log likelihood by `gain`."""

    link: str
    term: str
    gain: float


def missing_force(optimum: Optimum, structure: Structure) -> MissingForce | None:
    """The term of a link that explains most of what the laws leave; None where none does beyond chance."""
    candidates = [
        (link.name, term, CandidateForce(first, second, term))
        for link, (first, second) in zip(
            structure.links[:_LINKS], structure.topology.ends.tolist(), strict=False
        )
        for term in _TERMS
    ]
    try:
        quadratic = local_quadratic(optimum, [force for _, _, force in candidates])
    except np.linalg.LinAlgError:
        return None
    gains = _gains(quadratic, optimum.segments.system.parameters.size)
    best = int(np.argmax(gains))
    if gains[best] < _CHANCE + 2.0 * np.log(len(gains)):
        return None
    name, term, _ = candidates[best]
    return MissingForce(name, term.text, float(gains[best]))


def _gains(quadratic: LocalQuadratic, parameters: int) -> np.ndarray:
    """By how much each force alone would lower the cost, the coefficients of the laws fitted anew."""
    scale = np.sqrt(np.maximum(quadratic.curvature.diagonal(), np.finfo(float).tiny))
    curvature, slope = quadratic.curvature / np.outer(scale, scale), quadratic.slope / scale
    own, beside = slice(0, parameters), slice(parameters, None)
    found = np.linalg.lstsq(
        curvature[own, own], np.column_stack([curvature[own, beside], slope[own]]), rcond=1e-12
    )[0]
    left = curvature[beside, beside].diagonal() - np.einsum("ij,ij->j", curvature[own, beside], found[:, :-1])
    score = slope[beside] - curvature[beside, own] @ found[:, -1]
    tested = left > _COLLINEAR
    return np.where(tested, score**2 / np.where(tested, left, 1.0), 0.0)
