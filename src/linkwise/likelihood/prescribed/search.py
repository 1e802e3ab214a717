"""Least squares for the unknowns of links on a rig: many trials, of which the best are followed down."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from linkwise.arrays import Floats
from linkwise.likelihood.prescribed.problem import RigProblem
from linkwise.likelihood.prescribed.state_path import LinkPath
from linkwise.likelihood.starts.trials import trial_values, unit_sizes
from linkwise.model.parameters import Parameter
from linkwise.progress import Progress, ProgressReport

_TRIALS = 60
_REFINED = 6  # trials that are followed
_STEPS = 60  # of a search from a trial
_LAST_STEPS = 300
# residual, relative to the forces, of a trial whose states run away or whose laws are not finite
_RUNAWAY = 1e6
_SEED = 12


@dataclass(frozen=True, eq=False)
class Minimum:
    """Unknowns (u,) at a minimum, `cost` the sum of weighted squares there, the paths, and whether the search ended."""

    unknowns: Floats
    cost: float
    paths: tuple[LinkPath, ...]
    converged: bool


class _Follower:
    """The links along the motions at the unknowns asked for, sought near those asked for before."""

    def __init__(self, problem: RigProblem) -> None:
        self._problem = problem
        self._at = np.full(problem.size, np.nan)
        self._paths: tuple[LinkPath, ...] | None = None

    def paths(self, unknowns: Floats) -> tuple[LinkPath, ...]:
        if self._paths is None or not np.array_equal(unknowns, self._at):
            paths = self._problem.paths(unknowns, self._paths)
            if not all(path.converged for path in paths):
                paths = self._problem.paths(unknowns)
            self._at, self._paths = unknowns.copy(), paths
        return self._paths


def minimise(problem: RigProblem, start: Floats, weights: Floats, *, steps: int = _LAST_STEPS) -> Minimum:
    """The minimum of the squares of weighted residuals near `start`, within bounds; priors count."""
    low, high = bounds(problem)
    follower = _Follower(problem)
    prior = np.array([p.start or 0.0 for p in problem.parameters])
    certainty = problem.certainty[: len(prior)]

    def residuals(unknowns: Floats) -> Floats:
        paths = follower.paths(unknowns)
        if not all(path.converged for path in paths):
            return np.full(len(weights) + len(prior), _RUNAWAY)
        left = np.where(weights > 0.0, problem.residuals(unknowns, paths), 0.0)
        if not np.isfinite(left).all():
            return np.full(len(weights) + len(prior), _RUNAWAY)
        rows = np.clip(weights * left, -_RUNAWAY, _RUNAWAY)
        return np.concatenate([rows, certainty * (prior - unknowns[: len(prior)])])

    def jacobian(unknowns: Floats) -> Floats:
        own = np.zeros((len(prior), problem.size))
        own[:, : len(prior)] = -np.diag(certainty)
        slopes = -weights[:, None] * problem.jacobian(follower.paths(unknowns))
        return np.concatenate([np.nan_to_num(slopes, nan=0.0, posinf=0.0, neginf=0.0), own])

    inside = np.clip(start, low, high)
    with np.errstate(all="ignore"):
        optimum = scipy.optimize.least_squares(
            residuals,
            inside,
            jacobian,
            bounds=(low, high),
            x_scale="jac",
            max_nfev=steps,
            xtol=1e-9,
            ftol=1e-9,
        )
        unknowns = np.asarray(optimum.x)
        end = follower.paths(unknowns)
    return Minimum(
        unknowns, 2.0 * float(optimum.cost), end, bool(optimum.status > 0) and all(p.converged for p in end)
    )


def bounds(problem: RigProblem) -> tuple[Floats, Floats]:
    """Bounds (u,) of the unknowns."""
    low, high = np.full(problem.size, -np.inf), np.full(problem.size, np.inf)
    low[: len(problem.parameters)] = [p.lower for p in problem.parameters]
    high[: len(problem.parameters)] = [p.upper for p in problem.parameters]
    return low, high


def minima(
    problem: RigProblem, given: Mapping[str, float], level: float, progress: Progress
) -> list[Minimum]:
    """Minima found from trials of the sizes that units imply, the lowest first; `given` starts by name are kept near.

    Residuals are relative to a `level` in N.
    """
    linear = [p for p in problem.parameters if _is_linear(problem, p)]
    curved = [p for p in problem.parameters if p not in linear]
    motion = problem.records[0].motion
    left = problem.residuals(np.zeros(problem.size), problem.paths(np.zeros(problem.size)))
    force, weights = float(np.std(np.nan_to_num(left))), np.full(len(left), 1.0 / level)
    sizes = unit_sizes(curved, motion.d, motion.v, force or 1.0)
    rng = np.random.default_rng(_SEED)
    trials = []
    for number in range(_TRIALS if curved else 1):
        start = np.zeros(problem.size)
        chosen = trial_values(curved, given, sizes, rng, first=number == 0)
        for value, parameter in zip(chosen, curved, strict=True):
            start[problem.parameters.index(parameter)] = value
        trials.append(regressed(problem, start, linear, weights))
    trials.sort(key=lambda pair: pair[1])
    local_minima = []
    for number, (start, cost) in enumerate(trials[:_REFINED]):
        if np.isfinite(cost):
            local_minima.append(minimise(problem, start, weights, steps=_STEPS))
        progress(ProgressReport((number + 1) / min(_REFINED, len(trials)), "searching from several starts"))
    return sorted(local_minima, key=lambda minimum: minimum.cost)


def _is_linear(problem: RigProblem, parameter: Parameter) -> bool:
    return all(key in problem.structure.links[index].law.linear for index, key in parameter.members)


@np.errstate(all="ignore")
def regressed(
    problem: RigProblem, start: Floats, linear: Sequence[Parameter], weights: Floats
) -> tuple[Floats, float]:
    """The unknowns with linear parameters and offsets by regression, and the cost; infinite where states run away."""
    paths = problem.paths(start)
    if not all(path.converged for path in paths):
        return start, np.inf
    low, high = bounds(problem)
    columns = [problem.parameters.index(p) for p in linear]
    columns += list(range(len(problem.parameters), problem.first_state))
    rows = weights * problem.residuals(start, paths)
    slopes = weights[:, None] * problem.jacobian(paths)[:, columns]
    if not (np.isfinite(rows).all() and np.isfinite(slopes).all()):
        return start, np.inf
    size = np.maximum(np.sqrt(np.einsum("ij,ij->j", slopes, slopes)), 1e-300)
    values = np.linalg.lstsq(slopes / size, rows, rcond=1e-10)[0] / size
    unknowns = start.copy()
    unknowns[columns] = np.clip(values, low[columns], high[columns])
    return unknowns, float(np.sum((rows - slopes @ unknowns[columns]) ** 2))
