"""States of a linear system with random inputs: Kalman filter and fixed-interval smoother.

The covariance is the steady one, of the algebraic Riccati equation, and the gain with it; the first state is that from which
predictions are likeliest. The smoother runs an adjoint backwards through the filter's own closed loop, which is stable, and
divides by no covariance of a state, which sinks to rounding where little is random.

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

from linkwise.arrays import Floats
from linkwise.likelihood.starts.linear_part import LinearModel, LinearPart, inputs_of, recursion, samples_of
from linkwise.model.structure import Structure
from linkwise.records.record import Record

_DOUBLINGS = 60  # of the samples after which the covariance is that far from the start ...
_STEADY = 1e-9  # ... and what one may add to each variance, relative, in the end


class Filtered(NamedTuple):
    """What the filter of a system says of N samples, with its gain far from the start, from the likeliest first state.

    `whitened` (N, C) are errors of the predictions of samples from those before, `predicted` (N, m) the states, `covariance`
    (m, m) that of these beside that of the `first` (m, m), `loop` (m, m) what the filter makes of an error of a state from one
    sample to the next, and `root` (C, m) how whitened errors show it. `log_likelihood` lacks what no model changes.
    """

    whitened: Floats
    predicted: Floats
    covariance: Floats
    first: Floats
    loop: Floats
    root: Floats
    log_likelihood: float


def smooth(model: LinearModel, samples: Floats, inputs: Floats) -> tuple[Floats, Floats]:
    """Most likely states (N, m) by samples (N, C) with known inputs (N, r), and their covariance (m, m) in the middle.

    Raises numpy.linalg.LinAlgError as `filtered` does.
    """
    forward = filtered(model, samples, inputs)
    states, middle = forward.predicted + _adjoints(forward) @ forward.covariance, len(samples) // 2
    information = _accumulated(forward.loop, forward.root, len(samples) - middle)
    onward = np.linalg.matrix_power(forward.loop, middle)
    onward -= forward.covariance @ information @ onward  # what is left of an error of the first state
    return states, _reduced(forward.covariance, information) + onward @ forward.first @ onward.T


def filtered(model: LinearModel, samples: Floats, inputs: Floats) -> Filtered:
    """What the model predicts of samples (N, C) with inputs (N, r), of which the mean acts between two samples.

    Raises numpy.linalg.LinAlgError where the covariance of a prediction has no steady value.
    """
    covariance, observation = steady_covariance(model), model.observation
    noise = np.sqrt(model.noise)
    cross = covariance @ observation.T / noise
    sizes, axes = np.linalg.eigh(np.eye(len(noise)) + _symmetric((observation / noise[:, None]) @ cross))
    sizes = np.maximum(sizes, 1.0)  # of samples in units of their noise: rounding makes no variance smaller
    log_deviations = float(np.log(noise).sum() + 0.5 * np.log(sizes).sum())
    whitening = (axes / np.sqrt(sizes)) @ axes.T / noise
    through = model.transition @ (cross * noise @ (whitening.T @ whitening))
    loop, root = model.transition - through @ observation, whitening @ observation
    shown = samples - inputs @ model.direct.T
    added = shown[:-1] @ through.T + 0.5 * (inputs[1:] + inputs[:-1]) @ model.drive.T

    def following(state: Floats, first: Floats, likelihood: float) -> Filtered:
        predicted = recursion(loop, state, added)
        white = (shown - predicted @ observation.T) @ whitening.T
        likelihood -= 0.5 * float(np.sum(white**2)) + len(samples) * log_deviations
        return Filtered(white, predicted, covariance, first, loop, root, likelihood)

    unit = np.sqrt(model.first.diagonal())
    shares, axes = np.linalg.eigh(np.outer(unit, unit) * _symmetric(_accumulated(loop, root, len(samples))))
    shares = 1.0 + np.maximum(shares, 0.0)
    spread = unit[:, None] * axes / np.sqrt(shares)
    state = spread @ (spread.T @ _adjoints(following(np.zeros(len(unit)), model.first, 0.0))[0])
    prior = -0.5 * float(np.log(shares).sum() + np.sum((state / unit) ** 2))
    return following(state, spread @ spread.T, prior)


def _adjoints(forward: Filtered) -> Floats:
    """(N, m) slopes of the log likelihood by the state before each sample, from that sample on."""
    added = forward.whitened @ forward.root
    return np.asarray(recursion(forward.loop.T, np.zeros(added.shape[1]), added[::-1])[:0:-1])


def steady_covariance(model: LinearModel) -> Floats:
    """The covariance (m, m) of a state before its sample, far from the start; LinAlgError where there is none.

    That after 1, 2, 4, ... samples from a known state, by the doubling of E. K.-W. Chu et al., Int. J. Control 77, 767 (2004).
    """
    size = np.sqrt(model.first.diagonal())
    observation = model.observation * size / np.sqrt(model.noise)[:, None]
    step = (model.transition * size / size[:, None]).T
    information, covariance = observation.T @ observation, model.process / np.outer(size, size)
    identity = np.eye(len(size))
    for _ in range(_DOUBLINGS):
        through = np.linalg.solve(identity + information @ covariance, np.hstack([step, information]))
        moved, remaining = np.hsplit(through, 2)
        added = _symmetric(step.T @ covariance @ moved)
        information = _symmetric(information + step @ remaining @ step.T)
        covariance, step = covariance + added, step @ moved
        if not np.isfinite(covariance).all() or np.all(added.diagonal() <= _STEADY * covariance.diagonal()):
            break
    if not np.isfinite(covariance).all():
        raise np.linalg.LinAlgError("no steady covariance")
    return np.asarray(covariance * np.outer(size, size))


def _accumulated(loop: Floats, root: Floats, samples: int) -> Floats:
    """(m, m) information of the whitened errors of `samples` on the state before them, in powers of two of their number."""
    added, information = root.T @ root, np.zeros_like(loop)
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
    found = [_likelihood(model, samples, inputs) for model in models]
    likelihood, best = max(zip(found, tried, strict=True), key=lambda one: one[0])
    return float(likelihood + 0.5 * len(samples) * np.log(bounds).sum()), float(best)


def _likelihood(model: LinearModel, samples: Floats, inputs: Floats) -> float:
    """The log likelihood of samples; -inf for a filter that has no steady state."""
    try:
        likelihood = filtered(model, samples, inputs).log_likelihood
    except np.linalg.LinAlgError:
        return -np.inf
    return likelihood if np.isfinite(likelihood) else -np.inf


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
