"""The tree of links that accelerations of masses determine: each link explains the force on the masses beyond it best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.discovery.candidates import Candidates
from linkwise.model.link import BASE, GROUND
from linkwise.records.channel import Channel
from linkwise.records.record import Record
from linkwise.signals.noise import channel_noise
from linkwise.signals.states import channel_motion

# of a force in a window, so that its samples are more than the series can follow whatever it is of
_PERIODS = 4.0
_SHORTEST = 16  # samples of a window
# by number of integrations, the degree of what is taken from an elongation before its powers
_LINE = (0, 0, 1)
_DRIFT = (0, 0, 2)  # the degree of what a force may have of the drift: noise that is integrated twice bends
_POWERS = 3  # of the elongation, as in the laws of most links


def tree_of_forces(records: Sequence[Record], candidates: Candidates) -> frozenset[str]:
    """All candidates on the links of a tree that joins every mass to a support, each of which explains its force best.

    All that acts on a leaf is the force of its link, which the acceleration gives, and that is a function of elongation and
    rate of this link and of no other. Without displacements the elongation is known up to a constant, or a line, in each short
    window; a power series about its mean there has coefficients of its own, so that no constant is needed. The link that
    explains its force best is taken first; its force acts on the mass at its other end, whose links are tested anew.

    Empty where a mass is unknown or has no sensor, or links are stated: forces of links do not follow from accelerations then.
    """
    names = [mass.name for mass in candidates.masses]
    unknown = any(mass.mass.value is None for mass in candidates.masses)
    stated = any(pair.stated for pair in candidates.pairs)
    if unknown or stated or not all(record.motions_of(name) for record in records for name in names):
        return frozenset()
    supports = [end for end in (GROUND, BASE) if any(end in pair.between for pair in candidates.pairs)]
    motions = [_Motions.of(record, candidates, supports) for record in records]
    number = {end: place for place, end in enumerate([*names, *supports])}
    every = enumerate(candidates.pairs)
    pairs = {frozenset(number[end] for end in pair.between): place for place, pair in every}
    parents = _parents(motions, len(names), frozenset(pairs))
    chosen = {pairs[frozenset(ends)] for ends in parents.items()}
    return candidates.on_pairs(chosen)


@dataclass(frozen=True, eq=False)
class _Motions:
    """Of n masses and, after them, supports: `x` and `v` (n + s, N), integrated `order` (n + s,) times, and `force` (n, N).

    The latter is what all links of a mass must give.
    """

    x: Floats
    v: Floats
    force: Floats
    order: Indices
    rate: float

    @classmethod
    def of(cls, record: Record, candidates: Candidates, supports: Sequence[str]) -> _Motions:
        sigma, masses = channel_noise(record), candidates.masses
        sensors = [record.motions_of(mass.name)[0] for mass in masses]
        x, v, a = np.stack([channel_motion(record, sensor, sigma[sensor]) for sensor in sensors], axis=1)
        acting = {name: record.channel(name) for name in record.forces}
        applied = np.stack(
            [acting.get(Channel("force", mass.name), np.zeros(len(record))) for mass in masses]
        )
        fixed = np.zeros((len(supports), len(record)))
        for place, support in enumerate(supports):
            if support == BASE and f"x:{BASE}" in record.channels:
                fixed[place] = record.channel(f"x:{BASE}")
        inertia = np.array([mass.mass.value or 0.0 for mass in masses])[:, None]
        order = np.array([*(sensor.order for sensor in sensors), *(0 for _ in supports)])
        rates = np.gradient(fixed, record.step, axis=1)
        return cls(np.vstack([x, fixed]), np.vstack([v, rates]), inertia * a - applied, order, record.rate)

    def unexplained(self, mass: int, end: int, forces: Floats) -> tuple[float, float]:
        """The power of the force of a mass that no link to another place explains, and all of it."""
        force = forces[mass]
        length = _window(force, self.rate)
        count = len(force) // length
        x, rate = self.x[mass] - self.x[end], self.v[mass] - self.v[end]
        d, v, force = (part[: count * length].reshape(count, length) for part in (x, rate, force))
        time = np.linspace(-1.0, 1.0, length)
        order = int(max(self.order[mass], self.order[end]))
        drift = np.polynomial.legendre.legvander(time, _DRIFT[order])
        drift /= np.linalg.norm(drift, axis=0)
        known = drift[:, : _LINE[order] + 1]
        d = d - d @ known @ known.T
        series = [d**power for power in range(1, _POWERS + 1)]
        columns = [*series, v, *(np.broadcast_to(part, d.shape) for part in drift.T)]
        basis = np.stack(columns, axis=2)
        size = np.sqrt(np.einsum("ktc,ktc->kc", basis, basis))
        q, _ = np.linalg.qr(basis / np.where(size > 0.0, size, 1.0)[:, None])
        left = force - np.einsum("ktc,kc->kt", q, np.einsum("ktc,kt->kc", q, force))
        return float(np.sum(left**2)), float(np.sum(force**2))


def _window(force: Floats, rate: float) -> int:
    """Samples of a window over some periods of a force, at the frequency below which half of its power lies."""
    power = np.cumsum(np.abs(np.fft.rfft(force - force.mean())) ** 2)
    median = max(int(np.searchsorted(power, 0.5 * power[-1])), 1)  # periods in the record
    return int(np.clip(round(_PERIODS * len(force) / median), min(_SHORTEST, len(force)), len(force)))


def _parents(motions: Sequence[_Motions], masses: int, allowed: frozenset[frozenset[int]]) -> dict[int, int]:
    """For each of n masses the place that its link leads to, on its way to a support; supports are numbered from n on.

    Empty where no link is `allowed` to a mass.
    """
    forces = [motion.force.copy() for motion in motions]
    parents: dict[int, int] = {}
    ratios: dict[tuple[int, int], float] = {}  # the part of the force of a mass that a link to a place leaves
    changed = list(range(masses))
    while len(parents) < masses:
        for mass in changed:
            for end in range(len(motions[0].x)):
                if frozenset((mass, end)) in allowed and mass != end:
                    pairs = zip(motions, forces, strict=True)
                    parts = [motion.unexplained(mass, end, force) for motion, force in pairs]
                    left, whole = np.sum(parts, axis=0)
                    ratios[mass, end] = left / max(whole, np.finfo(float).tiny)
        left_over = [pair for pair in ratios if pair[0] not in parents]
        possible = [pair for pair in left_over if pair[0] not in _way(pair[1], parents)]
        if not possible:
            return {}
        mass, end = min(possible, key=lambda pair: ratios[pair])
        parents[mass] = end
        below = [place for place in _way(end, parents) if place < masses]
        for force in forces:
            force[below] += force[mass]
        changed = [place for place in below if place not in parents]
    return parents


def _way(place: int, parents: dict[int, int]) -> list[int]:
    """The place and all that follow on its way to a support, as far as it is known."""
    way = [place]
    while way[-1] in parents:
        way.append(parents[way[-1]])
    return way
