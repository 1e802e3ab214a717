"""The recorded motion of a rig as a smoothing spline: values between samples, and what its noise does to them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from linkwise.arrays import Floats
from linkwise.model.structure import BASE
from linkwise.records.channel import Channel
from linkwise.records.record import Record
from linkwise.signals.noise import noise_sigma
from linkwise.signals.states import SmoothingSpline, smoothing_spline

BASE_CHANNEL = Channel("x", BASE)
_FLOOR = 1e-12  # of the largest displacement: smaller noise is below rounding
_SUBSTEPS = 2  # between samples, at first


@dataclass(frozen=True, eq=False)
class PrescribedMotion:
    """The motion at the nodes (J): the samples, and `substeps` - 1 between each two.

    `sigma` is the noise of the displacement sensor in m.
    """

    spline: SmoothingSpline
    substeps: int
    sigma: float

    @cached_property
    def _basis(self) -> tuple[scipy.sparse.csr_array, scipy.sparse.csr_array]:
        """(J, N + 4) what the coefficients of the quintic B-splines make of the displacement and the velocity at the nodes."""
        count = len(self.spline.coefficients)
        knots = np.arange(-5.0, count + 1.0)
        nodes = np.arange((count - 5) * self.substeps + 1) / self.substeps
        lagged = scipy.sparse.eye_array(count - 1, count, k=1) - scipy.sparse.eye_array(count - 1, count)
        values, slopes = (
            scipy.interpolate.BSpline.design_matrix(
                nodes, knots[5 - degree : len(knots) - 5 + degree], degree
            )
            for degree in (5, 4)
        )
        return values, self.spline.rate * (slopes @ lagged)

    @cached_property
    def d(self) -> Floats:
        """(J,) displacement in m."""
        return np.asarray(self._basis[0] @ self.spline.coefficients[:, 0])

    @cached_property
    def v(self) -> Floats:
        """(J,) velocity in m/s."""
        return np.asarray(self._basis[1] @ self.spline.coefficients[:, 0])

    @property
    def step(self) -> float:
        """Time between nodes in s."""
        return 1.0 / (self.spline.rate * self.substeps)

    @property
    def period(self) -> int:
        """Samples in a period of the motion, by the ratio of displacement and velocity."""
        speed = float(np.std(self.v)) or 1.0
        return max(int(2.0 * np.pi * float(np.std(self.d)) / speed * self.spline.rate), 1)

    def liveliest(self, count: int) -> int:
        """First of the `count` samples in a row that move most."""
        power = np.concatenate([[0.0], np.cumsum(self.v[:: self.substeps] ** 2)])
        return int(np.argmax(power[count:] - power[:-count]))

    def noise_draws(self, rng: np.random.Generator, count: int) -> tuple[Floats, Floats]:
        """(J, count) what draws of the sensor's noise do to d and v at the nodes."""
        noise = self.sigma * rng.standard_normal((len(self.spline.coefficients) - 4, count))
        drawn = self.spline.smoothed(noise).coefficients
        return self._basis[0] @ drawn, self._basis[1] @ drawn

    def noise_of(self, by_d: Floats, by_v: Floats) -> Floats:
        """(N, q) by how much sums with derivatives (J, q) by d and v at the nodes change with the noise of each sample."""
        by_coefficient = self._basis[0].T @ by_d + self._basis[1].T @ by_v
        return self.spline.transposed(by_coefficient) * self.sigma


def prescribed_motion(record: Record) -> PrescribedMotion:
    """The motion of the base of a record, smoothed at the level of its noise."""
    values = record.channel(BASE_CHANNEL)
    spline = smoothing_spline(values, record.rate)
    return PrescribedMotion(spline, _SUBSTEPS, _sensor_noise(record, values, spline.value()[:, 0]))


def _sensor_noise(record: Record, values: Floats, smooth: Floats) -> float:
    """Standard deviation in m of the noise of the displacement; that of a coarse resolution is what smoothing takes out."""
    stated = record.noise.get(BASE_CHANNEL)
    if stated is not None:
        return float(stated)
    estimated = float(np.nan_to_num(noise_sigma(values)[0]))
    return max(estimated, float(np.std(values - smooth)), _FLOOR * float(np.abs(values).max()))
