"""Profile-likelihood intervals: where the cost, minimised over all other unknowns, reaches its 95 % quantile.

They follow the likelihood where it is not quadratic, which intervals from standard errors do not, at the cost of a few fits
for each end.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy

from linkwise.errors import IdentificationError, expect
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.link_estimate import NORMAL_95
from linkwise.likelihood.optima.other_optima import refitted
from linkwise.likelihood.search import Optimum
from linkwise.likelihood.shooting.minimise import AnnealingFit, AnnealingStatus
from linkwise.likelihood.shooting.segments import Iterate
from linkwise.progress import Progress, ProgressReport, silent
from linkwise.verdict import Grade

_CLOSE = 0.01  # of a standard error: accuracy of an end of an interval
_FARTHEST = 30.0  # standard errors: an end beyond is infinite


def profile_interval(estimate: Estimate, name: str, *, progress: Progress = silent) -> tuple[float, float]:
    """95 % profile-likelihood interval of an unknown.

    Each end is the value at which the cost, with the unknown held and everything else fitted again, has risen by 1.96^2 =
    3.84 in units of the noise.

    Parameters
    ----------
    estimate : Estimate
        A trusted estimate by the method "ml".
    name : str
        Name of the unknown, such as "nes1.alpha" or "m1.mass".
    progress : Progress, optional
        Called with each value that is tried as detail.

    Returns
    -------
    lower, upper : float
        The ends in SI units: the bound of the parameter where that comes first, infinite where the cost hardly rises.

    Raises
    ------
    IdentificationError
        If the estimate has no likelihood or is not trusted, the name is not an unknown or is at its bound, or a fit with the
        unknown held does not converge.

    References
    ----------
    D. J. Venzon and S. H. Moolgavkar, Appl. Statist. 37, 87 (1988).

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=1.0, rate=1000.0).with_noise(30.0, seed=1)
    >>> estimate = lw.identify(record, chain.unknown("nes1.alpha"))
    >>> lower, upper = lw.likelihood.profile_interval(estimate, "nes1.alpha")
    >>> f"{lower:.1f} to {upper:.1f} N/m"
    '-101.0 to -98.4 N/m'
    """
    expect("profile_interval(estimate, name): estimate", estimate, Estimate)
    names: list[str] = [parameter.name for parameter in estimate.parameters]
    if name not in names:
        raise IdentificationError(f'"{name}" was not identified; the unknowns were {", ".join(names)}')
    column = names.index(name)
    if estimate.profile is None:
        raise IdentificationError(
            f'profile intervals need the likelihood, and method "{estimate.method}" has none: use "ml"'
            if estimate.method != "ml"
            else "a profile does not allow for terms that are missing or that a discovery dropped, nor for noise of an input "
            "that the residuals hint at, as its intervals do"
        )
    if estimate.grade is Grade.REFUSED:
        raise IdentificationError(
            f"no interval is given for a fit that cannot be trusted ({estimate.status}): {estimate.explanation}"
        )
    deviation = float(np.sqrt(max(estimate.covariance[column, column], 0.0)))
    if not estimate.free[column] or not 0.0 < deviation < np.inf:
        raise IdentificationError(
            f"{name} was stopped by its bound, around which there is no interval; widen the bound"
        )
    return estimate.profile(name, deviation, progress)


def with_profiles(estimate: Estimate, progress: Progress) -> Estimate:
    """The estimate with the profile intervals of all unknowns that have one, and remarks on those that have none.

    Shapes of hosts, of which there are dozens, are left out, as is what is left when the user interrupts. Without trust there
    is none.
    """
    if estimate.grade is Grade.REFUSED:
        return estimate
    shapes = {shape.name for shape in estimate.shapes}
    names = [parameter.name for parameter in estimate.parameters if parameter.name not in shapes]
    intervals: dict[str, tuple[float, float]] = {}
    lacking: dict[str, list[str]] = (
        {"they are dozens": [f"the {len(shapes)} shapes of hosts"]} if shapes else {}
    )
    try:
        for number, name in enumerate(names):
            progress(ProgressReport(number / len(names), f"profile of {name}"))
            try:
                intervals[name] = profile_interval(estimate, name)
            except IdentificationError as error:
                lacking.setdefault(str(error), []).append(name)
    except KeyboardInterrupt:
        lacking["interrupted"] = [str(name) for name in names[number:]]
    remarks = (f"No profile interval of {', '.join(left)}: {reason}." for reason, left in lacking.items())
    return replace(estimate, profile_intervals=intervals, remarks=(*estimate.remarks, *remarks))


def profile_ends(optimum: Optimum, name: str, deviation: float, progress: Progress) -> tuple[float, float]:
    """Both ends of a profile-likelihood interval.

    Parameters
    ----------
    optimum : Optimum
        The optimum.
    name : str
        Name of the parameter.
    deviation : float
        Its standard error.
    progress : Progress
        Called with each value that is tried.

    Returns
    -------
    lower, upper : float
        The ends.

    Raises
    ------
    IdentificationError
        If a fit with the parameter held does not converge.
    """
    column = optimum.segments.system.parameters.names.index(name)
    profile = Profile(optimum, column, deviation, progress)
    return profile.end(-deviation), profile.end(deviation)


class Profile:
    """The cost along one parameter, by its number, minimised over everything else, from the `value` at the optimum on.

    `lowest` is the least rise of -2 log likelihood that was met, below zero where there is a higher optimum. Ends are as
    `close` as so many standard errors.
    """

    def __init__(
        self,
        optimum: Optimum,
        column: int,
        deviation: float,
        progress: Progress = silent,
        close: float = _CLOSE,
    ) -> None:
        self.optimum, self.column, self.progress, self.close = optimum, column, progress, close
        self.name = optimum.segments.system.parameters.names[column]
        self.noise = optimum.noise
        if optimum.of_white is not None:  # as which the cost takes the noise
            self.noise *= deviation / float(np.sqrt(optimum.of_white[column, column]))
        self.best = self._fitted(optimum.point)
        self.value, self.lowest = float(self.best.point.theta[column]), 0.0

    def end(self, deviation: float) -> float:
        """End of the interval on the side given by the sign of `deviation`, a standard error.

        The root of the rise is linear where the likelihood is quadratic, so one or two fits find it.
        """
        parameters = self.optimum.segments.system.parameters
        edge = float((parameters.upper if deviation > 0.0 else parameters.lower)[self.column])
        reach = min(_FARTHEST, (edge - self.value) / deviation)
        points = {0.0: self.best.point}
        excess = {0.0: -NORMAL_95}

        def beyond(moved: float) -> float:
            """Root of the rise of the cost less its 95 % quantile, `moved` standard errors away."""
            if moved not in excess:
                nearest = min(points, key=lambda known: abs(known - moved))
                value = edge if moved == reach < _FARTHEST else self.value + moved * deviation
                self.progress(ProgressReport(0.5 * (deviation > 0.0), f"{self.name} = {value:.6g}", value))
                fit = self._fitted(points[nearest], value)
                rise = (fit.misfit.cost(fit.q) - self.best.misfit.cost(fit.q)) / self.noise**2
                self.lowest = min(self.lowest, rise)
                root = float(np.sqrt(max(rise, 0.0))) - NORMAL_95
                points[moved], excess[moved] = fit.point, root if abs(root) > self.close else 0.0
            return excess[moved]

        near, far = 0.0, min(NORMAL_95, reach)
        while beyond(far) < 0.0:
            if far == reach:
                return edge if reach < _FARTHEST else float(np.copysign(np.inf, deviation))
            linear = NORMAL_95 / max(NORMAL_95 + beyond(far), self.close)
            near, far = far, min(reach, float(np.clip(linear, 1.25, 3.0)) * far)
        return self.value + float(scipy.optimize.brentq(beyond, near, far, xtol=self.close)) * deviation

    def _fitted(self, start: Iterate, value: float | None = None) -> AnnealingFit:
        """The fit from `start`, the parameter held at `value` if that is given."""
        is_fixed = np.zeros(len(start.theta), dtype=bool)
        if value is not None:
            is_fixed[self.column] = True
            start = replace(start, theta=np.where(is_fixed, value, start.theta))
        fit = refitted(self.optimum, start, is_fixed)
        if fit.status is not AnnealingStatus.CONVERGED:
            raise IdentificationError(
                f"the profile of {self.name} cannot be followed: with {self.name} = {start.theta[self.column]:.6g} the fit is "
                f"{fit.status.value}; use the interval from its standard error"
            )
        return fit
