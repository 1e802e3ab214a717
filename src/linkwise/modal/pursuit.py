"""First modes of a test, one at a time: the mode that explains most of what the others leave, then all of them again.

For given frequencies and damping the response is linear in residues and in free motions, which are eliminated (variable
projection). A mode is added as long as the Bayesian information criterion falls.

References
----------
G. H. Golub and V. Pereyra, SIAM J. Numer. Anal. 10, 413 (1973).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from linkwise.arrays import Floats
from linkwise.modal.measured import MeasuredRun, ModalMeasurement
from linkwise.progress import Progress, ProgressReport

_SAMPLES, _RUNS = 16000, 4  # that are looked at
_GRID, _PEAKS = (
    40,
    12,
)  # frequencies that are tried: spaced by a factor, and peaks of the spectrum of what is left
_DAMPING = (0.002, 0.01, 0.05)  # tried with each frequency
_BAND = 0.9  # of half the sampling rate: the highest frequency
_LEAST_DAMPING, _LARGEST_DAMPING = 1e-5, 0.7
_STEP = 1e-4  # of the logarithms of frequencies and damping, for differences
_EVALUATIONS = 20  # of a search for all of them
_MOST = 30  # modes
_BLOCKS = 40  # of a record, between which scores scatter


@dataclass(frozen=True, eq=False)
class PursuedModes:
    """Modes of a test with `frequencies` in Hz and `damping` (n,), and their `residues` (n, C, P) in 1/kg."""

    frequencies: Floats
    damping: Floats
    residues: Floats


def pursued_modes(measured: ModalMeasurement, count: int | None, progress: Progress) -> PursuedModes:
    """The modes of a test: `count` of them, or as many as the criterion asks for."""
    runs = tuple(run.shortened(_SAMPLES) for run in measured.runs[:_RUNS])
    part = replace(measured, runs=runs)
    logs: Floats = np.empty((0, 2))
    cost = _criterion(part, logs)
    most = _MOST if count is None else count
    while len(logs) < most:
        progress(ProgressReport(len(logs) / (most + 1), f"mode {len(logs) + 1}"))
        added = _refined(part, np.concatenate([logs, _best_addition(part, logs)]))
        new_cost = _criterion(part, added)
        if count is None and new_cost > cost:
            break
        logs, cost = added, new_cost
    logs = logs[np.argsort(logs[:, 0])]
    frequencies, damping = np.exp(logs).T
    return PursuedModes(frequencies, damping, _residues(part, logs))


@dataclass(frozen=True, eq=False)
class RefinedModes:
    """Modes of a test with `frequencies` in Hz and `damping` (n,), and their standard errors relative to them (n, 2).

    Errors are those of the curvature, or of the scatter of scores between blocks of the records where these are larger.
    `residues` (n, C, P) are in 1/kg. `left` is the power that the modes leave, as a part of that of the responses,
    `power` (C,).
    """

    frequencies: Floats
    damping: Floats
    relative_errors: Floats
    residues: Floats
    left: float
    power: Floats


def refined_modes(measured: ModalMeasurement, frequencies: Floats, damping: Floats) -> RefinedModes:
    """The modes near some `frequencies` in Hz and `damping` (n,) that leave least of a test."""
    runs = tuple(run.shortened(_SAMPLES) for run in measured.runs[:_RUNS])
    part = replace(measured, runs=runs)
    logs = _refined(part, np.log(np.stack([frequencies, damping], axis=1)))
    left = _left(part, logs)
    levels = _levels(left)
    base = _whitened(part, logs, levels)
    columns = []
    for number in range(logs.size):
        step = np.zeros(logs.size)
        step[number] = _STEP
        columns.append((_whitened(part, logs + step.reshape(logs.shape), levels) - base) / _STEP)
    jacobian = np.array(columns)
    inverse = np.linalg.pinv(jacobian @ jacobian.T, hermitian=True)
    scores = jacobian * base
    block = np.concatenate(
        [
            np.tile(np.arange(run.count) * _BLOCKS // run.count, len(measured.kinds)) + _BLOCKS * number
            for number, run in enumerate(runs)
        ]
    )
    sums = np.array([np.bincount(block, weights=row, minlength=_BLOCKS * len(runs)) for row in scores])
    robust = inverse @ (sums @ sums.T) @ inverse
    variance = np.maximum(np.maximum(inverse.diagonal(), robust.diagonal()), 0.0)
    unexplained = sum(np.nansum(residuals**2, axis=1) for residuals in left)
    power = np.sum([np.nansum(run.responses**2, axis=1) for run in runs], axis=0)
    samples = np.sum([np.isfinite(run.responses).sum(axis=1) for run in runs], axis=0)
    return RefinedModes(
        frequencies=np.exp(logs[:, 0]),
        damping=np.exp(logs[:, 1]),
        relative_errors=np.sqrt(variance).reshape(logs.shape),
        residues=_residues(part, logs),
        left=float(np.mean(unexplained / np.maximum(power, np.finfo(float).tiny))),
        power=power / np.maximum(samples, 1),
    )


def _parameters(measured: ModalMeasurement) -> int:
    """What a mode has: frequency, damping, shape and a free motion in each record."""
    return 2 + len(measured.points) + 2 * len(measured.runs)


def _criterion(measured: ModalMeasurement, logs: Floats) -> float:
    """-2 log likelihood of white noise of any level in each channel, and its penalty."""
    left = _left(measured, logs)
    cost, samples = 0.0, 0
    for channel in range(len(measured.kinds)):
        own = np.concatenate([residuals[channel] for residuals in left])
        own = own[np.isfinite(own)]
        samples += len(own)
        cost += len(own) * float(np.log(max(float(np.mean(own**2)), np.finfo(float).tiny)))
    return cost + _parameters(measured) * len(logs) * float(np.log(samples))


def _columns(run: MeasuredRun, logs: Floats) -> Floats:
    """(n (P + 2), 3, N) motions of modes under each force, and free ones."""
    if not len(logs):
        return np.empty((0, 3, run.count))
    return np.concatenate([run.motions(*np.exp(mode_logs)) for mode_logs in logs])


def _fits(measured: ModalMeasurement, run: MeasuredRun, logs: Floats) -> list[tuple[Floats, Floats]]:
    """Weights of the columns in each channel, and what they leave, NaN where a sample is missing."""
    columns = _columns(run, logs)
    ones = np.ones((1, run.count))
    fits = []
    for kind, samples in zip(measured.kinds.tolist(), run.responses, strict=True):
        basis = np.concatenate([columns[:, kind], ones])
        scale = np.sqrt(np.einsum("ij,ij->i", basis, basis))
        basis = basis / np.where(scale > 0.0, scale, 1.0)[:, None]
        known = np.isfinite(samples)
        shown, target = basis[:, known], samples[known]
        square = shown @ shown.T
        square[range(len(square)), range(len(square))] += 1e-12
        weights = scipy.linalg.solve(square, shown @ target, assume_a="pos")
        fits.append((weights / np.where(scale > 0.0, scale, 1.0), samples - weights @ basis))
    return fits


def _left(measured: ModalMeasurement, logs: Floats) -> list[Floats]:
    """(C, N) of each record that modes leave."""
    return [np.array([left for _, left in _fits(measured, run, logs)]) for run in measured.runs]


def _residues(measured: ModalMeasurement, logs: Floats) -> Floats:
    """(n, C, P) means over the records, each weighted by the size of its forces."""
    forces = len(measured.forced)
    total, weight = np.zeros((len(logs), len(measured.kinds), forces)), np.zeros(forces)
    for run in measured.runs:
        weights = np.array([column_weights[:-1] for column_weights, _ in _fits(measured, run, logs)])
        power = np.array([float(np.sum(force.samples**2)) for force in run.forces])
        own = weights.reshape(len(measured.kinds), len(logs), forces + 2)[:, :, :forces]
        total += own.transpose(1, 0, 2) * power
        weight += power
    return np.asarray(total / np.where(weight > 0.0, weight, 1.0))


def _whitened(measured: ModalMeasurement, logs: Floats, levels: Floats) -> Floats:
    """What modes leave of all samples, in units of `levels` (C,); 0 where a sample is missing."""
    parts = [residuals / levels[:, None] for residuals in _left(measured, logs)]
    return np.concatenate([np.where(np.isfinite(whitened), whitened, 0.0).ravel() for whitened in parts])


def _levels(left: Sequence[Floats]) -> Floats:
    """(C,) root mean squares."""
    powers = np.array([np.nansum(residuals**2, axis=1) for residuals in left]).sum(axis=0)
    counts = np.array([np.isfinite(residuals).sum(axis=1) for residuals in left]).sum(axis=0)
    return np.asarray(np.sqrt(np.maximum(powers / np.maximum(counts, 1), np.finfo(float).tiny)))


def _best_addition(measured: ModalMeasurement, logs: Floats) -> Floats:
    """(1, 2) logarithms of frequency and damping of the mode that explains most of what the others leave."""
    left = _left(measured, logs)
    levels = _levels(left)
    remaining = replace(
        measured,
        runs=tuple(
            MeasuredRun(residuals, run.forces, run.step)
            for residuals, run in zip(left, measured.runs, strict=True)
        ),
    )
    trials = [
        np.log([[frequency, damping]]) for frequency in _tried(remaining, levels) for damping in _DAMPING
    ]
    best = min(trials, key=lambda trial: float(np.sum(_whitened(remaining, trial, levels) ** 2)))
    return _refined(remaining, best, levels)


def _tried(measured: ModalMeasurement, levels: Floats) -> Floats:
    """Frequencies in Hz: on a grid, and at peaks of the spectra."""
    run = max(measured.runs, key=lambda candidate: candidate.count)
    samples = np.where(np.isfinite(run.responses), run.responses, 0.0) / levels[:, None]
    power = np.sum(np.abs(np.fft.rfft(samples, axis=1)) ** 2, axis=0)
    frequencies = np.fft.rfftfreq(run.count, run.step)
    lowest, highest = frequencies[1], _BAND * frequencies[-1]
    peaks = np.flatnonzero((power[1:-1] > power[:-2]) & (power[1:-1] >= power[2:])) + 1
    peaks = peaks[(frequencies[peaks] >= lowest) & (frequencies[peaks] <= highest)]
    strongest = peaks[np.argsort(-power[peaks])][:_PEAKS]
    return np.concatenate([np.geomspace(lowest, highest, _GRID), frequencies[strongest]])


def _refined(measured: ModalMeasurement, logs: Floats, levels: Floats | None = None) -> Floats:
    """The frequencies and damping that leave least, from a start."""
    levels = _levels(_left(measured, logs)) if levels is None else levels
    rate = 1.0 / measured.runs[0].step
    lower = np.broadcast_to(
        np.log([1e-3 / (measured.runs[0].count / rate), _LEAST_DAMPING]), logs.shape
    ).ravel()
    upper = np.broadcast_to(np.log([0.5 * rate, _LARGEST_DAMPING]), logs.shape).ravel()
    optimum = scipy.optimize.least_squares(
        lambda flat_logs: _whitened(measured, flat_logs.reshape(-1, 2), levels),
        np.clip(logs.ravel(), lower, upper),
        bounds=(lower, upper),
        diff_step=_STEP,
        x_scale=np.tile([0.01, 0.3], len(logs)),
        max_nfev=_EVALUATIONS,
    )
    return np.asarray(optimum.x.reshape(-1, 2))
