"""Whitened Jacobian of multiple shooting, group by group of columns, each along the part of the structure that it reaches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Floats, Indices
from linkwise.likelihood.shooting.loss import Loss
from linkwise.likelihood.shooting.neighbourhoods import Neighbourhood
from linkwise.likelihood.shooting.residuals import Misfit
from linkwise.likelihood.shooting.segments import A, F, S, Scales, Segments, V, X
from linkwise.likelihood.shooting.sensor_errors import SensorErrors
from linkwise.likelihood.shooting.system import NumericSystem
from linkwise.likelihood.shooting.tangent_forces import CandidateForces, Single, TangentForces
from linkwise.likelihood.shooting.tangents import Transfer, march, tangent_forces


@dataclass(frozen=True, eq=False)
class GroupRows:
    """Of k segments and a group of P columns: whitened `data` (k, C, M, P) of the group's channels, and `ends` (k, r, P'), the
    sensitivities of the group's rows at the segments' ends to the moving columns, both in scaled unknowns.
    """

    data: Single
    ends: Single


@dataclass(frozen=True, eq=False)
class LocalRows:
    """The Jacobian at a point, in `groups` of columns.

    The border's columns are parameters, amplitudes of `candidates`, sizes of `errors`, and offsets; `groups` have as moving
    ones the first two.
    """

    segments: Segments
    misfit: Misfit
    scales: Scales
    loss: Loss
    groups: Sequence[Neighbourhood]
    candidates: CandidateForces | None = None
    errors: SensorErrors | None = None

    @property
    def moving(self) -> int:
        """Columns of the border that act on the motion, which come first."""
        forces = 0 if self.candidates is None else len(self.candidates.first)
        return self.segments.system.parameters.size + forces

    @property
    def fixed(self) -> int:
        """Columns before those of offsets."""
        return self.moving + (0 if self.errors is None else len(self.errors.channel))

    def part(self, part: slice) -> tuple[list[GroupRows], Floats]:
        """The rows of some segments by group, and the whitened residuals (k, C, M)."""
        segments, misfit = self.segments, self.misfit
        root = misfit.roots(segments, self.loss, part)
        whiten = (root / self.scales.sigma[:, None]).astype(np.float32)
        if segments.relative_noise is not None:
            whiten /= segments.relative_noise[:, part].astype(np.float32)
        mechanics = segments.system.at(misfit.point.theta)
        step = segments.step[part] * segments.flow_steps_per_tangent
        orbit = misfit.trajectories.part(part).thinned(segments.flow_steps_per_tangent)
        candidates = None if self.candidates is None else self.candidates.part(part)
        unit = self.scales.theta[: segments.system.parameters.size]
        inputs = segments.inputs.part(part)
        forces = tangent_forces(mechanics, orbit, step, unit, candidates, inputs=inputs)
        rows = [self._of_group(group, mechanics, forces, part, step, whiten) for group in self.groups]
        return rows, (root * misfit.pulling[..., part]).transpose(2, 1, 0)

    def _of_group(
        self,
        group: Neighbourhood,
        mechanics: NumericSystem,
        forces: tuple[TangentForces, TangentForces],
        part: slice,
        step: Floats,
        whiten: Single,
    ) -> GroupRows:
        segments, m = self.segments, len(self.scales.state)
        width = group.moving
        columns = np.concatenate([group.states, m + group.border])[:width]
        M = len(segments.samples)
        data: NDArray[Any] = np.zeros((len(step), len(group.channels), M, group.size), np.float32)
        ends: NDArray[Any] = np.zeros((len(step), len(group.rows), width), np.float32)
        if width:
            starts, middles = (
                force.within(group.masses, group.links, group.memory, columns) for force in forces
            )
            steps = march(_transfer(mechanics, group), starts, middles, *self._units(group, step, width))
            shown = self._shown_by(group, step)
            for number, tangent in enumerate(steps):
                sample, between = divmod(number, segments.tangent_refine)
                if tangent.acceleration is None or between:
                    continue
                motions = tangent.shown()
                for kind, places, channels, rate in shown:
                    factor = (whiten[sample, group.channels[channels]] * rate).astype(np.float32)
                    data[:, channels, sample, :width] = (motions[kind][places] * factor[:, None]).transpose(
                        2, 0, 1
                    )
            r, rate = len(group.masses), (1.0 / step).astype(np.float32)
            ends[:, :r] = tangent.state[0].transpose(2, 0, 1)
            ends[:, r : 2 * r] = (tangent.state[1] * rate).transpose(2, 0, 1)
            ends[:, 2 * r :] = tangent.memory.transpose(2, 0, 1)
            ends /= self.scales.state[group.rows, None].astype(np.float32)
        self._add_errors(data, group, part, whiten)
        return GroupRows(data, ends)

    def _shown_by(
        self, group: Neighbourhood, step: Floats
    ) -> list[tuple[int, Indices | slice, Indices | slice, Floats]]:
        """By kind of sensor, the places that those of a group show, their places among its channels, and the factor (k,)."""
        sensors = self.segments.sensors
        kinds, numbers = sensors.kind[group.channels], sensors.mass[group.channels]
        rates = {X: np.ones_like(step), V: 1.0 / step, A: step**-2.0, F: step**-2.0, S: np.ones_like(step)}
        among = {F: group.links, S: group.memory}
        return [
            (
                kind,
                as_slice(np.searchsorted(among.get(kind, group.masses), numbers[own])),
                as_slice(own),
                rate,
            )
            for kind, rate in rates.items()
            if len(own := np.flatnonzero(kinds == kind))
        ]

    def _units(self, group: Neighbourhood, step: Floats, width: int) -> tuple[Single, Single]:
        """Sensitivities of a group at the nodes: of each of its states to itself, in its unit."""
        n, scale = len(self.segments.system.incidence), self.scales.state
        state = np.zeros((2, len(group.masses), width, len(step)), np.float32)
        inner = np.zeros((len(group.memory), width, len(step)), np.float32)
        for column, number in enumerate(group.states.tolist()):
            kind, place = divmod(number, n)
            if kind < 2:
                unit = scale[number] if kind == 0 else scale[number] * step
                state[kind, np.searchsorted(group.masses, place), column] = unit
            else:
                inner[np.searchsorted(group.memory, number - 2 * n), column] = scale[number]
        return state, inner

    def _add_errors(self, data: NDArray[Any], group: Neighbourhood, part: slice, whiten: Single) -> None:
        """The columns of errors and offsets of sensors, which act on one channel each or, offsets, on several."""
        first = len(group.states)
        for place, number in enumerate(group.border.tolist()):
            if self.errors is not None and self.moving <= number < self.fixed:
                channel = int(self.errors.channel[number - self.moving])
                values = self.errors.values[:, number - self.moving, part]
                own = int(np.searchsorted(group.channels, channel))
                data[:, own, :, first + place] = (whiten[:, channel] * values).T
            elif number >= self.fixed:
                offset = number - self.fixed
                unit = self.scales.theta[self.segments.system.parameters.size + offset]
                for channel in np.flatnonzero(self.segments.sensors.offset == offset).tolist():
                    own = int(np.searchsorted(group.channels, channel))
                    data[:, own, :, first + place] = whiten[:, channel].T * unit


def as_slice(numbers: Indices) -> Indices | slice:
    """The same places as a slice, where they follow each other, so that no copy is made."""
    if len(numbers) and numbers[-1] - numbers[0] == len(numbers) - 1 and (np.diff(numbers) == 1).all():
        return slice(int(numbers[0]), int(numbers[-1]) + 1)
    return numbers


def _transfer(mechanics: NumericSystem, group: Neighbourhood) -> Transfer:
    """The part of the structure that a group reaches."""
    inside = np.ix_(group.masses, group.links)
    return Transfer.of(mechanics.incidence[inside], mechanics.gain[inside])
