"""The quadratic model of a long record with columns for what is tested, piece by piece, so that these take little memory."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import pairwise

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.shooting.bordered_system import BorderedFactor
from linkwise.likelihood.shooting.loss import Loss
from linkwise.likelihood.shooting.normal_equations import add_prior, linearise
from linkwise.likelihood.shooting.pieces import chain_of_ends, inner_equations, piece_between, piece_ends
from linkwise.likelihood.shooting.residuals import Misfit
from linkwise.likelihood.shooting.segments import Scales, Segments
from linkwise.likelihood.shooting.sensor_errors import SensorErrors
from linkwise.likelihood.shooting.tangent_forces import CandidateForces
from linkwise.runtime import processors


def tested_in_pieces(
    segments: Segments,
    misfit: Misfit,
    scales: Scales,
    loss: Loss,
    q: float,
    candidates: CandidateForces,
    errors: SensorErrors | None,
) -> tuple[BorderedFactor, float] | None:
    """The equations of parameters and of sizes of what is tested, all nodes eliminated.

    Parameters
    ----------
    segments, misfit, scales, loss, candidates, errors
        As of `linearise`.
    q : float
        Relaxation.

    Returns
    -------
    tuple of (BorderedFactor, float) or None
        The factor, of which `schur` and `reduced` are these equations, and the largest sensitivity of the states over a
        segment, 1 at least; None where the equations are not positive definite.
    """

    @np.errstate(over="ignore", invalid="ignore")  # threads do not share the error state of the caller
    def work(own: tuple[int, int]) -> tuple[Floats, Floats, float] | None:
        part = slice(own[0], own[1] + 1)
        some = None if errors is None else replace(errors, values=errors.values[..., part])
        linear = linearise(
            piece_between(segments, *own), misfit.part(part), scales, loss, None, candidates.part(part), some
        )
        factor = inner_equations(linear.equations(q)).factor(overwrite=True)
        growth = float(np.max(np.abs(linear.state_ends), initial=1.0))
        return None if factor is None else (factor.schur, factor.reduced, growth)

    with ThreadPoolExecutor(processors()) as executor:
        eliminated = list(executor.map(work, pairwise(piece_ends(segments.linked).tolist())))
    pieces = [piece for piece in eliminated if piece is not None]
    if len(pieces) < len(eliminated):
        return None
    m = len(misfit.point.nodes)
    size = len(pieces[0][1]) - 2 * m
    corner, gradient = np.zeros((size, size)), np.zeros(size)
    if segments.prior is not None:
        add_prior(corner, gradient, segments.prior, misfit.point, scales)
    factor = chain_of_ends([piece[:2] for piece in pieces], m, corner, gradient).factor()
    return None if factor is None else (factor, max(growth for *_, growth in pieces))
