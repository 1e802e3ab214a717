"""States of a linear system with random inputs: Kalman filter and fixed-interval smoother.

After the first samples the covariance is the steady one, of the algebraic Riccati equation, and the gain with it. The smoother
runs an adjoint backwards through the filter's own closed loop, which is stable, and divides by no covariance of a state, which
sinks to rounding where little is random.

References
----------
A. E. Bryson and M. Frazier, Smoothing for linear and nonlinear dynamic systems, TDR 63-119, Wright-Patterson AFB (1963).
P. de Jong, J. Am. Stat. Assoc. 84, 1085 (1989).

Frequencies and damping of modes as a filter predicts the samples best.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy

from linkwise.arrays import Bools, Floats, Indices
from linkwise.likelihood.starts.linear_part import LinearModel, LinearPart, inputs_of, recursion, samples_of
from linkwise.model.structure import Structure
from linkwise.records.record import Record

_TRANSIENT = 400  # samples at most, until the covariance is taken for the steady one ...
_DOUBLINGS = 60  # of the samples after which the covariance is that far from the start ...
_STEADY = 1e-9  # ... and what one may add to each variance, relative, in the end
_SETTLED = 0.01  # ... and what it may differ from that, relative, before


class _Gain(NamedTuple):
    """What an update needs: the channels, their gain, what whitens their errors, and the covariances before and after it."""

    chosen: Indices
    gain: Floats
    whitening: Floats
    log_determinant: float
    predicted: Floats
    updated: Floats


def smooth(model: LinearModel, samples: Floats, inputs: Floats) -> tuple[Floats, Floats]:
    """Most likely states (N, m), and their covariance (m, m) in the middle.

    Parameters
    ----------
    model : LinearModel
        The system.
    samples : array of shape (N, C)
        The samples, NaN where missing.
    inputs : array of shape (N, r)
        The known inputs at the samples; between them their mean acts.
    """
    forward = filtered(model, samples, inputs, _TRANSIENT)
    count, which = len(samples), np.asarray(forward.which)
    middle, states = count // 2, np.empty_like(forward.predicted)
    adjoint, information = np.zeros(states.shape[1]), np.zeros(model.first.shape)
    firsts = np.append(0, 1 + np.flatnonzero(np.diff(which)))  # of runs of one gain
    for first, end in zip(firsts[::-1], np.append(firsts[1:], count)[::-1], strict=True):
        gain = forward.gains[which[first]]
        observation = model.observation[gain.chosen]
        loop = model.transition @ (np.eye(len(adjoint)) - gain.gain @ observation)
        root = observation.T @ gain.whitening.T
        added = forward.whitened[first:end, gain.chosen] @ root.T
        adjoints = recursion(loop.T, adjoint, added[::-1])[:0:-1]
        states[first:end] = forward.predicted[first:end] + adjoints @ gain.predicted
        adjoint = adjoints[0]
        if end > middle:
            information = _accumulated(loop, root @ root.T, information, int(end - max(first, middle)))
    return states, _reduced(forward.gains[which[middle]].predicted, information)


class Filtered(NamedTuple):
    """Whitened errors (N, C) of the predictions of samples from those before, 0 where one is missing, predicted states (N, m),
    the distinct gains, which of them each sample has, and the log likelihood, less what does not depend on the model.
    """

    whitened: Floats
    predicted: Floats
    gains: list[_Gain]
    which: list[int]
    log_likelihood: float


def filtered(model: LinearModel, samples: Floats, inputs: Floats, transient: int = 1) -> Filtered:
    """What the model predicts of samples (N, C) with inputs (N, r), its covariance steady after a `transient` at most."""
    count, m = len(samples), len(model.transition)
    known = np.isfinite(samples)
    shown = np.where(known, samples, 0.0) - inputs @ model.direct.T
    driven = np.zeros((count, m))
    driven[1:] = 0.5 * (inputs[1:] + inputs[:-1]) @ model.drive.T
    predicted = np.empty((count, m))
    whitened = np.zeros(samples.shape)
    steady = steady_covariance(model)
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
            predicted[rows] = recursion(model.transition - through @ model.observation, state, added)
        errors = (shown[rows] - predicted[rows] @ model.observation.T)[:, gain.chosen]
        white = errors @ gain.whitening.T
        whitened[rows, gain.chosen] = white
        total -= 0.5 * float(np.sum(white**2)) + (end - k) * gain.log_determinant
        if end < count:
            updated = predicted[end - 1] + gain.gain @ errors[-1]
            state = model.transition @ updated + driven[end]
        if not settled:
            covariance = _symmetric(model.transition @ gain.updated @ model.transition.T + model.process)
        k = end
    return Filtered(whitened, predicted, gains, which, total)


def steady_covariance(model: LinearModel) -> Floats | None:
    """The covariance (m, m) of a state before its sample, far from the start; None where there is none.

    That after 1, 2, 4, ... samples from a known state, by the doubling of E. K.-W. Chu et al., Int. J. Control 77, 767 (2004).
    """
    size = np.sqrt(model.first.diagonal())
    observation = model.observation * size / np.sqrt(model.noise)[:, None]
    step = (model.transition * size / size[:, None]).T
    information, covariance = observation.T @ observation, model.process / np.outer(size, size)
    identity = np.eye(len(size))
    for _ in range(_DOUBLINGS):
        try:
            through = np.linalg.solve(identity + information @ covariance, np.hstack([step, information]))
        except np.linalg.LinAlgError:
            return None
        moved, remaining = np.hsplit(through, 2)
        added = _symmetric(step.T @ covariance @ moved)
        information = _symmetric(information + step @ remaining @ step.T)
        covariance, step = covariance + added, step @ moved
        if not np.isfinite(covariance).all():
            return None
        if np.all(added.diagonal() <= _STEADY * covariance.diagonal()):
            break
    covariance = covariance * np.outer(size, size)
    return covariance if bool((covariance.diagonal() > 0.0).all()) else None


def _gain(model: LinearModel, covariance: Floats, known: Bools) -> _Gain:
    chosen = np.flatnonzero(known)
    observation, m = model.observation[chosen], len(covariance)
    if not len(chosen):
        return _Gain(chosen, np.zeros((m, 0)), np.zeros((0, 0)), 0.0, covariance, covariance)
    noise = np.sqrt(model.noise[chosen])
    cross = covariance @ observation.T / noise
    sizes, axes = np.linalg.eigh(np.eye(len(chosen)) + _symmetric((observation / noise[:, None]) @ cross))
    sizes = np.maximum(sizes, 1.0)  # of samples in units of their noise: rounding makes no variance smaller
    whitening = (axes / np.sqrt(sizes)) @ axes.T / noise
    gain = cross * noise @ (whitening.T @ whitening)
    complement = np.eye(m) - gain @ observation  # Joseph's form, which stays positive
    updated = complement @ covariance @ complement.T + (gain * noise**2) @ gain.T
    log_determinant = float(np.log(noise).sum() + 0.5 * np.log(sizes).sum())
    return _Gain(chosen, gain, whitening, log_determinant, covariance, _symmetric(updated))


def _accumulated(loop: Floats, added: Floats, information: Floats, samples: int) -> Floats:
    """Information (m, m) of `samples` errors and those after them: N_k-1 = `added` + loop' N_k loop, in powers of two."""
    while samples:
        if samples % 2:
            information = added + loop.T @ information @ loop
        added, loop = added + loop.T @ added @ loop, loop @ loop
        samples //= 2
    return information


def _reduced(covariance: Floats, information: Floats) -> Floats:
    """P - P N P of a covariance P and the information N of later errors (m, m), never negative."""
    scale = np.sqrt(np.maximum(covariance.diagonal(), np.finfo(float).tiny))
    sizes, axes = np.linalg.eigh(covariance / np.outer(scale, scale))
    root = scale[:, None] * axes * np.sqrt(np.maximum(sizes, 0.0))
    shares, axes = np.linalg.eigh(_symmetric(root.T @ information @ root))
    left = root @ axes * np.sqrt(np.clip(1.0 - shares, 0.0, 1.0))
    return np.asarray(left @ left.T)


def _symmetric(matrix: Floats) -> Floats:
    return np.asarray(0.5 * (matrix + matrix.T))


def _close(first: Floats, second: Floats) -> bool:
    scale = np.sqrt(np.maximum(np.outer(first.diagonal(), first.diagonal()), np.finfo(float).tiny))
    return bool((np.abs(first - second) <= _SETTLED * scale).all())


_TRIED = 2000  # samples that decide how fast the forces of links change
_TUNED = 4000  # samples that the frequencies of modes are tuned to
_ROUGH = 0.05  # relative size of a change of a frequency or damping without a prior
_DIFFERENCE, _STEPS = 1e-3, 12  # of the search for them
CHANGES: Floats = 10.0 ** np.arange(-4.0, 3.0)
"""Of a force over a sample, relative to its size: tried one after the other."""


def likeliest_change(
    record: Record, linear: LinearPart, sigma: Mapping[str, float], tried: Floats = CHANGES, white: float = 0
) -> tuple[float, float]:
    """The log likelihood of the samples, and by how much the forces of open links then change in a sample, relative to their
    size: one of those `tried`, beside `white` forces as of `LinearPart.model`.
    """
    samples, inputs = samples_of(record, linear)[:_TRIED], inputs_of(record)[:_TRIED]
    models = [linear.model(record, sigma, change, white=white) for change in tried.tolist()]
    bounds = models[0].noise[len(record.motions) :]  # of elongations, which are no samples
    found = [filtered(model, samples, inputs).log_likelihood for model in models]
    likelihood, best = max(zip(np.nan_to_num(found, nan=-np.inf), tried, strict=True), key=lambda one: one[0])
    return float(likelihood + 0.5 * len(samples) * np.log(bounds).sum()), float(best)


def tuned_modes(record: Record, structure: Structure, sigma: Mapping[str, float]) -> dict[str, float]:
    """Frequencies and damping of modes that are unknown, from what a filter with random forces of links predicts.

    Parameters
    ----------
    record : Record
        The record.
    structure : Structure
        The structure; frequencies and damping of modes have numbers or starts.
    sigma : mapping of str to float
        Standard deviations of the noise by channel, in SI units.

    Returns
    -------
    dict of str to float
        Values by name of the parameter; empty where all modes are known.
    """
    free = [p for p in structure.parameters if p.name.owner in structure.mass_names and not p.name.is_shape]
    if not free:
        return {}
    linear = LinearPart.of(structure)
    change = likeliest_change(record, linear, sigma)[1]
    start = np.array([float(p.start or 0.0) for p in free])
    unit = np.array(
        [min(p.sigma, _ROUGH * abs(value) or _ROUGH) for p, value in zip(free, start, strict=True)]
    )
    stated = np.array([p.sigma < np.inf for p in free], dtype=bool)
    samples, inputs = samples_of(record, linear)[:_TUNED], inputs_of(record)[:_TUNED]

    def values(moved: Floats) -> dict[str, float]:
        return dict(zip((p.name for p in free), (start + unit * moved).tolist(), strict=True))

    def residual(moved: Floats) -> Floats:
        model = LinearPart.of(with_starts(structure, values(moved))).model(record, sigma, change)
        return np.append(filtered(model, samples, inputs).whitened.ravel(), moved[stated])

    limits = np.array([[p.lower, p.upper] for p in free])
    lower, upper = ((limits - start[:, None]) / unit[:, None]).T
    optimum = scipy.optimize.least_squares(
        lambda shifted: residual(shifted - 1.0),  # from 1, of which a difference is a part
        np.ones(len(lower)),
        # rounding of a start at its bound exceeds it
        bounds=(np.minimum(lower, 0.0) + 1.0, np.maximum(upper, 0.0) + 1.0),
        diff_step=_DIFFERENCE,
        max_nfev=_STEPS,
    )
    return values(np.asarray(optimum.x) - 1.0)


def with_starts(structure: Structure, values: Mapping[str, float]) -> Structure:
    """A structure with other starts of unknown coefficients."""
    links = list(structure.links)
    for number, link in enumerate(links):
        own = {
            name: replace(coefficient, value=values[f"{link.name}.{name}"])
            for name, coefficient in link.coefficients.items()
            if f"{link.name}.{name}" in values
        }
        links[number] = replace(link, coefficients={**link.coefficients, **own}) if own else link
    return replace(structure, links=tuple(links))
