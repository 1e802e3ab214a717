"""Starts of a structure with hosts by the difference of free runs from the records, by the method of Levenberg and Marquardt.

Free runs need neither the motion nor the forces of links, which a filter infers badly where modes are known badly. Several
starts are searched side by side: first the coefficients of the links alone, then all parameters from the best of them. What is
known of parameters beforehand weighs as one sample of what runs leave.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Bools, Floats, Indices
from linkwise.likelihood.starts.free_runs import FreeRuns
from linkwise.likelihood.starts.memory import Valley
from linkwise.model.structure import Structure
from linkwise.progress import Progress, ProgressReport
from linkwise.records.record import Record

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
