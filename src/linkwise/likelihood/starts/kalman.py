"""The linear part of a structure with hosts, with the forces of other links as random inputs: Kalman filter and smoother.

After the first samples the covariance is the steady one, of the algebraic Riccati equation, and the gain with it. The smoother
runs an adjoint backwards through the filter's own closed loop, which is stable, and divides by no covariance of a state, which
sinks to rounding where little is random.

Unknown frequencies and damping of modes are those with which the filter predicts the samples best (`tuned_modes`), and starts
of linear links those with which a structure is stable: noise gives springs and dampers of either sign, and of any size.

References
----------
A. E. Bryson and M. Frazier, Smoothing for linear and nonlinear dynamic systems, TDR 63-119, Wright-Patterson AFB (1963).
P. de Jong, J. Am. Stat. Assoc. 84, 1085 (1989).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from math import isqrt
from typing import NamedTuple

import numpy as np
import scipy

from linkwise.arrays import Bools, Floats, Indices
from linkwise.errors import IdentificationError
from linkwise.expression import differentiate, symbols
from linkwise.model.law import Law
from linkwise.model.link import Link
from linkwise.model.structure import Structure
from linkwise.records.record import Record


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


def recursion(matrix: Floats, first: Floats, added: Floats) -> Floats:
    """States of a stable system, in blocks side by side.

    Parameters
    ----------
    matrix : array of shape (m, m)
        Transition over a sample.
    first : array of shape (m,)
        The state z_0.
    added : array of shape (N, m)
        What is added: z_k+1 = `matrix` z_k + `added`_k.

    Returns
    -------
    array of shape (N + 1, m)
        The states.
    """
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


_BOUND = 0.1  # of elongations that drift, as a part of the size of the measured motion
_CORRELATED = 0.1  # s over which a bound is one piece of information
_FASTEST = 10.0  # radians that the fastest start moves in a sample: what eight steps of the flow follow
_STABLE = 0.9  # of the static stiffness of a structure at the ends of a link: the largest negative spring between them
_HELD = 1e-6  # relative: what a force on a structure that holds it leaves of itself
_LOWEST = 3  # periods in a record of the slowest motion that counts for sizes


@dataclass(frozen=True, eq=False)
class LinearPart:
    """Linear system of a structure: stiffness and damping (n, n), and the open links, whose forces are random walks."""

    structure: Structure
    stiffness: Floats
    damping: Floats
    open: tuple[int, ...]

    @classmethod
    def of(cls, structure: Structure) -> LinearPart:
        slopes = [_linear_slopes(link, mode=link.name in structure.modes) for link in structure.links]
        open_links = tuple(number for number, own in enumerate(slopes) if own is None)
        both = np.array([own or (0.0, 0.0) for own in slopes]).reshape(-1, 2)
        incidence = structure.incidence.toarray()
        stiffness, damping = ((incidence * own) @ incidence.T for own in both.T)
        return cls(structure, stiffness, damping, open_links)

    @cached_property
    def incidence(self) -> Floats:
        """(n, U) rows of B of the open links."""
        return np.asarray(self.structure.incidence.toarray()[:, list(self.open)])

    def model(
        self,
        record: Record,
        sigma: Mapping[str, float],
        change: float,
        white: float = 0,
    ) -> LinearModel:
        """The system in samples of a record.

        Forces of open links change by `change` of their size in a sample; their elongations are bounded by `reach` times the
        size of the measured motion. White forces on all modes and masses are `white` times the size of their accelerations.
        """
        structure, n, u = self.structure, self.structure.size, len(self.open)
        masses, m = structure.mass_values[:, None], 2 * n + 2 * u
        rates = np.zeros((m, m))
        rates[:n, n : 2 * n] = np.eye(n)
        rates[n : 2 * n, : 2 * n + u] = -np.hstack([self.stiffness, self.damping, self.incidence]) / masses
        rates[2 * n : 2 * n + u, 2 * n + u :] = np.eye(u)
        applied = [structure.topology.row(channel.place) for channel in record.forces]
        drive = np.zeros((m, len(applied)))
        drive[n : 2 * n] = np.reshape(applied, (-1, n)).T / masses
        x, v = self._sizes(record)
        # what gives the ends of open links the acceleration of motion of these sizes
        size = v**2 / max(x, np.finfo(float).tiny) * self.masses
        intensity = np.zeros(m)
        intensity[2 * n + u :] = (change * size / record.step) ** 2 / record.step
        transition, process, input_effect = _discrete(rates, drive, intensity, record.step)
        process[range(n, 2 * n), range(n, 2 * n)] += (
            white * v**2 / max(x, np.finfo(float).tiny) * record.step
        ) ** 2
        whole = np.hstack([rates, drive])  # accelerations from states and inputs
        by_kind = np.stack([np.eye(n, m + len(applied), kind * n) for kind in (0, 1)] + [whole[n : 2 * n]])
        shown = [structure.topology.row(channel.place) @ by_kind[channel.order] for channel in record.motions]
        bounded = np.pad(self.incidence.T, ((0, 0), (0, whole.shape[1] - n)))
        observation = np.concatenate([np.stack(shown), bounded])
        bound = (_BOUND * x) ** 2 * _CORRELATED * record.rate
        start = np.concatenate([[x] * n, [v] * n, size, size / record.step])
        return LinearModel(
            transition=transition,
            process=process,
            observation=observation[:, :m],
            noise=np.array([*(sigma[name] ** 2 for name in record.motions), *[bound] * u]),
            drive=input_effect,
            direct=observation[:, m:],
            first=np.diag(np.square(10.0 * start)),
        )

    def bounds(self, number: int, rate: float) -> tuple[tuple[float, float], tuple[float, float]]:
        """Least and largest stiffness in N/m, and damping in N s/m, of open link `number` in a stable system.

        A spring may be as negative as the rest of the structure holds, and both as large as some steps a sample follow.
        """
        direction, stiffness = self.incidence[:, number], self.stiffness
        moved = np.linalg.lstsq(stiffness, direction, rcond=None)[0]
        is_held = np.linalg.norm(stiffness @ moved - direction) < _HELD * np.linalg.norm(direction)
        least = -_STABLE / float(direction @ moved) if is_held else 0.0
        fastest, mass = _FASTEST * rate, float(self.masses[number])
        return (least, fastest**2 * mass), (0.0, fastest * mass)

    @cached_property
    def masses(self) -> Floats:
        """(U,) kg that open links move."""
        mobilities = self.incidence / self.structure.mass_values[:, None]
        return np.asarray(1.0 / np.einsum("il,il->l", self.incidence, mobilities))

    def _sizes(self, record: Record) -> tuple[float, float]:
        """Sizes of displacements and velocities: the largest of the channels, integrated above the lowest frequencies."""
        sizes = []
        for name in record.motions:
            values = record.channel(name)
            spectrum = np.fft.rfft(np.where(np.isfinite(values), values, 0.0))[_LOWEST:]
            omega = 2.0 * np.pi * np.fft.rfftfreq(len(values), record.step)[_LOWEST:]
            order = name.order
            powers = [float(np.sum(np.abs(spectrum * omega ** (kind - order)) ** 2)) for kind in (0, 1)]
            sizes.append(np.sqrt(2.0 * np.array(powers)) / len(values))
        x, v = np.max(sizes, axis=0)
        return float(x), float(v)


def _linear_slopes(link: Link, *, mode: bool) -> tuple[float, float] | None:
    """Stiffness and damping of a link that is part of the linear system, None for another one."""
    missing = [name for name, coefficient in link.coefficients.items() if coefficient.value is None]
    if missing and mode:
        raise IdentificationError(
            f"no starting value for {link.name}.{missing[0]}: state {{ start = ... }} for it in the structure"
        )
    numbers = mode or all(coefficient.known for coefficient in link.coefficients.values())
    return _slopes(link, link.values) if numbers and not missing and is_linear(link.law) else None


@lru_cache(maxsize=512)
def is_linear(law: Law) -> bool:
    """Whether a law is linear in d and v, without states and signals."""
    return law.is_plain and not any(
        set(symbols(differentiate(law.expression, name))) & {"d", "v"} for name in ("d", "v")
    )


def samples_of(record: Record, linear: LinearPart) -> Floats:
    """(N, C + U) samples, and zeros that bound the elongations of open links."""
    shown = record.select(record.motions).values
    return np.concatenate([shown, np.zeros((len(record), len(linear.open)))], axis=1)


def inputs_of(record: Record) -> Floats:
    """(N, r) applied forces."""
    columns = [record.channel(name) for name in record.forces]
    return np.stack(columns, axis=1) if columns else np.zeros((len(record), 0))


def _discrete(rates: Floats, drive: Floats, intensity: Floats, step: float) -> tuple[Floats, Floats, Floats]:
    """Transition, process covariance and effect of inputs over a step.

    Van Loan's method runs a motion back in time, where that of an overdamped mode grows beyond all digits. It serves for a
    part of the step that is short for every mode, from which the covariance of the whole follows by doubling.
    """
    m, r = len(rates), drive.shape[1]
    augmented = np.zeros((m + r, m + r))
    augmented[:m, :m], augmented[:m, m:] = rates, drive
    whole = scipy.linalg.expm(augmented * step)
    fastest = float(np.abs(np.linalg.eigvals(rates)).max(initial=0.0)) * step
    doublings = max(0, int(np.ceil(np.log2(max(fastest, 1.0)))))
    block = np.zeros((2 * m, 2 * m))
    block[:m, :m], block[:m, m:], block[m:, m:] = -rates, np.diag(np.maximum(intensity, 0.0)), rates.T
    loaned = scipy.linalg.expm(block * (step / 2**doublings))
    transition = loaned[m:, m:].T
    process = transition @ loaned[:m, m:]
    for _ in range(doublings):
        process = process + transition @ process @ transition.T
        transition = transition @ transition
    return whole[:m, :m], 0.5 * (process + process.T), whole[:m, m:]


def stable_starts(
    linear: LinearPart, starts: Mapping[str, float], stated: Mapping[str, float], rate: float
) -> dict[str, float]:
    """Starting values with those of linear links moved to where the motion neither grows nor is too fast to be followed.

    Parameters
    ----------
    linear : LinearPart
        The linear system of the structure, with numbers for its modes.
    starts : mapping of str to float
        Starting values by name of the parameter.
    stated : mapping of str to float
        Starts that count as they are.
    rate : float
        Samples per second.

    Returns
    -------
    dict of str to float
        The starting values.
    """
    values = dict(starts)
    for number, index in enumerate(linear.open):
        link = linear.structure.links[index]
        own = {name: c.value for name, c in link.coefficients.items() if c.value is not None}
        own |= {name: values[key] for name in link.coefficients if (key := f"{link.name}.{name}") in values}
        free = [name for name in link.law.linear if f"{link.name}.{name}" in values.keys() - stated.keys()]
        if not free or own.keys() != link.coefficients.keys() or not is_linear(link.law):
            continue
        slopes = np.array(_slopes(link, own))
        missing = np.clip(slopes, *np.transpose(linear.bounds(number, rate))) - slopes
        if not missing.any():
            continue
        columns = [np.array(_slopes(link, own | {name: 2.0 * own[name] or 1.0})) - slopes for name in free]
        change = np.linalg.lstsq(np.stack(columns, axis=1), missing, rcond=None)[0]
        for name, part in zip(free, change, strict=True):
            values[f"{link.name}.{name}"] += float(part) * (own[name] or 1.0)
    return values


def _slopes(link: Link, values: Mapping[str, float]) -> tuple[float, float]:
    """Stiffness in N/m and damping in N s/m of a linear link."""
    partials = link.law.partials(0.0, 0.0, dict(values))
    return float(partials.by_d), float(partials.by_v)


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
    middle, states, end = len(samples) // 2, np.empty_like(forward.predicted), len(samples)
    adjoint, information = np.zeros(states.shape[1]), np.zeros(model.first.shape)
    for first, gain in reversed(forward.runs):
        observation = model.observation[gain.chosen]
        loop = model.transition @ (np.eye(len(adjoint)) - gain.gain @ observation)
        root = observation.T @ gain.whitening.T
        added = forward.whitened[first:end, gain.chosen] @ root.T
        adjoints = recursion(loop.T, adjoint, added[::-1])[:0:-1]
        states[first:end] = forward.predicted[first:end] + adjoints @ gain.predicted
        adjoint = adjoints[0]
        if end > middle:
            information = _accumulated(loop, root @ root.T, information, end - max(first, middle))
            covariance = gain.predicted
        end = first
    return states, _reduced(covariance, information)


class Filtered(NamedTuple):
    """Whitened errors (N, C) of the predictions of samples from those before, 0 where one is missing, predicted states (N, m),
    the gains of runs of samples by the first of each, and the log likelihood, less what does not depend on the model.
    """

    whitened: Floats
    predicted: Floats
    runs: list[tuple[int, _Gain]]
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
    runs: list[tuple[int, _Gain]] = []
    constant = None if steady is None else _gain(model, steady, np.ones(samples.shape[1], dtype=bool))
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
        gain = constant if settled and constant else _gain(model, covariance, known[k])
        end = int(gaps[np.searchsorted(gaps, k)]) if settled else k + 1
        runs.append((k, gain))
        rows = slice(k, end)
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
    return Filtered(whitened, predicted, runs, total)


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
    """A structure with other starts of unknown coefficients of links and modes; other values are left out."""
    names = {f"{link.name}.{name}" for link in structure.links for name in link.coefficients}
    own = {
        name: replace(structure.coefficient(name), value=value)
        for name, value in values.items()
        if name in names
    }
    return structure.with_coefficients(own)
