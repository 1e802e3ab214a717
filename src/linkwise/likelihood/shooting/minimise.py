"""Annealed multiple shooting: Levenberg-Marquardt iterations while the continuity of the segments is tightened.

    minimise  sum loss((y - h(flow)) / sigma)  +  sum |defect / S|^2 / q^2 ,   q from 1 towards 0

METHODS section 5. Beside the optimum the sensitivities hardly change any more, and steps by the factor of an earlier point
cost the flow alone (`ChordEquations`). With tight links a small error of a segment's sensitivities turns what its end pulls at
far aside; the pulls are therefore unknowns of their own, Lagrange's multipliers of the links: states, unknowns and pulls go to
where the gradient vanishes and defects are what the pulls leave of them. That gradient is exact: the scheme of the
sensitivities run backwards, in one sweep of a single column, which costs a part of what the flow does (`gradient`).

References
----------
H. G. Bock, in Modelling of Chemical Reaction Systems (1981), for multiple shooting.
J. Ye et al., Phys. Rev. E 92, 052901 (2015), for annealing.
J. Nocedal and S. J. Wright, Numerical Optimization (2006), section 18.1, for the equations of points and multipliers.
C. T. Kelley, Iterative Methods for Linear and Nonlinear Equations (1995), section 5.4, for chords.
D. G. Anderson, J. ACM 12, 547 (1965), for the mixing of the last few.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial

import numpy as np

from linkwise.arrays import Bools, Floats
from linkwise.errors import IdentificationError
from linkwise.likelihood.shooting.bordered_system import BorderedSystem
from linkwise.likelihood.shooting.linear_model import GaussNewtonModel, covariance, firm_border, linear_model
from linkwise.likelihood.shooting.loss import Loss
from linkwise.likelihood.shooting.residuals import Misfit, evaluate
from linkwise.likelihood.shooting.segments import Iterate, Scales, Segments, V, X
from linkwise.likelihood.shooting.steps import AnnealingSchedule as AnnealingSchedule
from linkwise.likelihood.shooting.steps import (
    AnnealingStep,
    DampedEquations,
    SearchState,
    bounds,
    change_of_defects,
    curved_step,
    freedom,
    is_explained,
    is_settled,
    pull_of_defects,
)
from linkwise.likelihood.shooting.system import NumericSystem
from linkwise.likelihood.shooting.tangents import TangentForces, tangent_forces
from linkwise.progress import Progress, silent

_AT_ONCE = 20_000  # elongations of links that are swept together


def has_adjoint(segments: Segments) -> bool:
    """Whether samples are displacements and velocities of masses that nothing but laws, forces and offsets determines.

    Parameters
    ----------
    segments : Segments
        The records in segments.

    Returns
    -------
    bool
        Whether `gradient` knows everything that they depend on.
    """
    system, sensors = segments.system, segments.sensors
    others = (
        system.states
        or system.shapes is not None
        or sensors.shapes is not None
        or segments.random is not None
        or segments.clipped is not None
    )
    uncertain = sensors.gains or sensors.delays or sensors.waveforms or segments.inputs.uncertain is not None
    return not others and not uncertain and bool(np.isin(sensors.kind, (X, V)).all())


def gradient(
    segments: Segments, misfit: Misfit, scales: Scales, loss: Loss, pulls: Floats
) -> tuple[Floats, Floats]:
    """Half the gradient of the cost at a relaxation, its sign reversed: the right-hand side of normal equations.

    Parameters
    ----------
    segments, misfit, scales, loss
        As of `evaluate`, where segments have an adjoint.
    pulls : array of shape (K - 1, m)
        What the ends of segments pull at: defects over the square of the relaxation, at the optimum.

    Returns
    -------
    nodes, border : array of shape (K, m) and (P,)
        The gradient in scaled unknowns.
    """
    system, p = segments.system, segments.system.parameters.size
    mechanics, K = system.at(misfit.point.theta), segments.count
    pulled = loss.weight(misfit.residuals) * misfit.residuals / scales.sigma[:, None]
    if segments.relative_noise is not None:
        pulled = pulled / segments.relative_noise
    defects = pulls.T
    nodes, border = np.zeros((system.dimension, K)), np.zeros(segments.parameters)
    size = max(_AT_ONCE // len(system.incidence.T), 16)
    for first in range(0, K, size):
        part = slice(first, min(first + size, K))
        _sweep(segments, misfit, scales, part, mechanics, (pulled, defects), nodes, border[:p])
    nodes *= scales.state[:, None]
    nodes[:, 1:] -= defects
    offset = segments.sensors.offset
    by_channel = pulled.sum(axis=(0, 2))
    np.add.at(border[p:], offset[offset >= 0], by_channel[offset >= 0])
    border[p:] *= scales.theta[p:]
    if segments.prior is not None:
        border += segments.prior.gradient(misfit.point.border, scales.theta)
    return nodes.T, border


def _sweep(
    segments: Segments,
    misfit: Misfit,
    scales: Scales,
    part: slice,
    mechanics: NumericSystem,
    pulls: tuple[Floats, Floats],
    nodes: Floats,
    border: Floats,
) -> None:
    """Put what samples (M, C, K) and defects (m, K - 1), the `pulls`, add to the `nodes` of some segments, in their own units,
    and add it to the `border` (p,) of scaled parameters.
    """
    pulled, defects = pulls
    sensors, n = segments.sensors, len(mechanics.gain)
    step = segments.step[part] * segments.flow_steps_per_tangent
    orbit = misfit.trajectories.part(part).thinned(segments.flow_steps_per_tangent)
    unit = scales.theta[: len(border)]
    starts, middles = tangent_forces(mechanics, orbit, step, unit, inputs=segments.inputs.part(part))
    backward = _Backward(mechanics, starts, middles, border)
    motion = np.zeros((2, n, len(step)))
    later = defects[:, part]
    motion[:, :, : later.shape[1]] = (later / scales.state[:, None]).reshape(2, n, -1)
    motion[1] /= step
    kinds = [(kind, sensors.kind == own) for kind, own in enumerate((X, V))]
    for j in reversed(range(middles.steps)):
        backward.step(j, motion)
        sample, between = divmod(j, segments.tangent_refine)
        if between:
            continue
        for kind, chosen in kinds:
            if chosen.any():
                shown = pulled[sample, chosen, part]
                np.add.at(motion[kind], sensors.mass[chosen], shown if kind == 0 else shown / step)
    nodes[:n, part], nodes[n:, part] = motion[0], motion[1] * step


class _Backward:
    """Nystroem's steps of `march`, transposed: what acts on the end of a step carried to its start and to `border`."""

    def __init__(
        self, mechanics: NumericSystem, starts: TangentForces, middles: TangentForces, border: Floats
    ) -> None:
        self.into_masses, self.onto_links = mechanics.incidence, mechanics.gain.T
        self.starts, self.middles, self.border = starts, middles, border
        self.states = mechanics.system.dimension

    def step(self, j: int, motion: Floats) -> None:
        """Carry (2, n, k) pulls at x and u = h v at the end of step j to its start."""
        starts, middles, into_masses = self.starts, self.middles, self.into_masses
        x, u = motion
        pull = self._pull(starts, j + 1, u / 6.0)
        d, v = starts.by_d[j + 1] * pull, starts.by_v[j + 1] * pull
        at_start, rate_at_start = d, d + v
        by_first, by_second = -v, 0.5 * d + 2.0 * v
        pull = self._pull(middles, j, (x + 2.0 * u) / 3.0 + into_masses @ by_second)
        d, v = middles.by_d[j] * pull, middles.by_v[j] * pull
        at_start, rate_at_start = at_start + d, rate_at_start + 0.5 * d + v
        by_first += 0.125 * d + 0.5 * v
        pull = self._pull(starts, j, (x + u) / 6.0 + into_masses @ by_first)
        at_start += starts.by_d[j] * pull
        rate_at_start += starts.by_v[j] * pull
        u += x
        x += into_masses @ at_start
        u += into_masses @ rate_at_start

    def _pull(self, forces: TangentForces, j: int, of_masses: Floats) -> Floats:
        """(L, k) what acts on the links, from what acts on accelerations of the masses; parameters have their share."""
        pull = self.onto_links @ of_masses
        by_parameter = np.einsum("ik,ik->i", forces.by_parameter[j], pull[forces.rows])
        np.add.at(self.border, forces.columns - self.states, by_parameter)
        for mass, column, change in forces.masses:
            self.border[column - self.states] += change[j] @ of_masses[mass]
        return np.asarray(pull)


_NEAR = 0.5  # standard errors: how far unknowns may be from equations that serve for a covariance
_ALONG = 0.005  # of the noise, in power: how far the motion may be
_LOOSER = 30.0  # times the relaxation that is aimed at: that of equations that still lead to it
_FAR = 20.0  # times what ends a search: what may be left by equations that are not near
_MOST = 16  # steps
# steps before that the next one is mixed with: as many directions as the curvature of the flow bends more than the equations
# know have to be seen before what is left falls
_MIXED = 8
_ASTRAY = 100.0  # times what was left before
_ARRIVED = 10.0  # times what such equations should leave: an end with more of it is no place to go on from with tight links
_FIRST_RATE = 0.5  # at which unknowns come nearer, before two steps tell it


@dataclass(frozen=True, eq=False)
class ChordEnd:
    """Where chord steps led to: the `misfit` of the lowest cost, the relaxation `q`, the reduction of the cost that is `left`,
    and whether that is as little as was asked.
    """

    misfit: Misfit
    q: float
    left: float
    settled: bool

    def as_step(self, number: int, start: Misfit, samples: int) -> AnnealingStep:
        """All chord steps from a start on as one step to report; those of the search itself say how straight it went."""
        cost = start.cost(self.q)
        gained = cost - self.misfit.cost(self.q)
        data = self.misfit.data / samples
        return AnnealingStep(number, self.q, cost, gained + self.left, gained, data, 0.0)


@dataclass(frozen=True, eq=False)
class ChordEquations:
    """The linearised problem at an earlier point.

    Attributes
    ----------
    segments, scales, loss
        As of `evaluate`.
    linear : Linearization or LocalLinearization
        The linearised problem.
    damped : DampedEquations
        Its equations.
    misfit : Misfit
        The misfit there.
    """

    segments: Segments
    linear: GaussNewtonModel
    damped: DampedEquations
    misfit: Misfit
    scales: Scales
    loss: Loss

    def followed(self, start: Misfit, q: float, little: float) -> ChordEnd | None:
        """Steps from the point that the equations led to.

        Parameters
        ----------
        start : Misfit
            The misfit there.
        q : float
            The relaxation to go to.
        little : float
            Reduction of the cost that ends the search.

        Returns
        -------
        ChordEnd or None
            The end; None where no step lowers the cost, where steps do not arrive, or by equations nearby do not settle, and
            where none is tried: by equations that are damped or of much looser links, of unknowns without an adjoint, and
            where the laws leave more than noise.
        """
        if not self._lead_to(q) or not is_explained(self.segments, start, self.loss):
            return None
        near = self._is_near(start, q)
        enough = little if near else _FAR * little
        nodes, border = self._scaled(start.point, self.misfit.point)
        pulls = (self.misfit.defects.T + change_of_defects(self.linear, nodes, border)) / self.damped.q**2
        left: list[float] = []
        mixing = _Mixing()
        lower, upper = bounds(self.segments)
        misfit = best = start
        reduction = np.inf
        while len(left) < _MOST and not max(_remaining(left), abs(reduction) if near else 0.0) < enough:
            solved = self._solved(misfit, pulls, q)
            if solved is None or (not near and _lead_astray([*left, solved.predicted])):
                break
            left.append(solved.predicted)
            nodes, border, pulled = self._parted(mixing.step(solved))
            moved = misfit.point.border + border * self.scales.theta
            if not np.all((lower < moved) & (moved < upper)):
                break
            pulls = pulls + pulled
            point = misfit.point.moved(misfit.point.nodes + (nodes * self.scales.state).T, moved)
            trial = evaluate(self.segments, point, self.scales, self.loss)
            reduction = misfit.cost(q) - trial.cost(q)
            if not np.isfinite(reduction):
                break
            misfit = trial
            if misfit.cost(q) < best.cost(q):
                best = misfit
        remaining = _remaining(left)
        settled = near and max(remaining, abs(reduction)) < little and self._is_near(best, q)
        # near ones that do not settle may end lower but behind a bend that no linearization follows
        arrived = settled if near else remaining < _ARRIVED * enough
        return ChordEnd(best, q, remaining, settled) if arrived and best is not start else None

    def _lead_to(self, q: float) -> bool:
        full = self.damped.factor is not None and not self.damped.damping
        return full and self.damped.q <= _LOOSER * q and has_adjoint(self.segments)

    def _is_near(self, misfit: Misfit, q: float) -> bool:
        """Whether the equations of their point serve for a covariance as well."""
        factor, samples = self.damped.factor, int(self.segments.observed.sum())
        if self.damped.q > q or factor is None:
            return False
        border = self._scaled(misfit.point, self.misfit.point)[1]
        try:
            variances = np.linalg.inv(factor.schur).diagonal()
        except np.linalg.LinAlgError:
            return False
        moved = float(np.sum((misfit.residuals - self.misfit.residuals) ** 2))
        return bool(np.all(border**2 < _NEAR**2 * variances)) and moved < _ALONG * samples

    def _scaled(self, point: Iterate, before: Iterate) -> tuple[Floats, Floats]:
        """(K, m) and (P,) how two points differ in scaled unknowns."""
        nodes = ((point.nodes - before.nodes) / self.scales.state[:, None]).T
        return nodes, (point.border - before.border) / self.scales.theta

    def _solved(self, misfit: Misfit, pulls: Floats, q: float) -> _Chord | None:
        """The step by the equations alone; None where there is none, or the slopes of the laws are not finite."""
        factor, linear, weight = self.damped.factor, self.linear, 1.0 / self.damped.q**2
        assert factor is not None
        nodes, border = gradient(self.segments, misfit, self.scales, self.loss, pulls)
        missed = misfit.defects.T - q**2 * pulls
        by_defects = pull_of_defects(linear, weight * missed)
        nodes, border = nodes + by_defects[0], border + by_defects[1]
        if not (np.isfinite(nodes).all() and np.isfinite(border).all()):
            return None
        before = self._gradient_before()
        solved = factor.moved(nodes - before[0], border - before[1]).solve(np.ones(len(border), bool))
        if solved is None:
            return None
        pulled = weight * (missed + change_of_defects(linear, *solved))
        return _Chord(
            np.concatenate([nodes.ravel(), border]),
            np.concatenate([solved[0].ravel(), solved[1], pulled.ravel()]),
        )

    def _parted(self, step: Floats) -> tuple[Floats, Floats, Floats]:
        """Nodes (K, m), border (P,) and pulls (K - 1, m) of a step."""
        K, m, P = self.segments.count, self.segments.system.dimension, len(self.scales.theta)
        nodes, border, pulls = np.split(step, [K * m, K * m + P])
        return nodes.reshape(K, m), border, pulls.reshape(K - 1, m)

    def _gradient_before(self) -> tuple[Floats, Floats]:
        """(K, m) and (P,) that of the equations."""
        equations = self.damped.equations
        if isinstance(equations, BorderedSystem):
            return equations.right[..., -1], equations.corner_gradient
        return equations.gradient[:, equations.order.places], equations.corner_gradient


@dataclass(frozen=True, eq=False)
class _Chord:
    """A `gradient` (K m + P,) of nodes and border, and the `step` (K m + P + (K - 1) m,) by it, in pulls as well."""

    gradient: Floats
    step: Floats

    @property
    def predicted(self) -> float:
        """The reduction of the cost that the equations predict."""
        return self.product(self)

    def product(self, second: _Chord) -> float:
        """That of the two gradients, in the metric of the inverse of the equations."""
        return float(self.gradient @ second.step[: len(self.gradient)])

    def without(self, before: _Chord) -> _Chord:
        """The difference to another one."""
        return _Chord(self.gradient - before.gradient, self.step - before.step)


class _Mixing:
    """Steps mixed with the last few so that what is left of the gradient is least (Anderson 1965)."""

    def __init__(self) -> None:
        self.last: _Chord | None = None
        self.last_step = np.empty(0)
        self.changes: list[tuple[_Chord, Floats]] = []

    def step(self, chord: _Chord) -> Floats:
        """The step to take, which is supposed to be the one that follows."""
        if self.last is not None:
            self.changes = [*self.changes, (chord.without(self.last), self.last_step)][-_MIXED:]
        mixed = chord.step
        if self.changes:
            changes = [change for change, _ in self.changes]
            products = np.array([[first.product(second) for second in changes] for first in changes])
            with_chord = np.array([change.product(chord) for change in changes])
            shares = np.linalg.lstsq(products, with_chord, rcond=1e-10)[0]
            for share, (change, before) in zip(shares, self.changes, strict=True):
                mixed = mixed - share * (before + change.step)
        self.last, self.last_step = chord, mixed
        return mixed


def _remaining(left: list[float]) -> float:
    """The reduction of the cost that is before steps which each leave so much of it, if they go on as the last two did.

    Unknowns come nearer by a factor r a step where what is left falls by r^2: what is before them is 1 / (1 - r)^2 of it.
    """
    if not left or (len(left) > 1 and not left[-1] < left[-2]):
        return float("inf")
    rate = float(np.sqrt(max(left[-1], 0.0) / left[-2])) if len(left) > 1 and left[-2] > 0.0 else _FIRST_RATE
    return left[-1] / (1.0 - rate) ** 2


def _lead_astray(left: list[float]) -> bool:
    """Whether steps lead away from the optimum; beside it, where equations are `near`, what is left may rise on the way."""
    return len(left) > 1 and not left[-1] < _ASTRAY * left[-2]


_MAX_DAMPING = 1e8  # at which steps are too short to matter


class AnnealingStatus(Enum):
    """How annealing ended; the value is text for messages."""

    CONVERGED = "converged"
    EXHAUSTED = "not converged: the number of steps ran out"
    STUCK = "not converged: no step lowers the cost"
    INTERRUPTED = "not converged: interrupted"
    COSTLY = "ended: the cost is higher than was asked"


@dataclass(frozen=True, eq=False)
class AnnealingFit:
    """Result of annealing.

    Attributes
    ----------
    point : Iterate
        The unknowns.
    misfit : Misfit
        Residuals and defects there.
    q : float
        Last relaxation.
    scales : Scales
        Units of the unknowns.
    covariance : array of shape (p + o + g, p + o + g)
        Covariance of parameters, offsets and gains; zero at bounds.
    at_bound : array of bool, shape (p + o + g,)
        True at a bound.
    chi_square : float
        Cost per degree of freedom, 1 for laws and noise that fit.
    samples : int
        Number of samples.
    status : AnnealingStatus
        How the search ended.
    path : tuple of AnnealingStep
        Its steps.
    """

    point: Iterate
    misfit: Misfit
    q: float
    scales: Scales
    covariance: Floats
    at_bound: Bools
    chi_square: float
    samples: int
    status: AnnealingStatus
    path: tuple[AnnealingStep, ...]


def anneal(
    segments: Segments,
    start: Iterate,
    scales: Scales,
    schedule: AnnealingSchedule,
    *,
    loss: Loss,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> AnnealingFit:
    """Fit nodes, parameters, offsets and gains to segments.

    Parameters
    ----------
    segments : Segments
        The records in segments.
    start : Iterate
        Starting values.
    scales : Scales
        Units of the unknowns.
    schedule : AnnealingSchedule
        How the relaxation is lowered.
    loss : Loss
        Loss of a residual.
    executor : Executor, optional
        Threads for the normal equations.
    progress : Progress, optional
        Called at every step.

    Returns
    -------
    AnnealingFit
        The result; an interrupt from the keyboard ends the search with the best so far.

    Raises
    ------
    IdentificationError
        If the motion from the start is not finite.
    """
    path: list[AnnealingStep] = []
    control, status = SearchState(schedule.initial_q, schedule.initial_q), AnnealingStatus.EXHAUSTED
    samples = int(segments.observed.sum())
    misfit = _started(segments, start, scales, loss, schedule.initial_q)
    linear: GaussNewtonModel | None = None
    damped: DampedEquations | None = None
    try:
        while len(path) < schedule.max_steps:
            linear = linear or linear_model(segments, misfit, scales, loss, executor)
            if control.damping > _MAX_DAMPING:
                status = AnnealingStatus.STUCK
                break
            if damped is None or (damped.q, damped.damping) != (control.q, control.damping):
                damped = None  # whose memory the next ones take
                damped = DampedEquations.of(linear, control.q, control.damping)
            attempt = curved_step(segments, linear, damped, misfit, scales, loss, control.stride)
            if attempt is None:
                control = control.firmer()
                continue
            trial, predicted, unclear = attempt
            unclear = max(unclear, predicted if control.stride < 1.0 else 0.0)  # by the shorter step
            step = control.evaluated_step(len(path), misfit, trial, predicted, samples)
            path.append(step)
            progress(step.report)
            if step.reduction > 0.0:
                before, misfit = misfit, trial
                schedule = schedule.with_ceiling(step, misfit, samples)
                if schedule.exceeded(step, unclear):
                    status = AnnealingStatus.COSTLY
                    break
            small, left = schedule.is_little(step, unclear, segments)
            settled = small and (
                control.ends_in_valley(step)
                or is_settled(segments, linear, damped, misfit, scales, loss, left)
            )
            if step.reduction > 0.0 and not settled and control.may_try(schedule, segments):
                chords = ChordEquations(segments, linear, damped, before, scales, loss)
                end = chords.followed(misfit, schedule.final_q, left)
                if end is not None:
                    progress(end.as_step(len(path), misfit, samples).report)
                    misfit, control, settled = end.misfit, replace(control, q=end.q), end.settled
            if settled:
                status = AnnealingStatus.CONVERGED
                break
            control = control.after(step, schedule, samples)
            linear, damped = (None, None) if step.reduction > 0.0 else (linear, damped)
    except KeyboardInterrupt:
        status = AnnealingStatus.INTERRUPTED
    factor = None if damped is None else damped.undamped_factor(control.q)
    linear, damped = linear or linear_model(segments, misfit, scales, loss, executor), None
    covariance_of = partial(covariance, firm_border(linear, control.q, factor), scales)
    return _fit(segments, covariance_of, misfit, scales, loss, control.q, status, tuple(path))


def _started(segments: Segments, start: Iterate, scales: Scales, loss: Loss, q: float) -> Misfit:
    """The misfit at the start, which must be finite."""
    misfit = evaluate(segments, start, scales, loss)
    if not np.isfinite(misfit.cost(q)):
        raise IdentificationError(
            "the motion that starts from the states in the record runs to infinity within a few samples: the time may be in "
            "another unit than s (write time[ms]), a channel in another than its header says, a law is not finite over the "
            "motion of its link, or a force acts that no channel shows (identify takes it as ambient)"
        )
    return misfit


def _fit(
    segments: Segments,
    covariance_of: Callable[[Bools], Floats],
    misfit: Misfit,
    scales: Scales,
    loss: Loss,
    q: float,
    status: AnnealingStatus,
    path: tuple[AnnealingStep, ...],
) -> AnnealingFit:
    theta, (lower, upper) = misfit.point.border, bounds(segments)
    free = (theta > lower) & (theta < upper)
    return AnnealingFit(
        misfit.point,
        misfit,
        q,
        scales,
        covariance_of(free),
        ~free,
        misfit.cost_of_samples(q) / (freedom(segments) * loss.expected),
        int(segments.observed.sum()),
        status,
        path,
    )


@dataclass(frozen=True)
class Annealer:
    """`anneal` with its threads, loss and progress.

    Parameters
    ----------
    executor : Executor
        Threads for the normal equations.
    loss : Loss
        Loss of a residual.
    progress : Progress
        Called at every step.
    """

    executor: Executor
    loss: Loss
    progress: Progress

    def __call__(
        self, segments: Segments, start: Iterate, scales: Scales, schedule: AnnealingSchedule
    ) -> AnnealingFit:
        return anneal(
            segments, start, scales, schedule, loss=self.loss, executor=self.executor, progress=self.progress
        )
