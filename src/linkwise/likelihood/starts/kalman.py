"""States of a linear system with random inputs: Kalman filter and Rauch-Tung-Striebel smoother.

After the first samples the covariance is the steady one, of the algebraic Riccati equation, and the gain with it.

References
----------
H. E. Rauch, F. Tung and C. T. Striebel, AIAA J. 3, 1445 (1965).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isqrt
from typing import NamedTuple

import numpy as np
import scipy
from scipy.linalg import lapack

from linkwise.arrays import Bools, Floats, Indices

_TRANSIENT = 400  # samples at most, until the covariance is taken for the steady one ...
_SETTLED = 0.01  # ... and what it may differ from that, relative, before
_NEGLIGIBLE = 1e-7  # entry of a power of the smoother's matrix: later terms of its series add nothing
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
    """What an update needs: the channels, their gain, what whitens their errors, and the covariances before and after it."""

    chosen: Indices
    gain: Floats
    whitening: Floats
    log_determinant: float
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
    count, which = len(states), np.asarray(forward.which)
    known: dict[tuple[int, int], Floats] = {}
    firsts = np.append(
        0, 1 + np.flatnonzero(np.diff(which[:-1]) | np.diff(which[1:]))
    )  # of runs of one pair of gains
    for first, end in zip(firsts[::-1], np.append(firsts[1:], count - 1)[::-1], strict=True):
        if first == end:
            continue  # a record of one sample
        pair = int(which[first]), int(which[first + 1])
        if pair not in known:
            before, after = (forward.gains[index] for index in pair)
            product = before.updated @ model.transition.T
            known[pair] = _solved(after.predicted, product.T).T
        back = known[pair]
        added = forward.updated[first:end] - forward.predicted[first + 1 : end + 1] @ back.T
        states[first:end] = _recursion(back, states[end], added[::-1])[:0:-1]
    middle = forward.gains[forward.which[count // 2]]
    return Smoothed(states, _smoothed_covariance(model, middle, count), forward.log_likelihood)


def log_likelihood(model: LinearModel, samples: Floats, inputs: Floats) -> float:
    """Log likelihood of samples (N, C), less what does not depend on the model, with inputs (N, r)."""
    return _filtered(model, samples, inputs, transient=1).log_likelihood


def innovations(model: LinearModel, samples: Floats, inputs: Floats) -> Floats:
    """Whitened errors (N, C) of the predictions of samples (N, C) from those before, 0 where one is missing."""
    return _filtered(model, samples, inputs, transient=1).whitened


class _Forward(NamedTuple):
    """Predicted and updated states (N, m), the distinct gains, which of them each sample has, errors and log likelihood."""

    whitened: Floats
    predicted: Floats
    updated: Floats
    gains: list[_Gain]
    which: list[int]
    log_likelihood: float


def _filtered(model: LinearModel, samples: Floats, inputs: Floats, transient: int = _TRANSIENT) -> _Forward:
    count, m = len(samples), len(model.transition)
    known = np.isfinite(samples)
    shown = np.where(known, samples, 0.0) - inputs @ model.direct.T
    driven = np.zeros((count, m))
    driven[1:] = 0.5 * (inputs[1:] + inputs[:-1]) @ model.drive.T
    predicted, updated = np.empty((count, m)), np.empty((count, m))
    whitened = np.zeros(samples.shape)
    steady = _steady(model)
    gains: list[_Gain] = []
    which: list[int] = []
    constant = -1  # which of the gains is the steady one
    state, covariance, total = np.zeros(m), model.first, 0.0
    complete: Bools = np.asarray(known.all(axis=1))
    gaps = np.append(np.flatnonzero(~complete), count)
    settled, since, k = False, 0, 0
    while k < count:
        if not complete[k]:
            settled, since = False, 0
        elif steady is not None and not settled:  # the steady gain is that of complete samples
            since += 1
            if since > transient or _close(covariance, steady):
                covariance, settled = steady, True
        if not (settled and constant >= 0):
            gains.append(_gain(model, covariance, known[k]))
            constant = len(gains) - 1 if settled else constant
        index = constant if settled else len(gains) - 1
        end = int(gaps[np.searchsorted(gaps, k)]) if settled else k + 1
        gain, rows = gains[index], slice(k, end)
        which += [index] * (end - k)
        if end == k + 1:
            predicted[k] = state
        else:
            through = model.transition @ gain.gain
            added = shown[k : end - 1] @ through.T + driven[k + 1 : end]
            predicted[rows] = _recursion(model.transition - through @ model.observation, state, added)
        errors = (shown[rows] - predicted[rows] @ model.observation.T)[:, gain.chosen]
        updated[rows] = predicted[rows] + errors @ gain.gain.T
        white = errors @ gain.whitening.T
        whitened[rows, gain.chosen] = white
        total -= 0.5 * float(np.sum(white**2)) + (end - k) * gain.log_determinant
        if end < count:
            state = model.transition @ updated[end - 1] + driven[end]
        if not settled:
            covariance = _symmetric(model.transition @ gain.updated @ model.transition.T + model.process)
        k = end
    return _Forward(whitened, predicted, updated, gains, which, total)


def _steady(model: LinearModel) -> Floats | None:
    """The covariance (m, m) of a state before its sample, far from the start; None where there is none."""
    size, noise = np.sqrt(model.first.diagonal()), np.sqrt(model.noise)
    transition = model.transition * size / size[:, None]
    observation = model.observation * size / noise[:, None]
    process = model.process / np.outer(size, size)
    try:
        scaled = scipy.linalg.solve_discrete_are(
            transition.T, observation.T, process, np.eye(len(noise)), balanced=False
        )
    except (np.linalg.LinAlgError, ValueError):
        return None
    covariance = _symmetric(scaled) * np.outer(size, size)
    return covariance if bool((covariance.diagonal() > 0.0).all()) else None


def _gain(model: LinearModel, covariance: Floats, known: Bools) -> _Gain:
    chosen = np.flatnonzero(known)
    observation, m = model.observation[chosen], len(covariance)
    if not len(chosen):
        return _Gain(chosen, np.zeros((m, 0)), np.zeros((0, 0)), 0.0, covariance, covariance)
    cross = covariance @ observation.T
    of_samples = observation @ cross + np.diag(model.noise[chosen])
    of_samples[range(len(chosen)), range(len(chosen))] *= 1.0 + _SHARE
    factor, failed = lapack.dpotrf(of_samples, lower=1)
    if failed:
        raise np.linalg.LinAlgError("the covariance of the samples is not positive definite")
    gain = lapack.dpotrs(factor, cross.T, lower=1)[0].T
    complement = np.eye(m) - gain @ observation  # Joseph's form, which stays positive
    updated = complement @ covariance @ complement.T + (gain * model.noise[chosen]) @ gain.T
    whitening = lapack.dtrtri(factor, lower=1)[0]
    return _Gain(
        chosen, gain, whitening, float(np.log(factor.diagonal()).sum()), covariance, _symmetric(updated)
    )


def _recursion(matrix: Floats, first: Floats, added: Floats) -> Floats:
    """(N + 1, m) states z_0 = `first` and z_k+1 = `matrix` z_k + `added`_k of a stable system, in blocks side by side."""
    count, m = added.shape
    length = max(1, isqrt(count))
    blocks = -(-count // length)
    states = np.zeros((blocks * length, m))
    states[:count] = added
    states = states.reshape(blocks, length, m)
    powers, starts = np.empty((length, m, m)), np.empty((blocks, m))
    powers[0] = matrix
    for k in range(1, length):  # as if every block started at 0
        states[:, k] += states[:, k - 1] @ matrix.T
        np.matmul(powers[k - 1], matrix, out=powers[k])
    starts[0] = first
    for block in range(1, blocks):
        starts[block] = powers[-1] @ starts[block - 1] + states[block - 1, -1]
    states += np.matmul(starts, powers.transpose(0, 2, 1)).transpose(1, 0, 2)
    return np.concatenate([first[None], states.reshape(-1, m)[:count]])


def _smoothed_covariance(model: LinearModel, gain: _Gain, count: int) -> Floats:
    """Covariance of a smoothed state in the middle of `count` samples, by the recursion of a constant gain.

    It ends at a fixed point, unless no sensor tells the place of a rigid motion, whose covariance grows with the record.
    """
    back = _solved(gain.predicted, model.transition @ gain.updated).T
    complement = np.eye(len(back)) - back @ model.transition  # Joseph's form, which stays positive
    change = complement @ gain.updated @ complement.T + back @ model.process @ back.T
    for _ in range(
        min(_DOUBLINGS, count.bit_length())
    ):  # sum of back^i change back'^i, twice as many terms at a time
        change = change + back @ change @ back.T
        back = back @ back
        if np.abs(back).max() < _NEGLIGIBLE:
            break
    return _symmetric(change)


def _solved(matrix: Floats, right: Floats) -> Floats:
    """matrix^-1 right for a covariance, scaled to a unit diagonal."""
    scale = np.sqrt(np.maximum(matrix.diagonal(), np.finfo(float).tiny))
    scaled = matrix / np.outer(scale, scale)
    scaled[range(len(scale)), range(len(scale))] += _SHARE
    sides = right / scale[:, None]
    _, solution, failed = lapack.dposv(scaled, sides)
    if failed:  # without random forces a covariance sinks to rounding
        sizes, axes = np.linalg.eigh(scaled)
        solution = axes @ (axes.T @ sides / np.maximum(sizes, _SHARE)[:, None])
    return np.asarray(solution / scale[:, None])


def _symmetric(matrix: Floats) -> Floats:
    return np.asarray(0.5 * (matrix + matrix.T))


def _close(first: Floats, second: Floats) -> bool:
    scale = np.sqrt(np.maximum(np.outer(first.diagonal(), first.diagonal()), np.finfo(float).tiny))
    return bool((np.abs(first - second) <= _SETTLED * scale).all())
