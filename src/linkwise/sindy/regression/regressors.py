"""Regressors: thresholded least squares (Brunton et al. 2016; step 6 of the paper's section 3), L1-penalised (the paper's
Eq. 7) and ordinary least squares.

The solution with a penalty is piecewise linear in it, so the path is followed exactly from kink to kink by the homotopy
method (LARS); each step is one small Cholesky factorisation on the active terms (M. R. Osborne, B. Presnell and B. A.
Turlach, IMA J. Numer. Anal. 20, 389 (2000)). Columns of monomials are strongly correlated: coordinate descent and FISTA
would need thousands of sweeps where this takes a few dozen steps.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, final

import numpy as np
from scipy.linalg import cho_solve

from linkwise.arrays import Bools, Floats
from linkwise.errors import IdentificationError
from linkwise.runtime import one_blas_thread
from linkwise.sindy.regression.gram import Gram, Solution, cholesky
from linkwise.sindy.regression.regressor import (
    EXACT,
    Regressor,
    SupportCandidate,
    best_support,
    score_support,
)

_PASSES = 50  # supports only shrink, so far fewer passes are enough
_FEW, _FEWER = 64, 16  # terms below which a tenth is dropped at once, and below which one is


@final
@dataclass(frozen=True)
class Stlsq(Regressor):
    """Sequentially thresholded least squares.

    Terms whose contribution ||c_j A_j|| / ||b|| is below a threshold are dropped and the others refitted, until none drops.

    Parameters
    ----------
    threshold : float, optional
        At least 0 and below 1, relative to the norm of the target, so that it means the same in every unit. By default it is
        chosen on rows held out.

    Raises
    ------
    IdentificationError
        If the threshold is out of range; on fitting, if it is None and there are fewer than 25 rows.

    Notes
    -----
    To choose the threshold, every fifth of a hundred runs of neighbouring rows is held out. On the other rows the threshold
    rises; each step drops the weakest third of the terms (a tenth of fewer than 64, one of fewer than 16, and all that
    contribute less than rounding) and refits. The support of smallest BIC on the rows held out is fitted to all rows. The path
    is kept in `RegressionFit.paths`.

    References
    ----------
    S. L. Brunton, J. L. Proctor and J. N. Kutz, PNAS 113, 3932 (2016).

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(
    ...     lw.bnes_chain(2), release={"v:m1": 1.0}, duration=2.0, rate=1000.0, sensors=("x", "v", "a")
    ... )
    >>> fit = lw.sindy.Stlsq(0.001).fit(lw.sindy.monomial_equations(lw.sindy.differentiate(record), order=3))
    >>> sorted(fit.terms("x1'"))
    ['v1']
    """

    title: ClassVar[str] = "sequentially thresholded least squares"

    threshold: float | None = None

    def __post_init__(self) -> None:
        if self.threshold is not None and not 0 <= self.threshold < 1:
            raise IdentificationError(
                f"threshold must be at least 0 and below 1, got {self.threshold!r}; it is the share of an equation's "
                "right-hand side below which a term is dropped"
            )

    def with_threshold(self, threshold: float) -> Stlsq:
        return Stlsq(threshold)

    def _solve(self, gram: Gram, target: int) -> tuple[Solution, float, tuple[SupportCandidate, ...]]:
        with one_blas_thread():  # many small steps
            if self.threshold is not None:
                return _shrunk(gram.solution(target), self.threshold), self.threshold, ()
            path = tuple(_threshold_path(gram.training, target))
        chosen = best_support(path)
        return gram.solution(target).on(chosen.support), chosen.setting, path


def _shrunk(solution: Solution, threshold: float) -> Solution:
    """The solution after dropping terms until every one that remains reaches the threshold."""
    least = threshold * solution.gram.norms[solution.target]
    for _ in range(_PASSES):
        scaled = solution.scaled
        support = (np.abs(scaled) >= least) & (scaled != 0)
        if np.array_equal(support, scaled != 0):
            break
        solution = solution.on(support)
    return solution


def _threshold_path(training: Gram, target: int) -> Iterator[SupportCandidate]:
    """Supports of decreasing size, from all columns to none, as the threshold rises."""
    columns, solution = np.arange(len(training.names)), training.solution(target)
    setting, norm = 0.0, float(training.norms[target])
    while True:
        candidate, scaled = score_support(solution, setting), solution.scaled
        support = np.zeros(len(training.names), dtype=bool)
        support[columns] = candidate.support
        yield replace(candidate, support=support)
        if not candidate.terms or not norm:
            return
        ranked = np.argsort(np.abs(scaled), kind="stable")[-candidate.terms :]
        negligible = int(np.count_nonzero(np.abs(scaled[ranked]) < EXACT * norm))
        dropped = ranked[: max(_step(candidate.terms), min(negligible, candidate.terms - 1))]
        setting = max(setting, float(np.abs(scaled[dropped[-1]])) / norm)
        remaining = candidate.support.copy()
        remaining[dropped] = False
        solution = solution.on(remaining)
        if 0 < np.count_nonzero(remaining) < len(columns) / 2:
            columns, solution = columns[remaining], solution.restricted().solution(0)


def _step(terms: int) -> int:
    """How many of `terms` terms are dropped at once."""
    return 1 if terms < _FEWER else terms // (10 if terms < _FEW else 3)


_SMALLEST = 1e-9  # penalty, in shares of the largest, at which the path ends
_STEPS_PER_COLUMN = 8
_PATIENCE = 30  # supports in a row that do not lower the BIC before the path is left


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
    >>> system = lw.sindy.link_columns(lw.sindy.differentiate(record), chain.unknown("nes1"))
    >>> {name: f"{value:.6g}" for name, value in lw.sindy.L1().fit(system).terms("force").items()}
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

    def _solve(self, gram: Gram, target: int) -> tuple[Solution, float, tuple[SupportCandidate, ...]]:
        path: tuple[SupportCandidate, ...] = ()
        if self.penalty is None:
            training = gram.training
            with one_blas_thread():  # many small steps
                scaled, setting, path = _chosen(training, target)
            if not self.debias and path:
                scaled = _at(gram, target, setting)
        else:
            scaled, setting = _at(gram, target, self.penalty), self.penalty
        solution = gram.solution(target).on(scaled != 0)
        if not self.debias:
            solution = replace(solution, change=scaled - gram.anchor[:, target], known_squares=None)
        return solution, setting, path


def _chosen(gram: Gram, target: int) -> tuple[Floats, float, tuple[SupportCandidate, ...]]:
    """The kink of the path whose support has the smallest BIC, its penalty, and all supports that were compared."""
    compared: dict[bytes, tuple[SupportCandidate, Floats]] = {}
    worse, lowest = 0, np.inf
    for penalty, scaled in _lasso_path(gram, target):
        support = scaled != 0
        key = support.tobytes()
        if key in compared:
            continue
        candidate = score_support(gram.solution(target).on(support), penalty)
        worse = 0 if candidate.bic < lowest else worse + 1
        lowest = min(lowest, candidate.bic)
        compared[key] = candidate, scaled
        if worse > _PATIENCE:
            break
    if not compared:
        return np.zeros(len(gram.names)), 1.0, ()
    candidates = tuple(candidate for candidate, _ in compared.values())
    chosen = best_support(candidates)
    return compared[chosen.support.tobytes()][1], chosen.setting, candidates


def _at(gram: Gram, target: int, penalty: float) -> Floats:
    """Scaled coefficients (p,) at one penalty: the path is linear between the kinks on its two sides."""
    before = np.zeros(len(gram.names))
    if not gram.norms[target]:
        return before
    above = float(np.max(np.abs(gram.moments[:, target]))) / gram.norms[target]
    if penalty >= above:
        return before
    for kink, scaled in _lasso_path(gram, target):
        if kink <= penalty:
            share = (above - penalty) / (above - kink)
            return np.asarray(before + share * (scaled - before))
        above, before = kink, scaled
    return before


def _lasso_path(gram: Gram, target: int) -> Iterator[tuple[float, Floats]]:
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


@final
class LeastSquares(Regressor):
    """Ordinary least squares on every column that is not zero throughout.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(
    ...     lw.bnes_chain(2), release={"v:m1": 1.0}, duration=2.0, rate=1000.0, sensors=("x", "v", "a")
    ... )
    >>> fit = lw.sindy.LeastSquares().fit(lw.sindy.monomial_equations(lw.sindy.differentiate(record), order=3))
    >>> fit.coefficients.shape
    (35, 4)
    """

    title = "least squares, nothing thresholded"

    def _solve(self, gram: Gram, target: int) -> tuple[Solution, float, tuple[SupportCandidate, ...]]:
        return gram.solution(target), 0.0, ()
