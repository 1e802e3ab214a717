"""The recorded motion of a rig as a smoothing spline: values between samples, and what its noise does to them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.signals.smooth import SmoothingSpline


def _weights(fraction: float, order: int) -> Floats:
    """Weights (6,) of quintic B-splines at a fraction of the way from one knot to the next, from the leftmost one on."""
    # truncated powers: B(t) = sum (-1)^k C(6, k) (t - k)_+^5 / 5!
    places = 5.0 - np.arange(6) + fraction
    knots, signs = np.arange(7.0), np.array([1.0, -6.0, 15.0, -20.0, 15.0, -6.0, 1.0])
    above = np.maximum(places[:, None] - knots, 0.0)
    powers = {0: above**5 / 120.0, 1: above**4 / 24.0}[order]
    return np.asarray(powers @ signs)


@dataclass(frozen=True, eq=False)
class PrescribedMotion:
    """Displacement `d` and velocity `v` (J,) at the nodes: the samples, and `substeps` - 1 between each two.

    `sigma` is the noise of the displacement sensor in m.
    """

    spline: SmoothingSpline
    substeps: int
    sigma: float
    d: Floats
    v: Floats

    @classmethod
    def of(cls, spline: SmoothingSpline, substeps: int, sigma: float) -> PrescribedMotion:
        coefficients, samples = spline.coefficients[:, 0], len(spline.coefficients) - 4
        rows = [np.empty((samples - 1) * substeps + 1) for _ in range(2)]
        for order, row in enumerate(rows):
            scale = spline.rate**order
            for number in range(substeps):
                weights = _weights(number / substeps, order) * scale
                row[number::substeps][: samples - 1] = (
                    sum(
                        weight * coefficients[lag : lag + samples - 1]
                        for lag, weight in enumerate(weights[:5])
                    )
                    + weights[5] * coefficients[5 : samples + 4]
                )
            row[-1] = _weights(0.0, order)[:5] @ coefficients[-5:] * scale
        return cls(spline, substeps, sigma, rows[0], rows[1])

    @property
    def step(self) -> float:
        """Time between nodes in s."""
        return 1.0 / (self.spline.rate * self.substeps)

    @property
    def period(self) -> int:
        """Samples in a period of the motion, by the ratio of displacement and velocity."""
        speed = float(np.std(self.v)) or 1.0
        return max(int(2.0 * np.pi * float(np.std(self.d)) / speed * self.spline.rate), 1)

    def with_substeps(self, substeps: int) -> PrescribedMotion:
        """The motion with other nodes between the samples."""
        return PrescribedMotion.of(self.spline, substeps, self.sigma)

    def part(self, first: int, count: int) -> PrescribedMotion:
        """The motion at `count` samples from the `first` on."""
        spline = replace(self.spline, coefficients=self.spline.coefficients[first : first + count + 4])
        return PrescribedMotion.of(spline, self.substeps, self.sigma)

    def liveliest(self, count: int) -> int:
        """First of the `count` samples in a row that move most."""
        power = np.concatenate([[0.0], np.cumsum(self.v[:: self.substeps] ** 2)])
        return int(np.argmax(power[count:] - power[:-count]))

    def noise_draws(self, rng: np.random.Generator, count: int) -> tuple[Floats, Floats]:
        """(J, count) what draws of the sensor's noise do to d and v at the nodes."""
        samples = len(self.spline.coefficients) - 4
        noise = self.sigma * rng.standard_normal((samples, count))
        drawn = self.spline.smoothed(noise)
        moved = [
            PrescribedMotion.of(replace(drawn, coefficients=column[:, None]), self.substeps, 0.0)
            for column in drawn.coefficients.T
        ]
        return np.stack([motion.d for motion in moved], axis=1), np.stack(
            [motion.v for motion in moved], axis=1
        )

    def noise_of(self, by_d: Floats, by_v: Floats) -> Floats:
        """(N, q) by how much sums with derivatives (J, q) by d and v at the nodes change with the noise of each sample."""
        samples = len(self.spline.coefficients) - 4
        by_coefficient = np.zeros((samples + 4, by_d.shape[1]))
        for order, slopes in enumerate((by_d, by_v)):
            scale = self.spline.rate**order
            for number in range(self.substeps):
                weights = _weights(number / self.substeps, order) * scale
                part = slopes[number :: self.substeps][: samples - 1]
                for lag, weight in enumerate(weights):
                    if weight:
                        by_coefficient[lag : lag + samples - 1] += weight * part
            by_coefficient[-5:] += scale * _weights(0.0, order)[:5, None] * slopes[-1]
        return self.spline.transposed(by_coefficient) * self.sigma
