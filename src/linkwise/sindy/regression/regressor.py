"""What every regressor does, equations in and a fit out, and the fit itself."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from linkwise.arrays import Bools, Floats
from linkwise.errors import IdentificationError
from linkwise.sindy.regression.gram import Gram
from linkwise.sindy.regression.linear_system import LinearSystem


@dataclass(frozen=True, eq=False)
class SupportCandidate:
    """One support (p,) on a regressor's path for one target.

    `setting` is the threshold or penalty that led to it, `terms` its number of columns, `residual` the norm of b - A c
    over that of b after least squares on the support in the rows that were fitted, `held_out` the same in those that were not,
    and `bic` the Bayesian information criterion of the latter (smaller is better).
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

    `coefficients` (p, T) in their own units, zero outside `support` (p, T); `standard_error` (p, T) from the residual,
    rows taken as independent, zero outside the support; `contribution` (p, T) is ||c_j A_j|| / ||b||, the share of a
    term in its equation; `residual` (T,) is ||b - A c|| / ||b||; `setting` (T,) is the threshold or penalty in force (0
    where there is none), and `paths` holds per target what was compared to choose it, empty where nothing was.
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
        """The terms of one target by name. Raises IdentificationError for a name that is no target."""
        column = self._column(target)
        return {
            self.names[j]: float(self.coefficients[j, column])
            for j in np.flatnonzero(self.support[:, column])
        }

    def require_explained(self, limit: float) -> None:
        """Raise IdentificationError, naming the targets, where more than `limit` of a target's norm is left unexplained."""
        bad = [
            f"{self.targets[t]} ({self.residual[t]:.2g})" for t in np.flatnonzero(~(self.residual <= limit))
        ]
        if bad:
            raise IdentificationError(
                f"the terms leave more than {limit:g} of these equations unexplained: {', '.join(bad)}; the library "
                "lacks a term that the motion has, or the derivatives are too noisy: try a higher "
                "order, other laws, or the weak form"
            )

    def text(self, digits: int = 6) -> str:
        """The identified equations, one a line, strongest term first: "x1'' = -29900*x1 - 1.02*v1 + ..."."""
        return "\n".join(
            f"{target} = {self._sum(column, digits)}" for column, target in enumerate(self.targets)
        )

    def _sum(self, column: int, digits: int) -> str:
        order = np.argsort(-self.contribution[:, column], kind="stable")
        written = ""
        for j in order[self.support[order, column]]:
            value = self.coefficients[j, column]
            sign = (" - " if value < 0 else " + ") if written else ("-" if value < 0 else "")
            size = f"{abs(value):.{digits}g}"
            written += sign + (size if self.names[j] == "1" else f"{size}*{self.names[j]}")
        return written or "0"

    def _column(self, target: str) -> int:
        if target not in self.targets:
            raise IdentificationError(
                f"no equation is called {target!r}; there are {', '.join(self.targets)}"
            )
        return self.targets.index(target)


class Regressor(ABC):
    """A way from equations to coefficients. Concretes choose the supports; everything else is shared.

    `title` says in a few words what a concrete does. One without arguments is made where a regressor is chosen by its name in
    `REGRESSORS`.
    """

    title: ClassVar[str]

    def with_threshold(self, threshold: float) -> Regressor:
        """The same with a threshold; raises IdentificationError for a regressor that has none."""
        raise IdentificationError(f"a threshold of {threshold!r} was given, and {self.title} has none")

    def fit(self, system: LinearSystem) -> RegressionFit:
        """Fit all targets of `system` on one Gram matrix; raises IdentificationError where that is impossible."""
        return self.fit_gram(Gram.of(system), system.units, system.targets)

    def fit_gram(self, gram: Gram, units: tuple[str, ...], targets: tuple[str, ...]) -> RegressionFit:
        """The same from a Gram matrix that exists, so several regressors can share it."""
        scaled = np.zeros((len(gram.names), len(targets)))
        setting, paths = np.zeros(len(targets)), []
        for target in range(len(targets)):
            scaled[:, target], setting[target], path = self.solve(gram, target)
            paths.append(path)
        return _fit(gram, scaled, units, targets, setting, tuple(paths))

    @abstractmethod
    def solve(self, gram: Gram, target: int) -> tuple[Floats, float, tuple[SupportCandidate, ...]]:
        """Scaled coefficients (p,) of one target, the setting in force, and the candidates that were compared."""


def _fit(
    gram: Gram,
    scaled: Floats,
    units: tuple[str, ...],
    targets: tuple[str, ...],
    setting: Floats,
    paths: tuple[tuple[SupportCandidate, ...], ...],
) -> RegressionFit:
    """Fill in what follows from the coefficients alone."""
    support = scaled != 0
    norms = np.where(gram.norms > 0, gram.norms, 1.0)
    squares = gram.sums.moved(scaled - gram.anchor).squares
    freedom = np.maximum(gram.rows - support.sum(axis=0), 1)
    variances = _variances(gram, support)
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
        paths=paths,
    )


def _variances(gram: Gram, support: Bools) -> Floats:
    """`Gram.variances` of each target's support (p, T); targets that share a support share the work."""
    found: dict[bytes, Floats] = {}
    for column in support.T:
        key = column.tobytes()
        if key not in found:
            found[key] = gram.variances(column)
    return np.column_stack([found[column.tobytes()] for column in support.T])
