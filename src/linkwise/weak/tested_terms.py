"""A score test of weak equations: terms that links lack most often, each of size zero, one at a time.

The score of a term is the sum over windows of the term times what the laws leave, without the bias due to noise and beside the
coefficients of the laws (Rao 1948); its variance is that of the normal equations due to noise (`scatter`). The equations of
each patch of masses are tested alone, so that the cost grows with the structure and not with its square.

References
----------
C. R. Rao, Math. Proc. Cambridge Philos. Soc. 44, 50 (1948), for the score test.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from linkwise.arrays import Bools, Floats, Indices
from linkwise.errors import IdentificationError
from linkwise.expression import to_text
from linkwise.model.coefficient import Coefficient
from linkwise.model.law import Law
from linkwise.model.link import Link
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.weak.equations import WeakEquations, weak_equations
from linkwise.weak.fit import (
    SIGNIFICANT,
    WeakFit,
    dense_blocks,
    normal_blocks,
    residual_power,
    significance,
)
from linkwise.weak.patch import Patch
from linkwise.weak.scatter import NoisyPatch, score_blocks

_TERMS = ("d**2", "d**3", "v*abs(v)", "sign(v)")
_COLLINEAR = 1e-6  # of its own moment: what is left of a term beside those of the laws
_CANCELLED = 0.1  # of what white noise would give: a smaller variance is the difference of large ones that are not exact
_NOISE_POWER = 0.03  # relative error of the power of noise that is found; of stated noise, what its residuals say is added
_CHANCE = 8.0  # with twice the logarithm of the number of scores: normal scores give one in 300 fits


@dataclass(frozen=True)
class MissingTerm:
    """A `term` whose score `z`, in standard errors, is beyond chance in a `link`."""

    link: str
    term: str
    z: float


def missing_term(
    record: Record, structure: Structure, equations: WeakEquations, fit: WeakFit
) -> MissingTerm | None:
    """The most significant term that a link lacks; None where chance explains all scores."""
    wide, added = _with_terms(structure)
    known = equations.by_name(fit.values)
    uncertain = _NOISE_POWER + (abs(fit.excess - 1.0) if record.noise else 0.0)
    try:
        system = weak_equations(record, wide, equations.motion, window=equations.window, values=known)
        values = np.array([known.get(name, 0.0) for name in system.parameters])
        tested = np.array([name not in known for name in system.parameters])
        scores = np.zeros(len(values))
        for patch in system.patches:
            numbers, z = _scores(patch, system, values, tested, max(fit.excess, 1.0), uncertain)
            scores[numbers] = np.where(np.abs(z) > np.abs(scores[numbers]), z, scores[numbers])
    except (IdentificationError, np.linalg.LinAlgError):  # a term may not be finite along the motion
        return None
    largest = int(np.argmax(np.abs(scores)))
    if not scores[largest] ** 2 > _CHANCE + 2.0 * float(np.log(max(np.sum(tested), 1))):
        return None
    name = wide.parameters[largest].name
    return MissingTerm(name.owner, added[name.key], float(scores[largest]))


def _scores(
    patch: Patch, system: WeakEquations, values: Floats, tested: Bools, excess: float, uncertain: float
) -> tuple[Indices, Floats]:
    """Numbers (s,) of the tested terms of a patch, and their scores: 0 for those that the laws have or noise hides."""
    numbers = np.unique(patch.layout.free_parameters)
    numbers = numbers[np.argsort(tested[numbers], kind="stable")]
    p, weights = int(np.count_nonzero(~tested[numbers])), [1.0 / residual_power(patch, values)]

    def sums(bias: float) -> tuple[Floats, Floats]:
        blocks, right = normal_blocks([patch], weights, len(values), bias=bias)
        moments = dense_blocks(blocks, numbers)
        return moments, right[numbers] - moments @ values[numbers]

    (moments, slope), (biased, biased_slope) = sums(0.0), sums(1.0)
    scatter = dense_blocks(score_blocks([NoisyPatch.of(patch, system, values)], weights), numbers)
    scale = 1.0 / np.sqrt(np.maximum(biased.diagonal(), np.finfo(float).tiny))
    moments, biased, scatter = (matrix * np.outer(scale, scale) for matrix in (moments, biased, scatter))
    beside = np.linalg.lstsq(moments[:p, :p], moments[:p, p:], rcond=_COLLINEAR**2)[0]
    across = np.concatenate([-beside, np.eye(len(numbers) - p)])
    matrices = (moments, biased - moments, scatter)
    left, bias, variance = (np.einsum("ij,ij->j", across, matrix @ across) for matrix in matrices)
    own, noise = moments.diagonal()[p:], scatter.diagonal()[p:]
    stands = (left > _COLLINEAR) & (own > 0.0) & (noise > 0.0)
    white = np.where(stands, left * noise, 0.0) / np.where(stands, own, 1.0)
    stands &= (variance > _CANCELLED * white) & (significance(left, bias, system.windows) > SIGNIFICANT)
    added = uncertain * (across.T @ (scale * (biased_slope - slope)))
    variance = excess * np.maximum(variance, white) + added**2
    scores = np.where(stands, across.T @ (scale * slope), 0.0)
    return numbers[p:], scores / np.sqrt(np.where(stands, variance, 1.0))


@lru_cache(maxsize=32)
def _with_terms(structure: Structure) -> tuple[Structure, dict[str, str]]:
    """The structure with an unknown coefficient for each term that a law has none for, and the terms by their names."""
    prefix = "added"
    while any(name.startswith(prefix) for link in structure.links for name in link.coefficients):
        prefix += "_"
    added = {f"{prefix}{number}": term for number, term in enumerate(_TERMS)}
    links = tuple(_with_link_terms(link, added) for link in structure.links)
    return replace(structure, links=links), added


def _with_link_terms(link: Link, added: dict[str, str]) -> Link:
    free = (name for name in link.law.linear if link.coefficients[name].value is None)
    unknown = {to_text(link.law.basis[name]).replace(" ", "") for name in free}
    new = {name: term for name, term in added.items() if term not in unknown}
    text = " + ".join([link.law.text, *(f"{name}*({term})" for name, term in new.items())])
    coefficients = {**link.coefficients, **{name: Coefficient.unknown() for name in new}}
    return replace(link, law=Law.parse(text, link.states), coefficients=coefficients)
