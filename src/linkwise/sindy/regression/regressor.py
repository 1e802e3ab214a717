"""Regressors, from a linear system to a fit, and the choice among supports by a BIC on rows held out.

On the rows that are fitted the larger support always has the smaller residual, and noise in the columns (errors in
variables) lets hundreds of wrong terms explain a little. On rows held out those terms increase the residual, and the
criterion has its minimum near the true number of terms.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from linkwise.arrays import Bools, Floats
from linkwise.errors import IdentificationError
from linkwise.sindy.regression.gram import Gram, Solution
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
