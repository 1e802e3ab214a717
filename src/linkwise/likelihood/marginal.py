"""Maximum marginal likelihood with random forces: the states integrated out, the deviations of forces and noise found.

The most likely states are smoother than the true ones, so that states and coefficients fitted together give biased
coefficients where random forces are large: a damping of nearly zero for a structure in ambient vibration. Integrated over the
states, -2 log of the likelihood is, in the Laplace approximation, exact for linear laws,

    min over states of the cost  +  log det H  +  2 K sum log(deviation of force)  +  2 N sum log(deviation of noise) ,

with the equations H of the states. The gradient of log det H by the coefficients, which hardly varies around the optimum, is
added to the cost as a linear term, and the fit repeated until it agrees with itself. The deviations follow from the same
log det H: that of a force is the root of its sum of squares over the number of forces that the record determines (MacKay
1992).

References
----------
D. J. C. MacKay, Neural Computation 4, 415 (1992).

L. Tierney and J. B. Kadane, J. Am. Stat. Assoc. 81, 82 (1986), for the Laplace approximation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from linkwise.arrays import Bools, Floats, Indices
from linkwise.likelihood.anneal import Annealer, AnnealingFit, AnnealingSchedule, AnnealingStatus
from linkwise.likelihood.normal_equations import linearise
from linkwise.likelihood.residuals import evaluate
from linkwise.likelihood.segments import Iterate, Scales, Segments

_PARTS, _LENGTH = 8, 500  # pieces of the records, and segments in each, whose log det stands for that of all
_STEP = 0.5  # standard errors: for the differences of log det by an unknown
_LOG_STEP = 0.05  # for those by the logarithm of a deviation
_ROUNDS = 30
_SETTLED = 0.05  # standard errors, or of the logarithm of a deviation over `_LOG_WEIGHT`
_LOG_WEIGHT = 5.0
_LARGEST_CHANGE = 1.5  # of the logarithm of a deviation in one round
_HIDDEN = 0.03  # of a random force: the error that the relaxation of the flow stands for beside it
_LOOSEST = 0.02  # relaxation


def relaxation(segments: Segments, scales: Scales, theta: Floats) -> float:
    """The relaxation q of the flow that is small beside the random forces, and no smaller than rounding needs.

    Parameters
    ----------
    segments : Segments
        The records in segments, with random forces.
    scales : Scales
        Units of the states.
    theta : array of shape (p,)
        The parameters.

    Returns
    -------
    float
        The relaxation.
    """
    random = segments.random
    assert random is not None
    n = len(segments.system.incidence)
    mechanics = segments.system.at(theta)
    links = segments.system.state_links[random.rows - 2 * n]
    gain = np.abs(mechanics.gain[:, links])  # (n, r)
    kick = np.einsum("nr,rk->nrk", gain, random.deviation * segments.step * segments.steps).mean(axis=2)
    ratio = (kick / scales.state[n : 2 * n, None])[gain > 0.0]
    return float(np.clip(_HIDDEN * ratio.min(), AnnealingSchedule.final_q, _LOOSEST))


def marginal_fit(
    segments: Segments, fit: AnnealingFit, known_noise: Bools, annealer: Annealer
) -> tuple[Segments, AnnealingFit]:
    """Maximise the marginal likelihood, from a fit of states and parameters together.

    Parameters
    ----------
    segments : Segments
        The records in segments, with random forces.
    fit : AnnealingFit
        The fit; another than a converged one is returned as it is.
    known_noise : array of bool, shape (C,)
        Whether the noise of a channel is stated, and so not found.
    annealer : Annealer
        How annealing runs.

    Returns
    -------
    segments : Segments
        The segments with the deviations found.
    fit : AnnealingFit
        The fit at the maximum, exhausted where it did not settle.
    """
    path = fit.path
    for _ in range(_ROUNDS):
        if fit.status is not AnnealingStatus.CONVERGED:
            return segments, replace(fit, path=path)
        change, segments, start, scales = _next_round(segments, fit, known_noise, annealer)
        if change < _SETTLED:
            return segments, replace(fit, path=path)
        q = relaxation(segments, scales, start.theta)
        fit = annealer(segments, start, scales, AnnealingSchedule(initial_q=q, final_q=q))
        path = (*path, *fit.path)
    return segments, replace(fit, path=path, status=AnnealingStatus.EXHAUSTED)


def parts_of(segments: Segments) -> tuple[Indices, float]:
    """Segments that stand for all, in pieces that follow each other, and how many times as many there are.

    Parameters
    ----------
    segments : Segments
        The segments.

    Returns
    -------
    which : array of int
        Their numbers.
    share : float
        The number of all over theirs.
    """
    count = segments.count
    if count <= _PARTS * _LENGTH:
        return np.arange(count), 1.0
    firsts = np.linspace(0, count - _LENGTH, _PARTS).astype(int)
    which = (firsts[:, None] + np.arange(_LENGTH)).ravel()
    return which, count / len(which)


def _next_round(
    segments: Segments, fit: AnnealingFit, known_noise: Bools, annealer: Annealer
) -> tuple[float, Segments, Iterate, Scales]:
    """The largest change, and segments, start and scales of the next fit."""
    random = segments.random
    assert random is not None
    determinant = _LogDeterminant.of(segments, fit, annealer)
    border, deviation = fit.point.border, np.sqrt(np.maximum(fit.covariance.diagonal(), 0.0))
    slope = determinant.slope(~fit.at_bound, deviation)
    before = 0.0 if random.slope is None else random.slope
    shift = -0.5 * fit.covariance @ (slope - before)
    noise, force = determinant.freedoms(known_noise)
    of_noise = np.where(known_noise, 1.0, _ratio(np.sum(fit.misfit.residuals**2, axis=(0, 2)), noise))
    forces = fit.point.nodes[random.rows] / random.deviation
    of_force = np.where(random.found, _ratio(np.sum(forces**2, axis=1), force), 1.0)
    moved = np.abs(shift[deviation > 0.0]) / deviation[deviation > 0.0]
    logs = np.log(np.concatenate([of_noise, of_force]))
    change = max(float(moved.max(initial=0.0)), _LOG_WEIGHT * float(np.abs(logs).max()))
    state = fit.scales.state.copy()
    state[random.rows] *= of_force
    scales = replace(fit.scales, sigma=fit.scales.sigma * of_noise, state=state)
    following = replace(segments, random=replace(random.scaled(of_force), slope=slope))
    return change, following, fit.point.moved(fit.point.nodes, border + shift), scales


def _ratio(squares: Floats, freedom: Floats) -> Floats:
    """Factors on deviations, from sums of squares in their units and the numbers that the record determines."""
    found = np.sqrt(squares / np.maximum(freedom, 1.0))
    return np.clip(found, np.exp(-_LARGEST_CHANGE), np.exp(_LARGEST_CHANGE))


@dataclass(frozen=True, eq=False)
class _LogDeterminant:
    """Log det of the equations of the states in parts of the records, times `factor` to stand for all."""

    segments: Segments
    point: Iterate
    scales: Scales
    q: float
    annealer: Annealer
    factor: float

    @classmethod
    def of(cls, segments: Segments, fit: AnnealingFit, annealer: Annealer) -> _LogDeterminant:
        """That of the equations of a fit."""
        which, share = parts_of(segments)
        point = replace(fit.point, nodes=fit.point.nodes[:, which])
        return cls(segments.chosen(which), point, fit.scales, fit.q, annealer, share)

    def slope(self, free: Bools, deviation: Floats) -> Floats:
        """(P,) its gradient by the unknowns that all nodes share, zero for those that are not free."""
        border = self.point.border

        def at(column: int, step: float) -> float:
            moved = border.copy()
            moved[column] += step
            return replace(self, point=self.point.moved(self.point.nodes, moved)).value()

        steps = np.where(free, _STEP * deviation, 0.0)
        return np.array(
            [
                _slope(partial(at, column), float(size)) if size > 0.0 else 0.0
                for column, size in enumerate(steps)
            ]
        )

    def freedoms(self, known_noise: Bools) -> tuple[Floats, Floats]:
        """(C,) residuals and (r,) forces that the record determines, of those whose deviations are to be found."""
        random = self.segments.random
        assert random is not None
        residuals = self.factor * self.segments.observed.sum(axis=(0, 2)).astype(float)
        forces = np.full(len(random.rows), self.factor * self.segments.count)
        for channel in np.flatnonzero(~known_noise).tolist():
            residuals[channel] += 0.5 * _slope(partial(self._louder, channel), _LOG_STEP)
        for force in np.flatnonzero(random.found).tolist():
            forces[force] += 0.5 * _slope(partial(self._stronger, force), _LOG_STEP)
        return residuals, forces

    def _louder(self, channel: int, step: float) -> float:
        sigma = self.scales.sigma.copy()
        sigma[channel] *= np.exp(step)
        return replace(self, scales=replace(self.scales, sigma=sigma)).value()

    def _stronger(self, force: int, step: float) -> float:
        random = self.segments.random
        assert random is not None
        factors = np.ones(len(random.rows))
        factors[force] = np.exp(step)
        return replace(self, segments=replace(self.segments, random=random.scaled(factors))).value()

    def value(self) -> float:
        misfit = evaluate(self.segments, self.point, self.scales, self.annealer.loss)
        linear = linearise(self.segments, misfit, self.scales, self.annealer.loss, self.annealer.executor)
        factor = linear.equations(self.q).factor()
        return np.nan if factor is None else self.factor * 2.0 * float(np.log(factor.chol[0]).sum())


def _slope(function: Callable[[float], float], step: float) -> float:
    """Derivative by a central difference, zero where it is not finite."""
    slope = (function(step) - function(-step)) / (2.0 * step)
    return slope if np.isfinite(slope) else 0.0
