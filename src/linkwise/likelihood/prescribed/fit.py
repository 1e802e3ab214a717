"""The most likely unknowns of links on a rig, their covariance, and how far the laws are from the forces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from linkwise.arrays import Bools, Floats
from linkwise.errors import IdentificationError
from linkwise.likelihood.prescribed.covariance import covariance_of
from linkwise.likelihood.prescribed.motion import PrescribedMotion
from linkwise.likelihood.prescribed.problem import RigProblem
from linkwise.likelihood.prescribed.search import Minimum, bounds, minima, minimise
from linkwise.progress import Progress

_SEARCHED = 4096  # samples of a record in which starts are searched for
_MOST_SUBSTEPS = 32
_DISCRETISED = 0.5  # of the residuals over the root of their number: what finer steps may change, far below errors of noise
_CHI_SQUARE = 0.08  # what the estimate of the noise may leave chi-square off by
_SIGMAS = 5.0  # and its own scatter
_REWEIGHTED = 3
_DRAWS = 32  # of the noise of the motion, for the size of what it does to the forces
_SEED = 7
_NEAR = 1.2  # times the lowest cost: minima in parts of records that may be the lowest of the whole
_WHOLE_STEPS = 40  # of their search on the whole
_TIED = 20.0  # in -2 log likelihood: a minimum that near is as good
_ALIKE = 4.0  # standard errors within which two minima are one


@dataclass(frozen=True, eq=False)
class RigFit:
    """A minimum of the weighted squares of what load cells show beside the laws.

    Attributes
    ----------
    problem : RigProblem
        Records, structure and unknowns.
    minimum : Minimum
        The unknowns (u,), and the links along the motions.
    covariance : array of shape (u, u)
        Their covariance; of those at a bound 0.
    free : array of bool, shape (u,)
        False at a bound.
    residuals, deviations : array of shape (R,)
        Measured less modelled forces in N, and their standard deviations from the noise of load cells and motion.
    cells : array of shape (R,)
        Standard deviations in N of the noise of load cells alone.
    model_force : float
        Standard deviation in N of what the laws leave beside noise, 0 where noise explains the residuals.
    chi_square : float
        Per degree of freedom, of noise alone.
    determined : bool
        Whether the forces determine all unknowns.
    others : tuple of array of shape (u,)
        Unknowns at other minima that are as likely.
    """

    problem: RigProblem
    minimum: Minimum
    covariance: Floats
    free: Bools
    residuals: Floats
    deviations: Floats
    cells: Floats
    model_force: float
    chi_square: float
    determined: bool
    others: tuple[Floats, ...] = ()

    @property
    def weights(self) -> Floats:
        """(R,) one over the standard deviations of the residuals."""
        return 1.0 / np.hypot(self.deviations, self.model_force)


def rig_fit(
    problem: RigProblem, noise: Mapping[int, float], given: Mapping[str, float], progress: Progress
) -> RigFit:
    """Fit a rig; `noise` in N is that of load cells by the number of their link, `given` starts by name."""
    cells = np.concatenate(
        [
            np.full(len(problem.cell(number)), noise[link])
            for number, (_, link, _) in enumerate(problem.states)
        ]
    )
    measured = np.concatenate([problem.cell(number) for number in range(len(problem.states))])
    level = max(float(np.nanstd(measured)), np.finfo(float).tiny)
    candidates = minima(problem.shortened(_SEARCHED), given, level, progress)
    candidates = _on_whole(problem, candidates, np.full(len(cells), 1.0 / level))
    if not candidates:
        candidates = [minimise(problem, np.zeros(problem.size), np.full(len(cells), 1.0 / level))]
    candidates = [minimum for minimum in candidates if _is_finite(problem, minimum)]
    if not candidates:
        raise IdentificationError(_not_finite(problem))
    problem, best = refined(problem, candidates[0], cells)
    deviations, model = _levels(problem, best, cells)
    for _ in range(_REWEIGHTED):
        best = minimise(problem, best.unknowns, 1.0 / np.hypot(deviations, model))
        deviations, model = _levels(problem, best, cells)
    residuals = problem.residuals(best.unknowns, best.paths)
    freedom = max(int(np.count_nonzero(residuals)) - problem.size, 1)
    chi_square = float(np.sum((residuals / deviations) ** 2)) / freedom
    free = _inside(problem, best.unknowns)
    if not np.isfinite(problem.jacobian(best.paths)).all():
        raise IdentificationError(_not_finite(problem))
    covariance, determined = covariance_of(
        problem, best, free, cells, 1.0 / np.hypot(deviations, model), residuals, inexact=model > 0.0
    )
    fit = RigFit(problem, best, covariance, free, residuals, deviations, cells, model, chi_square, determined)
    return replace(fit, others=_others(fit, candidates[1:]))


def _on_whole(problem: RigProblem, candidates: Sequence[Minimum], weights: Floats) -> list[Minimum]:
    """Minima found in parts of the records, searched again on the whole where they are near the lowest, the lowest first."""
    if max(len(problem.cell(number)) for number in range(len(problem.states))) <= _SEARCHED:
        return list(candidates)
    whole: list[Minimum] = []
    for candidate in candidates:
        if whole and candidate.cost > _NEAR * candidates[0].cost:
            break
        unknowns = candidate.unknowns.copy()
        unknowns[problem.first_state :] = 0.0  # at the start of whole records
        again = minimise(problem, unknowns, weights, steps=_WHOLE_STEPS)
        if _is_finite(problem, again):
            whole.append(again)
    return sorted(whole, key=lambda minimum: minimum.cost)


def _is_finite(problem: RigProblem, minimum: Minimum) -> bool:
    """Whether the laws are finite along the whole motions."""
    return bool(np.isfinite(problem.residuals(minimum.unknowns, minimum.paths)).all())


def _not_finite(problem: RigProblem) -> str:
    names = ", ".join(problem.structure.links[link].name for link in problem.links)
    return (
        f"no values were found with which the law of {names} and its derivatives are finite along the recorded motion; give "
        "starting values with which they are, or bounds of its coefficients"
    )


def _levels(problem: RigProblem, minimum: Minimum, cells: Floats) -> tuple[Floats, float]:
    """Standard deviations (R,) in N of the residuals from noise, and that of what the laws leave beside it."""
    deviations = np.hypot(cells, motion_deviations(problem, minimum))
    residuals = problem.residuals(minimum.unknowns, minimum.paths)
    return deviations, _model_force(residuals, deviations, problem.size)


def refined(problem: RigProblem, minimum: Minimum, cells: Floats) -> tuple[RigProblem, Minimum]:
    """The problem with as many steps between samples as the residuals call for, and its minimum."""
    while True:
        residuals = problem.residuals(minimum.unknowns, minimum.paths)
        size = float(np.sqrt(np.mean(residuals**2)))
        level = np.hypot(cells, max(size - float(np.mean(cells)), 0.0))
        minimum = minimise(problem, minimum.unknowns, 1.0 / level)
        if not any(path.law.states for path in minimum.paths):
            return problem, minimum
        finer = problem.with_substeps(2 * problem.records[0].motion.substeps)
        change = finer.residuals(minimum.unknowns, finer.paths(minimum.unknowns)) - problem.residuals(
            minimum.unknowns, minimum.paths
        )
        if not np.isfinite(change).all():
            return problem, minimum
        if not np.sqrt(np.mean(change**2)) > _DISCRETISED * size / np.sqrt(len(residuals)):
            return problem, minimum
        if finer.records[0].motion.substeps > _MOST_SUBSTEPS:
            return problem, minimum
        problem = finer
        minimum = replace(minimum, paths=problem.paths(minimum.unknowns))


def motion_deviations(problem: RigProblem, minimum: Minimum) -> Floats:
    """(R,) standard deviations in N of the modelled forces by the noise of the motion."""
    rng = np.random.default_rng(_SEED)
    noises: list[PrescribedMotion] = [record.motion for record in problem.records]
    changes = [motion.noise_draws(rng, _DRAWS) for motion in noises]
    rows = []
    for (record, link, _), path in zip(problem.states, minimum.paths, strict=True):
        motion = noises[record]
        moved = path.tangents(problem.free(link)).by_motion(*changes[record])[:: motion.substeps]
        rows.append(np.sqrt(np.mean(moved**2, axis=1)))
    return np.asarray(np.nan_to_num(np.concatenate(rows)))


def _model_force(residuals: Floats, deviations: Floats, unknowns: int) -> float:
    """Standard deviation beside `deviations` with which the residuals have a chi-square of 1; 0 where noise explains them."""
    is_measured = residuals != 0.0
    count = max(int(is_measured.sum()) - unknowns, 1)
    squares, variances = residuals[is_measured] ** 2, deviations[is_measured] ** 2
    if np.sum(squares / variances) / count <= 1.0 + _CHI_SQUARE + _SIGMAS * np.sqrt(2.0 / count):
        return 0.0
    low, high = 0.0, float(np.sum(squares)) / count
    for _ in range(60):
        middle = 0.5 * (low + high)
        if np.sum(squares / (variances + middle)) > count:
            low = middle
        else:
            high = middle
    return float(np.sqrt(high))


def _inside(problem: RigProblem, unknowns: Floats) -> Bools:
    low, high = bounds(problem)
    size = 1e-7 * (np.abs(unknowns) + np.where(np.isfinite(high - low), high - low, 0.0))
    return np.asarray((unknowns - low > size) & (high - unknowns > size), dtype=bool)


def _others(fit: RigFit, candidates: Sequence[Minimum]) -> tuple[Floats, ...]:
    """Other minima as likely as the best, each searched again with its weights; those that are alike are reported once."""
    errors = np.sqrt(np.maximum(fit.covariance.diagonal(), 0.0))
    p = len(fit.problem.parameters)
    best = fit.minimum
    distinct: list[Floats] = []
    for candidate in candidates:
        near = [best.unknowns, *distinct]
        size = np.maximum(_ALIKE * errors, 0.01 * np.abs(best.unknowns))[:p]
        if any(np.all(np.abs(candidate.unknowns - known)[:p] <= size) for known in near):
            continue
        if candidate.cost > _NEAR * candidates[0].cost:
            continue
        again = minimise(fit.problem, candidate.unknowns, fit.weights)
        apart = all(np.any(np.abs(again.unknowns - known)[:p] > size) for known in near)
        if again.converged and apart and abs(again.cost - best.cost) < _TIED:
            distinct.append(again.unknowns)
    return tuple(unknowns[:p] for unknowns in distinct)
