"""States of a linear system with random inputs: Kalman filter and Rauch-Tung-Striebel smoother.

Matrices are computed anew only until they have settled, and where the channels that have a sample change.

References
----------
H. E. Rauch, F. Tung and C. T. Striebel, AIAA J. 3, 1445 (1965).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy

from linkwise.arrays import Floats, Indices

_SETTLED = 1e-7  # relative change of the covariance of a sample, from which it counts as constant
_DOUBLINGS = 40  # of the number of samples over which the smoothed covariance is summed, at most
_SHARE = 1e-9  # of a measured variance: what keeps its Cholesky factor positive


@dataclass(frozen=True, eq=False)
class LinearModel:
    """z_k+1 = transition z_k + drive u_k + w_k, y_k = observation z_k + direct u_k + e_k.

    Attributes
    ----------
    transition, process : array of shape (m, m)
        Transition over a sample, and covariance of w.
    observation : array of shape (C, m)
        What the channels show.
    noise : array of shape (C,)
        Variances of e.
    drive, direct : array of shape (m, r) and (C, r)
        Effect of known inputs.
    first : array of shape (m, m)
        Covariance of the first state, which has the mean 0.
    """

    transition: Floats
    process: Floats
    observation: Floats
    noise: Floats
    drive: Floats
    direct: Floats
    first: Floats


class _Gain(NamedTuple):
    """What an update needs: the channels, their gain, and the covariances before and after it."""

    chosen: Indices
    gain: Floats
    factor: Floats
    predicted: Floats
    updated: Floats


@dataclass(frozen=True, eq=False)
class Smoothed:
    """Smoothed states (N, m), their covariance (m, m) in the middle of the record, and the log likelihood of the samples."""

    states: Floats
    covariance: Floats
    log_likelihood: float


def smooth(model: LinearModel, samples: Floats, inputs: Floats) -> Smoothed:
    """Most likely states.

    Parameters
    ----------
    model : LinearModel
        The system.
    samples : array of shape (N, C)
        The samples, NaN where missing.
    inputs : array of shape (N, r)
        The known inputs at the samples; between them their mean acts.

    Returns
    -------
    Smoothed
        The states.
    """
    forward = _filtered(model, samples, inputs)
    states = forward.updated.copy()
    count = len(states)
    known: dict[tuple[int, int], Floats] = {}
    for k in range(count - 2, -1, -1):
        pair = forward.which[k], forward.which[k + 1]
        if pair not in known:
            before, after = (forward.gains[index] for index in pair)
            product = before.updated @ model.transition.T
            known[pair] = _solved(after.predicted, product.T).T
        back = known[pair]
        states[k] += back @ (states[k + 1] - forward.predicted[k + 1])
    middle = forward.gains[forward.which[count // 2]]
    return Smoothed(states, _smoothed_covariance(model, middle), forward.log_likelihood)


def log_likelihood(model: LinearModel, samples: Floats, inputs: Floats) -> float:
    """Log likelihood of samples (N, C), less what does not depend on the model, with inputs (N, r)."""
    return _filtered(model, samples, inputs).log_likelihood


class _Forward(NamedTuple):
    """Predicted and updated states (N, m), the distinct gains, which of them each sample has, and the log likelihood."""

    predicted: Floats
    updated: Floats
    gains: list[_Gain]
    which: list[int]
    log_likelihood: float


def _filtered(model: LinearModel, samples: Floats, inputs: Floats) -> _Forward:
    count, m = len(samples), len(model.transition)
    known = np.isfinite(samples)
    shown = np.where(known, samples, 0.0) - inputs @ model.direct.T
    driven = np.zeros((count, m))
    driven[1:] = 0.5 * (inputs[1:] + inputs[:-1]) @ model.drive.T
    predicted, updated = np.empty((count, m)), np.empty((count, m))
    gains: list[_Gain] = []
    which: list[int] = []
    state, covariance, total, settled = np.zeros(m), model.first, 0.0, False
    for k in range(count):
        same = k > 1 and settled and np.array_equal(known[k], known[k - 1])
        if not same:
            gains.append(_gain(model, covariance, known[k]))
            settled = (
                len(gains) > 1
                and k > 0
                and np.array_equal(known[k], known[k - 1])
                and _close(gains[-1].updated, gains[which[-1]].updated)
            )
        which.append(len(gains) - 1)
        gain = gains[-1]
        predicted[k] = state
        error = (shown[k] - model.observation @ state)[gain.chosen]
        state = state + gain.gain @ error
        updated[k] = state
        if len(error):
            white = scipy.linalg.solve_triangular(gain.factor, error, lower=True, check_finite=False)
            total -= 0.5 * float(white @ white) + float(np.log(gain.factor.diagonal()).sum())
        if k + 1 < count:
            state = model.transition @ state + driven[k + 1]
            if not same:
                covariance = _symmetric(model.transition @ gain.updated @ model.transition.T + model.process)
    return _Forward(predicted, updated, gains, which, total)


def _gain(model: LinearModel, covariance: Floats, known: Floats) -> _Gain:
    chosen = np.flatnonzero(known)
    observation = model.observation[chosen]
    cross = covariance @ observation.T
    of_samples = observation @ cross + np.diag(model.noise[chosen])
    of_samples[range(len(chosen)), range(len(chosen))] *= 1.0 + _SHARE
    factor = np.asarray(np.linalg.cholesky(of_samples), dtype=float) if len(chosen) else np.zeros((0, 0))
    gain = (
        scipy.linalg.cho_solve((factor, True), cross.T).T if len(chosen) else np.zeros((len(covariance), 0))
    )
    kept = np.eye(len(covariance)) - gain @ observation  # Joseph's form, which stays positive
    updated = kept @ covariance @ kept.T + (gain * model.noise[chosen]) @ gain.T
    return _Gain(chosen, gain, factor, covariance, _symmetric(updated))


def _smoothed_covariance(model: LinearModel, gain: _Gain) -> Floats:
    """Covariance of a smoothed state far from the ends of a record, by the recursion of a constant gain to its fixed point."""
    back = _solved(gain.predicted, model.transition @ gain.updated).T
    change = gain.updated - back @ gain.predicted @ back.T
    for _ in range(_DOUBLINGS):  # sum of back^i change back'^i, twice as many terms at a time
        change = change + back @ change @ back.T
        back = back @ back
        if np.abs(back).max() < _SETTLED:
            break
    return _symmetric(change)


def _solved(matrix: Floats, right: Floats) -> Floats:
    """matrix^-1 right for a covariance, scaled to a unit diagonal."""
    scale = np.sqrt(np.maximum(matrix.diagonal(), np.finfo(float).tiny))
    scaled = matrix / np.outer(scale, scale)
    scaled[range(len(scale)), range(len(scale))] += _SHARE
    solution = scipy.linalg.solve(scaled, right / scale[:, None], assume_a="pos", check_finite=False)
    return np.asarray(solution / scale[:, None])


def _symmetric(matrix: Floats) -> Floats:
    return np.asarray(0.5 * (matrix + matrix.T))


def _close(one: Floats, other: Floats) -> bool:
    scale = np.sqrt(np.maximum(np.outer(one.diagonal(), one.diagonal()), np.finfo(float).tiny))
    return bool((np.abs(one - other) <= _SETTLED * scale).all())
