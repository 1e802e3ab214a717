"""The linear part of a structure with hosts for a Kalman filter, with the forces of other links as random inputs.

A linear system in samples, with random inputs and noise.

Starts of linear links with which a structure is stable: noise gives springs and dampers of either sign, and of any size.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import isqrt

import numpy as np
import scipy

from linkwise.arrays import Floats
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


TIGHT = 0.1
"""A bound on elongations that drift, as a part of the size of the measured motion."""
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
        reach: float = TIGHT,
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
        size = self._force_sizes(x, v)
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
        bound = (reach * x) ** 2 * _CORRELATED * record.rate
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
        fastest, mass = _FASTEST * rate, self.mass(number)
        return (least, fastest**2 * mass), (0.0, fastest * mass)

    def mass(self, number: int) -> float:
        """Mass in kg that open link `number` moves."""
        direction = self.incidence[:, number]
        return 1.0 / float(direction @ (direction / self.structure.mass_values))

    def _force_sizes(self, x: float, v: float) -> Floats:
        """(U,) sizes of the forces of open links: what would give their ends the acceleration of motion of these sizes."""
        mobility = np.einsum("il,il->l", self.incidence, self.incidence / self.structure.mass_values[:, None])
        return np.asarray(v**2 / max(x, np.finfo(float).tiny) / mobility)

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
    if missing or not (mode or all(coefficient.known for coefficient in link.coefficients.values())):
        return None
    if not is_linear(link.law):
        return None
    return _slopes(link, link.values)


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
