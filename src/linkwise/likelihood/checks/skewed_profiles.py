"""Coefficients whose profile of the likelihood is skewed: intervals as wide as it reaches, not as a parabola would.

Standard errors take -2 log likelihood for a parabola. A motion that nearly comes to rest between two wells goes into the other
one as soon as a coefficient passes some value: on that side the profile is a wall, on the other it rises slowly. The curvature
at the optimum is mostly that of the wall, and a true value on the slow side is many standard errors away.

To third order a profile rises by s^2 - a s^3 at s standard errors. Its third derivative follows from first derivatives of the
states by the coefficient: along these the flow leaves defects of second order, which pull at the coefficient with a, its
acceleration along its own profile. One direction along all profiles at once tells which coefficients to look at.

References
----------
D. M. Bates and D. G. Watts, J. R. Statist. Soc. B 42, 1 (1980), for parameter-effects curvature.
M. K. Transtrum and J. P. Sethna, arXiv:1201.5885 (2012), for the acceleration by second directional derivatives.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.display import enumerated
from linkwise.errors import IdentificationError
from linkwise.estimates.link_estimate import NORMAL_95
from linkwise.likelihood.checks.judgement import SKEWED, Examined, Judgement
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.optima.other_optima import along_profile, is_loosened, rises_by, with_faint_modes
from linkwise.likelihood.optima.profiles import Profile
from linkwise.likelihood.shooting.minimise import pull_of_defects
from linkwise.likelihood.tests.diagnosis import TestedCauses
from linkwise.likelihood.tests.variances import free_of_bounds
from linkwise.verdict import Verdict

_SKEWED = 0.3
"""Acceleration beyond which a profile is followed. Of 768 fits of two masses at 16 to 40 dB one in 18 is beyond; below it most
profiles end within a quarter of where standard errors say, and errors are as large as these."""
_CLOSE = 0.03  # standard errors, to which an end is followed
_WIDER = 1.05  # times as wide, that an interval is said to be
_BEYOND = 6.0, 9.0  # standard errors at which a wall is looked over
_TOO_LITTLE = 0.5  # of the rise expected there
_LOWER = -0.5  # of -2 log likelihood: there is another optimum, which is higher


def skewed_profiles(of: Examined, before: Judgement) -> Judgement | None:
    """Whether profiles of the likelihood are skewed, beside nothing but exact laws and white noise.

    Intervals reach as far as these do; none where they cannot be followed. Those of faint modes do not rest on the covariance.
    """
    fit = of.fit
    exact = before.verdict is Verdict.CONVERGED and not fit.random_forces and fit.optimum.coloured is None
    if not exact or not fit.free.any():
        return None
    faint, names = with_faint_modes(fit, of.identified)[1], fit.names
    accelerations = _accelerations(fit, of.diagnosis.tested)
    reaches: dict[int, float] = {}
    for number in np.flatnonzero(fit.free & [name not in faint for name in names]).tolist():
        acceleration = accelerations.get(number, 0.0)
        if not abs(acceleration) < _SKEWED:
            reach = _reach_on_slow_side(fit, number, acceleration)
        elif any(_is_wall(fit, number, side=side) for side in (1.0, -1.0)):
            continue
        else:
            reach = None
        if reach is None:
            doubted = before.saying(
                f"But the likelihood of {names[number]} either cannot be followed to the end of its interval, or rises again "
                "beyond. Hold it at a known value, or add a record of another motion or with less noise."
            )
            return replace(doubted, verdict=Verdict.SEVERAL_OPTIMA)
        reaches[number] = reach / NORMAL_95
    wider = {number: factor for number, factor in reaches.items() if factor > _WIDER}
    if not wider:
        return None
    named = enumerated([f"{names[number]} ({factor:.2g} times)" for number, factor in wider.items()])
    remark = f"The likelihood falls slowly on one side of {named}; intervals reach as far as it does."
    return before.saying(remark, {SKEWED: _added(fit.covariance, wider)})


def _added(covariance: Floats, factors: dict[int, float]) -> Floats:
    """(p, p) what makes standard errors larger by `factors`, along the profiles; of two that share one, the wider counts."""
    added = np.zeros_like(covariance)
    for number in sorted(factors, key=lambda number: -factors[number]):
        variance = covariance[number, number]
        lacking = factors[number] ** 2 * variance - variance - added[number, number]
        if lacking > 0.0:
            along = covariance[:, number] / variance
            added += lacking * np.outer(along, along)
    return added


def _is_wall(fit: LikelihoodFit, number: int, *, side: float) -> bool:
    """Whether the likelihood of a parameter stays low on a side, looked at where the laws hold loosely.

    There the likelihood of exact laws has other optima, of which noise may make a wrong one the highest.
    """
    if not is_loosened(fit):
        return True
    return all(
        rises_by(_TOO_LITTLE, fit, *along_profile(fit, number, side * distance), distance)
        for distance in _BEYOND
    )


def _reach_on_slow_side(fit: LikelihoodFit, number: int, acceleration: float) -> float | None:
    """The reach of a profile on its slow side, or the farther of both where the motion runs away, which hides which it is.

    None where it is not found, or the other side is no wall.
    """
    farthest = 0.0
    for side in (float(np.sign(acceleration)),) if np.isfinite(acceleration) else (1.0, -1.0):
        reach = _reach(fit, number, side=side) if _is_wall(fit, number, side=-side) else None
        if reach is None:
            return None
        farthest = max(farthest, reach)
    return farthest


def _reach(fit: LikelihoodFit, number: int, *, side: float) -> float | None:
    """How many standard errors away, on a side, the profile of a parameter is at its 95 % quantile; None if that is not found,
    too far away, or there is a higher optimum on the way.
    """
    error = float(np.sqrt(fit.covariance[number, number]))
    try:
        profile = Profile(fit.optimum, number, error, close=_CLOSE)
        end = profile.end(side * error)
    except IdentificationError:
        return None
    reach = abs(end - profile.value) / error
    return reach if np.isfinite(reach) and profile.lowest >= _LOWER else None


@np.errstate(over="ignore", invalid="ignore")  # a motion that runs away bends without end
def _accelerations(fit: LikelihoodFit, tested: TestedCauses | None) -> dict[int, float]:
    """Accelerations along their own profiles, in standard errors, of the parameters that may have large ones.

    Those that have none of a move along the profiles of all are left out; all of long records in pieces, and where the model
    in which causes were `tested` is singular.
    """
    if tested is None or tested.quadratic.model is None:
        return {}
    optimum, model = tested.longer, tested.quadratic.model
    misfit, point, schur, free = optimum.misfit, optimum.point, model.factor.schur, free_of_bounds(fit)
    covariance, none = np.zeros_like(schur), np.zeros(len(schur), dtype=bool)
    still = model.factor.solve(none)
    try:
        covariance[np.ix_(free, free)] = np.linalg.inv(schur[np.ix_(free, free)])
    except np.linalg.LinAlgError:
        return {}
    errors = np.sqrt(np.maximum(covariance.diagonal(), 0.0))
    if still is None or not (np.isfinite(errors).all() and (errors[free] > 0.0).all()):
        return {}
    units = np.where(free, errors, 1.0)
    profiles = (
        covariance / units[:, None]
    )  # moves of the scaled border along that of each, by one standard error

    def acceleration(border: Floats, length: float) -> Floats:
        """(P,) second derivatives of the border, in standard errors, by a move of it (P,) that the nodes follow.

        They are differences over a `length` of the move.
        """
        solved = model.factor.solve(none, border)
        assert solved is not None  # which was solved before
        nodes = ((solved[0] - still[0]) * optimum.scales.state).T
        moved = border * optimum.scales.theta
        both = [
            misfit.at(point.moved(point.nodes + part * nodes, point.border + part * moved)).defects
            for part in (length, -length)
        ]
        bent = (both[0] + both[1] - 2.0 * misfit.defects) / length**2
        pull = pull_of_defects(model.linear, bent.reshape(len(nodes), -1).T / optimum.q**2)
        change = model.factor.moved(*pull).reduced - model.factor.reduced
        return np.asarray(covariance @ change / units, dtype=float)

    numbers = np.flatnonzero(fit.free)
    of_all: Floats = profiles[numbers[0]].copy()
    for number in numbers[1:].tolist():  # with signs by which none takes a part of another back
        of_all += np.copysign(1.0, of_all[number]) * profiles[number]
    along = acceleration(of_all, len(numbers) ** -0.5)
    skewed = numbers[~(np.abs(along[numbers]) < _SKEWED)].tolist()
    return {number: float(acceleration(profiles[number], 1.0)[number]) for number in skewed}
