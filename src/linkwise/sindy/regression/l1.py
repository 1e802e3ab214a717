"""L1-penalised least squares (the paper's Eq. 7), along the whole path of penalties.

The solution is piecewise linear in the penalty, so the path is followed exactly from kink to kink (the homotopy of
Osborne, Presnell and Turlach 2000, known as LARS): each step is one small Cholesky on the terms in play. On columns as
correlated as monomials are, coordinate descent and FISTA need thousands of sweeps for what takes this a few dozen
steps.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np
from scipy.linalg import cho_solve

from linkwise.arrays import Bools, Floats
from linkwise.errors import IdentificationError
from linkwise.runtime import one_blas_thread
from linkwise.sindy.regression.cholesky import cholesky
from linkwise.sindy.regression.gram import Gram
from linkwise.sindy.regression.regressor import Regressor, SupportCandidate
from linkwise.sindy.regression.selection import best_support, score_support

_SMALLEST = 1e-9  # penalty, in shares of the largest, at which the path ends
_STEPS_PER_COLUMN = 8
_PATIENCE = 30  # supports in a row that do not lower the BIC before the path is left


@final
@dataclass(frozen=True)
class L1(Regressor):
    """Minimise ||b - A c||^2 / 2 + penalty * ||b|| * sum_j ||c_j A_j||: every term is charged for its contribution.

    The penalty is a share: at 1 no term survives in any unit, near 0 all do. With `penalty` None it is chosen on rows held out
    as in `Stlsq`: of the supports along the path in the other rows, compared as least squares on each, the one of smallest BIC
    there is taken. `debias` refits the chosen
    support by least squares, which undoes the shrinkage of the penalty. Raises IdentificationError for a penalty
    outside (0, 1].
    """

    title: ClassVar[str] = "least squares with an L1 penalty"

    penalty: float | None = None
    debias: bool = True

    def __post_init__(self) -> None:
        if self.penalty is not None and not 0 < self.penalty <= 1:
            raise IdentificationError(
                f"a penalty of {self.penalty!r} was given; it is the share of an equation's right-hand side that a term must "
                "explain beyond the others to be let in, 0 < penalty <= 1"
            )

    def solve(self, gram: Gram, target: int) -> tuple[Floats, float, tuple[SupportCandidate, ...]]:
        path: tuple[SupportCandidate, ...] = ()
        if self.penalty is None:
            training = gram.training
            with one_blas_thread():  # many small steps
                scaled, setting, path = _chosen(training, target)
            if not self.debias and path:
                scaled = _at(gram, target, setting)
        else:
            scaled, setting = _at(gram, target, self.penalty), self.penalty
        if self.debias:
            scaled = gram.solve(scaled != 0, target)
        return scaled, setting, path


def _chosen(gram: Gram, target: int) -> tuple[Floats, float, tuple[SupportCandidate, ...]]:
    """The kink of the path whose support has the smallest BIC, its penalty, and all supports that were compared."""
    found: dict[bytes, tuple[SupportCandidate, Floats]] = {}
    worse, lowest = 0, np.inf
    for penalty, scaled in _path(gram, target):
        support = scaled != 0
        key = support.tobytes()
        if key in found:
            continue
        one = score_support(gram, target, *gram.project(support, target), penalty)
        worse = 0 if one.bic < lowest else worse + 1
        lowest = min(lowest, one.bic)
        found[key] = one, scaled
        if worse > _PATIENCE:
            break
    if not found:
        return np.zeros(len(gram.names)), 1.0, ()
    chosen = best_support(one for one, _ in found.values())
    return found[chosen.support.tobytes()][1], chosen.setting, tuple(one for one, _ in found.values())


def _at(gram: Gram, target: int, penalty: float) -> Floats:
    """Scaled coefficients (p,) at one penalty: the path is linear between the kinks on its two sides."""
    before = np.zeros(len(gram.names))
    if not gram.norms[target]:
        return before
    above = float(np.max(np.abs(gram.moments[:, target]))) / gram.norms[target]
    if penalty >= above:
        return before
    for kink, scaled in _path(gram, target):
        if kink <= penalty:
            share = (above - penalty) / (above - kink)
            return np.asarray(before + share * (scaled - before))
        above, before = kink, scaled
    return before


def _path(gram: Gram, target: int) -> Iterator[tuple[float, Floats]]:
    """Kinks of the path from the largest penalty down: the penalty as a share of ||b||, and the scaled coefficients there."""
    norm = float(gram.norms[target])
    if norm == 0:
        return
    moments = gram.moments[:, target] / norm
    scaled, correlation = np.zeros(len(moments)), moments
    free = gram.alive.copy()  # columns that may still enter
    active: list[int] = []
    signs: list[float] = []
    entering, left = int(np.argmax(np.where(free, np.abs(moments), -1.0))), -1
    penalty = float(abs(moments[entering]))
    last = penalty * _SMALLEST
    for _ in range(_STEPS_PER_COLUMN * len(moments)):
        if entering >= 0:
            active.append(entering)
            signs.append(float(np.sign(correlation[entering])))
        solved = _direction(gram.matrix, active, signs)
        if solved is None:  # the newcomer is a copy of what is there
            free[active.pop()] = False
            signs.pop()
            solved = _direction(gram.matrix, active, signs) if active else None
        if solved is None:
            return
        columns = gram.matrix[:, active]
        step, entering = _next_entry(correlation, columns @ solved, penalty, free, active, left)
        step, leaving = _first_exit(scaled[active], solved, min(step, penalty - last))
        scaled[active] += step * solved
        penalty -= step
        left = -1
        if leaving >= 0:
            entering, left = -1, active.pop(leaving)
            signs.pop(leaving)
            scaled[left] = 0.0
        correlation = moments - gram.matrix[:, active] @ scaled[active]
        yield penalty, scaled * norm
        if penalty <= last * (1 + 1e-9) or (entering < 0 and leaving < 0) or not active:
            return


def _direction(matrix: Floats, active: list[int], signs: list[float]) -> Floats | None:
    """How the coefficients in play grow per unit of falling penalty; None where their columns are dependent."""
    factor = cholesky(matrix[np.ix_(active, active)])
    return None if factor is None else np.asarray(cho_solve(factor, np.array(signs), check_finite=False))


def _next_entry(
    correlation: Floats, drop: Floats, penalty: float, free: Bools, active: list[int], left: int
) -> tuple[float, int]:
    """The step at which another column's correlation meets the penalty, and that column (-1: none before the penalty is 0)."""
    steps = np.full(len(correlation), np.inf)
    for sign in (1.0, -1.0):
        closing = 1.0 - sign * drop
        with np.errstate(divide="ignore", invalid="ignore"):
            candidates = (penalty - sign * correlation) / closing
        usable = (closing > 1e-12) & (candidates > -1e-12 * penalty)
        np.minimum(steps, np.maximum(candidates, 0.0), out=steps, where=usable)
    steps[~free] = np.inf
    steps[active] = np.inf
    if left >= 0 and steps[left] < 1e-9 * penalty:
        steps[left] = np.inf  # a column that has just left meets the penalty where it left it
    entering = int(np.argmin(steps))
    return (float(steps[entering]), entering) if steps[entering] < penalty else (penalty, -1)


def _first_exit(values: Floats, speed: Floats, step: float) -> tuple[float, int]:
    """The step at which a coefficient in play returns to zero, and its place (-1: none within `step`)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        crossings = np.where(values * speed < 0, -values / speed, np.inf)
    place = int(np.argmin(crossings)) if len(crossings) else -1
    return (float(crossings[place]), place) if place >= 0 and crossings[place] < step else (step, -1)
