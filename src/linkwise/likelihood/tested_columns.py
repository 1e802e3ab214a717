"""The columns of the linearised equations that a diagnosis tests, alone or in sums of several."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.base_errors import BASE_ERRORS, BaseErrors
from linkwise.likelihood.damping_errors import DampingErrors
from linkwise.likelihood.score_test import AugmentedQuadratic
from linkwise.likelihood.shape_errors import ShapeErrors
from linkwise.likelihood.shooting.sensor_errors import SensorErrors
from linkwise.likelihood.shooting.tangent_forces import CandidateForces


@dataclass(frozen=True, eq=False)
class TestedColumns:
    """Columns of candidate `forces`, then of sensor `errors`, and the `units` (h,) of h hypotheses.

    `weights` (c, h) is what each hypothesis has of the c columns.
    """

    __test__ = False  # no test of pytest

    forces: CandidateForces
    errors: SensorErrors
    units: Floats
    weights: Floats

    @classmethod
    def separate(cls, forces: CandidateForces, errors: SensorErrors, units: Floats) -> TestedColumns:
        """Every column alone, in this order."""
        return cls(forces, errors, units, np.eye(len(units)))

    def with_sum(self, errors: SensorErrors) -> TestedColumns:
        """These and the sum of the columns of `errors`, as one hypothesis in their unit."""
        nobody = CandidateForces(
            self.forces.first[:0],
            self.forces.second[:0],
            self.forces.starts[:, :0],
            self.forces.middles[:, :0],
        )
        return self._with(nobody, errors, np.ones((len(errors.kind), 1)), np.ones(1))

    def with_load_cells(self, forces: Sequence[int], channels: Sequence[int], refine: int) -> TestedColumns:
        """These, where load cells show the `forces`, by number, in `channels`, with `refine` steps between their samples."""
        values = self.forces.starts[::refine, list(forces)]
        added = len(forces)
        shown = np.zeros((added, self.weights.shape[1]))
        shown[np.arange(added), list(forces)] = 1.0
        errors = self.errors
        return replace(
            self,
            errors=SensorErrors(
                np.append(errors.channel, np.array(channels, dtype=int)),
                (*errors.kind, *("load cell",) * added),
                np.append(errors.source, np.full(added, -1)),
                np.concatenate([errors.values, values[: len(errors.values)]], axis=1),
            ),
            weights=np.concatenate([self.weights, shown]),
        )

    def with_base(self, base: BaseErrors) -> TestedColumns:
        """These and the errors of the base, each of which acts on all masses and in all channels."""
        n, count = base.starts.shape[1:3]
        channels = base.values.shape[1]
        power = np.mean(base.starts**2, axis=(0, 1, 3))
        scale = np.sqrt(np.where(power > 0.0, power, 1.0))
        starts, middles, values = (
            (part / scale[:, None]).reshape(len(part), -1, part.shape[-1])
            for part in (base.starts, base.middles, base.values)
        )
        masses, sensors = np.repeat(np.arange(n), count), np.repeat(np.arange(channels), count)
        forces = CandidateForces(np.full(len(masses), -1), masses, starts, middles)
        errors = SensorErrors(sensors, BASE_ERRORS * channels, np.full(len(sensors), -1), values)
        return self._with(forces, errors, np.tile(np.eye(count), (n + channels, 1)), 1.0 / scale)

    def with_shapes(self, shapes: ShapeErrors) -> TestedColumns:
        """These and errors of the shapes of hosts, each of which acts on several places and channels."""
        return self._with(shapes.forces, shapes.errors, shapes.weights, np.ones(len(shapes.places)))

    def with_damping(self, damping: DampingErrors) -> TestedColumns:
        """These and damping between modes of hosts, which acts on both modes."""
        nowhere = SensorErrors(self.errors.channel[:0], (), self.errors.source[:0], self.errors.values[:, :0])
        return self._with(damping.forces, nowhere, damping.weights, damping.units)

    def _with(
        self, forces: CandidateForces, errors: SensorErrors, weights: Floats, units: Floats
    ) -> TestedColumns:
        """These and hypotheses of which each has `weights` (c, h) of more columns, forces first."""
        before, added = len(self.forces.first), len(forces.first)
        own = np.pad(self.weights, ((0, 0), (0, len(units))))
        more = np.pad(weights, ((0, 0), (self.weights.shape[1], 0)))
        return TestedColumns(
            self.forces.joined(forces) if added else self.forces,
            SensorErrors(
                np.append(self.errors.channel, errors.channel),
                (*self.errors.kind, *errors.kind),
                np.append(self.errors.source, errors.source),
                np.concatenate([self.errors.values, errors.values], axis=1),
            ),
            np.append(self.units, units),
            np.concatenate([own[:before], more[:added], own[before:], more[added:]]),
        )

    def joined(self, augmented: AugmentedQuadratic, parameters: int) -> tuple[Floats, Floats, Floats]:
        """Curvature, slope and its covariance in the parameters and the sizes of the hypotheses."""
        columns, hypotheses = self.weights.shape
        weights = np.eye(parameters + columns, parameters + hypotheses)
        weights[parameters:, parameters:] = self.weights
        curvature = weights.T @ augmented.curvature @ weights
        white = augmented.scatter is augmented.curvature
        return (
            curvature,
            weights.T @ augmented.slope,
            curvature if white else weights.T @ augmented.scatter @ weights,
        )
