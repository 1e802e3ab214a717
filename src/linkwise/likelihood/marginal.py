"""Searches that stop short of exact laws: with random forces, states integrated out, and in long records of few masses.

With random forces the deviations of forces and noise are found with the coefficients. The most likely states are smoother than
the true ones, so that states and coefficients fitted together give biased coefficients where random forces are large: a
damping of nearly zero for a structure in ambient vibration. Integrated over the states, -2 log of the likelihood is, in the
Laplace approximation, exact for linear laws,

    min over states of the cost  +  log det H  +  2 K sum log(deviation of force)  +  2 N sum log(deviation of noise) ,

with the equations H of the states. The gradient of log det H by the coefficients, which hardly varies around the optimum, is
added to the cost as a linear term, and the fit repeated until it agrees with itself. The deviations follow from the same
log det H: that of a force is the root of its sum of squares over the number of forces that the record determines (MacKay
1992).

In a long record of few masses the links between segments are tightened only as far as its likelihood has one optimum. A search
that tightens the links between segments as far as in other records creeps in a long chaotic one. Somewhere in it the motion
comes close to where neighbouring motions part, and there the likelihood of exact laws has many optima: each of a hundred
thousand samples has its own such places, the damping that one of them needs holds back all others, and where the search ends
is one optimum of many. With looser links the motion forgets before that happens. The tightest links are taken at which few
steps lead to an optimum that looser links do not contradict: of two estimates, one of which uses more of the same data, the
difference has the covariance of the one less that of the other.

References
----------
A. C. Aitken, Proc. R. Soc. Edinb. 46, 289 (1926).

D. J. C. MacKay, Neural Computation 4, 415 (1992).

L. Tierney and J. B. Kadane, J. Am. Stat. Assoc. 81, 82 (1986), for the Laplace approximation.

J. A. Hausman, Econometrica 46, 1251 (1978), for the test of two relaxations.
"""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np
import scipy

from linkwise.arrays import Bools, Floats, Indices
from linkwise.likelihood.noise import evidence
from linkwise.likelihood.shooting.minimise import Annealer, AnnealingFit, AnnealingSchedule, AnnealingStatus
from linkwise.likelihood.shooting.normal_equations import Linearization, chunks, linearise
from linkwise.likelihood.shooting.residuals import Misfit
from linkwise.likelihood.shooting.segments import Segments
from linkwise.likelihood.shooting.system import MANY
from linkwise.likelihood.shooting.tangents import whitened_jacobian

_PARTS, _LENGTH = 8, 500  # pieces of the records, and segments in each, whose log det stands for that of all
_STEP = 0.5  # standard errors: for the differences of log det by an unknown
_ROUNDS = 30
_SETTLED = 0.05  # standard errors, or of the logarithm of a deviation over `_LOG_WEIGHT`
_LOG_WEIGHT = 5.0
_SLOWEST = 0.95  # ratio of the changes of two rounds that is believed
# of the samples: fewer errors of samples that a record determines do not determine their deviation
_ENOUGH = 0.02
# of the values of a random force: where a record determines fewer, its deviation is as good as zero
_NONE = 0.1
# changes of the logarithms of deviations, after which slopes that scatter do so by rounding
_NEARLY_SETTLED = 0.05
_ONWARD = 0.9  # cosine of the angle between changes of two rounds, below which they scatter
_LARGEST_CHANGE = 1.5  # of the logarithm of a deviation in one round
_HIDDEN = 0.03  # of a random force: the error that the relaxation of the flow stands for beside it
_LOOSEST = 0.02  # relaxation


def relaxation(misfit: Misfit) -> float:
    """The relaxation q of the flow that is small beside the random forces, and no smaller than rounding needs.

    Parameters
    ----------
    misfit : Misfit
        That of the records, with random forces; its residuals are not used.

    Returns
    -------
    float
        The relaxation.
    """
    segments, scales = misfit.segments, misfit.scales
    random, mechanics = segments.random, misfit.mechanics
    assert random is not None
    n = len(segments.system.incidence)
    states = random.rows - 2 * n
    gain = np.abs(mechanics.gain[:, segments.system.state_links[states]])  # (n, r)
    gain[:, states == segments.system.base_error] = _gain_of_base(misfit)[:, None]
    kick = np.einsum("nr,rk->nrk", gain, random.deviation * segments.step * segments.steps).mean(axis=2)
    ratio = (kick / scales.state[n : 2 * n, None])[(gain > 0.0) & random.present]
    if not random.present.any():
        return AnnealingSchedule.final_q
    return float(np.clip(_HIDDEN * ratio.min(initial=np.inf), AnnealingSchedule.final_q, _LOOSEST))


def _gain_of_base(misfit: Misfit) -> Floats:
    """(n,) root mean square of the accelerations of masses by a displacement of the base, where segments begin."""
    (d, v), inside = misfit.trajectories.links[0], misfit.trajectories.memory[0]
    slopes = misfit.mechanics.partials(d, v, inside)
    pulls = misfit.mechanics.gain @ (misfit.segments.system.base[:, None] * slopes.by_d)
    return np.asarray(np.sqrt(np.mean(pulls**2, axis=1)))


def marginal_fit(fit: AnnealingFit, known_noise: Bools, annealer: Annealer) -> AnnealingFit:
    """Maximise the marginal likelihood, from a fit of states and parameters together.

    Parameters
    ----------
    fit : AnnealingFit
        The fit, with random forces; another than a converged one is returned as it is.
    known_noise : array of bool, shape (C,)
        Whether the noise of a channel is stated, and so not found.
    annealer : Annealer
        How annealing runs.

    Returns
    -------
    AnnealingFit
        The fit at the maximum, with the deviations found, exhausted where it did not settle.
    """
    path, before, slopes = fit.path, None, _MeanSlope()
    for _ in range(_ROUNDS):
        if fit.status is not AnnealingStatus.CONVERGED:
            return replace(fit, path=path)
        segments, change, logs, slope, border = _changes(fit, known_noise, annealer, slopes)
        misfit = replace(fit.misfit, segments=segments)
        random = segments.random
        # forces that vary within a segment leave no defects at first
        loosens = random and random.varying.any() and random.weights is None
        if change < _SETTLED and not loosens:
            return replace(fit, misfit=misfit, path=path)
        logs, before = _extrapolated(logs, before)
        misfit = _changed(misfit, logs, slope, border)
        q = relaxation(misfit)
        misfit = replace(misfit, segments=_loosened(misfit, q))
        fit = annealer(misfit.at(misfit.point), AnnealingSchedule(initial_q=q, final_q=q))
        path = (*path, *fit.path)
    return replace(fit, path=path, status=AnnealingStatus.EXHAUSTED)


def _loosened(misfit: Misfit, q: float) -> Segments:
    """The segments with the defects of displacements that forces leave which vary within them, at a relaxation.

    White noise of a mean F over a time h moves a mass by F h^2 / 2m, and by what is independent of its mean and has a standard
    deviation of s h^2 / (m sqrt(12)), s being that of F.
    """
    segments, mechanics = misfit.segments, misfit.mechanics
    random, n = segments.random, len(segments.system.incidence)
    assert random is not None
    chosen = np.flatnonzero(random.varying & random.present)
    gain = mechanics.gain[:, segments.system.state_links[random.rows[chosen] - 2 * n]]
    powers = gain**2 @ random.deviation[chosen] ** 2 / 12.0
    sizes = np.sqrt(powers) * (segments.step * segments.steps) ** 2 / misfit.scales.state[:n, None]
    weights = np.ones((segments.system.dimension, segments.count))
    weights[:n] = q / np.maximum(sizes, q)
    return replace(segments, random=replace(random, weights=weights))


def parts_of(segments: Segments) -> tuple[Indices, float]:
    """Segments that stand for all, in pieces that follow each other, and how many times as many there are.

    Of linear laws any do, of others only all: log det changes with the size of the motion, which differs from piece to piece.

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
    count, system, random = segments.count, segments.system, segments.random
    forced = 0 if random is None else len(random.rows)
    linear = len(system.linear_links) + forced == system.incidence.shape[1]
    if count <= _PARTS * _LENGTH or not linear:
        return np.arange(count), 1.0
    firsts = np.linspace(0, count - _LENGTH, _PARTS).astype(int)
    which = (firsts[:, None] + np.arange(_LENGTH)).ravel()
    return which, count / len(which)


def _changes(
    fit: AnnealingFit, known_noise: Bools, annealer: Annealer, slopes: _MeanSlope
) -> tuple[Segments, float, Floats, Floats, Floats]:
    """The largest change; those of the logarithms of deviations (C + r,), the new slope (P,) and unknowns (P,).

    The segments, first, say which forces are absent: where none acts, a deviation would shrink for ever.
    """
    segments, random = fit.misfit.segments, fit.misfit.segments.random
    assert random is not None
    determinant = _LogDeterminant.of(fit, annealer)
    deviation = np.sqrt(np.maximum(fit.covariance.diagonal(), 0.0))
    noise, force = determinant.freedoms(known_noise)
    measurable = ~known_noise & (noise > _ENOUGH * segments.observed.sum(axis=(0, 2)))
    of_noise = np.where(measurable, _log_ratio(np.sum(fit.misfit.residuals**2, axis=(0, 2)), noise), 0.0)
    forces = fit.point.nodes[random.rows] / random.deviation
    vanishing = force < _NONE
    of_force = np.where(random.is_estimated & ~vanishing, _log_ratio(np.sum(forces**2, axis=1), force), 0.0)
    logs = np.concatenate([of_noise, of_force])
    before = np.zeros(len(deviation)) if random.slope is None else random.slope
    slope = determinant.slope(~fit.at_bound, deviation)
    slope = slopes.following(slope, before, deviation, settled=float(np.abs(logs).max()) < _NEARLY_SETTLED)
    shift = -0.5 * fit.covariance @ (slope - before)
    moved = np.abs(shift[deviation > 0.0]) / deviation[deviation > 0.0]
    segments = replace(segments, random=replace(random, absent=random.is_estimated & vanishing))
    change = max(float(moved.max(initial=0.0)), _LOG_WEIGHT * float(np.abs(logs).max()))
    return segments, change, logs, slope, fit.point.border + shift


def _extrapolated(logs: Floats, before: Floats | None) -> tuple[Floats, Floats | None]:
    """Changes, those that shrink slowly from round to round summed to their end in every second one (Aitken 1926)."""
    if before is None:
        return logs, logs
    ratio = np.divide(logs, before, out=np.zeros_like(logs), where=before != 0.0)
    factor = np.where(ratio > 0.0, 1.0 / (1.0 - np.clip(ratio, 0.0, _SLOWEST)), 1.0)
    return np.clip(factor * logs, -_LARGEST_CHANGE, _LARGEST_CHANGE), None


def _changed(misfit: Misfit, logs: Floats, slope: Floats, border: Floats) -> Misfit:
    """Segments, scales and start of the next fit, with residuals that are not those there yet."""
    random, scales = misfit.segments.random, misfit.scales
    assert random is not None
    of_noise, of_force = np.split(np.exp(logs), [len(scales.sigma)])
    state = scales.state.copy()
    state[random.rows] *= of_force
    tilted = replace(random.scaled(of_force), slope=slope, origin=border)
    return replace(
        misfit,
        segments=replace(misfit.segments, random=tilted),
        scales=replace(scales, sigma=scales.sigma * of_noise, state=state),
        point=misfit.point.moved(misfit.point.nodes, border),
    )


def _log_ratio(squares: Floats, freedom: Floats) -> Floats:
    """Logarithms of factors on deviations, from sums of squares in their units and the numbers that the record determines."""
    log_factors = 0.5 * np.log(np.maximum(squares, np.finfo(float).tiny) / np.maximum(freedom, 1.0))
    return np.clip(log_factors, -_LARGEST_CHANGE, _LARGEST_CHANGE)


class _MeanSlope:
    """The gradient of log det from round to round: the mean of those that scatter by rounding, so that the rounds settle.

    Where the noise of sensors is far below what the random forces do, differences of log det lose digits. Changes that go on
    in one direction are no scatter, nor are those while deviations change.
    """

    def __init__(self) -> None:
        self._averaged, self._last = 1, np.zeros(0)

    def following(self, slope: Floats, before: Floats, deviation: Floats, *, settled: bool) -> Floats:
        """The gradient (P,) after the one `before`, by the `slope` there; `deviation` are those of the unknowns.

        `settled` says whether the deviations of forces and noise nearly are.
        """
        change = (slope - before) * deviation
        sizes = float(np.linalg.norm(change) * np.linalg.norm(self._last))
        if not settled:
            self._averaged = 1
        elif len(self._last) and float(change @ self._last) < _ONWARD * sizes:
            self._averaged += 1
        self._last = change
        return before + (slope - before) / self._averaged


@dataclass(frozen=True, eq=False)
class _LogDeterminant:
    """Log det of the equations of the states in parts of the records, times `factor` to stand for all."""

    misfit: Misfit
    q: float
    executor: Executor | None
    factor: float

    @classmethod
    def of(cls, fit: AnnealingFit, annealer: Annealer) -> _LogDeterminant:
        """That of the equations of a fit."""
        which, share = parts_of(fit.misfit.segments)
        point = replace(fit.point, nodes=fit.point.nodes[:, which])
        misfit = replace(fit.misfit, segments=fit.misfit.segments.chosen(which)).at(point)
        return cls(misfit, fit.q, annealer.executor, share)

    def slope(self, free: Bools, deviation: Floats) -> Floats:
        """(P,) its gradient by the unknowns that all nodes share, zero for those that are not free."""
        slopes = np.zeros(len(free))
        for column in np.flatnonzero(free & (deviation > 0.0)).tolist():
            step = np.zeros(len(free))
            step[column] = _STEP * deviation[column]
            slope = (self._value(step) - self._value(-step)) / (2.0 * step[column])
            slopes[column] = slope if np.isfinite(slope) else 0.0
        return slopes

    def freedoms(self, known_noise: Bools) -> tuple[Floats, Floats]:
        """(C,) residuals and (r,) forces that the record determines, of those whose deviations are to be found.

        They are all but the traces of H^-1 times what each channel, and each force, adds to H.
        """
        segments, scales = self.misfit.segments, self.misfit.scales
        random = segments.random
        assert random is not None
        residuals = segments.observed.sum(axis=(0, 2)).astype(float)
        factor = self._linear(self.misfit).equations(self.q).factor()
        m, (M, C, K) = len(scales.state), segments.samples.shape
        # zeros where the equations are singular
        inverse = np.zeros((K, m, m)) if factor is None else factor.inverse_blocks()[0]
        for part in chunks(segments, segments.parameters):
            rows = whitened_jacobian(self.misfit, part)[0][..., :m].astype(float)
            leverage = np.sum((rows @ inverse[part]) * rows, axis=(0, 2)).reshape(M, C).sum(axis=0)
            residuals -= np.where(known_noise, 0.0, leverage)
        own = inverse[:, random.rows, random.rows].T
        forces = segments.count - np.sum(own * random.curvature(scales.state), axis=1)
        return self.factor * residuals, self.factor * forces

    def _value(self, step: Floats) -> float:
        """Log det where the border (P,) is moved by a step."""
        point = self.misfit.point
        moved = self.misfit.at(point.moved(point.nodes, point.border + step))
        factor = self._linear(moved).equations(self.q).factor()
        return np.nan if factor is None else self.factor * factor.root.log_determinant

    def _linear(self, misfit: Misfit) -> Linearization:
        """The linearised equations."""
        return linearise(misfit, self.executor)


_LONG = 16_000  # segments: of fewer most searches lead straight to exact laws
_LOOSE, _TIGHT = 1e-3, 1e-4  # relaxations of exact laws: at the latter most long records have one optimum yet
_DOWN_TO = AnnealingSchedule(
    initial_q=0.1, final_q=_TIGHT, smallest_factor=0.3
)  # faster leads to worse optima
_STEPS = 15  # on to exact laws, or back to loose links; a search that takes more does not lead straight
_CHANCE = 1e-3  # probability of a larger difference between two relaxations by chance
# of -2 log of the marginal likelihood: more than rounding and the error of Laplace's approximation
_WORSE = 2.0
_LEAST_VARIANCE = 0.05  # that tighter links add, of that of an unknown: more than rounding


def is_long(segments: Segments) -> bool:
    """Whether a record is searched in pieces: many segments, few masses, and no unknowns but coefficients and states.

    Parameters
    ----------
    segments : Segments
        The record in segments.

    Returns
    -------
    bool
        Whether it is.
    """
    system, sensors = segments.system, segments.sensors
    return (
        segments.count >= _LONG
        and len(system.incidence) < MANY
        and system.dimension == 2 * len(system.incidence)
        and system.parameters.size > 0
        and system.shapes is None
        and segments.random is None
        and segments.clipped is None
        and sensors.unknowns == 0
    )


def search_long_record(start: Misfit, annealer: Annealer, limit: float) -> AnnealingFit | None:
    """The optimum of a long record at the tightest links that lead to it straight.

    Parameters
    ----------
    start : Misfit
        That of the unknowns to start from, in segments of which `is_long` holds.
    annealer : Annealer
        How annealing runs.
    limit : float
        By how much chi-square may exceed 1.

    Returns
    -------
    AnnealingFit or None
        The fit; None where laws leave more than noise, an unknown is at a bound, or values contradict each other at loose
        links, so that another search has to look for it.
    """
    fit = annealer(start, _DOWN_TO)
    if did_not_converge(fit):
        fit = annealer(start, replace(_DOWN_TO, final_q=_LOOSE))
    if fit.status is AnnealingStatus.INTERRUPTED:
        return fit
    if did_not_converge(fit) or not _is_exact(fit, limit):
        return None
    for q in (_LOOSE, AnnealingSchedule.final_q) if fit.q < _LOOSE else ():
        schedule = AnnealingSchedule(initial_q=max(q, fit.q), final_q=q, max_steps=_STEPS)
        other = annealer(fit.misfit, schedule)
        if other.status is AnnealingStatus.INTERRUPTED:
            return replace(fit, status=AnnealingStatus.INTERRUPTED)
        if did_not_converge(other):
            continue
        looser, tighter = (other, fit) if q == _LOOSE else (fit, other)
        agree = _agree(looser, tighter)
        if not _is_exact(other, limit) or (q == _LOOSE and not agree):
            return None
        if q < _LOOSE and agree:
            fit = replace(other, path=(*fit.path, *other.path))
    return fit


def did_not_converge(fit: AnnealingFit) -> bool:
    """Whether a search ended without an optimum, and not by an interrupt."""
    return fit.status in (AnnealingStatus.EXHAUSTED, AnnealingStatus.STUCK)


def _is_exact(fit: AnnealingFit, limit: float) -> bool:
    """Whether noise explains what the laws leave, with no unknown at a bound."""
    return fit.chi_square < 1.0 + limit and not fit.at_bound.any()


def _agree(looser: AnnealingFit, fit: AnnealingFit) -> bool:
    """Whether tighter links are as likely as looser ones, and change values by no more than they add to what is known."""
    (_, before), (_, after) = (evidence(own) for own in (looser, fit))
    if not after <= before + _WORSE:
        return False
    size = np.sqrt(np.maximum(looser.covariance.diagonal(), np.finfo(float).tiny))
    added = (looser.covariance - fit.covariance) / np.outer(size, size)
    variances, directions = np.linalg.eigh(added)
    change = (fit.point.border - looser.point.border) / size
    square = np.sum((directions.T @ change) ** 2 / np.maximum(variances, _LEAST_VARIANCE))
    return bool(scipy.special.chdtrc(len(change), square) > _CHANCE)
