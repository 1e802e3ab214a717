"""Errors of the shapes of hosts: what a mode that moves a point more than stated does to links, forces and sensors there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.fit import Optimum
from linkwise.likelihood.score_test import states_at_ends_and_middles
from linkwise.likelihood.shooting.flow import at_ends_and_middles
from linkwise.likelihood.shooting.residuals import Misfit
from linkwise.likelihood.shooting.sensor_errors import SensorErrors, motion_of
from linkwise.likelihood.shooting.tangent_forces import CandidateForces
from linkwise.model.names import SHAPE
from linkwise.model.structure import Structure
from linkwise.records.channel import Channel

_MOST = 60  # modes and points of which the shapes are tested


@dataclass(frozen=True, eq=False)
class ShapeErrors:
    """h relative errors of shapes: `places` (point, mode), and `weights` (c, h) of candidate `forces` and sensor `errors`."""

    places: tuple[tuple[str, str], ...]
    forces: CandidateForces
    errors: SensorErrors
    weights: Floats

    @classmethod
    def of(
        cls, optimum: Optimum, misfit: Misfit, structure: Structure, channels: Sequence[Channel]
    ) -> ShapeErrors | None:
        """The shapes at points with a link, a force or a sensor; None where there are none, or too many."""
        used = {end for link in structure.links for end in link.between}
        used |= {channel.place for channel in channels}
        parameter_names = optimum.segments.system.parameters.names
        places = [
            (point, mode, shape)
            for host in structure.hosts
            for point in host.points
            if point in used
            for mode, shape in host.shape(point).items()
            if shape and f"{mode}.{SHAPE}{point.removeprefix(f'{host.name}.')}" not in parameter_names
        ]
        if not 0 < len(places) <= _MOST:
            return None
        parts = _Parts.of(optimum, misfit, structure, channels)
        rows = [parts.candidate_forces(point, mode, shape) for point, mode, shape in places]
        shown = [parts.shown(point, mode, shape) for point, mode, shape in places]
        first, second, starts, middles = zip(*chain.from_iterable(rows), strict=True)
        sensors = list(chain.from_iterable(shown))
        empty = np.zeros((len(optimum.segments.samples), 0, optimum.segments.count))
        return cls(
            tuple((point, mode) for point, mode, _ in places),
            CandidateForces(np.array(first), np.array(second), np.stack(starts, 1), np.stack(middles, 1)),
            SensorErrors(
                np.array([channel for channel, _ in sensors], dtype=int),
                ("shape",) * len(sensors),
                np.full(len(sensors), -1),
                np.stack([values for _, values in sensors], 1) if sensors else empty,
            ),
            np.concatenate([_ownership(rows), _ownership(shown)]),
        )


def _ownership(parts: Sequence[Sequence[object]]) -> Floats:
    """(c, h) 1 where a column is one of those of a hypothesis."""
    owners = [number for number, members in enumerate(parts) for _ in members]
    return np.asarray(np.eye(len(parts))[owners])


CandidateForce = tuple[int, int, Floats, Floats]
"""Numbers of the places on which a force acts, negative on the first, and its values at ends and middles of steps."""


@dataclass(frozen=True, eq=False)
class _Parts:
    """Motion and forces along the fitted orbit, at the ends of steps and in their middles."""

    optimum: Optimum
    misfit: Misfit
    structure: Structure
    channels: Sequence[Channel]
    motion: tuple[Floats, Floats]
    slopes: tuple[tuple[Floats, Floats], ...]
    forces: tuple[Floats, ...]
    applied: dict[str, tuple[Floats, Floats]]

    @classmethod
    def of(
        cls, optimum: Optimum, misfit: Misfit, structure: Structure, channels: Sequence[Channel]
    ) -> _Parts:
        segments = optimum.segments
        stride = segments.flow_steps_per_tangent
        mechanics = segments.system.at(optimum.point.theta)
        orbit = misfit.trajectories.thinned(stride)
        motion = states_at_ends_and_middles(misfit.trajectories, stride, segments.step, segments.inputs)
        slopes, forces = [], []
        for links, memory in ((orbit.links, orbit.memory), (orbit.middle_links, orbit.middle_memory)):
            partials = mechanics.partials(links[:, 0], links[:, 1], memory)
            slopes.append((partials.by_d, partials.by_v))
            force = np.empty_like(links[:, 0])
            mechanics.force(links[:, 0], links[:, 1], memory, force, np.empty_like(memory))
            forces.append(force)
        applied: dict[str, tuple[Floats, Floats]] = {}
        forced = [channel.place for channel in channels if channel.is_force]
        if segments.inputs.force is not None and forced:
            rows = np.stack([structure.topology.row(name) for name in forced])
            known = np.linalg.pinv(rows.T)  # a few points by modes
            on_modes = segments.inputs.applied(mechanics, slice(None))
            for name, row in zip(forced, known, strict=True):
                at_place = np.einsum("n,jpnk->jpk", row, on_modes)
                applied[name] = at_ends_and_middles(at_place, stride)
        return cls(optimum, misfit, structure, channels, motion, tuple(slopes), tuple(forces), applied)

    def candidate_forces(self, point: str, mode: str, shape: float) -> list[CandidateForce]:
        """The forces that follow from a shape that is larger by its own size: one on the mode, and one of each link there."""
        topology, order = self.structure.topology, self.optimum.segments.system.order.tolist()
        place, number = topology.index[point], topology.index[mode]
        on_mode = [np.zeros_like(motion[:, 0, 0]) for motion in self.motion]
        if point in self.applied:
            on_mode = [shape * force for force in self.applied[point]]
        candidates: list[CandidateForce] = []
        for link, (first, second) in enumerate(topology.ends.tolist()):
            if place not in (first, second):
                continue
            part, column = (shape if first == place else -shape), order.index(link)
            change = [
                part * (by_d[:, column] * motion[:, 0, number] + by_v[:, column] * motion[:, 1, number])
                for (by_d, by_v), motion in zip(self.slopes, self.motion, strict=True)
            ]
            on_mode = [
                total - part * force[:, column] for total, force in zip(on_mode, self.forces, strict=True)
            ]
            candidates.append((first, second, change[0], change[1]))
        return [*candidates, (-1, number, on_mode[0], on_mode[1])]

    def shown(self, point: str, mode: str, shape: float) -> list[tuple[int, Floats]]:
        """What sensors at the point show more of."""
        segments, number = self.optimum.segments, self.structure.topology.index[mode]
        responses = [name for name in self.channels if not name.is_input]
        return [
            (
                channel,
                shape * motion_of(segments, self.misfit, int(segments.sensors.kind[channel]), number)[0],
            )
            for channel, name in enumerate(responses)
            if name.place == point
        ]
