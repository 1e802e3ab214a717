"""Long records in pieces: equations of which the nodes inside a piece are eliminated, so that pieces meet at their ends alone.

A piece is a run of segments from one node to another, which it shares with the next. Its own equations hold a border of both
ends and the unknowns of all; eliminated piece by piece, in memory that does not grow with the record, they leave a chain of
ends, whose solution is exactly that of the equations of all nodes (substructuring).

References
----------
J. S. Przemieniecki, AIAA J. 1, 138 (1963), for substructures.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
from scipy.linalg import lapack

from linkwise.arrays import Bools, Floats, Indices
from linkwise.likelihood.shooting.bordered_system import BorderedFactor, BorderedSystem
from linkwise.likelihood.shooting.loss import Loss
from linkwise.likelihood.shooting.normal_equations import add_prior, linearise
from linkwise.likelihood.shooting.residuals import evaluate
from linkwise.likelihood.shooting.segments import Iterate, Scales, Segments

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
