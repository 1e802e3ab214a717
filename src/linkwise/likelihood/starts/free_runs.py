"""Free runs of a structure with hosts for many values of its parameters, side by side.

Modes and links that are linear move exactly from step to step (exponential integration); forces of others and applied ones
change linearly between, by a step of the method of Heun. That is exact enough to choose starts. Each run begins at rest: what
a free motion of the linear part may explain of the difference from the record is left out.

References
----------
M. Hochbruck and A. Ostermann, Acta Numerica 19, 209 (2010).

Starts of a structure with hosts by the difference of free runs from the records, by the method of Levenberg and Marquardt.

Free runs need neither the motion nor the forces of links, which a filter infers badly where modes are known badly. Several
starts are searched side by side: first the coefficients of the links alone, then all parameters from the best of them. What is
known of parameters beforehand weighs as one sample of what runs leave.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy

from linkwise.arrays import Bools, Floats, Indices
from linkwise.likelihood.starts.linear_part import LinearPart
from linkwise.likelihood.starts.memory import Valley
from linkwise.model.law import Law
from linkwise.model.structure import Structure
from linkwise.progress import Progress, ProgressReport
from linkwise.records.channel import Channel
from linkwise.records.record import Record

_MOST_SAMPLES = 8192  # of a record that is run
_PER_PERIOD = 12  # steps in the shortest period that matters
_IN_BAND = 0.95  # of the power of the responses lies below that frequency
_FREE = 1e-8  # relative size of a free motion that is another one than those before
_RUN_AWAY = 1e3  # times the size of the record: relative difference of a run that left the numbers


class _Steps(NamedTuple):
    """Systems of B values of the parameters with u open links and r forces, in steps.

    `advance` (B, 2n + 2r + u, 2n) leads states, applied forces before and after, and forces of links before over a step;
    those after add `late` (B, u, 2n). `motion` (B, 2n, 2u) gives elongations and rates of open links from states, `shown`
    (B, 2n + r + u, C) the channels from states, applied forces and forces of links.
    """

    advance: Floats
    late: Floats
    motion: Floats
    shown: Floats


class _Moment(NamedTuple):
    """A sample of runs: channels (B, R, C), states of coordinates (B, R, 2n), and those of links, each (B, R)."""

    shown: Floats
    states: Floats
    inner: list[Floats]


@dataclass(frozen=True, eq=False)
class FreeRuns:
    """Runs of a structure along its records, which have the same channels.

    Free motions that are left out are those with the values `linear` (p,) of the parameters.
    """

    structure: Structure
    records: tuple[Record, ...]
    linear: Floats

    @classmethod
    def of(cls, records: Sequence[Record], structure: Structure, linear: Floats) -> FreeRuns:
        """Along the first samples of records."""
        count = min(_MOST_SAMPLES, *(len(record) for record in records))
        return cls(structure, tuple(record[:count] for record in records), linear)

    def differences(self, theta: Floats) -> Floats:
        """Of each of B values (B, p), (B, R N C) channels of free runs less the records, relative to these.

        The sum of squares is the mean over channels and records of the part of their power that a run leaves.
        """
        with np.errstate(all="ignore"):
            shown = self._run(theta)
            difference = np.where(self._known, (shown - self._measured) * self._weights, 0.0)
        size = difference[0].size
        gone = ~(np.abs(difference).reshape(len(theta), -1).max(axis=1) < _RUN_AWAY)
        difference[gone] = _RUN_AWAY / np.sqrt(size)
        for number, free in enumerate(self._free_motions):
            rows = difference[:, number].reshape(len(theta), -1)
            difference[:, number] -= ((rows @ free) @ free.T).reshape(difference[:, number].shape)
        return difference.reshape(len(theta), -1)

    @property
    def samples(self) -> int:
        """Number of samples of all channels."""
        return int(self._known.sum())

    @cached_property
    def _channels(self) -> tuple[Channel, ...]:
        return self.records[0].motions

    @cached_property
    def _forced(self) -> tuple[Channel, ...]:
        return self.records[0].forces

    @cached_property
    def _raw(self) -> Floats:
        """(R, N, C) samples."""
        return np.stack([record.select(self._channels).values for record in self.records])

    @cached_property
    def _known(self) -> Bools:
        return np.asarray(np.isfinite(self._raw))

    @cached_property
    def _measured(self) -> Floats:
        return np.where(self._known, self._raw, 0.0)

    @cached_property
    def _weights(self) -> Floats:
        """(R, 1, C) that make the sum of squares of each channel 1, and that of all."""
        power = np.sum(self._measured**2, axis=1, keepdims=True)
        return np.asarray(1.0 / np.sqrt(np.maximum(power, np.finfo(float).tiny) * power.size))

    @cached_property
    def _finer(self) -> int:
        """Steps a sample."""
        power = np.sum(
            np.abs(np.fft.rfft(self._measured, axis=1)[:, 1:]) ** 2 * self._weights**2, axis=(0, 2)
        )
        inside = np.searchsorted(np.cumsum(power), _IN_BAND * power.sum()) + 1
        shortest = self._measured.shape[1] / inside  # samples
        return int(np.clip(np.ceil(_PER_PERIOD / shortest), 1, _PER_PERIOD))

    @cached_property
    def _applied(self) -> Floats:
        """(R, S N - S + 1, r) applied forces at each step."""
        forces = np.stack([[record.channel(name) for name in self._forced] for record in self.records])
        count = forces.shape[2]
        times = np.arange(self._finer * (count - 1) + 1) / self._finer
        spline = scipy.interpolate.CubicSpline(np.arange(count), forces, axis=2)
        return np.asarray(spline(times).transpose(0, 2, 1))

    def _valued(self, theta: Floats) -> Structure:
        values: dict[str, float] = dict(
            zip((p.name for p in self.structure.parameters), map(float, theta), strict=True)
        )
        return self.structure.with_values(values)

    def _linear(self, valued: Structure) -> tuple[LinearPart, Floats, Floats, Floats]:
        """The linear part, its rates (2n, 2n), and what forces (r) and open links (u) drive (2n, r + u)."""
        part, n, masses = LinearPart.of(valued), valued.size, valued.mass_values[:, None]
        rates = np.zeros((2 * n, 2 * n))
        rates[:n, n:] = np.eye(n)
        rates[n:, :n], rates[n:, n:] = -part.stiffness / masses, -part.damping / masses
        incidence = valued.incidence.toarray()[:, list(part.open)]
        applied = [valued.topology.row(name.place) for name in self._forced]
        drive = np.zeros((2 * n, len(applied) + len(part.open)))
        drive[n:] = np.concatenate([np.reshape(applied, (-1, n)).T, -incidence], axis=1) / masses
        rows = np.stack([valued.topology.row(name.place) for name in self._channels])
        return part, rates, drive, rows

    def _shown(self, rates: Floats, drive: Floats, rows: Floats) -> Floats:
        """(2n + r + u, C) channels by states and forces."""
        n, whole = rows.shape[1], np.concatenate([rates, drive], axis=1)
        kinds = [channel.order for channel in self._channels]
        by_kind = [np.eye(2 * n, whole.shape[1])[:n], np.eye(2 * n, whole.shape[1])[n:], whole[n:]]
        return np.stack([row @ by_kind[kind] for row, kind in zip(rows, kinds, strict=True)], axis=1)

    def _steps(self, valued: Sequence[Structure]) -> _Steps:
        """Systems in steps, with forces that change linearly over each."""
        advance, late, motion, shown = [], [], [], []
        step = self.records[0].step / self._finer
        for structure in valued:
            part, rates, drive, rows = self._linear(structure)
            m, r = len(rates), len(self._forced)
            width = drive.shape[1]
            whole = np.zeros((m + 2 * width, m + 2 * width))
            whole[:m, :m], whole[:m, m : m + width] = rates * step, drive * step
            whole[m : m + width, m + width :] = np.eye(width)
            effect = scipy.linalg.expm(whole)[:m].T
            before, after = effect[m : m + width] - effect[m + width :], effect[m + width :]
            advance.append(np.concatenate([effect[:m], before[:r], after[:r], before[r:]]))
            late.append(after[r:])
            incidence = structure.incidence.toarray()[:, list(part.open)]
            motion.append(scipy.linalg.block_diag(incidence, incidence))
            shown.append(self._shown(rates, drive, rows))
        return _Steps(*(np.stack(matrices) for matrices in (advance, late, motion, shown)))

    def states(self, theta: Floats) -> list[Floats]:
        """Of each record the states (2n + S, N), as in `System.states`, of a run from rest with values (p,)."""
        valued = self._valued(theta)
        places = {member: row for row, member in enumerate(_members(valued))}
        order = [
            places[number, name]
            for law, numbers in valued.topology.by_law
            for name in law.states
            for number in numbers.tolist()
        ]
        motion = [
            np.concatenate([moment.states[0], np.stack(moment.inner, axis=2)[0][:, order]], axis=1)
            if order
            else moment.states[0]
            for moment in self._moments(theta[None])
        ]
        return list(np.stack(motion, axis=2))

    def _run(self, theta: Floats) -> Floats:
        """(B, R, N, C) channels of free runs from rest."""
        return np.stack([moment.shown for moment in self._moments(theta)], axis=2)

    def _moments(self, theta: Floats) -> Iterator[_Moment]:
        """Free runs from rest, sample by sample."""
        valued = [self._valued(values) for values in theta]
        steps = self._steps(valued)
        links = _OpenLinks.of(valued, LinearPart.of(valued[0]).open)
        applied, finer = self._applied, self._finer
        batch, runs, size = len(theta), len(self.records), steps.advance.shape[2]
        states, inner = np.zeros((batch, runs, size)), links.at_rest(batch, runs)
        step = self.records[0].step / finer
        forces, rates = links.forces(states @ steps.motion, inner)
        both = np.broadcast_to(applied[None], (batch, *applied.shape))
        for number in range(applied.shape[1]):
            present = both[:, :, number]
            if number % finer == 0:
                yield _Moment(np.concatenate([states, present, forces], axis=2) @ steps.shown, states, inner)
            if number + 1 == applied.shape[1]:
                break
            moved = np.concatenate([states, present, both[:, :, number + 1], forces], axis=2) @ steps.advance
            ahead = [state + step * rate for state, rate in zip(inner, rates, strict=True)]
            predicted, rates_ahead = links.forces((moved + forces @ steps.late) @ steps.motion, ahead)
            states = moved + predicted @ steps.late
            inner = [
                state + 0.5 * step * (rate + late)
                for state, rate, late in zip(inner, rates, rates_ahead, strict=True)
            ]
            forces, rates = links.forces(states @ steps.motion, inner)

    @cached_property
    def _free_motions(self) -> list[Floats]:
        """Of each record orthonormal free motions (N C, k) of the linear part, weighted as differences are."""
        _, rates, drive, rows = self._linear(self._valued(self.linear))
        shown = self._shown(rates, drive, rows)[: len(rates)]
        transition = scipy.linalg.expm(rates.T * self.records[0].step)
        states, motions = np.eye(len(rates)), np.empty((self._measured.shape[1], len(rates), shown.shape[1]))
        for number in range(len(motions)):
            motions[number] = states @ shown
            states = states @ transition
        bases = []
        for weights, known in zip(self._weights, self._known, strict=True):
            columns = (
                np.where(known[:, None, :], motions * weights, 0.0).transpose(0, 2, 1).reshape(-1, len(rates))
            )
            norms = np.linalg.norm(columns, axis=0)
            basis, sizes, _ = np.linalg.svd(columns / np.where(norms > 0.0, norms, 1.0), full_matrices=False)
            bases.append(basis[:, sizes > _FREE * sizes[0]])
        return bases


def _members(valued: Structure) -> list[tuple[int, str]]:
    """Open links and their states, in the order of runs."""
    numbers = LinearPart.of(valued).open
    return [(number, name) for number in numbers for name in valued.links[number].law.states]


class _OpenLink(NamedTuple):
    law: Law
    values: dict[str, Floats]


@dataclass(frozen=True, eq=False)
class _OpenLinks:
    """Links whose forces are not linear, with coefficients (B, 1)."""

    links: tuple[_OpenLink, ...]

    @classmethod
    def of(cls, valued: Sequence[Structure], numbers: Sequence[int]) -> _OpenLinks:
        return cls(
            tuple(
                _OpenLink(
                    valued[0].links[number].law,
                    {
                        name: np.array([structure.links[number].values[name] for structure in valued])[
                            :, None
                        ]
                        for name in valued[0].links[number].coefficients
                    },
                )
                for number in numbers
            )
        )

    def at_rest(self, batch: int, runs: int) -> list[Floats]:
        return [np.zeros((batch, runs)) for link in self.links for _ in link.law.states]

    def forces(self, motion: Floats, inner: Sequence[Floats]) -> tuple[Floats, list[Floats]]:
        """Forces (B, R, u), and rates of states, from elongations and rates (B, R, 2u) and states."""
        count = len(self.links)
        forces = np.empty((*motion.shape[:2], count))
        rates: list[Floats] = []
        first = 0
        for number, link in enumerate(self.links):
            d, v = motion[..., number], motion[..., count + number]
            states = inner[first : first + len(link.law.states)]
            first += len(states)
            values = link.values | dict(zip(link.law.states, states, strict=True))
            forces[..., number] = link.law.force(d, v, values)
            if states:
                rates += link.law.state_rates(d, v, values)
        return forces, rates


_LINKS_FROM, _ALL_FROM = 6, 2  # starts of a search in the coefficients of links, and in all parameters
_STEPS = 15  # of each, at most
_ENDS = 3e-3  # relative gain below which a search ends
_SAME, _HARDLY_MORE = 0.02, 2.0  # of what another start leaves
_NUDGE = 1e-3  # of the unit of a parameter
_PART = 0.1  # of a value that is known beforehand, the most that its unit is
_MARGIN = 0.02  # of the room between two bounds, next to them
_TRIED = (0.01, 1.0, 100.0)  # factors on the damping of a step, side by side
_DEPENDENT = 4.0  # samples that say as much as one
_FIRST_DAMPING, _LARGEST_DAMPING = 1e-2, 1e3


def free_run_starts(
    records: Sequence[Record],
    structure: Structure,
    given: Mapping[str, float],
    valleys: Sequence[Valley],
    progress: Progress,
) -> tuple[Valley, ...]:
    """Starts whose free runs come closest to the records.

    Parameters
    ----------
    records : sequence of Record
        The records, with the same channels.
    structure : Structure
        The structure, with a host.
    given : mapping of str to float
        Starting values by name of the parameter.
    valleys : sequence of Valley
        Starts of the search, such as those by forces of links.
    progress : Progress
        Called at every step.

    Returns
    -------
    tuple of Valley
        The minima, the lowest first, whose misfits are parts in power of the records that free runs leave; none where records
        of different rates, or without applied forces, are not followed by runs from rest.
    """
    forced = all(record.forces for record in records)
    if not forced or len({record.rate for record in records}) > 1:
        return ()
    search = FreeRunSearch.of(FreeRuns.of(records, structure, valleys[0].values), given, valleys)
    of_links = search.refined(search.best(_LINKS_FROM), ~search.of_hosts, progress)
    of_all = search.refined(
        _distinct(of_links, search.left(of_links)), np.ones(len(search.units), bool), progress
    )
    left = search.left(of_all)
    return tuple(Valley(of_all[k], float(left[k])) for k in np.argsort(left).tolist())


def _distinct(starts: Floats, left: Floats) -> Floats:
    """The best of starts, that first, and others that leave another part, but hardly more."""
    chosen = [0]
    for number in range(1, len(starts)):
        apart = all(abs(left[number] - left[earlier]) > _SAME * left[earlier] for earlier in chosen)
        if apart and left[number] < _HARDLY_MORE * left[0]:
            chosen.append(number)
    return starts[chosen[:_ALL_FROM]]


@dataclass(frozen=True, eq=False)
class FreeRunSearch:
    """A search from `starts` (M, p) in parameters of some `units` (p,).

    They are known beforehand to be near `centre` to within `sigma` (p,), infinite for the others; `of_hosts` (p,) says which
    are of modes, and they lie between `low` and `high`.
    """

    runs: FreeRuns
    starts: Floats
    units: Floats
    centre: Floats
    sigma: Floats
    of_hosts: Bools
    low: Floats
    high: Floats

    @classmethod
    def of(cls, runs: FreeRuns, given: Mapping[str, float], valleys: Sequence[Valley]) -> FreeRunSearch:
        """From valleys, each also with modes as they are known beforehand."""
        parameters = runs.structure.parameters
        links = {link.name for link in runs.structure.links} - set(runs.structure.mass_names)
        of_hosts = np.array(
            [not any(p.name.startswith(f"{link}.") for link in links) for p in parameters], dtype=bool
        )
        stated = [given.get(p.name, p.start) for p in parameters]
        starts = np.array([valley.values for valley in valleys])
        centre = np.array(
            [first if value is None else value for value, first in zip(stated, starts[0], strict=True)]
        )
        as_known = np.where(of_hosts, centre, starts)
        starts = np.concatenate([starts, as_known]) if of_hosts.any() else starts
        sigma = np.array([p.sigma for p in parameters])
        sizes = np.maximum(np.abs(starts).mean(axis=0), np.finfo(float).tiny)
        units = np.where(np.isfinite(sigma), np.minimum(sigma, _PART * sizes + _NUDGE * sigma), sizes)
        low, high = np.array([[p.lower, p.upper] for p in parameters]).T
        margin = np.where(np.isfinite(high - low), _MARGIN * (high - low), 0.0)
        return cls(runs, starts, units, centre, sigma, of_hosts, low + margin, high - margin)

    def left(self, theta: Floats) -> Floats:
        """(B,) parts in power of the records that free runs leave."""
        return np.asarray(np.sum(self.runs.differences(theta) ** 2, axis=1))

    def best(self, count: int) -> Floats:
        """The starts whose free runs leave least, (count, p) at most."""
        return self.starts[np.argsort(self.left(self.starts), kind="stable")[:count]]

    def refined(self, starts: Floats, free: Bools, progress: Progress) -> Floats:
        """Minima near starts (M, p) in `free` parameters (p,), the lowest first."""
        best, damping = starts.copy(), np.full(len(starts), _FIRST_DAMPING)
        left, numbers = self.runs.differences(best), np.flatnonzero(free)
        slopes = self._slopes(best, left, numbers)
        active, moved = np.arange(len(best)), np.zeros(len(best), dtype=bool)
        for step in range(_STEPS):
            progress(
                ProgressReport(
                    step / _STEPS, f"free runs leave {np.sqrt(np.min(np.sum(left**2, axis=1))):.1%}"
                )
            )
            if moved.any():
                slopes[moved] = self._slopes(best[moved], left[moved], numbers)
            tried = np.array(
                [
                    self._step(best[k], left[k], slopes[k], numbers, factor * damping[k])
                    for k in active
                    for factor in _TRIED
                ]
            )
            rows, gains = self.runs.differences(tried), np.zeros(len(best))
            moved[:] = False
            for place, k in enumerate(active.tolist()):
                ends = range(place * len(_TRIED), (place + 1) * len(_TRIED))
                weight = self._weight(left[k])
                costs = [self._cost(tried[end], rows[end], numbers, weight) for end in ends]
                lowest = int(np.argmin(costs))
                gains[k] = 1.0 - costs[lowest] / self._cost(best[k], left[k], numbers, weight)
                moved[k] = gains[k] > 0.0
                damping[k] *= _TRIED[lowest] if moved[k] else _TRIED[-1] ** 2
                if moved[k]:
                    best[k], left[k] = tried[ends[lowest]], rows[ends[lowest]]
            again = ~moved & (damping < _LARGEST_DAMPING)
            active = active[((gains > _ENDS) | again)[active]]
            if not len(active):
                break
            moved &= gains > _ENDS
        return best[np.argsort(np.sum(left**2, axis=1), kind="stable")]

    def _weight(self, left: Floats) -> float:
        """The power that one sample leaves, of which several say as much as one."""
        return float(left @ left) / self.runs.samples * _DEPENDENT

    def _cost(self, theta: Floats, left: Floats, numbers: Indices, weight: float) -> float:
        off = (theta - self.centre)[numbers] / self.sigma[numbers]
        return float(left @ left + weight * off @ off)

    def _slopes(self, theta: Floats, left: Floats, numbers: Indices) -> Floats:
        """(M, q, R) derivatives of differences (M, R) by parameters in their units."""
        nudge = np.where(theta + _NUDGE * self.units > self.high, -_NUDGE, _NUDGE)  # (M, p)
        points = theta[:, None] + (nudge * self.units)[:, None] * np.eye(theta.shape[1])[numbers]
        around = self.runs.differences(points.reshape(-1, theta.shape[1])).reshape(*points.shape[:2], -1)
        return np.asarray((around - left[:, None]) / nudge[:, numbers, None])

    def _step(self, theta: Floats, left: Floats, slopes: Floats, numbers: Indices, damping: float) -> Floats:
        """Where a damped step leads."""
        units, weight = self.units[numbers], self._weight(left)
        known = weight * (units / self.sigma[numbers]) ** 2
        curvature = slopes @ slopes.T + np.diag(known)
        slope = slopes @ left + known * (theta - self.centre)[numbers] / units
        scale = np.sqrt(np.maximum(curvature.diagonal(), np.finfo(float).tiny))
        matrix = curvature / np.outer(scale, scale) + damping * np.eye(len(scale))
        moved = theta.copy()
        moved[numbers] -= np.linalg.solve(matrix, slope / scale) / scale * units
        return np.clip(moved, self.low, self.high)
