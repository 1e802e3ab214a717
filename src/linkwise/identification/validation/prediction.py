"""The prediction of a record: one free run, or windows where the motion is chaotic, with what limits its accuracy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Bools, Floats
from linkwise.errors import SimulationError
from linkwise.identification.validation.free_run import run_from
from linkwise.identification.validation.windows import WindowPredictor
from linkwise.model.structure import BASE
from linkwise.progress import Progress, ProgressReport
from linkwise.records.checks import LARGEST
from linkwise.records.record import Record

_STEP = 0.1  # of a standard error: departures of runs are linear in it, and grow no larger than the motion
_LOST = 0.1  # of the RMS of a channel: an uncertainty of the state that has grown to it ends a prediction
_GROWN = 10.0  # times that over the burn: what is as uncertain from the start has not grown
_STAYS = 0.5  # of the time that follows, as long as the burn: an uncertainty that passes is not the end
_FEWEST = 50  # samples of that time at least: after a shorter burn the uncertainty grows for as long without any chaos
_SHORTEST = 4  # samples that a window predicts at least
_LONGEST = 8  # windows at least
_SETTLE = 100  # samples at most that determine the state of a window
# of the samples must come before the prediction of their window is lost; the others are left out
_WITHIN = 0.9
_HISTORY = 20  # samples before the one that is predicted one step ahead
_MOST_STEPS = 4000  # predictions one step ahead


@dataclass(frozen=True, eq=False)
class Prediction:
    """N samples of C responses as a structure predicts them.

    Attributes
    ----------
    predicted : array of shape (N, C)
        In SI units; NaN where nothing is predicted.
    by_state, by_coefficients, by_laws : array of shape (N, C)
        Variances of it: from the state at the start, the coefficients, and the stated error of the laws.
    d, v : array of shape (N, L)
        Elongations in m and their rates in m/s along the predicted motion.
    starts : int
        Number of independent states from which it runs.
    window : float or None
        Time in s that each window predicts; None for one free run.
    horizon : float or None
        Time in s after the burn at which one run is lost in the growth of the error of its state; None if it is not.
    """

    predicted: Floats
    by_state: Floats
    by_coefficients: Floats
    by_laws: Floats
    d: Floats
    v: Floats
    starts: int
    window: float | None
    horizon: float | None


def predict(predictor: WindowPredictor, burn: int, progress: Progress) -> Prediction:
    """Predict a record from the state in its first `burn` samples, as far as chaos lets it, else in windows."""
    progress(ProgressReport(0.0, "state at the start"))
    run = _free_run(predictor, burn, progress)
    record = predictor.record
    size = np.nanstd(record.select(record.responses).values, axis=0)
    deviation = np.sqrt(run.by_state)
    span = max(burn, _FEWEST)
    early = np.sqrt(np.mean(run.by_state[:span], axis=0))
    lost = (deviation > _LOST * size) & (deviation > _GROWN * early)
    lost = (lost & (_ahead(lost, span) > _STAYS)).any(axis=1)
    lost[:burn] = False
    if not lost.any():
        return run
    horizon = max(int(np.argmax(lost)) - burn, 2 * _SHORTEST)
    progress(ProgressReport(0.6, "windows"))
    return _windows(predictor, burn, horizon, size)


def one_step(predictor: WindowPredictor, burn: int) -> tuple[Floats, Floats]:
    """Predictions (N, C) of samples after the burn, each from the samples just before it, and their variance.

    NaN where a sample is not predicted, which is so of most in a long record.
    """
    record = predictor.record
    history = min(_HISTORY, burn)
    count = len(record) - burn
    targets = burn + np.arange(0, count, -(-count // _MOST_STEPS))
    prediction = predictor(targets - history, history, history + 1)
    shape = (len(record), len(record.responses))
    predicted, variance = np.full(shape, np.nan), np.full(shape, np.nan)
    predicted[targets] = prediction.predicted[-1].T
    variance[targets] = (prediction.by_state + prediction.by_coefficients + prediction.by_laws)[-1].T
    return predicted, variance


def _free_run(predictor: WindowPredictor, burn: int, progress: Progress) -> Prediction:
    """One run, and runs from states and with coefficients that are a little off."""
    record, structure = predictor.record, predictor.structure
    channels = record.responses
    start = predictor(np.zeros(1, dtype=int), burn, burn)
    state, root = start.state[:, 0], start.state_root[0]
    if not (np.isfinite(state).all() and np.isfinite(root).all()):
        raise SimulationError(
            f"no state is found from which the answer follows the first {burn} samples of the record: its laws run away along "
            "that motion; check its coefficients and their units, or identify again"
        )
    names = [parameter.name for parameter in structure.parameters]
    follow = start.state_by_coefficients[0] @ predictor.root  # (2 n + S, r)

    def run(state: Floats, theta: Floats, extra: dict[str, Floats] | None = None) -> Record:
        valued = structure.with_values(dict(zip(names, map(float, theta), strict=True)))
        return run_from(valued, record, (*channels, *accelerations), state, extra)

    accelerations = tuple(
        f"a:{name}" for name in structure.mass_names if f"a:{name}" not in channels and predictor.law_error
    )
    whole = run(state, predictor.values)
    motion = whole.select(channels).values
    shape, done = motion.shape, 0
    total = len(state) + follow.shape[1] + (structure.size if predictor.law_error else 0)

    def departure(moved: Floats, theta: Floats, extra: dict[str, Floats] | None = None) -> Floats:
        nonlocal done
        done += 1
        progress(ProgressReport(0.6 * done / total, "free runs"))
        return np.asarray(run(moved, theta, extra).select(channels).values - motion)

    by_state, by_theta, by_laws = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    for column in root.T:
        by_state += (departure(state + _STEP * column, predictor.values) / _STEP) ** 2
    for column, moved in zip(predictor.root.T, follow.T, strict=True):
        theta = predictor.values + _STEP * column
        by_theta += (departure(state + _STEP * moved, theta) / _STEP) ** 2
    for name, force in _law_errors(predictor, whole).items():
        by_laws += departure(state, predictor.values, {name: force}) ** 2
    base = record.channel(f"x:{BASE}") if f"x:{BASE}" in record.channels else None
    truth = whole.simulated
    assert truth is not None
    return Prediction(
        predicted=_after(motion, burn),
        by_state=by_state,
        by_coefficients=by_theta,
        by_laws=by_laws,
        d=structure.elongations(truth.displacement, base),
        v=structure.elongations(truth.velocity, None if base is None else np.gradient(base, record.step)),
        starts=1,
        window=None,
        horizon=None,
    )


def _law_errors(predictor: WindowPredictor, run: Record) -> dict[str, Floats]:
    """Forces on each mass that its links leave out or add, as large a part of theirs as the laws are off."""
    if not predictor.law_error:
        return {}
    record, structure = predictor.record, predictor.structure
    masses = structure.with_values(
        dict(zip((p.name for p in structure.parameters), map(float, predictor.values), strict=True))
    ).mass_values
    applied = np.zeros((structure.size, len(record)))
    for channel in record.inputs:
        kind, _, place = channel.partition(":")
        if kind == "force":
            applied += structure.topology.row(place)[:, None] * record.channel(channel)
    forces = {}
    for name, mass, own in zip(structure.mass_names, masses, applied, strict=True):
        forces[f"force:{name}"] = predictor.law_error * (mass * run.channel(f"a:{name}") - own)
    return forces


def _windows(predictor: WindowPredictor, burn: int, horizon: int, size: Floats) -> Prediction:
    """The longest windows, by factors of two, of which nearly all samples come before the state is lost."""
    record, structure = predictor.record, predictor.structure
    samples = max(min((len(record) - burn) // _LONGEST, horizon), _SHORTEST)
    while True:
        settle = min(burn, max(_HISTORY, samples), _SETTLE)
        firsts = np.arange(burn, len(record), samples) - settle
        prediction = predictor(firsts, settle, settle + samples)
        deviation = np.sqrt(prediction.by_state[settle:])  # (M, C, K)
        early = np.sqrt(np.mean(prediction.by_state[:settle], axis=0))
        lost = ((deviation > _LOST * size[:, None]) & (deviation > _GROWN * early)).any(axis=1)
        lost = np.maximum.accumulate(lost, axis=0)  # (M, K)
        if 1.0 - np.mean(lost) >= _WITHIN or samples == _SHORTEST:
            break
        samples = max(samples // 2, _SHORTEST)
    ahead = prediction.predicted[settle:].transpose(0, 2, 1)
    running_away = int(np.any(~(np.abs(ahead) <= LARGEST) & ~lost[..., None], axis=(0, 2)).sum())
    if running_away:
        raise SimulationError(
            f"from {running_away} of {len(firsts)} states along the record the motion of the answer runs to infinity; check "
            "its coefficients, and the units of the channels of the record and of its time"
        )
    ahead[lost] = np.nan

    def joined(parts: Floats) -> Floats:
        """(N, ...) from (M, ..., K): what follows the state of each window, one after the other."""
        tail = np.moveaxis(parts[settle:], -1, 0)
        tail = tail.reshape(-1, *tail.shape[2:])[: len(record) - burn]
        return np.concatenate([np.full((burn, *tail.shape[1:]), np.nan), tail])

    motion = joined(prediction.motion)
    base = record.channel(f"x:{BASE}") if f"x:{BASE}" in record.channels else None
    return Prediction(
        predicted=joined(prediction.predicted),
        by_state=joined(prediction.by_state),
        by_coefficients=joined(prediction.by_coefficients),
        by_laws=joined(prediction.by_laws),
        d=structure.elongations(motion[:, 0], base),
        v=structure.elongations(motion[:, 1], None if base is None else np.gradient(base, record.step)),
        starts=len(firsts),
        window=samples * record.step,
        horizon=horizon * record.step,
    )


def _ahead(values: Floats | Bools, samples: int) -> Floats:
    """Means (N, C) of `values` over the samples that follow each."""
    total = np.cumsum(np.concatenate([np.zeros((1, values.shape[1])), values]), axis=0, dtype=float)
    ends = np.minimum(np.arange(len(values)) + samples, len(values))
    return np.asarray((total[ends] - total[:-1]) / (ends - np.arange(len(values)))[:, None])


def _after(values: Floats, burn: int) -> Floats:
    late = values.copy()
    late[:burn] = np.nan
    return late
