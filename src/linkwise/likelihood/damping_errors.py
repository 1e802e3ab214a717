"""Damping between modes that a host lacks: an entry of its modal damping matrix, whose force on each mode follows the other.

Damping ratios leave out what a damper at one place of a host adds between its modes (Caughey and O'Kelly, J. Appl. Mech. 32,
1965). It matters where modes are near each other, and there it looks like the damper of a link.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.fit import Optimum
from linkwise.likelihood.score_test import states_at_ends_and_middles
from linkwise.likelihood.shooting.residuals import Misfit
from linkwise.likelihood.shooting.tangent_forces import CandidateForces
from linkwise.model.host import DAMPING, Host, Pair, damping_link
from linkwise.model.link import GROUND
from linkwise.model.structure import Structure

_MOST = 30  # pairs of modes that are tested, the nearest ones


@dataclass(frozen=True, eq=False)
class DampingErrors:
    """Damping between h pairs of modes: `links` that would hold it, as named in a structure, and its `forces`.

    Each pair has two of these in a row, one on each of its modes, in scaled sizes of which `units` (h,) are in N s/m.
    """

    links: tuple[str, ...]
    forces: CandidateForces
    units: Floats

    @classmethod
    def of(cls, optimum: Optimum, misfit: Misfit, structure: Structure) -> DampingErrors | None:
        """Of pairs whose damping is not estimated, the nearest modes first; None without any."""
        nearest = nearest_pairs(structure, optimum.segments.system.parameters.names)
        if not nearest:
            return None
        segments, index = optimum.segments, structure.topology.index
        modes = np.array(
            [[index[host.coordinates[number - 1]] for number in pair] for host, pair in nearest], dtype=int
        )
        motion = states_at_ends_and_middles(
            misfit.trajectories, segments.flow_steps_per_tangent, segments.step, segments.inputs
        )
        starts, middles = (part[:, 1, modes[:, ::-1]] for part in motion)  # each mode feels the other's rate
        power = np.mean(np.square(starts), axis=(0, 2, 3))
        units = 1.0 / np.sqrt(np.where(power > 0.0, power, 1.0))
        starts, middles = (
            (part * units[:, None, None]).reshape(len(part), -1, part.shape[-1]) for part in (starts, middles)
        )
        forces = CandidateForces(modes.ravel(), np.full(modes.size, index[GROUND]), starts, middles)
        return cls(tuple(damping_link(host.name, pair) for host, pair in nearest), forces, units)

    @property
    def weights(self) -> Floats:
        """(2 h, h) 1 where a force is one of those of a pair."""
        return np.repeat(np.eye(len(self.links)), 2, axis=0)


def nearest_pairs(structure: Structure, estimated: Collection[str] = ()) -> list[tuple[Host, Pair]]:
    """Pairs of modes of a host whose damping is not among the coefficients `estimated`, the nearest first; 30 at most."""
    pairs = [
        (host, pair)
        for host in structure.hosts
        for pair in combinations(range(1, len(host.modes) + 1), 2)
        if f"{damping_link(host.name, pair)}.{DAMPING}" not in estimated
    ]
    return sorted(pairs, key=lambda place: _distance(*place))[:_MOST]


def largest_damping(structure: Structure) -> dict[str, float]:
    """The largest damping in N s/m between two modes that dissipates, by the link that would hold it.

    It is the geometric mean of the damping of the two: a larger one would feed energy into a motion of both.
    """
    largest = {}
    for host in structure.hosts:
        entries = {first: entry.value for (first, second), entry in host.entries.items() if first == second}
        own = [
            4.0 * np.pi * (mode.frequency.value or 0.0) * (mode.damping.value or 0.0)
            + (entries.get(number) or 0.0)
            for number, mode in enumerate(host.modes, 1)
        ]
        for first, second in combinations(range(1, len(own) + 1), 2):
            product = max(own[first - 1], 0.0) * max(own[second - 1], 0.0)
            largest[damping_link(host.name, (first, second))] = float(np.sqrt(product))
    return largest


def _distance(host: Host, pair: Pair) -> float:
    """How far apart two modes are: the difference of their frequencies relative to the sum."""
    first, second = (host.modes[number - 1].frequency.value or 0.0 for number in pair)
    return abs(first - second) / max(first + second, np.finfo(float).tiny)
