"""L1-penalised least squares (the paper's Eq. 7), along the whole path of penalties.

The solution is piecewise linear in the penalty, so the path is followed exactly from kink to kink by the homotopy method
(LARS); each step is one small Cholesky factorisation on the active terms. Columns of monomials are strongly correlated:
coordinate descent and FISTA would need thousands of sweeps where this takes a few dozen steps.

References
----------
M. R. Osborne, B. Presnell and B. A. Turlach, IMA J. Numer. Anal. 20, 389 (2000).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np
from scipy.linalg import cho_solve

from linkwise.argument_types import checked_class
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


@checked_class
@final
@dataclass(frozen=True)
class L1(Regressor):
    """L1-penalised least squares (lasso): minimise ||b - A c||^2 / 2 + penalty ||b|| sum_j ||c_j A_j||.

    Without a penalty, the support along the path of smallest BIC on rows held out is used, as in `Stlsq`.

    Parameters
    ----------
    penalty : float, optional
        Above 0 and at most 1, relative to the norm of the target: at 1 no term survives in any unit.
    debias : bool, optional
        Refit the support by least squares, which removes the shrinkage of the penalty.

    Raises
    ------
    IdentificationError
        If the penalty is out of range; on fitting, if it is None and there are fewer than 25 rows.

    References
    ----------
    R. Tibshirani, J. R. Stat. Soc. B 58, 267 (1996).

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=2.0, rate=1000.0, sensors=("x", "v", "a"))
    >>> system = lw.link_columns(lw.differentiate(record), chain.unknown("nes1"))
    >>> {name: f"{value:.6g}" for name, value in lw.L1().fit(system).terms("force").items()}
    {'nes1.alpha': '-100', 'nes1.beta': '1e+06', 'nes1.c': '0.02'}
    """

    title: ClassVar[str] = "least squares with an L1 penalty"

    penalty: float | None = None
    debias: bool = True

    def __post_init__(self) -> None:
        if self.penalty is not None and not 0 < self.penalty <= 1:
            raise IdentificationError(
                f"penalty must be above 0 and at most 1, got {self.penalty!r}; it is the share of an equation's right-hand "
                "side that a term must explain beyond the others to be selected"
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
    compared: dict[bytes, tuple[SupportCandidate, Floats]] = {}
    worse, lowest = 0, np.inf
    for penalty, scaled in _path(gram, target):
        support = scaled != 0
        key = support.tobytes()
        if key in compared:
            continue
        candidate = score_support(gram, target, *gram.project(support, target), penalty)
        worse = 0 if candidate.bic < lowest else worse + 1
        lowest = min(lowest, candidate.bic)
        compared[key] = candidate, scaled
        if worse > _PATIENCE:
            break
    if not compared:
        return np.zeros(len(gram.names)), 1.0, ()
    chosen = best_support(candidate for candidate, _ in compared.values())
    candidates = tuple(candidate for candidate, _ in compared.values())
    return compared[chosen.support.tobytes()][1], chosen.setting, candidates


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
        if solved is None:  # the entering column depends on the active ones
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
    """Change of the active coefficients per unit of falling penalty; None where their columns are dependent."""
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
    """The step at which an active coefficient returns to zero, and its index (-1: none within `step`)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        crossings = np.where(values * speed < 0, -values / speed, np.inf)
    index = int(np.argmin(crossings)) if len(crossings) else -1
    return (float(crossings[index]), index) if index >= 0 and crossings[index] < step else (step, -1)
