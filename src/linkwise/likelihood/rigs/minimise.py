"""Least squares for the unknowns of links on a rig, from starts that a regression along the motion finds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy

from linkwise.arrays import Floats, bridged
from linkwise.likelihood.rigs.link_path import LinkPath
from linkwise.likelihood.rigs.problem import RigProblem, cell_name
from linkwise.likelihood.starts.memory import MemorySearch, Start

_SEARCHED = 4096  # samples of a record in which starts are searched for
_OF_PERIOD = 256  # of them in a period of the motion: more make the search longer, and show no more of a law
_LAST_STEPS = 300
# residual, relative to the forces, of a trial whose states run away or whose laws are not finite
_RUNAWAY = 1e6


@dataclass(frozen=True, eq=False)
class Minimum:
    """Unknowns (u,) at a minimum, `cost` the sum of weighted squares there, the paths, and whether the search ended."""

    unknowns: Floats
    cost: float
    paths: tuple[LinkPath, ...]
    converged: bool


def minimise(problem: RigProblem, start: Floats, weights: Floats, *, steps: int = _LAST_STEPS) -> Minimum:
    """The minimum of the squares of weighted residuals near `start`, within bounds; priors count."""
    low, high = problem.bounds
    last: tuple[LinkPath, ...] | None = None
    prior = np.array([p.start or 0.0 for p in problem.parameters])
    certainty = problem.certainty[: len(prior)]

    @lru_cache(maxsize=1)
    def paths_at(*unknowns: float) -> tuple[LinkPath, ...]:
        """The links along the motions, sought near those asked for before."""
        nonlocal last
        last = problem.paths(np.array(unknowns), last)
        return last

    def residuals(unknowns: Floats) -> Floats:
        paths = paths_at(*unknowns)
        left = np.where(weights > 0.0, problem.residuals(unknowns, paths), 0.0)
        if not (all(path.converged for path in paths) and np.isfinite(left).all()):
            return np.full(len(weights) + len(prior), _RUNAWAY)
        rows = np.clip(weights * left, -_RUNAWAY, _RUNAWAY)
        return np.concatenate([rows, certainty * (prior - unknowns[: len(prior)])])

    def jacobian(unknowns: Floats) -> Floats:
        own = np.zeros((len(prior), problem.size))
        own[:, : len(prior)] = -np.diag(certainty)
        slopes = -weights[:, None] * problem.jacobian(paths_at(*unknowns))
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
        end = paths_at(*unknowns)
    return Minimum(
        unknowns, 2.0 * float(optimum.cost), end, bool(optimum.status > 0) and all(p.converged for p in end)
    )


def starts(problem: RigProblem, given: Mapping[str, float]) -> tuple[Start, ...]:
    """Values of the parameters from which little of the forces is left, the best first; `given` starts by name are kept near.

    They are searched for in the liveliest part of the first record, without the means of the forces where a zero is unknown.
    """
    motion, forces = problem.motions[0], problem.forces[0]
    thinned = max(motion.period // _OF_PERIOD, 1)
    count = min(_SEARCHED * thinned, len(next(iter(forces.values()))))
    first = motion.liveliest(count)
    searched = slice(first, first + count, thinned)
    d, v = (
        np.outer(along[:: motion.substeps][searched], problem.structure.base_incidence)
        for along in (motion.d, motion.v)
    )
    shown: dict[str, Floats] = {
        cell_name(problem.structure, link): bridged(force)[searched] for link, force in forces.items()
    }
    slow = int(bool(problem.offsets))
    step = thinned * motion.step * motion.substeps
    return MemorySearch(problem.structure, step, d, v, (), shown, given, {}, slow, sharp=True).minima()
