"""Rows of the linearised equations at an optimum with the states eliminated: how residuals and defects follow the unknowns.

Where an unknown moves, the states follow as the whole record determines. Sums over these rows are what samples and links
between segments say of the unknowns.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.shooting.block_information import followed_states
from linkwise.likelihood.shooting.loss import Loss
from linkwise.likelihood.shooting.normal_equations import chunks, linearise, whitened_jacobian
from linkwise.likelihood.shooting.residuals import Misfit
from linkwise.likelihood.shooting.segments import Scales, Segments
from linkwise.likelihood.shooting.sensor_errors import SensorErrors
from linkwise.likelihood.shooting.tangent_forces import CandidateForces


@dataclass(frozen=True, eq=False)
class EliminatedRows:
    """Of the k segments `part`: `data` (k, M C, p), `residuals` (k, M C), `defects` (k, 2n + S, p) and `missed` (k, 2n + S).

    Rows and residuals are whitened, in scaled unknowns (theta, amplitudes of candidates, sizes of errors, offsets, gains).
    """

    part: slice
    data: Floats
    residuals: Floats
    defects: Floats
    missed: Floats


def eliminated_rows(
    segments: Segments,
    misfit: Misfit,
    scales: Scales,
    loss: Loss,
    q: float,
    candidates: CandidateForces | None = None,
    errors: SensorErrors | None = None,
) -> Iterator[EliminatedRows] | None:
    """The rows of all segments, chunk by chunk; None where the equations are singular."""
    linear = linearise(segments, misfit, scales, loss, candidates=candidates, errors=errors)
    factor = linear.equations(q).factor()
    if factor is None:
        return None
    follow = followed_states(factor)
    _, m, p = follow.shape
    following = np.concatenate([follow[1:], np.zeros((1, m, p))])
    weights, missed = np.zeros((2, segments.count, m))
    weights[:-1], missed[:-1] = segments.link_weights.T, misfit.defects.reshape(m, -1).T

    def chunk(part: slice) -> EliminatedRows:
        rows, ends = whitened_jacobian(segments, misfit, scales, loss, part, candidates, errors)
        node = follow[part]
        defects = ends[..., m:] - ends[..., :m] @ node + following[part]
        defects *= weights[part, :, None] / q
        data = rows[..., m:-1] - rows[..., :m] @ node
        return EliminatedRows(part, data, rows[..., -1], defects, missed[part] / q)

    return map(chunk, chunks(segments, p))
