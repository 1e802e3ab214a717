"""The search at one relaxation in a long record: steps of all pieces together, whose states then settle piece by piece.

A step that the pieces share moves the unknowns that all have in common and the ends of the pieces as the linearised equations
of everything say. A piece in which the motion bends away from these then lowers its cost by its inner states alone, with a
damping of its own. The ends of the pieces lie elsewhere at every second step.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.shooting.bordered_system import BorderedFactor
from linkwise.likelihood.shooting.damped_step import bounds
from linkwise.likelihood.shooting.loss import Loss
from linkwise.likelihood.shooting.pieces import (
    JoinedPieces,
    PieceSteps,
    joined_pieces,
    piece_between,
    piece_ends,
)
from linkwise.likelihood.shooting.schedule import AnnealingStep
from linkwise.likelihood.shooting.segments import Iterate, Scales, Segments
from linkwise.likelihood.shooting.settled_states import settled_states
from linkwise.progress import Progress, silent

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
