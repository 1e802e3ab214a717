"""First modes of a test, one at a time: the mode that explains most of what the others leave, then all of them again.

Modes are added as long as the Bayesian information criterion falls. Where a structure is not quite linear, or its modes
are not quite real, it would fall on and on: what true modes leave there stands far above the noise, and narrow modes
beside them fit it little by little. Two that move alike, closer than their bandwidth, are one. Once the modes explain the
response but for a small part, one more must take most of what they leave above the noise.

Residues, free motions and offsets follow from frequencies and damping by linear least squares (variable projection, G. H.
Golub and V. Pereyra, SIAM J. Numer. Anal. 10, 413 (1973)). Derivatives of what is left are those of the columns for fixed
weights, projected off the columns: exact in the slope, and in the curvature to the order of what is left (L. Kaufman, BIT
15, 49 (1975)).

Both searches for modes take Levenberg-Marquardt steps on the normal equations of a few unknowns (`least_squares`).

References
----------
J. J. Moré, Lecture Notes in Mathematics 630, 105 (1978).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from linkwise.arrays import Bools, Floats
from linkwise.modal.measurement import MeasuredRun, ModalMeasurement
from linkwise.progress import Progress, ProgressReport

_FIRST_DAMPED, _LEAST_DAMPED, _MOST_DAMPED = 1e-4, 1e-9, 1e12  # of steps, as a part of the curvature


class LinearProblem(NamedTuple):
    """A sum of squares about a point: its `cost`, half its slope downwards (p,), its curvature (p, p), and where they were
    asked for the scores (B, p) of blocks, which the slope is the sum of but for what is known before.
    """

    cost: float
    slope: Floats
    curvature: Floats
    scores: Floats = np.empty(0)


def least_squares(
    start: Floats,
    equations: Callable[[Floats], LinearProblem],
    cost: Callable[[Floats], float],
    within: Callable[[Floats], Floats],
    *,
    steps: int,
    least_gain: float,
) -> tuple[Floats, bool]:
    """The point of the least sum of squares near `start` (p,), where no step lowers the cost or one lowers it by less than
    a part `least_gain`, and whether the search converged: if the first step there promised no more than that. `equations`
    linearises the problem about a point, `cost` is the sum of squares there, `within` the nearest point within the bounds.
    """
    point, linear, damping = start, equations(start), _FIRST_DAMPED
    for _ in range(steps):
        promised: float | None = None
        scale = np.sqrt(np.maximum(linear.curvature.diagonal(), np.finfo(float).tiny))
        matrix = linear.curvature / np.outer(scale, scale)
        while True:
            step = np.linalg.solve(matrix + damping * np.eye(len(point)), linear.slope / scale) / scale
            trial = within(point + step)
            if promised is None:  # what points out of the bounds gains nothing
                promised = float(linear.slope @ (trial - point))
            trial_cost = cost(trial)
            if trial_cost < linear.cost:
                break
            damping *= 10.0
            if damping > _MOST_DAMPED:
                return point, promised < least_gain * linear.cost
        gained, point = linear.cost - trial_cost, trial
        if gained < least_gain * trial_cost:
            return point, True
        linear, damping = equations(point), max(0.1 * damping, _LEAST_DAMPED)
    return point, False


_RIDGE = 1e-12  # of columns of unit norm: two modes may be the same


class _Basis(NamedTuple):
    """Columns (k, N) of unit norm, 0 where a sample is missing, what they were divided by (k,), and their Cholesky factor."""

    columns: Floats
    norms: Floats
    factor: tuple[Floats, bool]

    @classmethod
    def of(cls, columns: Floats) -> _Basis:
        norms = np.sqrt(np.einsum("ij,ij->i", columns, columns))
        norms = np.where(norms > 0.0, norms, 1.0)
        columns = columns / norms[:, None]
        square = columns @ columns.T
        square[np.diag_indices_from(square)] += _RIDGE
        return cls(columns, norms, scipy.linalg.cho_factor(square))


class _ChannelFit(NamedTuple):
    """Of one channel: its basis, the weights (k,) of its columns, and what they leave (N,), 0 where a sample is missing."""

    basis: _Basis
    weights: Floats
    left: Floats


@dataclass(frozen=True, eq=False)
class Projection:
    """Modes fitted to a test at given `logs` (n, 2) of frequencies in Hz and of damping ratios."""

    measured: ModalMeasurement
    logs: Floats

    @cached_property
    def _fits(self) -> tuple[tuple[_ChannelFit, ...], ...]:
        """Of each channel of each record."""
        return tuple(tuple(self._fitted(run)) for run in self.measured.runs)

    def _fitted(self, run: MeasuredRun) -> Iterator[_ChannelFit]:
        columns = np.empty((0, 3, run.count))
        if len(self.logs):
            columns = np.concatenate([run.motions(*np.exp(of_mode)) for of_mode in self.logs])
        complete: dict[int, _Basis] = {}
        for kind, samples in zip(self.measured.kinds.tolist(), run.responses, strict=True):
            known = np.isfinite(samples)
            basis = complete.get(kind)
            if basis is None or not known.all():
                basis = _Basis.of(np.where(known, np.vstack([columns[:, kind], np.ones(run.count)]), 0.0))
            if known.all():
                complete[kind] = basis
            target = np.where(known, samples, 0.0)
            weights = scipy.linalg.cho_solve(basis.factor, basis.columns @ target)
            yield _ChannelFit(basis, weights, target - weights @ basis.columns)

    @property
    def left(self) -> list[Floats]:
        """(C, N) of each record that the modes leave, NaN where a sample is missing."""
        left = ([fit.left for fit in fits] for fits in self._fits)
        runs = zip(self.measured.runs, left, strict=True)
        return [np.where(np.isfinite(run.responses), left, np.nan) for run, left in runs]

    @property
    def levels(self) -> Floats:
        """(C,) root mean squares of what is left."""
        mean = self.power / np.maximum(self.measured.samples, 1)
        return np.asarray(np.sqrt(np.maximum(mean, np.finfo(float).tiny)))

    @property
    def power(self) -> Floats:
        """(C,) sums of squares of what is left."""
        sums = [[float(fit.left @ fit.left) for fit in fits] for fits in self._fits]
        return np.asarray(np.sum(sums, axis=0))

    def cost(self, levels: Floats) -> float:
        """The sum of squares of what is left, in units of `levels` (C,)."""
        cost = float(np.sum(self.power / levels**2))
        return cost if np.isfinite(cost) else np.inf

    def residues(self, run: int) -> Floats:
        """(n, C, P) residues that a record gives."""
        return np.asarray(self._weights(run)[:, :, :-2].transpose(1, 0, 2))

    def _weights(self, run: int) -> Floats:
        """(C, n, P + 2) sizes of the motions of each mode, those under each force first, in the channels of a record."""
        weights = np.array([(fit.weights / fit.basis.norms)[:-1] for fit in self._fits[run]])
        return weights.reshape(len(weights), len(self.logs), len(self.measured.forced) + 2)

    def free_motions(self, run: int) -> NDArray[np.complex128]:
        """(n, C) free motion of each mode at the start of a record, as complex accelerations of each place."""
        weights = self._weights(run)
        return np.asarray((weights[:, :, -2] - 1j * weights[:, :, -1]).T)

    def equations(self, levels: Floats) -> LinearProblem:
        """The sum of squares about `logs`, in units of `levels` (C,)."""
        size = self.logs.size
        slope, curvature = np.zeros(size), np.zeros((size, size))
        for number in range(len(self.measured.runs)):
            for rows, left in self.derivatives(number, levels):
                slope += rows @ left
                curvature += rows @ rows.T
        return LinearProblem(self.cost(levels), slope, curvature)

    def derivatives(self, run: int, levels: Floats) -> Iterator[tuple[Floats, Floats]]:
        """Of each channel of a record, derivatives (2 n, N) of the response by `logs`, and what is left (N,), over levels."""
        record = self.measured.runs[run]
        changes = [record.motion_derivatives(*np.exp(of_mode)) for of_mode in self.logs]
        known, weights = np.isfinite(record.responses), self._weights(run)
        for channel, (fit, kind) in enumerate(zip(self._fits[run], self.measured.kinds, strict=True)):
            of_modes = zip(weights[channel], changes, strict=True)
            rows = np.concatenate(
                [np.einsum("p,jpt->jt", sizes, change[:, :, kind]) for sizes, change in of_modes]
            )
            rows = np.where(known[channel], rows, 0.0)
            products = scipy.linalg.cho_solve(fit.basis.factor, fit.basis.columns @ rows.T)
            yield (rows - products.T @ fit.basis.columns) / levels[channel], fit.left / levels[channel]


_SAMPLES, _RUNS = 16000, 4  # that are looked at
# frequencies that are tried: spaced by a factor, and peaks of the spectrum of what is left
_GRID, _PEAKS = (40, 12)
_DAMPING = (0.002, 0.01, 0.05)  # tried with each frequency
_BAND = 0.9  # of half the sampling rate: the highest frequency
_LEAST_DAMPING, _LARGEST_DAMPING = 1e-5, 0.7
_STEPS = 20  # of a search for all of them
_LEAST_GAIN = 1e-4  # of the cost: a step that gains less ends such a search; what follows goes on from there
_MOST = 30  # modes
_EXPLAINED = 0.1  # of the response, root mean square: modes that leave more than this are not all found
_MOST_OF_IT = 0.75  # of the power above the noise that such a part has
_HALF_POWER = 2.0  # damping ratios times the frequency: the band of a mode between its points of half power
_BESIDE = 3.0  # damping ratios times the frequency between a mode and one that only takes in what it leaves
_ALIKE = 0.98  # cosine between the residues of modes that move alike
_BAND_LINES = 16  # of a spectrum, over which what modes leave is taken for white
_BLOCKS = 40  # of a record, between which scores scatter


@dataclass(frozen=True, eq=False)
class PursuedModes:
    """Modes of a test with `frequencies` in Hz and `damping` (n,), and their `residues` (n, C, P) in 1/kg; where no force
    acts, their complex `free` accelerations (R, n, C) at the start of each record.
    """

    frequencies: Floats
    damping: Floats
    residues: Floats
    free: NDArray[np.complex128]


def pursued_modes(
    measured: ModalMeasurement, count: int | None, progress: Progress, *, most: int = _MOST
) -> PursuedModes:
    """The modes of a test: `count` of them, or as many as the criterion asks for, `most` at most."""
    part = replace(measured, runs=tuple(run.shortened(_SAMPLES) for run in measured.runs[:_RUNS]))
    modes = Projection(part, np.empty((0, 2)))
    most = most if count is None else count
    doubtful: list[tuple[float, float]] = []
    while len(modes.logs) < most:
        progress(ProgressReport(len(modes.logs) / (most + 1), f"mode {len(modes.logs) + 1}"))
        addition = best_addition(modes, doubtful)
        if addition is None or any(low < np.exp(addition[0, 0]) < high for low, high in doubtful):
            break
        added = _refined_projection(part, np.concatenate([modes.logs, addition]))
        gains = count is not None or (_criterion(added) < _criterion(modes) and _gains_in_bands(modes, added))
        if not gains or (count is None and not _stands_out(modes, added)):
            break
        if count is None and _is_doubled(added):
            doubtful.append(_doubtful_band(addition, modes))
            continue
        modes = added
    modes = Projection(part, modes.logs[np.argsort(modes.logs[:, 0])])
    frequencies, damping = np.exp(modes.logs).T
    free = np.array([modes.free_motions(run) for run in range(len(part.runs))])
    return PursuedModes(frequencies, damping, _residues(modes), free)


def _is_doubled(modes: Projection) -> bool:
    """Whether two stand beside each other for one whose frequency or damping moves with its amplitude."""
    frequencies, damping = np.exp(modes.logs).T
    motions = _residues(modes).reshape(len(frequencies), -1)
    return doubled_mode(frequencies, damping, motions) is not None


def _doubtful_band(addition: Floats, modes: Projection) -> tuple[float, float]:
    """Frequencies in Hz beside an addition (1, 2) in which no more is looked for: what one mode leaves hides others."""
    widths = np.exp(np.concatenate([modes.logs, addition]).sum(axis=1))  # Hz, half of the bands of half power
    hz = float(np.exp(addition[0, 0]))
    width = _BESIDE * float(max(widths[-1], widths[np.argmin(np.abs(modes.logs[:, 0] - addition[0, 0]))]))
    return hz - width, hz + width


def doubled_mode(frequencies: Floats, damping: Floats, motions: Floats) -> int | None:
    """The weaker of two modes that are within the half-power bandwidth of each other and move alike; None if there are none.

    `motions` (n, p) are residues or shapes. Modes of a linear structure that lie so close move differently.
    """
    sizes = np.linalg.norm(motions, axis=1)
    pairs = np.argwhere(np.triu(_moving_alike(frequencies, damping, motions, _HALF_POWER), k=1)).tolist()
    return min(pairs[0], key=lambda number: float(sizes[number] / damping[number])) if pairs else None


def shadow_mode(frequencies: Floats, damping: Floats, motions: Floats, faint: Bools) -> int | None:
    """A `faint` mode (n,) that moves like another beside it, which is not faint; None if there is none.

    It takes in what that one leaves, of a structure that is not quite linear, and has no motion of its own. Arguments as of
    `doubled_mode`.
    """
    shadows = (_moving_alike(frequencies, damping, motions, _BESIDE) & ~faint).any(axis=1) & faint
    return int(np.argmax(shadows)) if shadows.any() else None


def _moving_alike(frequencies: Floats, damping: Floats, motions: Floats, times: float) -> Bools:
    """(n, n) whether modes are so many `times` damping ratio and frequency from each other and move alike, in two or more
    places.
    """
    sizes, widths = np.linalg.norm(motions, axis=1), times * frequencies * damping
    near = np.abs(np.subtract.outer(frequencies, frequencies)) < np.maximum.outer(widths, widths)
    alike = (np.abs(motions @ motions.T) > _ALIKE * np.outer(sizes, sizes)) & (motions.shape[1] > 1)
    return np.asarray(near & alike & ~np.eye(len(sizes), dtype=bool))


@dataclass(frozen=True, eq=False)
class RefinedModes:
    """Modes of a test with `frequencies` in Hz and `damping` (n,), and their standard errors relative to them (n, 2).

    Errors are those of the curvature, or of the scatter of scores between blocks of the records where these are larger.
    `residues` (n, C, P) are in 1/kg, `free` (n, C) are the amplitudes of free motion at the start of the first record in
    the unit of each response. `left` is the power that the modes leave, as a part of that of the responses, `power` (C,).
    """

    frequencies: Floats
    damping: Floats
    relative_errors: Floats
    residues: Floats
    free: Floats
    left: float
    power: Floats


def refined_modes(measured: ModalMeasurement, frequencies: Floats, damping: Floats) -> RefinedModes:
    """The modes near some `frequencies` in Hz and `damping` (n,) that leave least of a test."""
    runs = tuple(run.shortened(_SAMPLES) for run in measured.runs[:_RUNS])
    part = replace(measured, runs=runs)
    modes = _refined_projection(part, np.log(np.stack([frequencies, damping], axis=1)))
    levels = modes.levels
    inverse = np.linalg.pinv(modes.equations(levels).curvature, hermitian=True)
    scores = []
    for number, run in enumerate(runs):
        of_run = np.zeros((_BLOCKS, modes.logs.size))
        block = np.arange(run.count) * _BLOCKS // run.count
        for rows, left in modes.derivatives(number, levels):
            of_run += np.array([np.bincount(block, weights=row * left, minlength=_BLOCKS) for row in rows]).T
        scores.append(of_run)
    sums = np.concatenate(scores).T
    robust = inverse @ (sums @ sums.T) @ inverse
    variance = np.maximum(np.maximum(inverse.diagonal(), robust.diagonal()), 0.0)
    return RefinedModes(
        frequencies=np.exp(modes.logs[:, 0]),
        damping=np.exp(modes.logs[:, 1]),
        relative_errors=np.sqrt(variance).reshape(modes.logs.shape),
        residues=_residues(modes),
        free=np.abs(modes.free_motions(0))
        * (2.0 * np.pi * np.exp(modes.logs[:, :1])) ** (measured.kinds - 2.0),
        left=float(np.mean(modes.power / np.maximum(part.power, np.finfo(float).tiny))),
        power=part.power / np.maximum(part.samples, 1),
    )


def _parameters(measured: ModalMeasurement) -> int:
    """What a mode has: frequency, damping, shape and a free motion in each record."""
    return 2 + len(measured.points) + 2 * len(measured.runs)


def _criterion(modes: Projection) -> float:
    """-2 log likelihood of white noise of any level in each channel, and its penalty."""
    samples = modes.measured.samples
    cost = float(samples @ (2.0 * np.log(modes.levels)))
    return cost + _parameters(modes.measured) * len(modes.logs) * float(np.log(samples.sum()))


def _gains_in_bands(modes: Projection, added: Projection) -> bool:
    """Whether a mode gains more than its penalty where noise is white only within bands, of the level that is left there.

    What a force that is not linear leaves is large at resonance, where a mode that fits few lines of it would gain much by the
    level of all samples.
    """
    gain, samples = 0.0, 0
    for before, after in zip(modes.left, added.left, strict=True):
        for left, less in zip(_spectral_bands(before), _spectral_bands(after), strict=True):
            gain += float(np.sum(left / np.maximum(less.mean(axis=1, keepdims=True), np.finfo(float).tiny)))
            gain -= less.size
        samples += after.size
    return 2.0 * gain > _parameters(modes.measured) * float(np.log(samples))


def _spectral_bands(left: Floats) -> list[Floats]:
    """The spectrum (C, L) of what modes leave, (C, N), in narrow bands."""
    lines = np.fft.rfft(np.where(np.isfinite(left), left, 0.0), axis=1)[:, 1:]
    return np.array_split(np.abs(lines) ** 2, max(lines.shape[1] // _BAND_LINES, 1), axis=1)


def _stands_out(modes: Projection, added: Projection) -> bool:
    """Whether the modes leave much of the response, or the one `added` takes most of the little that they leave."""
    measured = modes.measured
    noise = np.sum([run.noise**2 for run in measured.runs], axis=0) / len(measured.runs)
    left, after = modes.power / measured.power, added.power / measured.power
    above_noise = np.maximum(left - noise * measured.samples / measured.power, 0.0)
    return bool(np.any(left > _EXPLAINED**2) or np.sum(left - after) >= _MOST_OF_IT * np.sum(above_noise))


def _residues(modes: Projection) -> Floats:
    """(n, C, P) means over the records, each weighted by the size of its forces."""
    runs = modes.measured.runs
    powers = np.array([[float(np.sum(force.samples**2)) for force in run.forces] for run in runs])
    total = sum(modes.residues(number) * power for number, power in enumerate(powers))
    weight = powers.sum(axis=0)
    return np.asarray(total / np.where(weight > 0.0, weight, 1.0))


def best_addition(modes: Projection, doubtful: Sequence[tuple[float, float]]) -> Floats | None:
    """(1, 2) logarithms of frequency and damping of the mode that explains most of what the others leave, outside of
    `doubtful` bands in Hz. None where none follows the force.
    """
    levels = modes.levels
    left = zip(modes.left, modes.measured.runs, strict=True)
    remaining = replace(modes.measured, runs=tuple(replace(run, responses=one) for one, run in left))
    tried = np.log(list(product(_tried_hz(remaining, levels, doubtful), _DAMPING)))[:, None]
    physical = [trial for logs in tried if _follows_the_force(trial := Projection(remaining, logs))]
    best = min(physical, key=lambda trial: trial.cost(levels), default=None)
    return None if best is None else _refined_projection(remaining, best.logs, levels).logs


def _follows_the_force(trial: Projection) -> bool:
    """Whether one mode moves with the force where both are measured, as a positive modal mass does."""
    residues, measured = _residues(trial)[0], trial.measured
    collocated = measured.sensed[:, None] == measured.forced
    return bool(residues[collocated].sum() >= 0.0)


def _tried_hz(measured: ModalMeasurement, levels: Floats, doubtful: Sequence[tuple[float, float]]) -> Floats:
    """Frequencies in Hz: on a grid, and at peaks of the spectra, outside of `doubtful` bands."""
    run = max(measured.runs, key=lambda candidate: candidate.count)
    samples = np.where(np.isfinite(run.responses), run.responses, 0.0) / levels[:, None]
    power = np.sum(np.abs(np.fft.rfft(samples, axis=1)) ** 2, axis=0)
    frequencies = np.fft.rfftfreq(run.count, run.step)
    lowest, highest = frequencies[1], _BAND * frequencies[-1]
    peaks = np.flatnonzero((power[1:-1] > power[:-2]) & (power[1:-1] >= power[2:])) + 1
    peaks = peaks[(frequencies[peaks] >= lowest) & (frequencies[peaks] <= highest)]
    grid = np.geomspace(lowest, highest, _GRID)
    for low, high in doubtful:
        peaks = peaks[(frequencies[peaks] < low) | (frequencies[peaks] > high)]
        grid = grid[(grid < low) | (grid > high)]
    strongest = peaks[np.argsort(-power[peaks])][:_PEAKS]
    return np.concatenate([grid, frequencies[strongest]])


def _refined_projection(measured: ModalMeasurement, logs: Floats, levels: Floats | None = None) -> Projection:
    """The modes that leave least, from the logarithms of frequencies and damping of a start."""
    duration = measured.runs[0].count * measured.runs[0].step
    lowest = np.log([1e-3 / duration, _LEAST_DAMPING])
    highest = np.log([0.5 / measured.runs[0].step, _LARGEST_DAMPING])
    shape = logs.shape

    def within(point: Floats) -> Floats:
        return np.clip(point.reshape(shape), lowest, highest).ravel()

    def at(point: Floats) -> Projection:
        return Projection(measured, point.reshape(shape))

    start = within(logs)
    fixed = at(start).levels if levels is None else levels
    point, _ = least_squares(
        start,
        lambda point: at(point).equations(fixed),
        lambda point: at(point).cost(fixed),
        within,
        steps=_STEPS,
        least_gain=_LEAST_GAIN,
    )
    return at(point)
