"""Maximum likelihood of the modes of a test: the response that they give against that which was measured.

Residues of a mode are the products of its shape at the points of response and of force, so that one shape at each point is
found for all of them. Noise is white in each channel, of a level that follows from the residuals. Standard errors come from
the curvature, or from the scatter of the score between blocks of the records where that is larger, which they are where the
residuals are more than noise (White 1982).

References
----------
H. White, Econometrica 50, 1 (1982).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from linkwise.arrays import Floats
from linkwise.modal.measured import MeasuredRun, ModalMeasurement
from linkwise.modal.pursuit import PursuedModes

_STEPS = 60
_CONVERGED = 1e-6  # of the cost: a step that gains less ends the search
_DIFFERENCE = 1e-5  # relative, of frequencies and of damping
_LEAST_DAMPING, _LARGEST_DAMPING = 1e-6, 0.9
_BLOCKS = 40  # of a record, between which scores scatter
_FIRST_DAMPING, _MOST_DAMPING = 1e-4, 1e12  # of steps, as a part of the curvature
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
        Of frequency, damping and shape, mode by mode.
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
    covariance = _covariance(problem, theta, noise)
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
        noise=noise,
        residuals=residuals,
        converged=converged,
    )


def _searched(problem: _OutputError, theta: Floats, noise: Floats) -> tuple[Floats, bool]:
    """Levenberg-Marquardt steps with given levels of noise, and whether they converged.

    Where no step lowers the cost, they did if the first step promised to lower it by less than what ends the search.
    """
    equations, damping = problem.equations(theta, noise), _FIRST_DAMPING
    for _ in range(_STEPS):
        promised: float | None = None
        scale = np.maximum(equations.curvature.diagonal(), np.finfo(float).tiny)
        while True:
            matrix = equations.curvature + np.diag(damping * scale)
            size = np.sqrt(np.outer(scale, scale))
            step = np.linalg.solve(matrix / size, equations.slope / np.sqrt(scale)) / np.sqrt(scale)
            if promised is None:
                promised = float(equations.slope @ step)
            trial = problem.within(theta + step)
            cost = problem.cost(trial, noise)
            if cost < equations.cost:
                break
            damping *= 10.0
            if damping > _MOST_DAMPING:
                return theta, promised < _CONVERGED * equations.cost
        gained, theta = equations.cost - cost, trial
        if gained < _CONVERGED * cost:
            return theta, True
        equations, damping = problem.equations(theta, noise), max(0.1 * damping, 1e-9)
    return theta, False


def _covariance(problem: _OutputError, theta: Floats, noise: Floats) -> Floats:
    """The covariance from the curvature, each variance at least that of the scatter between blocks."""
    equations = problem.equations(theta, noise)
    scale = np.sqrt(np.maximum(equations.curvature.diagonal(), np.finfo(float).tiny))
    size = np.outer(scale, scale)
    inverse = np.linalg.pinv(equations.curvature / size, rcond=_SINGULAR, hermitian=True) / size
    scores = equations.scores - equations.scores.mean(axis=0)
    blocks = len(scores)
    scatter = scores.T @ scores * (blocks / max(blocks - 1, 1))
    robust = inverse @ scatter @ inverse
    factor = np.sqrt(np.maximum(robust.diagonal() / inverse.diagonal(), 1.0))
    return np.asarray(inverse * np.outer(factor, factor))


class _Equations(NamedTuple):
    """Cost, slope (p,) and curvature (p, p) of half the squares, and the scores (B, p) of blocks."""

    cost: float
    slope: Floats
    curvature: Floats
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

    def equations(self, theta: Floats, noise: Floats) -> _Equations:
        """The linearised problem about some parameters."""
        size = len(theta)
        cost, slope, curvature, scores = 0.0, np.zeros(size), np.zeros((size, size)), []
        for number, run in enumerate(self.measured.runs):
            left = (run.responses - self.response(theta, number)) / noise[:, None]
            own = np.zeros((_BLOCKS, size))
            for channel, (columns, numbers) in enumerate(self._jacobian(theta, number)):
                known = np.isfinite(left[channel])
                rows = np.where(known, columns / noise[channel], 0.0)
                error = np.where(known, left[channel], 0.0)
                cost += float(error @ error)
                curvature[np.ix_(numbers, numbers)] += rows @ rows.T
                for block, part in enumerate(np.array_split(np.arange(run.count), _BLOCKS)):
                    own[block, numbers] += rows[:, part] @ error[part]
            scores.append(own)
            slope += own.sum(axis=0)
        return _Equations(cost, slope, curvature, np.concatenate(scores))

    def _jacobian(self, theta: Floats, run: int) -> Iterator[tuple[Floats, list[int]]]:
        """For each channel the derivatives (k, N) of its response by some parameters, and the numbers of these."""
        measured, record = self.measured, self.measured.runs[run]
        forces = len(measured.forced)
        modes = []
        for mode in range(self.modes):
            frequency, damping, shape, free = self._mode(theta, run, mode)
            motions = record.motions(frequency, damping)
            weights = np.concatenate([shape[measured.forced], free])
            by = [
                (
                    self._motion(record, frequency + df, damping + dz, shape, free)
                    - self._motion(record, frequency - df, damping - dz, shape, free)
                )
                / (2.0 * (df + dz))
                for df, dz in ((_DIFFERENCE * frequency, 0.0), (0.0, _DIFFERENCE * damping))
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
