"""Maximum likelihood of the modes of a test: the response that they give against that which was measured.

Residues of a mode are the products of its shape at the points of response and of force, so that one shape at each point is
found for all of them. Noise is white in each channel, of a level that follows from the residuals. Where these are more than
noise, what linear modes leave rings down with the modes, and errors are those of the scatter of the score between blocks of
the records that last longer than that (White 1982).

References
----------
H. White, Econometrica 50, 1 (1982).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy

from linkwise.arrays import Floats
from linkwise.modal.least_squares import LinearProblem, SearchEnd, least_squares
from linkwise.modal.measured import MeasuredRun, ModalMeasurement
from linkwise.modal.pursuit import PursuedModes

_STEPS = 60
_CONVERGED = 1e-6  # of the cost: a step that gains less ends the search
_LEAST_DAMPING, _LARGEST_DAMPING = 1e-6, 0.9
_FEWEST, _MOST = 5, 40  # blocks, between which scores scatter
_LEVEL = 0.975  # of the quantile by which few blocks widen errors
_ROUNDS = 3  # of levels of noise
_SINGULAR = 1e-13  # of the scaled curvature: rounding


@dataclass(frozen=True, eq=False)
class ModalFit:
    """The most likely modes.

    Attributes
    ----------
    frequencies, damping : array of shape (n,)
        In Hz, and as parts of the critical damping.
    shapes : array of shape (n, m)
        Mass-normalised, at the points.
    covariance : array of shape (n (2 + m), n (2 + m))
        Of frequency, damping and shape, mode by mode, where noise explains the residuals.
    block_ratios : array of shape (n (2 + m),)
        Standard errors by the scatter between blocks of the records over those of `covariance`, at least 1.
    sensitivities : array of shape (n (2 + m),)
        By how much the response changes with each, the others held: the root of the sum of squares in units of `noise`.
    noise : array of shape (C,)
        Root mean squares of the residuals.
    residuals : tuple of array of shape (C, N)
        Of each record, NaN where a sample is missing.
    converged : bool
        Whether the search converged.
    """

    frequencies: Floats
    damping: Floats
    shapes: Floats
    covariance: Floats
    block_ratios: Floats
    sensitivities: Floats
    noise: Floats
    residuals: tuple[Floats, ...]
    converged: bool


def modal_fit(measured: ModalMeasurement, start: PursuedModes) -> ModalFit:
    """The most likely modes, searched from a start."""
    problem = _OutputError(measured, len(start.frequencies))
    theta = problem.start(start)
    noise, converged = problem.levels(theta), False
    for _ in range(_ROUNDS):
        theta, converged = _searched(problem, theta, noise)
        noise = problem.levels(theta)
    covariance, ratios, sensitivities = _errors(problem, theta, noise)
    own = slice(0, problem.modes * problem.width)
    by_mode = theta[own].reshape(problem.modes, problem.width)
    order = np.argsort(by_mode[:, 0])
    numbers = (order[:, None] * problem.width + np.arange(problem.width)).ravel()
    residuals = tuple(
        run.responses - problem.response(theta, number) for number, run in enumerate(measured.runs)
    )
    return ModalFit(
        frequencies=by_mode[order, 0],
        damping=by_mode[order, 1],
        shapes=by_mode[order, 2:],
        covariance=covariance[np.ix_(numbers, numbers)],
        block_ratios=ratios[numbers],
        sensitivities=sensitivities[numbers],
        noise=noise,
        residuals=residuals,
        converged=converged,
    )


def _searched(problem: _OutputError, theta: Floats, noise: Floats) -> SearchEnd:
    """The parameters that are most likely with given levels of noise."""
    return least_squares(
        theta,
        lambda point: problem.equations(point, noise).linear,
        lambda point: problem.cost(point, noise),
        problem.within,
        steps=_STEPS,
        least_gain=_CONVERGED,
    )


def _errors(problem: _OutputError, theta: Floats, noise: Floats) -> tuple[Floats, Floats, Floats]:
    """The covariance (p, p) from the curvature, ratios (p,) of errors by blocks, and sensitivities (p,) of the response."""
    equations = problem.equations(theta, noise, blocks=problem.blocks(theta))
    curvature = equations.linear.curvature
    scale = np.sqrt(np.maximum(curvature.diagonal(), np.finfo(float).tiny))
    size = np.outer(scale, scale)
    inverse = np.linalg.pinv(curvature / size, rcond=_SINGULAR, hermitian=True) / size
    scores = equations.scores - equations.scores.mean(axis=0)
    blocks = len(scores)
    scatter = scores.T @ scores * (blocks / (blocks - 1))
    robust = (inverse @ scatter @ inverse).diagonal()
    quantiles = scipy.special.stdtrit(blocks - 1, _LEVEL) / scipy.special.ndtri(_LEVEL)
    return inverse, np.maximum(quantiles * np.sqrt(robust / inverse.diagonal()), 1.0), scale


class _Equations(NamedTuple):
    """The linearised problem, and the scores (B, p) of blocks, which its slope is the sum of."""

    linear: LinearProblem
    scores: Floats


@dataclass(frozen=True, eq=False)
class _OutputError:
    """The response of `modes` to the forces of a test, as a function of its parameters.

    Mode by mode frequency, damping and shape at m points; then of each record the free motions (n, 2) and offsets (C,).
    """

    measured: ModalMeasurement
    modes: int

    @property
    def width(self) -> int:
        """Parameters of a mode."""
        return 2 + len(self.measured.points)

    @property
    def _of_run(self) -> int:
        return 2 * self.modes + len(self.measured.kinds)

    def _free(self, run: int) -> int:
        """The number of the first parameter of a record."""
        return self.modes * self.width + run * self._of_run

    def start(self, pursued: PursuedModes) -> Floats:
        """Parameters from residues: the shape at a point of force by the response there, the others by theirs."""
        theta = np.zeros(self._free(len(self.measured.runs)))
        for mode in range(self.modes):
            own = theta[mode * self.width : (mode + 1) * self.width]
            own[:2] = pursued.frequencies[mode], pursued.damping[mode]
            own[2:] = _shape(self.measured, pursued.residues[mode])
        return self.within(theta)

    def within(self, theta: Floats) -> Floats:
        """Parameters with positive frequencies and damping below the critical one."""
        bounded = theta.copy()
        own = bounded[: self.modes * self.width].reshape(self.modes, self.width)
        own[:, 0] = np.abs(own[:, 0])
        own[:, 1] = np.clip(own[:, 1], _LEAST_DAMPING, _LARGEST_DAMPING)
        return bounded

    def response(self, theta: Floats, run: int) -> Floats:
        """(C, N) of a record."""
        measured = self.measured
        total = np.zeros_like(measured.runs[run].responses)
        for mode in range(self.modes):
            frequency, damping, shape, free = self._mode(theta, run, mode)
            motion = self._motion(measured.runs[run], frequency, damping, shape, free)
            total += shape[measured.sensed][:, None] * motion[measured.kinds]
        return total + self._offsets(theta, run)[:, None]

    def _mode(self, theta: Floats, run: int, mode: int) -> tuple[float, float, Floats, Floats]:
        own = theta[mode * self.width : (mode + 1) * self.width]
        first = self._free(run) + 2 * mode
        return float(own[0]), float(own[1]), own[2:], theta[first : first + 2]

    def _offsets(self, theta: Floats, run: int) -> Floats:
        first = self._free(run) + 2 * self.modes
        return theta[first : first + len(self.measured.kinds)]

    def _motion(
        self, run: MeasuredRun, frequency: float, damping: float, shape: Floats, free: Floats
    ) -> Floats:
        """(3, N) motion of the coordinate of a mode."""
        weights = np.concatenate([shape[self.measured.forced], free])
        return np.asarray(np.tensordot(weights, run.motions(frequency, damping), axes=1))

    def levels(self, theta: Floats) -> Floats:
        """(C,) root mean squares of the residuals."""
        power, count = np.zeros(len(self.measured.kinds)), np.zeros(len(self.measured.kinds))
        for number, run in enumerate(self.measured.runs):
            left = run.responses - self.response(theta, number)
            power += np.nansum(left**2, axis=1)
            count += np.isfinite(left).sum(axis=1)
        return np.asarray(np.sqrt(np.maximum(power / np.maximum(count, 1.0), np.finfo(float).tiny)))

    def cost(self, theta: Floats, noise: Floats) -> float:
        """The sum of squares in units of the noise."""
        total = 0.0
        for number, run in enumerate(self.measured.runs):
            total += float(np.nansum(((run.responses - self.response(theta, number)) / noise[:, None]) ** 2))
        return total if np.isfinite(total) else np.inf

    def blocks(self, theta: Floats) -> int:
        """Of each record: as many as the slowest mode rings down in it, and no fewer than needed to compare them."""
        own = theta[: self.modes * self.width].reshape(self.modes, self.width)
        slowest = float(np.min(2.0 * np.pi * own[:, 0] * own[:, 1]))
        shortest = min(run.count * run.step for run in self.measured.runs)
        fewest = max(1, -(-_FEWEST // len(self.measured.runs)))
        return int(np.clip(shortest * slowest, fewest, _MOST))

    def equations(self, theta: Floats, noise: Floats, *, blocks: int = 1) -> _Equations:
        """The linearised problem about some parameters, each record in so many blocks."""
        size = len(theta)
        cost, curvature, scores = 0.0, np.zeros((size, size)), []
        for number, run in enumerate(self.measured.runs):
            left = (run.responses - self.response(theta, number)) / noise[:, None]
            of_blocks = np.zeros((blocks, size))
            for channel, (columns, numbers) in enumerate(self._jacobian(theta, number)):
                known = np.isfinite(left[channel])
                rows = np.where(known, columns / noise[channel], 0.0)
                error = np.where(known, left[channel], 0.0)
                cost += float(error @ error)
                curvature[np.ix_(numbers, numbers)] += rows @ rows.T
                edges = np.linspace(0, run.count, blocks + 1).astype(int).tolist()
                for block, (first, end) in enumerate(pairwise(edges)):
                    of_blocks[block, numbers] += rows[:, first:end] @ error[first:end]
            scores.append(of_blocks)
        joined = np.concatenate(scores)
        return _Equations(LinearProblem(cost, joined.sum(axis=0), curvature), joined)

    def _jacobian(self, theta: Floats, run: int) -> Iterator[tuple[Floats, list[int]]]:
        """For each channel the derivatives (k, N) of its response by some parameters, and the numbers of these."""
        measured, record = self.measured, self.measured.runs[run]
        forces = len(measured.forced)
        modes = []
        for mode in range(self.modes):
            frequency, damping, shape, free = self._mode(theta, run, mode)
            motions = record.motions(frequency, damping)
            weights = np.concatenate([shape[measured.forced], free])
            changes = record.motion_derivatives(frequency, damping)
            by = [
                np.tensordot(weights, change, axes=1) / value
                for change, value in zip(changes, (frequency, damping), strict=True)
            ]
            modes.append((shape, motions, np.tensordot(weights, motions, axes=1), by))
        for channel, (kind, point) in enumerate(
            zip(measured.kinds.tolist(), measured.sensed.tolist(), strict=True)
        ):
            rows, numbers = [], []
            for mode, (shape, motions, motion, by) in enumerate(modes):
                first = mode * self.width
                by_point = {point: motion[kind].copy()}
                for number, force in enumerate(measured.forced.tolist()):
                    by_point[force] = by_point.get(force, 0.0) + shape[point] * motions[number, kind]
                rows += [shape[point] * derivative[kind] for derivative in by]
                numbers += [first, first + 1]
                rows += list(by_point.values())
                numbers += [first + 2 + place for place in by_point]
                rows += list(shape[point] * motions[forces:, kind])
                numbers += [self._free(run) + 2 * mode, self._free(run) + 2 * mode + 1]
            rows.append(np.ones(record.count))
            numbers.append(self._free(run) + 2 * self.modes + channel)
            yield np.array(rows), numbers


def _shape(measured: ModalMeasurement, residues: Floats) -> Floats:
    """(m,) shape from the residues (C, P) of a mode: scaled where a response was measured at a force."""
    sensed, forced = measured.sensed.tolist(), measured.forced.tolist()
    driven = [
        (abs(residues[c, p]), c, p) for c, at in enumerate(sensed) for p, by in enumerate(forced) if at == by
    ]
    size, _, force = max(driven)
    scale = float(np.sqrt(max(size, np.finfo(float).tiny)))
    shape = np.zeros(len(measured.points))
    for p, by in enumerate(forced):
        collocated = [residues[c, p] for c, at in enumerate(sensed) if at == by]
        shape[by] = np.sqrt(abs(collocated[0])) if collocated else scale
    for c, at in enumerate(sensed):
        if at not in forced:
            shape[at] = residues[c, force] / scale
        elif at != forced[force]:
            shape[at] = np.copysign(shape[at], residues[c, force])
    return shape
