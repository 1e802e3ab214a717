"""The linearised problem at a point, dense for few masses and local for many."""

from __future__ import annotations

from concurrent.futures import Executor, ThreadPoolExecutor

import numpy as np
from scipy.linalg import solve_triangular

from linkwise.arrays import Bools, Floats, Indices
from linkwise.likelihood.shooting.bordered_system import BorderedFactor, BorderEquations
from linkwise.likelihood.shooting.common_shift import with_common_shift
from linkwise.likelihood.shooting.local_equations import LocalFactor, LocalLinearization
from linkwise.likelihood.shooting.local_products import local_linearization
from linkwise.likelihood.shooting.local_rows import LocalRows
from linkwise.likelihood.shooting.loss import Loss
from linkwise.likelihood.shooting.neighbourhoods import MANY, clusters, neighbourhoods, reach
from linkwise.likelihood.shooting.normal_equations import Linearization, linearise
from linkwise.likelihood.shooting.residuals import Misfit
from linkwise.likelihood.shooting.segments import F, S, Scales, Segments
from linkwise.likelihood.shooting.sensor_errors import SensorErrors
from linkwise.likelihood.shooting.tangent_forces import CandidateForces
from linkwise.runtime import processors

GaussNewtonModel = Linearization | LocalLinearization
Factor = BorderedFactor | LocalFactor
Border = BorderEquations | Factor

_LOOSER = (3.0, 10.0, 30.0, 100.0)  # times the relaxation, for a covariance
_ROUNDED = 1e-13  # of the diagonal of the border: information of which rounding hides more than a hundredth
_WORTHWHILE = 0.9  # of the sensitivities of the whole: what groups may have of them


def linear_model(
    segments: Segments,
    misfit: Misfit,
    scales: Scales,
    loss: Loss,
    executor: Executor | None = None,
    candidates: CandidateForces | None = None,
    errors: SensorErrors | None = None,
    blocks: int = 1,
) -> GaussNewtonModel:
    """Gauss-Newton blocks at a point.

    Parameters
    ----------
    segments, misfit, scales, loss, candidates, errors, blocks
        As of `linearise`.
    executor : Executor, optional
        Threads; by default as many as there are processors.

    Returns
    -------
    Linearization or LocalLinearization
        The latter where influences reach a small part of the structure within a segment.
    """
    if executor is None:
        with ThreadPoolExecutor(processors()) as threads:
            return linear_model(segments, misfit, scales, loss, threads, candidates, errors, blocks)
    if _separable(segments):
        reached = reach(segments, misfit, scales)
        origins = column_origins(segments, candidates, errors)
        moving = segments.system.parameters.size + (0 if candidates is None else len(candidates.first))
        groups = neighbourhoods(segments, reached, clusters(segments.system), origins, moving)
        m, n = segments.system.dimension, len(segments.system.incidence)
        handled = sum(len(group.masses) * group.size for group in groups)
        if handled < _WORTHWHILE * n * (m + len(origins)):
            rows = LocalRows(segments, misfit, scales, loss, groups, candidates, errors)
            return local_linearization(rows, executor, blocks)
    return linearise(segments, misfit, scales, loss, executor, candidates, errors, blocks)


def _separable(segments: Segments) -> bool:
    """Whether there are many masses, and nothing that acts on all of them at once."""
    sensors = segments.sensors
    hosts = len(segments.system.points) > 0 or sensors.shapes is not None
    return (
        len(segments.system.incidence) >= MANY
        and segments.random is None
        and not hosts
        and not sensors.gains
        and not sensors.delays
        and not sensors.waveforms
    )


def column_origins(
    segments: Segments, candidates: CandidateForces | None, errors: SensorErrors | None
) -> list[Indices]:
    """Of each column of the border the masses on which the unknown acts, or whose sensors it changes.

    Parameters
    ----------
    segments, candidates, errors
        As of `linear_model`.

    Returns
    -------
    list of array of int
        The masses.
    """
    system, sensors = segments.system, segments.sensors
    touched = [np.flatnonzero(column) for column in system.incidence.T]
    masses: list[set[int]] = [set() for _ in range(system.parameters.size)]
    for link, column, _ in system.interactions:
        masses[column] |= set(touched[link].tolist())
    for mass, column in np.argwhere(system.parameters.mass_map).tolist():
        masses[column].add(mass)

    def of_channel(channel: int) -> set[int]:
        place = int(sensors.mass[channel])
        if sensors.kind[channel] not in (F, S):
            return {place}
        return set(touched[int(system.state_links[place]) if sensors.kind[channel] == S else place].tolist())

    if candidates is not None:
        ends = zip(candidates.first.tolist(), candidates.second.tolist(), strict=True)
        masses += [{end for end in pair if end >= 0} for pair in ends]
    if errors is not None:
        masses += [of_channel(channel) for channel in errors.channel.tolist()]
    for offset in range(sensors.offsets):
        masses.append(set().union(*map(of_channel, np.flatnonzero(sensors.offset == offset).tolist())))
    return [np.array(sorted(own_masses), dtype=int) for own_masses in masses]


def border_equations(linear: GaussNewtonModel, q: float) -> Border | None:
    """The equations of the border at a relaxation, as the factor has them; of many masses without room for the factor."""
    return linear.border(q) if isinstance(linear, LocalLinearization) else linear.factor(q)


def precise_model(
    linear: GaussNewtonModel, q: float, factor: Factor | None = None, own: int | None = None
) -> tuple[GaussNewtonModel, Factor | None]:
    """A linearised problem with its factor, whose rounding hides nothing that the equations tell of the border.

    Parameters
    ----------
    linear : Linearization or LocalLinearization
        The linearised problem.
    q : float
        Relaxation.
    factor : BorderedFactor or LocalFactor, optional
        Its factor at the relaxation.
    own : int, optional
        How many of the border, the first, rounding must not hide; candidates behind them may well be as good as singular. By
        default all.

    Returns
    -------
    tuple
        The same problem, in coordinates of the nodes relative to a common shift where rounding makes that necessary, and its
        factor; None where its equations are not positive definite.
    """
    factor = factor or linear.factor(q)
    if isinstance(linear, Linearization) and _is_rounded(linear, factor, q, own):
        linear = with_common_shift(linear)
        factor = linear.factor(q)
    return linear, factor


def firm_border(linear: GaussNewtonModel, q: float, factor: Factor | None = None) -> Border | None:
    """`border_equations` at a relaxation, or at the least larger one at which nothing has to be added to the nodes.

    That at the relaxation is the given one, if there is one. What is added makes a factor, and would count as information; a
    larger relaxation can only widen the covariance. Where nothing helps it is that with the addition.
    """
    border: Border | None
    if isinstance(linear, LocalLinearization):
        border = factor or linear.border(q)
    else:
        linear, border = precise_model(linear, q, factor)
    for looser in _LOOSER if border is not None and border.damped else ():
        again = border_equations(linear, looser * q)
        if again is not None and not again.damped:
            return again
    return border


def _is_rounded(linear: Linearization, factor: Factor | None, q: float, own: int | None) -> bool:
    """Whether rounding hides what equations tell of some direction in the first `own` columns of the border."""
    if factor is None or not len(factor.schur[:own]):
        return False
    diagonal = (linear.data.corner + linear.defects.corner / q**2).diagonal()[:own]
    size = np.sqrt(np.maximum(diagonal, np.finfo(float).tiny))
    relative = factor.schur[:own, :own] / np.outer(size, size)
    return bool(np.isfinite(relative).all() and np.linalg.eigvalsh(relative)[0] < _ROUNDED)


def covariance(border: Border | None, scales: Scales, free: Bools) -> Floats:
    """Of theta, offsets and gains in their own units, zero where not free; infinite where rounding leaves the equations no
    positive definite matrix, since the variances of another would be its errors alone.
    """
    size = len(scales.theta)
    unknown = np.full((size, size), np.inf)
    if border is None:
        return unknown
    chosen = np.ix_(free, free)
    try:
        root = np.linalg.cholesky(border.schur[chosen])
    except np.linalg.LinAlgError:
        return unknown
    out = np.zeros((size, size))
    half = solve_triangular(root, np.diag(scales.theta[free]), lower=True, check_finite=False)
    out[chosen] = half.T @ half
    return out
