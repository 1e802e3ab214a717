"""Steps by the sensitivities and the factor of an earlier one, at the price of the flow and of the factor's solutions.

Beside the optimum sensitivities hardly change any more, but the gradient of the cost does, and with tight links a small error
of a segment's sensitivities turns what its end pulls at far aside. The pulls are therefore unknowns of their own, Lagrange's
multipliers of the links: states, unknowns and pulls go to where the gradient, which the adjoint gives exactly, vanishes and
defects are what the pulls leave of them. The equations of an earlier point, and of looser links, lead there (chord method);
fewer steps do where the last few are mixed.

References
----------
J. Nocedal and S. J. Wright, Numerical Optimization (2006), section 18.1, for the equations of points and multipliers.

C. T. Kelley, Iterative Methods for Linear and Nonlinear Equations (1995), section 5.4, for chords.

D. G. Anderson, J. ACM 12, 547 (1965), for the mixing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.shooting.adjoint import gradient, has_adjoint
from linkwise.likelihood.shooting.bordered_system import BorderedSystem
from linkwise.likelihood.shooting.curved_step import is_explained
from linkwise.likelihood.shooting.damped_step import DampedEquations, bounds
from linkwise.likelihood.shooting.linear_model import GaussNewtonModel
from linkwise.likelihood.shooting.linearised_defects import change_of_defects, pull_of_defects
from linkwise.likelihood.shooting.loss import Loss
from linkwise.likelihood.shooting.residuals import Misfit, evaluate
from linkwise.likelihood.shooting.schedule import AnnealingStep
from linkwise.likelihood.shooting.segments import Iterate, Scales, Segments

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
