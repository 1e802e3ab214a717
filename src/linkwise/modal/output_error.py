"""Maximum likelihood of the modes of a test: the response that they give against that which was measured.

Residues of a mode are the products of its shape at the points of response and of force, so that one shape at each point is
found for all of them. Noise is white in each channel, of a level that follows from the residuals. Where these are more than
noise, what linear modes leave rings down with the modes, and errors are those of the scatter of the score between blocks of
the records that last longer than that (White 1982).

Damping between modes is let free, for all pairs of modes at once, where the score of one of them says that the likelihood
would rise by more than the penalty of the Bayesian information criterion. Then it is known beforehand to be of the size that
damping has which dissipates in every motion, c_rs^2 < c_rr c_ss.

In each channel the response is the real part of a weighted sum of signals that all channels share: of each complex mode the
motion under each force, and a free decay. Derivatives are sums of these and of their derivatives by the pole.

References
----------
H. White, Econometrica 50, 1 (1982).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import combinations, pairwise, product

import numpy as np
import scipy

from linkwise.arrays import Floats
from linkwise.modal.measurement import MeasuredRun, ModalMeasurement
from linkwise.modal.oscillators import Complex, ComplexModes, pole
from linkwise.modal.pursuit import LinearProblem, PursuedModes, least_squares
from linkwise.progress import Progress, ProgressReport, part, silent

_ACCELERATION = 2  # among the kinds of responses


@dataclass(frozen=True, eq=False)
class CoupledResponse:
    """The response of `modes` with `shapes` (n, m) at the points, from displacements and velocities `first` (n, 2)."""

    measured: ModalMeasurement
    modes: ComplexModes
    shapes: Floats
    first: Floats

    @cached_property
    def _at_points(self) -> Complex:
        """(n, m) complex shapes."""
        return np.asarray(self.modes.vectors @ self.shapes)

    @cached_property
    def _at_start(self) -> Complex:
        """(n,) complex modes at the start."""
        q, v = self.first.T
        vectors = self.modes.vectors
        return np.asarray(vectors @ (self.modes.damping @ q + v) + self.modes.poles * (vectors @ q))

    @cached_property
    def _participation(self) -> Complex:
        """(n, P + 1) how each force, and the start, enter each complex mode."""
        return np.concatenate([self._at_points[:, self.measured.forced], self._at_start[:, None]], axis=1)

    def of(self, run: MeasuredRun) -> Floats:
        """(C, N) without offsets, in a record."""
        signals = np.array([run.signals(s) for s in self.modes.poles.tolist()])
        at, kinds = self._at_points[:, self.measured.sensed], self.measured.kinds
        weights = 2.0 * (self.modes.poles[:, None] ** kinds * at).T[:, :, None] * self._participation
        response = _real_sum(weights, signals)
        direct = self.shapes[:, self.measured.sensed].T @ self.shapes[:, self.measured.forced]
        response[kinds == _ACCELERATION] += direct[kinds == _ACCELERATION] @ run.applied
        return response

    def derivatives(self, run: MeasuredRun) -> Iterator[Floats]:
        """(K, N) of each channel: by what complex modes change with, by shapes mode by mode, and by the start mode by mode."""
        poles, count = self.modes.poles, len(self.shapes)
        signals = np.array([run.signals(s) for s in poles.tolist()])
        by_pole = [run.signals_by_pole(s, own) for s, own in zip(poles.tolist(), signals, strict=True)]
        both = np.concatenate([signals, by_pole], axis=1)
        moved, turned, entering = self._changes
        for kind, point in zip(self.measured.kinds.tolist(), self.measured.sensed.tolist(), strict=True):
            power = 2.0 * poles**kind
            slope = 2.0 * kind * poles ** max(kind - 1, 0)
            at, participation = self._at_points[:, point], self._participation
            scaled = slope * moved * at + power * turned[:, :, point]
            weights = scaled[:, :, None] * participation + (power * at)[:, None] * entering
            of_poles = (power * moved * at)[:, :, None] * participation
            rows = _real_sum(np.concatenate([weights, of_poles], axis=2), both)
            if kind == _ACCELERATION:
                shapes = rows[-count * (len(self.measured.points) + 2) : -2 * count]
                of_shapes = shapes.reshape(count, len(self.measured.points), -1)
                for number, force in enumerate(self.measured.forced.tolist()):
                    of_shapes[:, point] += self.shapes[:, force, None] * run.applied[number]
                    of_shapes[:, force] += self.shapes[:, point, None] * run.applied[number]
            yield rows

    @cached_property
    def _changes(self) -> tuple[Complex, Complex, Complex]:
        """Derivatives of poles (K, n), complex shapes (K, n, m) and the participation (K, n, P + 1) by all parameters."""
        modes, (n, m) = self.modes, self.shapes.shape
        poles, vectors = modes.poles, modes.vectors
        of_poles, of_vectors = modes.changes
        own, free = len(of_poles), n * m
        moved = np.zeros((own + free + 2 * n, n), dtype=complex)
        moved[:own] = of_poles
        turned = np.zeros((len(moved), n, m), dtype=complex)
        turned[:own] = of_vectors @ self.shapes
        for mode in range(n):
            for point in range(m):
                turned[own + mode * m + point, :, point] = vectors[:, mode]
        q, v = self.first.T
        at_start = np.zeros((len(moved), n), dtype=complex)
        at_start[:own] = (
            of_vectors @ (modes.damping @ q + v)
            + (modes.damping_changes @ q) @ vectors.T
            + of_poles * (vectors @ q)
            + poles * (of_vectors @ q)
        )
        at_start[own + free :: 2] = (vectors @ modes.damping + poles[:, None] * vectors).T
        at_start[own + free + 1 :: 2] = vectors.T
        entering = np.concatenate([turned[:, :, self.measured.forced], at_start[:, :, None]], axis=2)
        return moved, turned, entering


def _real_sum(weights: Complex, signals: Complex) -> Floats:
    """(K, N) real parts of the sums of signals (n, p, N) with weights (K, n, p)."""
    by_row = weights.reshape(len(weights), -1)
    flat = signals.reshape(by_row.shape[1], -1)
    return np.asarray(by_row.real @ flat.real - by_row.imag @ flat.imag)


_STEPS = 60
_CONVERGED = 1e-6  # of the cost: a step that gains less ends the search
_LEAST_DAMPING, _LARGEST_DAMPING = 1e-6, 0.9
_FEWEST, _MOST = 5, 40  # blocks, between which scores scatter
_LEVEL = 0.975  # of the quantile by which few blocks widen errors
_ROUNDS = 3  # of levels of noise
_STANDS_OUT = 3.0  # standard errors of damping between modes
# modes up to which damping couples all pairs, and how far apart by number with more
_EVERY_PAIR, _NEIGHBOURS = (12, 3)
_SINGULAR = 1e-13  # of the scaled curvature: rounding


@dataclass(frozen=True, eq=False)
class ModalFit:
    """The most likely n modes: frequencies in Hz and damping ratios (n,), mass-normalised shapes (n, m) at the points, and
    for `pairs` of modes whose damping matrix is not diagonal its entries `between` (k,) in N s/m, with about the largest
    `sizes` with which it dissipates. `covariance` is of frequency, damping and shape, mode by mode, then of `between`,
    where noise explains the residuals; `block_ratios` are standard errors by the scatter between blocks of the records
    over those, at least 1. `noise` (C,) are the root mean squares of the `residuals` (C, N) of each record, NaN where a
    sample is missing, and `starts` (n,) its free motion, as complex accelerations of each mode.
    """

    frequencies: Floats
    damping: Floats
    shapes: Floats
    pairs: tuple[tuple[int, int], ...]
    between: Floats
    sizes: Floats
    covariance: Floats
    block_ratios: Floats
    noise: Floats
    residuals: tuple[Floats, ...]
    starts: tuple[Complex, ...]
    converged: bool


def modal_fit(measured: ModalMeasurement, start: PursuedModes, progress: Progress = silent) -> ModalFit:
    """The most likely modes, searched from a start; with damping between pairs of them where that of one stands out."""
    problem = _OutputError(measured, len(start.frequencies))
    optimum = _most_likely(problem, problem.start(start), part(progress, 0.0, 0.5))
    coupled, point = _with_pairs(problem, *optimum[:2])
    if coupled.pairs:
        fit = _modal_fit(coupled, _most_likely(coupled, point, part(progress, 0.5, 1.0)))
        errors = np.sqrt(fit.covariance.diagonal()) * fit.block_ratios
        if np.any(np.abs(fit.between) > _STANDS_OUT * errors[-len(fit.pairs) :]):
            return fit
    return _modal_fit(problem, optimum)


def _modal_fit(problem: _OutputError, found: tuple[Floats, Floats, bool]) -> ModalFit:
    """The modes that were found, in the order of their frequencies, with their errors."""
    measured, (theta, noise, converged) = problem.measured, found
    theta, scaling = problem.scaled(theta)
    covariance, ratios = _errors(problem, theta, noise, scaling)
    by_mode = problem.by_mode(theta)
    order = np.argsort(by_mode[:, 0])
    numbers = np.arange(by_mode.size).reshape(by_mode.shape)[order].ravel()
    numbers = np.concatenate([numbers, np.arange(by_mode.size, problem.own)])
    place = np.argsort(order).tolist()
    return ModalFit(
        frequencies=by_mode[order, 0],
        damping=by_mode[order, 1],
        shapes=by_mode[order, 2:],
        pairs=tuple((place[first], place[second]) for first, second in problem.pairs),
        between=problem.between(theta),
        sizes=problem.sizes,
        covariance=covariance[np.ix_(numbers, numbers)],
        block_ratios=ratios[numbers],
        noise=noise,
        residuals=tuple(problem.left(theta)),
        starts=tuple(problem.free(theta, run)[order] for run in range(len(measured.runs))),
        converged=converged,
    )


def _most_likely(problem: _OutputError, theta: Floats, progress: Progress) -> tuple[Floats, Floats, bool]:
    """The parameters and levels of noise that are most likely, searched in turn, and whether the search converged."""
    noise, converged = problem.levels(theta), False
    for number in range(_ROUNDS):
        between = ", damping between them" if problem.pairs else ""
        progress(ProgressReport(number / _ROUNDS, f"all {problem.modes} modes{between}"))
        equations, cost = partial(problem.equations, noise=noise), partial(problem.cost, noise=noise)
        theta, converged = least_squares(
            theta, equations, cost, problem.within, steps=_STEPS, least_gain=_CONVERGED
        )
        noise = problem.levels(theta)
    return theta, noise, converged


def _with_pairs(problem: _OutputError, theta: Floats, noise: Floats) -> tuple[_OutputError, Floats]:
    """The problem with damping between pairs of modes, and where to start from, if one of them gains enough."""
    far = problem.modes if problem.modes <= _EVERY_PAIR else _NEIGHBOURS
    pairs = tuple(pair for pair in combinations(range(problem.modes), 2) if pair[1] - pair[0] <= far)
    of_modes = problem.by_mode(theta)
    damping = 4.0 * np.pi * of_modes[:, 0] * of_modes[:, 1]
    sizes = np.array([np.sqrt(damping[first] * damping[second]) for first, second in pairs])
    coupled = replace(problem, pairs=pairs, sizes=sizes)
    point = np.insert(theta, problem.own, np.zeros(len(pairs)))
    if not pairs:
        return coupled, point
    equations = coupled.equations(point, noise, blocks=coupled.blocks(point))
    tested = np.arange(problem.own, coupled.own)
    others = np.setdiff1d(np.arange(len(point)), tested)
    curvature, scores = equations.curvature, equations.scores
    lost = np.linalg.pinv(curvature[np.ix_(others, others)], rcond=_SINGULAR, hermitian=True)
    shared = lost @ curvature[np.ix_(others, tested)]
    expected = curvature[tested, tested] - np.einsum("ip,ip->p", curvature[np.ix_(others, tested)], shared)
    of_blocks = scores[:, tested] - scores[:, others] @ shared
    scatter = np.var(of_blocks, axis=0, ddof=1) * len(of_blocks)
    gains = of_blocks.sum(axis=0) ** 2 / np.maximum(np.maximum(expected, scatter), np.finfo(float).tiny)
    enough = gains.max() > np.log(problem.measured.samples.sum()) + 2.0 * np.log(len(pairs))
    return (coupled, point) if enough else (problem, theta)


def _errors(problem: _OutputError, theta: Floats, noise: Floats, scaling: Floats) -> tuple[Floats, Floats]:
    """The covariance (p, p) from the curvature, and ratios (p,) of errors by blocks, of parameters with a `scaling` (p, p)."""
    equations = problem.equations(theta, noise, blocks=problem.blocks(theta))
    curvature = equations.curvature
    scale = np.sqrt(np.maximum(curvature.diagonal(), np.finfo(float).tiny))
    size = np.outer(scale, scale)
    inverse = scaling @ (np.linalg.pinv(curvature / size, rcond=_SINGULAR, hermitian=True) / size)
    scores = equations.scores - equations.scores.mean(axis=0)
    blocks = len(scores)
    scatter = scores.T @ scores * (blocks / (blocks - 1))
    robust = (inverse @ scatter @ inverse.T).diagonal()
    inverse = inverse @ scaling.T
    quantiles = scipy.special.stdtrit(blocks - 1, _LEVEL) / scipy.special.ndtri(_LEVEL)
    variance = np.maximum(inverse.diagonal(), np.finfo(float).tiny)
    return inverse, np.maximum(quantiles * np.sqrt(np.maximum(robust, 0.0) / variance), 1.0)


@dataclass(frozen=True, eq=False)
class _OutputError:
    """The response of `modes` to the forces of a test, as a function of its parameters.

    Mode by mode frequency, damping and shape at m points; then the damping between `pairs` of modes; then of each record the
    displacements and velocities of the modes at its start, mode by mode, and offsets (C,).
    """

    measured: ModalMeasurement
    modes: int
    pairs: tuple[tuple[int, int], ...] = ()
    sizes: Floats = field(default_factory=lambda: np.empty(0))  # that damping between pairs has

    @property
    def width(self) -> int:
        """Parameters of a mode."""
        return 2 + len(self.measured.points)

    @property
    def own(self) -> int:
        """Parameters of the structure."""
        return self.modes * self.width + len(self.pairs)

    def _free(self, run: int) -> int:
        """The number of the first parameter of a record."""
        return self.own + run * (2 * self.modes + len(self.measured.kinds))

    def start(self, pursued: PursuedModes) -> Floats:
        """Parameters from decays, or from residues: the shape at a force by the response there, the others by theirs."""
        theta, free = np.zeros(self._free(len(self.measured.runs))), not len(self.measured.forced)
        own = self.by_mode(theta)
        own[:, 0], own[:, 1] = pursued.frequencies, pursued.damping
        for mode, residues in enumerate(pursued.residues):
            own[mode, 2:] = self._decay(theta, mode, pursued) if free else _shape(self.measured, residues)
        return self.within(theta)

    def _decay(self, theta: Floats, mode: int, pursued: PursuedModes) -> Floats:
        """(m,) shape of a mode from its free motions, whose starts in each record are written into `theta`."""
        free, s = pursued.free[:, mode], pole(float(pursued.frequencies[mode]), float(pursued.damping[mode]))
        loudest = free[np.unravel_index(np.argmax(np.abs(free)), free.shape)[0]]
        seen = (loudest / loudest[np.argmax(np.abs(loudest))]).real
        for run, motion in enumerate(free):
            start = motion @ seen / (seen @ seen)
            theta[self._free(run) + 2 * mode :][:2] = (start / s**2).real, (start / s).real
        shape = np.zeros(len(self.measured.points))
        shape[self.measured.sensed] = seen
        return shape

    def by_mode(self, theta: Floats) -> Floats:
        """(n, 2 + m) frequency, damping and shape of each mode, a view."""
        return theta[: self.modes * self.width].reshape(self.modes, self.width)

    def free(self, theta: Floats, run: int) -> Complex:
        """(n,) free motion of the modes at the start of a record, as complex accelerations."""
        first, of_modes = self._free(run), self.by_mode(theta)
        poles = np.array([pole(*map(float, row)) for row in of_modes[:, :2]])
        q, v = theta[first : first + 2 * self.modes].reshape(self.modes, 2).T
        return np.asarray((q - 1j * (v - poles.real * q) / poles.imag) * poles**2)

    def scaled(self, theta: Floats) -> tuple[Floats, Floats]:
        """Of decays: shapes of unit modal mass, without masses of 1 where they are largest, and the projection (p, p) of the
        parameters off what that size takes; else the same, which the force has scaled.
        """
        scaled, of_size = theta.copy(), np.eye(len(theta))
        if len(self.measured.forced):
            return scaled, of_size
        masses = self.measured.masses
        for mode, shape in enumerate(self.by_mode(theta)[:, 2:]):
            own = np.arange(mode * self.width + 2, (mode + 1) * self.width)
            weights = masses if masses.any() else np.eye(len(shape))[np.argmax(np.abs(shape))]
            size = float(np.sqrt(weights @ shape**2))
            scaled[own] = shape / size
            of_size[np.ix_(own, own)] -= np.outer(scaled[own], weights * scaled[own])
            for run in range(len(self.measured.runs)):
                start = self._free(run) + 2 * mode
                scaled[start : start + 2] *= size
        return scaled, of_size

    def between(self, theta: Floats) -> Floats:
        """Damping between the pairs."""
        return theta[self.modes * self.width : self.own]

    def within(self, theta: Floats) -> Floats:
        """Parameters with positive frequencies and damping below the critical one."""
        bounded = theta.copy()
        of_modes = self.by_mode(bounded)
        of_modes[:, 0] = np.abs(of_modes[:, 0])
        of_modes[:, 1] = np.clip(of_modes[:, 1], _LEAST_DAMPING, _LARGEST_DAMPING)
        return bounded

    def _coupled(self, theta: Floats, run: int) -> CoupledResponse:
        """Of a record, without offsets."""
        of_modes, first = self.by_mode(theta), self._free(run)
        modes = ComplexModes(of_modes[:, 0], of_modes[:, 1], self.pairs, self.between(theta))
        start = theta[first : first + 2 * self.modes].reshape(self.modes, 2)
        return CoupledResponse(self.measured, modes, of_modes[:, 2:], start)

    def response(self, theta: Floats, run: int) -> Floats:
        """(C, N) of a record."""
        first = self._free(run) + 2 * self.modes
        offsets = theta[first : first + len(self.measured.kinds)]
        return self._coupled(theta, run).of(self.measured.runs[run]) + offsets[:, None]

    def left(self, theta: Floats) -> Iterator[Floats]:
        """(C, N) residuals of each record."""
        for number, run in enumerate(self.measured.runs):
            yield run.responses - self.response(theta, number)

    def levels(self, theta: Floats) -> Floats:
        """(C,) root mean squares of the residuals."""
        power = np.sum([np.nansum(left**2, axis=1) for left in self.left(theta)], axis=0)
        mean = power / np.maximum(self.measured.samples, 1)
        return np.asarray(np.sqrt(np.maximum(mean, np.finfo(float).tiny)))

    def cost(self, theta: Floats, noise: Floats) -> float:
        """The sum of squares in units of the noise."""
        total = float(np.sum((self.between(theta) / self.sizes) ** 2))
        try:
            total += sum(float(np.nansum((left / noise[:, None]) ** 2)) for left in self.left(theta))
        except np.linalg.LinAlgError:  # a mode does not vibrate
            return np.inf
        return total if np.isfinite(total) else np.inf

    def blocks(self, theta: Floats) -> int:
        """Of each record: as many as the slowest mode rings down in it, and no fewer than needed to compare them."""
        of_modes = self.by_mode(theta)
        slowest = float(np.min(2.0 * np.pi * of_modes[:, 0] * of_modes[:, 1]))
        shortest = min(run.count * run.step for run in self.measured.runs)
        fewest = max(1, -(-_FEWEST // len(self.measured.runs)))
        return int(np.clip(shortest * slowest, fewest, _MOST))

    def equations(self, theta: Floats, noise: Floats, *, blocks: int = 1) -> LinearProblem:
        """The linearised problem about some parameters, each record in so many blocks."""
        size = len(theta)
        between = self.between(theta)
        of_pairs = np.arange(self.own - len(between), self.own)
        cost, curvature, scores = float(np.sum((between / self.sizes) ** 2)), np.zeros((size, size)), []
        curvature[of_pairs, of_pairs] = self.sizes**-2.0
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
        slope = joined.sum(axis=0)
        slope[of_pairs] -= between / self.sizes**2
        return LinearProblem(cost, slope, curvature, joined)

    def _jacobian(self, theta: Floats, run: int) -> Iterator[tuple[Floats, list[int]]]:
        """For each channel the derivatives (k, N) of its response by some parameters, and the numbers of these."""
        first, record = self._free(run), self.measured.runs[run]
        own = np.arange(self.modes * self.width).reshape(self.modes, self.width)
        numbers = [*own[:, :2].ravel(), *range(own.size, self.own), *own[:, 2:].ravel()]
        numbers += range(first, first + 2 * self.modes)
        for channel, rows in enumerate(self._coupled(theta, run).derivatives(record)):
            of_offset = np.ones((1, record.count))
            yield np.concatenate([rows, of_offset]), [*map(int, numbers), first + 2 * self.modes + channel]


def _shape(measured: ModalMeasurement, residues: Floats) -> Floats:
    """(m,) shape from the residues (C, P) of a mode: scaled where a response was measured at a force."""
    sensed, forced = measured.sensed.tolist(), measured.forced.tolist()
    pairs = product(enumerate(sensed), enumerate(forced))
    size, _, force = max((abs(residues[c, p]), c, p) for (c, at), (p, by) in pairs if at == by)
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
