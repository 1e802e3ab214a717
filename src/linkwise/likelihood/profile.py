"""Profile-likelihood intervals: where the cost, all other unknowns fitted anew, has risen by what chance allows.

They follow the likelihood where it is no parabola, which intervals from standard errors do not, and cost a few fits a side.
Venzon, Moolgavkar, "A method for computing profile-likelihood-based confidence intervals", Appl. Statist. 37 (1988).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy

from linkwise.deprecation import Deprecated, deprecated_keyword
from linkwise.errors import IdentificationError
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.link_estimate import NORMAL_95
from linkwise.likelihood.anneal import AnnealingFit, AnnealingSchedule, AnnealingStatus, anneal
from linkwise.likelihood.fit import Optimum
from linkwise.likelihood.segments import Iterate
from linkwise.progress import Progress, ProgressReport, silent

_LOOSENED = 1e3  # times the last q: from here annealing follows a coefficient that was moved
_LOOSEST = 1e-2
_CLOSE = 0.01  # of a standard error: an end of an interval is no better known
_FARTHEST = 30.0  # standard errors: an end beyond is none


@deprecated_keyword("report", Deprecated("progress", since="0.2.0", until="0.4.0"))
def profile_interval(estimate: Estimate, name: str, *, progress: Progress = silent) -> tuple[float, float]:
    """The 95 % profile-likelihood interval of the unknown `name` ("nes1.alpha", "m1.mass") of a fit by method "ml".

    The ends are where the cost has risen by 1.96^2 = 3.84, in units of what the noise left, when `name` is held and everything
    else is fitted anew. An end is the bound of the parameter where that comes first, and infinite where the cost hardly rises.
    `progress` is told each value that is tried, with the value as `detail`. Raises IdentificationError for other methods, for
    a fit that cannot be trusted, and where a fit with `name` held does not converge.
    """
    column = _column(estimate, name)
    if estimate.profile is None:
        raise IdentificationError(
            f'profile intervals need the likelihood, and method "{estimate.method}" has none: use "ml"'
        )
    if not estimate.trusted:
        raise IdentificationError(
            f"there is no interval of a fit that cannot be trusted ({estimate.status}): {estimate.explanation}"
        )
    deviation = float(np.sqrt(max(estimate.covariance[column, column], 0.0)))
    if not estimate.free[column] or not 0.0 < deviation < np.inf:
        raise IdentificationError(
            f"{name} was stopped by its bound, around which there is no interval; widen the bound"
        )
    return estimate.profile(name, deviation, progress)


def profile_ends(optimum: Optimum, name: str, deviation: float, progress: Progress) -> tuple[float, float]:
    """Both ends of the interval of the parameter `name` with standard error `deviation` around `optimum`."""
    column = optimum.segments.system.parameters.names.index(name)
    profile = _Profile(optimum, name, column, progress)
    return profile.end(-deviation), profile.end(deviation)


def _column(estimate: Estimate, name: str) -> int:
    names = [parameter.name for parameter in estimate.parameters]
    if name not in names:
        raise IdentificationError(f'"{name}" was not identified; the unknowns were {", ".join(names)}')
    return names.index(name)


class _Profile:
    """The cost along one parameter, everything else fitted anew."""

    def __init__(self, optimum: Optimum, name: str, column: int, progress: Progress) -> None:
        self.optimum, self.name, self.column, self.progress = optimum, name, column, progress
        self.best = self._fitted(optimum.point)
        self.value = float(self.best.point.theta[column])

    def end(self, deviation: float) -> float:
        """Where the cost has risen enough, on the side to which `deviation`, a standard error with a sign, points.

        The root of the rise is a straight line where the likelihood is a parabola, so one or two looks find it.
        """
        parameters = self.optimum.segments.system.parameters
        edge = float((parameters.upper if deviation > 0.0 else parameters.lower)[self.column])
        reach = min(_FARTHEST, (edge - self.value) / deviation)
        points = {0.0: self.best.point}
        excess = {0.0: -NORMAL_95}

        def beyond(moved: float) -> float:
            """The root of the rise over what chance allows, `moved` standard errors away."""
            if moved not in excess:
                nearest = min(points, key=lambda known: abs(known - moved))
                value = edge if moved == reach < _FARTHEST else self.value + moved * deviation
                self.progress(ProgressReport(0.5 * (deviation > 0.0), f"{self.name} = {value:.6g}", value))
                fit = self._fitted(points[nearest], value)
                rise = max(fit.misfit.cost(fit.q) - self.best.misfit.cost(fit.q), 0.0)
                root = float(np.sqrt(rise)) / self.optimum.noise - NORMAL_95
                points[moved], excess[moved] = fit.point, root if abs(root) > _CLOSE else 0.0
            return excess[moved]

        near, far = 0.0, min(NORMAL_95, reach)
        while beyond(far) < 0.0:
            if far == reach:
                return edge if reach < _FARTHEST else float(np.copysign(np.inf, deviation))
            straight = NORMAL_95 / max(NORMAL_95 + beyond(far), _CLOSE)
            near, far = far, min(reach, float(np.clip(straight, 1.25, 3.0)) * far)
        return self.value + float(scipy.optimize.brentq(beyond, near, far, xtol=_CLOSE)) * deviation

    def _fitted(self, start: Iterate, value: float | None = None) -> AnnealingFit:
        """The fit from `start`, the parameter held at `value` if that is given."""
        optimum = self.optimum
        system = optimum.segments.system
        if value is not None:
            lower, upper, theta = (
                a.copy() for a in (system.parameters.lower, system.parameters.upper, start.theta)
            )
            lower[self.column] = upper[self.column] = theta[self.column] = value
            system = replace(system, parameters=replace(system.parameters, lower=lower, upper=upper))
            start = replace(start, theta=theta)
        fit = anneal(
            replace(optimum.segments, system=system),
            start,
            optimum.scales,
            AnnealingSchedule(
                initial_q=max(optimum.q, min(_LOOSENED * optimum.q, _LOOSEST)), final_q=optimum.q
            ),
            loss=optimum.loss,
        )
        if fit.status is not AnnealingStatus.CONVERGED:
            raise IdentificationError(
                f"the profile of {self.name} cannot be followed: with {self.name} = {start.theta[self.column]:.6g} the fit is "
                f"{fit.status.value}; the interval from its standard error is all there is"
            )
        return fit
