"""Regressors, from a linear system to a fit: thresholded least squares (Brunton et al. 2016; step 6 of the paper's section 3),
L1-penalised (the paper's Eq. 7) and ordinary least squares, and the choice among supports by a BIC on rows held out.

On the rows that are fitted the larger support always has the smaller residual, and noise in the columns (errors in
variables) lets hundreds of wrong terms explain a little. On rows held out those terms increase the residual, and the
criterion has its minimum near the true number of terms.

The solution with a penalty is piecewise linear in it, so the path is followed exactly from kink to kink by the homotopy
method (LARS); each step is one small Cholesky factorisation on the active terms (M. R. Osborne, B. Presnell and B. A.
Turlach, IMA J. Numer. Anal. 20, 389 (2000)). Columns of monomials are strongly correlated: coordinate descent and FISTA
would need thousands of sweeps where this takes a few dozen steps.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, final

import numpy as np
from scipy.linalg import cho_solve

from linkwise.arrays import Bools, Floats
from linkwise.errors import IdentificationError
from linkwise.runtime import one_blas_thread
from linkwise.sindy.regression.gram import Gram, Solution, cholesky
from linkwise.sindy.regression.linear_system import LinearSystem


@dataclass(frozen=True, eq=False)
class SupportCandidate:
    """One support on the path of a regressor for one target.

    Attributes
    ----------
    support : array of bool, shape (p,)
        The columns.
    setting : float
        Threshold or penalty that led to it.
    terms : int
        Number of columns in the support.
    residual : float
        ||b - A c|| / ||b|| after least squares on the support, in the rows that were fitted.
    held_out : float
        The same in the rows held out.
    bic : float
        Bayesian information criterion on the rows held out; smaller is better.

    Examples
    --------
    >>> import numpy as np
    >>> import linkwise as lw
    >>> matrix = np.column_stack([np.ones(50), np.arange(50.0)])
    >>> fit = lw.sindy.Stlsq().fit(lw.sindy.DenseSystem(matrix, matrix @ [1.0, 2.0], ("a", "b"), targets=("f",)))
    >>> [candidate.terms for candidate in fit.paths[0]]
    [2, 1, 0]
    """

    support: Bools
    setting: float
    terms: int
    residual: float
    held_out: float
    bic: float


@dataclass(frozen=True, eq=False)
class RegressionFit:
    """Coefficients of p columns for T targets.

    Attributes
    ----------
    names, units, targets : tuple of str
        Names of the columns, units of their coefficients ("" where unknown) and names of the targets.
    coefficients : array of shape (p, T)
        Coefficients in their own units, zero outside the support.
    support : array of bool, shape (p, T)
        The columns that each target keeps.
    standard_error : array of shape (p, T)
        Standard errors from the residual, rows taken as independent; zero outside the support.
    contribution : array of shape (p, T)
        ||c_j A_j|| / ||b||, the share of a term in its equation.
    residual : array of shape (T,)
        ||b - A c|| / ||b||.
    setting : array of shape (T,)
        Threshold or penalty in force; 0 where there is none.
    paths : tuple of tuple of SupportCandidate
        For each target the supports that were compared; empty where the setting was given.

    Examples
    --------
    >>> import numpy as np
    >>> import linkwise as lw
    >>> matrix = np.column_stack([np.ones(50), np.arange(50.0)])
    >>> system = lw.sindy.DenseSystem(matrix, matrix @ [1.0, 2.0], ("a", "b"), targets=("f",))
    >>> print(lw.sindy.LeastSquares().fit(system).text(digits=3))
    f = 2*b + 1*a
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    targets: tuple[str, ...]
    coefficients: Floats
    support: Bools
    standard_error: Floats
    contribution: Floats
    residual: Floats
    setting: Floats
    paths: tuple[tuple[SupportCandidate, ...], ...]

    def terms(self, target: str) -> dict[str, float]:
        """Terms of one equation.

        Parameters
        ----------
        target : str
            Name of the target.

        Returns
        -------
        dict of str to float
            Coefficients by name of the column, those of the support alone.

        Raises
        ------
        IdentificationError
            If there is no such target.
        """
        column = self._column(target)
        values, retained = self.coefficients[:, column], np.flatnonzero(self.support[:, column])
        return {self.names[j]: float(values[j]) for j in retained}

    def text(self, digits: int = 6) -> str:
        """The identified equations as text.

        Parameters
        ----------
        digits : int, optional
            Significant digits.

        Returns
        -------
        str
            One equation a line, strongest term first: "x1'' = -29900*x1 - 1.02*v1 + ...".
        """
        return "\n".join(f"{name} = {self._sum(n, digits)}" for n, name in enumerate(self.targets))

    def _sum(self, column: int, digits: int) -> str:
        order = np.argsort(-self.contribution[:, column], kind="stable")
        terms = ""
        for j in order[self.support[order, column]]:
            value = self.coefficients[j, column]
            sign = (" - " if value < 0 else " + ") if terms else ("-" if value < 0 else "")
            size = f"{abs(value):.{digits}g}"
            terms += sign + (size if self.names[j] == "1" else f"{size}*{self.names[j]}")
        return terms or "0"

    def _column(self, target: str) -> int:
        if target not in self.targets:
            raise IdentificationError(f"unknown equation {target!r}; choose from {', '.join(self.targets)}")
        return self.targets.index(target)


class Regressor(ABC):
    """A method of regression on a linear system. Concrete classes choose the support; everything else is shared.

    `REGRESSORS` creates one without arguments for each name, so that all parameters need defaults.

    Attributes
    ----------
    title : str
        Short description for messages and reports, set on the class.

    Examples
    --------
    >>> import linkwise as lw
    >>> isinstance(lw.sindy.Stlsq(), lw.sindy.Regressor), lw.sindy.Stlsq.title
    (True, 'sequentially thresholded least squares')
    """

    title: ClassVar[str]

    def with_threshold(self, threshold: float) -> Regressor:
        """The same regressor with a threshold.

        Parameters
        ----------
        threshold : float
            The threshold.

        Returns
        -------
        Regressor
            A regressor with this threshold.

        Raises
        ------
        IdentificationError
            If the regressor has no threshold, or it is out of range.
        """
        raise IdentificationError(f"a threshold of {threshold!r} was given, and {self.title} has none")

    def fit(self, system: LinearSystem) -> RegressionFit:
        """Fit all targets of a system on one Gram matrix.

        Parameters
        ----------
        system : LinearSystem
            The equations.

        Returns
        -------
        RegressionFit
            The coefficients.

        Raises
        ------
        IdentificationError
            If the system is empty, columns of the support are dependent, or too few rows are left to choose a setting.
        """
        return self.fit_gram(Gram.of(system), system.units, system.targets)

    def fit_gram(
        self,
        gram: Gram,
        units: tuple[str, ...],
        targets: tuple[str, ...],
        *,
        columns: Sequence[int] | None = None,
        errors: bool = True,
    ) -> RegressionFit:
        """Fit from a Gram matrix, which several regressors can share.

        Parameters
        ----------
        gram : Gram
            Gram matrix of the system.
        units, targets : tuple of str
            Units of the coefficients and names of the targets.
        columns : sequence of int, optional
            The numbers of these targets among those of the system; by default they are all of them.
        errors : bool, default True
            Compute standard errors, which take longer than all else where a system has many columns; else they are NaN.

        Returns
        -------
        RegressionFit
            The coefficients.

        Raises
        ------
        IdentificationError
            As `fit`.
        """
        shape = len(gram.names), len(targets)
        scaled, variances = np.zeros(shape), np.full(shape, np.nan)
        setting, squares, paths = np.zeros(len(targets)), np.zeros(len(targets)), []
        chosen = list(range(len(targets)) if columns is None else columns)
        for target, column in enumerate(chosen):
            solution, setting[target], path = self._solve(gram, column)
            scaled[:, target], squares[target] = solution.scaled, solution.squares
            if errors:
                variances[:, target] = solution.variances()
            paths.append(path)
        norms, support = np.where(gram.norms > 0, gram.norms, 1.0)[chosen], scaled != 0
        freedom = np.maximum(gram.rows - support.sum(axis=0), 1)
        return RegressionFit(
            names=gram.names,
            units=units,
            targets=targets,
            coefficients=gram.unscaled(scaled),
            support=support,
            standard_error=np.sqrt(variances * squares / freedom),
            contribution=np.abs(scaled) / norms,
            residual=np.sqrt(squares) / norms,
            setting=setting,
            paths=tuple(paths),
        )

    @abstractmethod
    def _solve(self, gram: Gram, target: int) -> tuple[Solution, float, tuple[SupportCandidate, ...]]:
        """Coefficients of one target on the support that is chosen, the threshold or penalty in force (0 where there is none),
        and the supports that were compared.
        """


EXACT = 1e-11  # relative residual below which it is rounding: there fewer terms are always better


def score_support(solution: Solution, setting: float) -> SupportCandidate:
    """Score a solution on the rows that are fitted by the rows held out.

    The criterion is BIC = R log(rss / R) + k log R over the R rows held out. To the sum of squares rss is added
    (1e-11 ||b||)^2: the residual of noise-free data is rounding, which no term should explain. A support of more than half as
    many terms as rows were fitted scores infinity, since such a fit interpolates its rows.
    """
    training, target = solution.gram, solution.target
    held_out = training.held_out
    assert held_out is not None  # `Gram.training` has refused systems without
    norm = held_out.norms[target]
    squares = held_out.squares_at(solution.change, target) + (EXACT * norm) ** 2
    support = solution.scaled != 0
    terms = int(np.count_nonzero(support))
    tiny = np.finfo(np.float64).tiny
    bic = held_out.rows * np.log(max(squares, tiny) / held_out.rows) + terms * np.log(held_out.rows)
    fitted = training.norms[target]
    return SupportCandidate(
        support=support,
        setting=setting,
        terms=terms,
        residual=float(np.sqrt(solution.squares) / fitted) if fitted > 0 else 0.0,
        held_out=float(np.sqrt(squares) / norm) if norm > 0 else 0.0,
        bic=float(np.inf if terms > training.rows / 2 else bic),
    )


def best_support(candidates: Iterable[SupportCandidate]) -> SupportCandidate:
    """The candidate of smallest BIC, of one at least; among equals the one with fewer terms."""
    return min(candidates, key=lambda candidate: (candidate.bic, candidate.terms))


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
            solution = replace(solution, change=scaled - gram.anchor[:, target])
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
