"""Starting states and values of structures with hosts: the linear part is a known filter, the forces of links its inputs.

Modes and links whose law is linear with numbers for its coefficients make a linear system. The other links exert forces that
are random walks, once integrated; a Kalman smoother finds the motion and these forces together. Laws follow from forces and
elongations; an elongation that no sensor determines is known up to drift, as in `inverse_dynamics`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.expression import differentiate, symbols
from linkwise.likelihood.starts.coefficients import start_of_links
from linkwise.likelihood.starts.drift_tracking import elongations_from_forces
from linkwise.likelihood.starts.inverse_dynamics import LinkSignals
from linkwise.likelihood.starts.kalman import LinearModel, Smoothed, log_likelihood, smooth
from linkwise.model.link import Link
from linkwise.model.structure import Structure
from linkwise.records.channel import Channel
from linkwise.records.record import Record

_TRIED = 2000  # samples that decide how fast the forces of links change
_CHANGES = 10.0 ** np.arange(
    -4.0, 3.0
)  # of a force over a sample, relative to its size: tried one after the other
_ELONGATION = (
    30.0  # of the size of the measured motion: the elongation that bounds the drift of what is not measured
)
_CORRELATED = 1000.0  # samples over which that bound is one piece of information
_DETERMINED = 0.1  # deviation of an elongation relative to its size, up to which it counts as measured


@dataclass(frozen=True, eq=False)
class HostMotion:
    """Motion of a structure with hosts.

    Attributes
    ----------
    x, v : array of shape (n, N)
        Displacements in m and velocities in m/s of modes and masses.
    deviation : array of shape (2 n,)
        Standard deviations of both.
    signals : LinkSignals
        Signals of the L links; forces of those in `open` alone.
    open : tuple of int
        Links whose law is not known, or not linear.
    coupling : array of shape (n, L)
        How displacements follow from a change of an elongation.
    """

    x: Floats
    v: Floats
    deviation: Floats
    signals: LinkSignals
    open: tuple[int, ...]
    coupling: Floats

    def with_drift_tracked(self, structure: Structure) -> HostMotion:
        """The motion with elongations that are known up to drift taken from the forces, all laws being known."""
        if not self.signals.integration_order.any():
            return self
        d, v = elongations_from_forces(self.signals, structure.links)
        return replace(
            self,
            x=self.x + self.coupling @ (d - self.signals.d),
            v=self.v + self.coupling @ (v - self.signals.v),
        )


def host_motion(record: Record, structure: Structure, sigma: Mapping[str, float]) -> HostMotion:
    """The motion that a record tells of a structure with hosts.

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
    HostMotion
        The motion.

    Raises
    ------
    IdentificationError
        If a mode has no number and no start.
    """
    linear = _LinearPart.of(structure)
    samples, inputs = _samples(record, linear), _inputs(record)
    first = slice(None, min(_TRIED, len(record)))
    fits = []
    for change in _CHANGES:
        model = linear.model(record, sigma, change)
        fits.append((log_likelihood(model, samples[first], inputs[first]), change))
    smoothed = smooth(linear.model(record, sigma, max(fits)[1]), samples, inputs)
    return _motion(structure, linear, smoothed, record)


def _motion(structure: Structure, linear: _LinearPart, smoothed: Smoothed, record: Record) -> HostMotion:
    n, open_links = structure.size, linear.open
    x, v = smoothed.states[:, :n].T, smoothed.states[:, n : 2 * n].T
    d, rate = structure.elongations(x.T).T, structure.elongations(v.T).T
    force = np.zeros_like(d)
    force[list(open_links)] = smoothed.states[:, 2 * n : 2 * n + len(open_links)].T
    incidence = structure.incidence.toarray()
    covariance = smoothed.covariance[:n, :n]
    variance = np.einsum("il,ij,jl->l", incidence, covariance, incidence)
    drifts = variance > (_DETERMINED**2) * np.mean(d**2, axis=1)
    is_open = np.isin(np.arange(len(structure.links)), open_links)
    of_force = smoothed.covariance.diagonal()[2 * n : 2 * n + len(open_links)]
    walk = np.zeros(len(d))
    gain = np.abs(incidence.T @ (incidence / structure.mass_values[:, None]))
    walk[list(open_links)] = np.sqrt(of_force) * gain.diagonal()[list(open_links)]
    return HostMotion(
        x=x,
        v=v,
        deviation=np.sqrt(smoothed.covariance.diagonal()[: 2 * n]),
        signals=LinkSignals(
            d=d,
            v=rate,
            force=force,
            integration_order=np.where(is_open & drifts, 2, 0),
            random_walk_intensity=walk,
            step=record.step,
        ),
        open=open_links,
        coupling=(covariance @ incidence) / np.where(variance > 0.0, variance, 1.0),
    )


def host_start(
    record: Record, structure: Structure, sigma: Mapping[str, float], given: Mapping[str, float]
) -> dict[str, float]:
    """Starting values of all parameters of a structure with hosts.

    Parameters
    ----------
    record : Record
        The record.
    structure : Structure
        The structure.
    sigma : mapping of str to float
        Standard deviations of the noise by channel, in SI units.
    given : mapping of str to float
        Starting values by name of the parameter.

    Returns
    -------
    dict of str to float
        Starting values by name of the parameter.

    Raises
    ------
    IdentificationError
        If an unknown has no starting value, and the forces of the links do not tell one.
    """
    motion = host_motion(record, structure, sigma)
    found = start_of_links(motion.signals, structure, given, motion.open) | dict(given)
    missing = [p.name for p in structure.parameters if p.name not in found]
    if missing:
        raise IdentificationError(
            f"no starting value for {', '.join(missing)}: state {{ start = ... }} for it in the structure"
        )
    return {p.name: found[p.name] for p in structure.parameters}


@dataclass(frozen=True, eq=False)
class _LinearPart:
    """Linear system of a structure: stiffness and damping (n, n), the open links, and rows of the channels (C, n)."""

    structure: Structure
    stiffness: Floats
    damping: Floats
    open: tuple[int, ...]

    @classmethod
    def of(cls, structure: Structure) -> _LinearPart:
        incidence = structure.incidence.toarray()
        n = structure.size
        stiffness, damping, open_links = np.zeros((n, n)), np.zeros((n, n)), []
        for number, link in enumerate(structure.links):
            slopes = _linear_slopes(link, mode=link.name in structure.modes)
            if slopes is None:
                open_links.append(number)
                continue
            both = np.outer(incidence[:, number], incidence[:, number])
            stiffness += slopes[0] * both
            damping += slopes[1] * both
        return cls(structure, stiffness, damping, tuple(open_links))

    def model(self, record: Record, sigma: Mapping[str, float], change: float) -> LinearModel:
        """The system in samples of a record, with forces of open links that change by `change` of their size in a sample."""
        structure, n, u = self.structure, self.structure.size, len(self.open)
        masses = structure.mass_values
        incidence = structure.incidence.toarray()[:, list(self.open)]
        m = 2 * n + 2 * u
        rates = np.zeros((m, m))
        rates[:n, n : 2 * n] = np.eye(n)
        rates[n : 2 * n, :n] = -self.stiffness / masses[:, None]
        rates[n : 2 * n, n : 2 * n] = -self.damping / masses[:, None]
        rates[n : 2 * n, 2 * n : 2 * n + u] = -incidence / masses[:, None]
        rates[2 * n : 2 * n + u, 2 * n + u :] = np.eye(u)
        applied = _applied(record, structure)
        drive = np.zeros((m, len(applied)))
        drive[n : 2 * n] = applied.T / masses[:, None]
        size = self._force_sizes(record)
        intensity = np.zeros(m)
        intensity[2 * n + u :] = (change * size / record.step) ** 2 / record.step
        transition, process, held = _discrete(rates, drive, intensity, record.step)
        rows = np.stack([structure.topology.row(Channel.parse(name).mass) for name in _shown(record)])
        kinds = ["xva".index(Channel.parse(name).kind) for name in _shown(record)]
        by_kind = np.stack([np.eye(m)[:n], np.eye(m)[n : 2 * n], rates[n : 2 * n]])
        direct = np.stack([np.zeros_like(drive[:n]), np.zeros_like(drive[:n]), drive[n : 2 * n]])
        observation = np.stack([row @ by_kind[kind] for row, kind in zip(rows, kinds, strict=True)])
        reach = _ELONGATION * self._sizes(record)[0]
        bounded = np.concatenate([incidence.T, np.zeros((u, m - n))], axis=1)
        noise = [sigma[name] ** 2 for name in _shown(record)]
        start = np.zeros(m)
        start[:n], start[n : 2 * n] = self._sizes(record)
        start[2 * n : 2 * n + u], start[2 * n + u :] = size, size / record.step
        return LinearModel(
            transition=transition,
            process=process,
            observation=np.concatenate([observation, bounded]),
            noise=np.array([*noise, *[reach**2 * _CORRELATED] * u]),
            drive=held,
            direct=np.concatenate(
                [
                    np.stack([row @ direct[kind] for row, kind in zip(rows, kinds, strict=True)]),
                    np.zeros((u, len(applied))),
                ]
            ),
            first=np.diag(np.square(10.0 * start)),
        )

    def _force_sizes(self, record: Record) -> Floats:
        """(U,) sizes of the forces of open links: what would give their ends the measured acceleration."""
        incidence = self.structure.incidence.toarray()[:, list(self.open)]
        mobility = np.einsum("il,il->l", incidence, incidence / self.structure.mass_values[:, None])
        x, v = self._sizes(record)
        return np.asarray(v**2 / max(x, np.finfo(float).tiny) / mobility)

    def _sizes(self, record: Record) -> tuple[float, float]:
        """Sizes of displacements and velocities, from the root mean squares and zero crossings of the channels."""
        x, v = [], []
        for name in _shown(record):
            values = record.channel(name)
            values = values[np.isfinite(values)]
            crossings = max(int(np.count_nonzero(np.diff(np.signbit(values - values.mean())))), 2)
            omega = np.pi * crossings * record.rate / len(values)
            order = "xva".index(Channel.parse(name).kind)
            size = float(np.sqrt(np.mean(values**2)))
            x.append(size / omega**order)
            v.append(size / omega ** (order - 1))
        return max(x), max(v)


def _linear_slopes(link: Link, *, mode: bool) -> tuple[float, float] | None:
    """Stiffness and damping of a link that is part of the linear system, None for another one."""
    coefficients = link.coefficients.values()
    if any(coefficient.value is None for coefficient in coefficients):
        if mode:
            missing = next(name for name, each in link.coefficients.items() if each.value is None)
            raise IdentificationError(
                f"no starting value for {link.name}.{missing}: state {{ start = ... }} for it in the structure"
            )
        return None
    if not mode and not all(coefficient.known for coefficient in coefficients):
        return None
    slopes = link.law.partials(0.0, 0.0, link.values) if not link.law.states else None
    if slopes is None or not _is_linear(link):
        return None
    return float(slopes.by_d), float(slopes.by_v)


def _is_linear(link: Link) -> bool:
    """Whether a law is linear in d and v."""
    return not any(set(symbols(differentiate(link.law.expression, name))) & {"d", "v"} for name in ("d", "v"))


def _shown(record: Record) -> list[str]:
    """Channels of motion."""
    return [name for name in record.responses if Channel.parse(name).kind in "xva"]


def _samples(record: Record, linear: _LinearPart) -> Floats:
    """(N, C + U) samples, and zeros that bound the elongations of open links."""
    shown = record.select(_shown(record)).values
    return np.concatenate([shown, np.zeros((len(record), len(linear.open)))], axis=1)


def _forced(record: Record) -> list[str]:
    return [name for name in record.inputs if Channel.parse(name).kind == "force"]


def _applied(record: Record, structure: Structure) -> Floats:
    """(r, n) parts of modes and masses in the applied forces."""
    rows = [structure.topology.row(Channel.parse(name).mass) for name in _forced(record)]
    return np.stack(rows) if rows else np.zeros((0, structure.size))


def _inputs(record: Record) -> Floats:
    """(N, r) applied forces."""
    columns = [record.channel(name) for name in _forced(record)]
    return np.stack(columns, axis=1) if columns else np.zeros((len(record), 0))


def _discrete(rates: Floats, drive: Floats, intensity: Floats, step: float) -> tuple[Floats, Floats, Floats]:
    """Transition, process covariance (by Van Loan's method) and effect of inputs over a step."""
    m, r = len(rates), drive.shape[1]
    held = np.zeros((m + r, m + r))
    held[:m, :m], held[:m, m:] = rates, drive
    whole = scipy.linalg.expm(held * step)
    scale = np.sqrt(np.maximum(intensity, 0.0))
    block = np.zeros((2 * m, 2 * m))
    block[:m, :m], block[:m, m:], block[m:, m:] = -rates, np.diag(scale**2), rates.T
    loaned = scipy.linalg.expm(block * step)
    transition = loaned[m:, m:].T
    process = transition @ loaned[:m, m:]
    return whole[:m, :m], 0.5 * (process + process.T), whole[:m, m:]
