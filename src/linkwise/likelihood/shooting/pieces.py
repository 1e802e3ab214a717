"""Long records in pieces: equations of which the nodes inside a piece are eliminated, so that pieces meet at their ends alone.

A piece is a run of segments from one node to another, which it shares with the next. Its own equations hold a border of both
ends and the unknowns of all; eliminated piece by piece, in memory that does not grow with the record, they leave a chain of
ends, whose solution is exactly that of the equations of all nodes (substructuring).

Motion close to where it parts bends away from the linearised equations within few segments. After each step that all pieces
share, a piece in which it does lowers its cost by its inner states alone, with a damping of its own, and no other one is held
back. The ends of the pieces lie elsewhere at every second step.

References
----------
J. S. Przemieniecki, AIAA J. 1, 138 (1963), for substructures.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
from scipy.linalg import lapack

from linkwise.arrays import Bools, Floats, Indices
from linkwise.likelihood.shooting.bordered_system import BorderedFactor, BorderedSystem, Damping
from linkwise.likelihood.shooting.loss import Loss
from linkwise.likelihood.shooting.normal_equations import Linearization, add_prior, linearise
from linkwise.likelihood.shooting.residuals import Misfit, SensorErrors, evaluate
from linkwise.likelihood.shooting.segments import Iterate, Scales, Segments
from linkwise.likelihood.shooting.steps import SLIGHT, AnnealingStep, bounds
from linkwise.likelihood.shooting.tangents import CandidateForces
from linkwise.progress import Progress, silent
from linkwise.runtime import processors

T = TypeVar("T")

_LENGTH = (
    4000  # segments in a piece: in shorter ones threads wait for each other, longer ones leave the caches
)


def piece_ends(linked: Bools, *, shifted: bool = False) -> Indices:
    """The nodes at which pieces of segments end, the first and the last node among them.

    None ends at the first node of another record, which would have neither samples nor a link in that piece.

    Parameters
    ----------
    linked : array of bool, shape (K - 1,)
        Which neighbouring segments are continuous.
    shifted : bool, optional
        Whether pieces end in the middles of the others.

    Returns
    -------
    array of int, shape (P + 1,)
        The nodes.
    """
    count = len(linked) + 1
    number = max(1, round(count / _LENGTH))
    ends = np.linspace(0, count - 1, number + 1).round().astype(int)
    if shifted and number > 1:
        ends = np.concatenate([ends[:1], (ends[:-1] + ends[1:]) // 2, ends[-1:]])
    ends[1:-1] -= ~linked[ends[1:-1] - 1]
    return ends


def piece_between(segments: Segments, first: int, last: int) -> Segments:
    """The segments between two nodes, without what is known of the unknowns beforehand.

    Parameters
    ----------
    segments : Segments
        All segments.
    first, last : int
        The nodes.

    Returns
    -------
    Segments
        The piece; the samples behind its last node belong to the next, unless there is none.
    """
    piece = replace(segments.chosen(np.arange(first, last + 1)), prior=None)
    if last < segments.count - 1:
        observed = piece.observed.copy()
        observed[..., -1] = False
        piece = replace(piece, observed=observed)
    return piece


class InCaller(Executor):
    """An executor without threads of its own, for what runs in one of several threads."""

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """Run `fn` at once."""
        future: Future[T] = Future()
        future.set_result(fn(*args, **kwargs))
        return future


@dataclass(frozen=True, eq=False)
class EliminatedPiece:
    """The equations of a piece without its inner nodes.

    Attributes
    ----------
    cost : float
        Cost of the piece.
    gradient : array of shape (k, m)
        Negative gradient by the k inner nodes.
    of_ends : array of shape (2 m + p,)
        The same by the first and the last node and the border.
    factor : BorderedFactor
        Factor of the inner nodes; `schur` and `reduced` are the equations of the ends and the border.
    """

    cost: float
    gradient: Floats
    of_ends: Floats
    factor: BorderedFactor

    def inner_step(self, ends: Floats) -> Floats:
        """(k, m) step of the inner nodes with one of the ends and the border (2 m + p,)."""
        right = self.factor.forward[..., -1] - self.factor.forward[..., :-1] @ ends
        nodes, _ = lapack.dtbtrs(self.factor.chol, right.reshape(-1, 1), uplo="L", trans="T")
        return np.asarray(nodes.reshape(right.shape))

    def drop(self, inner: Floats, ends: Floats) -> float:
        """Reduction of the cost that a step predicts, both parts of which are scaled."""
        return float(np.vdot(self.gradient, inner) + self.of_ends @ ends)


def inner_equations(equations: BorderedSystem) -> BorderedSystem:
    """Equations of a piece with its first and last node in the border, before the other unknowns there.

    Parameters
    ----------
    equations : BorderedSystem
        Equations of k + 2 nodes with p unknowns in the border.

    Returns
    -------
    BorderedSystem
        Of the k nodes between, with 2 m + p unknowns in the border.
    """
    m, p = equations.diagonal.shape[1], len(equations.corner)
    head, tail, rest = slice(0, m), slice(m, 2 * m), slice(2 * m, 2 * m + p)
    right = np.zeros((len(equations.diagonal) - 2, m, 2 * m + p + 1))
    right[..., 2 * m :] = equations.right[1:-1]
    right[0, :, head] = equations.coupling[0]
    right[-1, :, tail] = equations.coupling[-1].T
    corner = np.zeros((2 * m + p, 2 * m + p))
    for own, node in ((head, 0), (tail, -1)):
        corner[own, own] = equations.diagonal[node]
        corner[own, rest] = equations.right[node, :, :p]
        corner[rest, own] = corner[own, rest].T
    corner[rest, rest] = equations.corner
    gradient = [equations.right[0, :, p], equations.right[-1, :, p], equations.corner_gradient]
    return BorderedSystem(
        equations.diagonal[1:-1], equations.coupling[1:-1], right, corner, np.concatenate(gradient)
    )


@dataclass(frozen=True, eq=False)
class PieceSteps:
    """A step of all unknowns: `nodes` (m, K) and `border` (P,) in their own units, and the reduction of the cost that it
    predicts for each piece, `drops` (P',), and for what is known beforehand, `of_prior`.
    """

    nodes: Floats
    border: Floats
    drops: Floats
    of_prior: float

    @property
    def predicted(self) -> float:
        """The reduction of the whole cost."""
        return float(self.drops.sum()) + self.of_prior


@dataclass(frozen=True, eq=False)
class JoinedPieces:
    """The equations of all pieces.

    Attributes
    ----------
    ends : array of int, shape (P' + 1,)
        The nodes at which pieces end.
    pieces : tuple of EliminatedPiece
        The pieces.
    factor : BorderedFactor
        Factor of the ends and the border.
    of_prior : array of shape (P,)
        Negative gradient of what is known of the border beforehand.
    cost : float
        Cost of all.
    """

    ends: Indices
    pieces: tuple[EliminatedPiece, ...]
    factor: BorderedFactor
    of_prior: Floats
    cost: float

    def steps(self, scales: Scales, *, border_change: Floats | None = None) -> PieceSteps | None:
        """The Gauss-Newton step, or that of the nodes where the border moves by `border_change` (P,), in its own units.

        None where the equations are not positive definite.
        """
        free = np.full(len(scales.theta), border_change is None)
        solved = self.factor.solve(free, None if border_change is None else border_change / scales.theta)
        if solved is None:
            return None
        of_ends, border = solved
        nodes = np.empty((self.ends[-1] + 1, of_ends.shape[1]))
        nodes[self.ends] = of_ends
        drops = np.empty(len(self.pieces))
        for number, (piece, (first, last)) in enumerate(zip(self.pieces, pairwise(self.ends), strict=True)):
            both = np.concatenate([of_ends[number], of_ends[number + 1], border])
            nodes[first + 1 : last] = piece.inner_step(both)
            drops[number] = piece.drop(nodes[first + 1 : last], both)
        return PieceSteps(
            (nodes * scales.state).T, border * scales.theta, drops, float(self.of_prior @ border)
        )

    @property
    def log_determinant(self) -> float:
        """Of the equations of all unknowns."""
        inner = sum(2.0 * float(np.log(piece.factor.chol[0]).sum()) for piece in self.pieces)
        return inner + self.factor.log_determinant(np.ones(len(self.of_prior), dtype=bool))


def joined_pieces(
    segments: Segments,
    point: Iterate,
    scales: Scales,
    q: float,
    loss: Loss,
    ends: Indices,
    executor: Executor,
) -> JoinedPieces | None:
    """The equations of all pieces at a point.

    Parameters
    ----------
    segments : Segments
        All segments.
    point : Iterate
        The unknowns.
    scales : Scales
        Their units.
    q : float
        Relaxation.
    loss : Loss
        Loss of a residual.
    ends : array of int, shape (P' + 1,)
        The nodes at which pieces end.
    executor : Executor
        Threads, one for a piece at a time.

    Returns
    -------
    JoinedPieces or None
        The equations; None where they are not positive definite.
    """

    @np.errstate(over="ignore", invalid="ignore")
    def work(own: tuple[int, int]) -> EliminatedPiece | None:
        first, last = own
        piece = piece_between(segments, first, last)
        misfit = evaluate(piece, replace(point, nodes=point.nodes[:, first : last + 1]), scales, loss)
        inner = inner_equations(linearise(piece, misfit, scales, loss).equations(q))
        gradient = inner.right[..., -1].copy()
        factor = inner.factor(overwrite=True)
        return (
            None
            if factor is None
            else EliminatedPiece(misfit.cost(q), gradient, inner.corner_gradient, factor)
        )

    eliminated = list(executor.map(work, pairwise(ends.tolist())))
    pieces = tuple(piece for piece in eliminated if piece is not None)
    if len(pieces) < len(eliminated):
        return None
    corner, of_prior = np.zeros((len(scales.theta), len(scales.theta))), np.zeros(len(scales.theta))
    cost = sum(piece.cost for piece in pieces)
    if segments.prior is not None:
        add_prior(corner, of_prior, segments.prior, point, scales)
        cost += segments.prior.cost(point.border)
    of_ends = [(piece.factor.schur, piece.factor.reduced) for piece in pieces]
    factor = chain_of_ends(of_ends, len(point.nodes), corner, of_prior).factor()
    return None if factor is None else JoinedPieces(ends, pieces, factor, of_prior, cost)


def chain_of_ends(
    pieces: Sequence[tuple[Floats, Floats]], m: int, corner: Floats, gradient: Floats
) -> BorderedSystem:
    """The equations of the ends of pieces and of the border.

    Parameters
    ----------
    pieces : sequence of tuple of array
        Of each piece the matrix (2 m + p, 2 m + p) and the right-hand side (2 m + p,) of its ends and the border.
    m : int
        States of a node.
    corner, gradient : array of shape (p, p) and (p,)
        What is added to those of the border.

    Returns
    -------
    BorderedSystem
        The equations.
    """
    p = len(gradient)
    diagonal, coupling = np.zeros((len(pieces) + 1, m, m)), np.empty((len(pieces), m, m))
    right, corner, gradient = np.zeros((len(pieces) + 1, m, p + 1)), corner.copy(), gradient.copy()
    for number, (matrix, own_gradient) in enumerate(pieces):
        for node, own in ((number, slice(0, m)), (number + 1, slice(m, 2 * m))):
            diagonal[node] += matrix[own, own]
            right[node, :, :p] += matrix[own, 2 * m :]
            right[node, :, p] += own_gradient[own]
        coupling[number] = matrix[m : 2 * m, :m]
        corner += matrix[2 * m :, 2 * m :]
        gradient += own_gradient[2 * m :]
    return BorderedSystem(diagonal, coupling, right, corner, gradient)


_STEPS = 40
_LITTLE = 0.01  # of the cost: what a full step may still gain
_MAX_DAMPING = 1e6


def with_held_parameters(
    segments: Segments, point: Iterate, scales: Scales
) -> tuple[Segments, Iterate, Scales]:
    """A problem whose parameters are known, so that nothing is derived by them.

    Parameters
    ----------
    segments : Segments
        The segments, without shapes of hosts among the unknowns.
    point : Iterate
        The unknowns.
    scales : Scales
        Their units.

    Returns
    -------
    tuple of (Segments, Iterate, Scales)
        The same without parameters.
    """
    p = len(point.theta)
    return (
        replace(segments, system=segments.system.without_parameters(point.theta), prior=None),
        replace(point, theta=np.empty(0)),
        replace(scales, theta=scales.theta[p:]),
    )


def settled_states(
    piece: Segments, point: Iterate, scales: Scales, q: float, loss: Loss, goal: float
) -> tuple[Floats, float]:
    """Lower the cost of a piece by its inner nodes alone.

    Parameters
    ----------
    piece : Segments
        The piece.
    point : Iterate
        Where it starts.
    scales : Scales
        Units of the unknowns.
    q : float
        Relaxation.
    loss : Loss
        Loss of a residual.
    goal : float
        Cost that is low enough.

    Returns
    -------
    nodes : array of shape (m, K)
        The nodes, the first and the last unchanged.
    cost : float
        Cost of the piece with them.
    """
    segments, point, scales = with_held_parameters(piece, point, scales)
    misfit = evaluate(segments, point, scales, loss)
    damping, growth, steps = 0.0, 2.0, 0
    linear: Linearization | None = None
    while steps < _STEPS and goal < misfit.cost(q) < np.inf and damping < _MAX_DAMPING:
        if linear is None:
            linear = linearise(segments, misfit, scales, loss)
            equations = _inner_nodes(linear.equations(q))
        steps += 1
        attempt = _attempt(segments, misfit, scales, loss, equations, _damping(linear, damping))
        if attempt is None:
            damping = max(10.0 * damping, 1e-6)
            continue
        trial, predicted = attempt
        gained = misfit.cost(q) - trial.cost(q)
        if gained > 0.0:
            ratio = gained / predicted
            damping *= max(1 / 3, 1 - (2 * ratio - 1) ** 3) if ratio < 1.5 else 1 / 3  # Nielsen 1999
            damping, growth = damping if damping >= SLIGHT else 0.0, 2.0
            misfit, linear = trial, None
        else:
            damping, growth = max(growth * damping, 0.01), 2.0 * growth
        if predicted < _LITTLE and damping == 0.0:
            break
    return misfit.point.nodes, misfit.cost(q)


def _inner_nodes(equations: BorderedSystem) -> BorderedSystem:
    """The equations of the nodes between the first and the last, which are held as the border is."""
    right = equations.right[1:-1, :, -1:].copy()
    return BorderedSystem(
        equations.diagonal[1:-1], equations.coupling[1:-1], right, np.zeros((0, 0)), np.zeros(0)
    )


def _damping(linear: Linearization, strength: float) -> Damping | None:
    damping = linear.damping(strength)
    return None if damping is None else Damping(damping.nodes[1:-1], np.zeros(0))


def _attempt(
    segments: Segments,
    misfit: Misfit,
    scales: Scales,
    loss: Loss,
    equations: BorderedSystem,
    damping: Damping | None,
) -> tuple[Misfit, float] | None:
    """The misfit behind a step and the reduction of the cost that it predicts; None where there is no step."""
    factor = equations.factor(damping)
    solved = None if factor is None else factor.solve(np.zeros(0, dtype=bool))
    if solved is None:
        return None
    nodes = misfit.point.nodes.copy()
    nodes[:, 1:-1] += (solved[0] * scales.state).T
    trial = evaluate(segments, replace(misfit.point, nodes=nodes), scales, loss)
    return trial, equations.drop(*solved)


def tested_in_pieces(
    segments: Segments,
    misfit: Misfit,
    scales: Scales,
    loss: Loss,
    q: float,
    candidates: CandidateForces,
    errors: SensorErrors | None,
) -> BorderedFactor | None:
    """The equations of parameters and of sizes of what is tested, all nodes eliminated.

    Parameters
    ----------
    segments, misfit, scales, loss, candidates, errors
        As of `linearise`.
    q : float
        Relaxation.

    Returns
    -------
    BorderedFactor or None
        The factor, of which `schur` and `reduced` are these equations; None where they are not positive definite.
    """

    @np.errstate(over="ignore", invalid="ignore")  # threads do not share the error state of the caller
    def work(own: tuple[int, int]) -> tuple[Floats, Floats] | None:
        part = slice(own[0], own[1] + 1)
        some = None if errors is None else replace(errors, values=errors.values[..., part])
        linear = linearise(
            piece_between(segments, *own), misfit.part(part), scales, loss, None, candidates.part(part), some
        )
        factor = inner_equations(linear.equations(q)).factor(overwrite=True)
        return None if factor is None else (factor.schur, factor.reduced)

    with ThreadPoolExecutor(processors()) as executor:
        eliminated = list(executor.map(work, pairwise(piece_ends(segments.linked).tolist())))
    pieces = [piece for piece in eliminated if piece is not None]
    if len(pieces) < len(eliminated):
        return None
    m = len(misfit.point.nodes)
    size = len(pieces[0][1]) - 2 * m
    corner, gradient = np.zeros((size, size)), np.zeros(size)
    if segments.prior is not None:
        add_prior(corner, gradient, segments.prior, misfit.point, scales)
    return chain_of_ends(pieces, m, corner, gradient).factor()


_LEAST = 0.1  # of the predicted reduction: a step that gains less of it has left its valley
_MOST = 0.5  # of it: a last step that gains less of it does not end beside an optimum
_OWN, _SHARE = 0.2, 0.2  # of what a step gains in its piece, or in an average one: what need not settle
_SLIGHT = 0.05  # of the cost of each piece: what no step needs to gain
_STATES = 3  # steps of the states beside an optimum


@dataclass(frozen=True, eq=False)
class JointEnd:
    """Where a search at one relaxation led to.

    Attributes
    ----------
    q : float
        The relaxation.
    point : Iterate
        The unknowns.
    cost : float
        Cost there.
    factor : BorderedFactor
        Factor of the ends of pieces and the unknowns that all share, at the last step.
    log_determinant : float
        Of the equations of all unknowns.
    path : tuple of AnnealingStep
        The steps.
    straight : bool
        Whether every step gained what was predicted, and the last one changed little enough.
    interrupted : bool
        Whether the keyboard interrupted it.
    """

    q: float
    point: Iterate
    cost: float
    factor: BorderedFactor
    log_determinant: float
    path: tuple[AnnealingStep, ...]
    straight: bool
    interrupted: bool = False


@dataclass(frozen=True, eq=False)
class JointSearch:
    """A search for the most likely unknowns of a long record.

    Attributes
    ----------
    segments : Segments
        The record in segments.
    scales : Scales
        Units of the unknowns.
    loss : Loss
        Loss of a residual.
    executor : Executor
        Threads.
    progress : Progress
        Called at every step.
    """

    segments: Segments
    scales: Scales
    loss: Loss
    executor: Executor
    progress: Progress = silent

    def at(self, q: float, start: Iterate, *, little: float, most: int) -> JointEnd | None:
        """Steps at a relaxation.

        Parameters
        ----------
        q : float
            Relaxation.
        start : Iterate
            Where they start, with states close to the motion.
        little : float
            Change of every unknown in standard errors that ends the search.
        most : int
            Largest number of steps.

        Returns
        -------
        JointEnd or None
            The end; None where the equations are not positive definite at the start.

        Raises
        ------
        KeyboardInterrupt
            If the keyboard interrupts the first step; later steps end with the best so far.
        """
        end: JointEnd | None = None
        try:
            while end is None or len(end.path) < most:
                following = self._behind(q, start, end, little)
                if following is None:
                    break
                end = following
                self.progress(end.path[-1].report)
                if end.straight or _leads_nowhere(end.path, len(piece_ends(self.segments.linked)) - 1):
                    break
        except KeyboardInterrupt:
            if end is None:
                raise
            return replace(end, interrupted=True)
        return end

    def rises_beside(self, end: JointEnd, changes: Sequence[Floats]) -> Iterator[list[float]]:
        """By how much the lowest cost rises where the unknowns that all pieces share are moved from an end and held.

        Parameters
        ----------
        end : JointEnd
            Where they are moved from.
        changes : sequence of array of shape (P,)
            The moves, in their own units.

        Yields
        ------
        list of float
            The rises from the cost with the unknowns held where they are, again and again as the states settle in more steps;
            those of the end settle as well.
        """
        unmoved = np.zeros(len(end.point.border))
        moves = [unmoved, *changes]
        points, costs = [end.point] * len(moves), [np.inf] * len(moves)
        equations = [self._joined(end.q, end.point, 0)] * len(moves)
        for number in range(1, _STATES + 1):
            for side, (joined, change) in enumerate(zip(equations, moves, strict=True)):
                steps = None if joined is None else joined.steps(self.scales, border_change=change)
                if joined is not None and steps is not None:
                    points[side], cost = self._settled(joined, steps, points[side], end.q)
                    costs[side] = min(costs[side], cost)
            if not np.isfinite(costs).all():
                return
            yield [cost - costs[0] for cost in costs[1:]]
            moves = [unmoved] * len(moves)
            if number < _STATES:
                equations = [self._joined(end.q, point, number) for point in points]

    def _joined(self, q: float, point: Iterate, number: int) -> JoinedPieces | None:
        ends = piece_ends(self.segments.linked, shifted=number % 2 == 1)
        return joined_pieces(self.segments, point, self.scales, q, self.loss, ends, self.executor)

    def _behind(self, q: float, start: Iterate, end: JointEnd | None, little: float) -> JointEnd | None:
        """The end behind one more step; None where the equations are not positive definite."""
        path = () if end is None else end.path
        point = start if end is None else end.point
        joined = self._joined(q, point, len(path))
        steps = None if joined is None else joined.steps(self.scales)
        if joined is None or steps is None:
            return None
        moved, cost = self._settled(joined, steps, point, q)
        gained, data = joined.cost - cost, cost / int(self.segments.observed.sum())
        step = AnnealingStep(len(path), q, joined.cost, steps.predicted, gained, data, 0.0)
        return JointEnd(
            q,
            moved if gained > 0.0 else point,
            min(cost, joined.cost),
            joined.factor,
            joined.log_determinant,
            (*path, step),
            _gains(step, _MOST, len(joined.pieces))
            and _largest_change(joined, steps.border, self.scales) < little,
        )

    def _settled(
        self, joined: JoinedPieces, steps: PieceSteps, point: Iterate, q: float
    ) -> tuple[Iterate, float]:
        """The point behind a step, in which the states of every piece have settled, and its cost."""
        border = np.clip(point.border + steps.border, *bounds(self.segments))
        moved = point.moved(point.nodes + steps.nodes, border)
        average = max(float(steps.drops.mean()), _SLIGHT)

        @np.errstate(over="ignore", invalid="ignore")  # threads do not share the error state of the caller
        def work(number: int) -> tuple[Floats, float]:
            first, last = joined.ends[number : number + 2].tolist()
            drop = steps.drops[number]
            goal = joined.pieces[number].cost - drop + max(_OWN * abs(drop), _SHARE * average)
            piece = piece_between(self.segments, first, last)
            start = replace(moved, nodes=moved.nodes[:, first : last + 1])
            return settled_states(piece, start, self.scales, q, self.loss, goal)

        cost = 0.0 if self.segments.prior is None else self.segments.prior.cost(border)
        nodes = moved.nodes.copy()
        by_piece = self.executor.map(work, range(len(joined.pieces)))
        for (first, last), (settled, own_cost) in zip(pairwise(joined.ends), by_piece, strict=True):
            nodes[:, first + 1 : last] = settled[:, 1:-1]
            cost += own_cost
        return replace(moved, nodes=nodes), cost


def _leads_nowhere(path: Sequence[AnnealingStep], pieces: int) -> bool:
    """Whether the last step left its valley, or the last two, whose pieces end elsewhere, did not lower the cost."""
    stalled = len(path) > 1 and all(step.reduction <= 0.0 for step in path[-2:])
    return stalled or not _gains(path[-1], _LEAST, pieces)


def _gains(step: AnnealingStep, part: float, pieces: int) -> bool:
    """Whether a step gained a part of what was predicted, or nothing was to be gained in so many pieces."""
    return step.reduction > part * step.predicted_reduction or step.predicted_reduction < _SLIGHT * pieces


def _largest_change(joined: JoinedPieces, border: Floats, scales: Scales) -> float:
    """The largest of the changes of unknowns (P,), in their standard errors."""
    variances = np.linalg.inv(joined.factor.schur).diagonal()
    return float(np.max(np.abs(border / scales.theta) / np.sqrt(np.maximum(variances, np.finfo(float).tiny))))
