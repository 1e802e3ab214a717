"""Fisher information of theta in segments with free starts: what any estimate that does not look beyond a segment can know.

The full-record bound is useless for a chaotic structure, whose sensitivities of 1e20 make it collapse; segments of a quarter
of a second with free states are not (METHODS section 5).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy

from linkwise.arrays import Floats, Indices
from linkwise.likelihood.flow import flow, tangents
from linkwise.likelihood.segments import A, Iterate, Scales, Segments, V, X

_NUMBERS = 4_000_000  # in the sensitivities of one batch of segments
_BLIND = 1e-9  # of what would be known beside known states: below it single-precision tangents say nothing
_SEEN_TOGETHER = 1e-3  # share of a combination in blind directions that makes it blind
_RELATED = 0.01  # cosine between the blind parts of two parameters that are confused with each other


@dataclass(frozen=True, eq=False)
class FisherInformation:
    """`fisher` (p, p) with the starts of all segments unknown, `diagonal_known_states` (p,) its diagonal if they were
    known.
    """

    fisher: Floats
    diagonal_known_states: Floats

    def with_prior(self, deviation: Floats) -> FisherInformation:
        """The same with what is known beforehand to standard deviations (p,), infinite where nothing is."""
        known = 1.0 / deviation**2
        return FisherInformation(self.fisher + np.diag(known), self.diagonal_known_states + known)


@dataclass(frozen=True, eq=False)
class Precision:
    """How well p parameters are told: covariance = `root` root', over what is told at all.

    `null_directions` (p, b) holds orthonormal directions of `scale` * theta that leave no trace in the sensors.
    """

    root: Floats
    null_directions: Floats
    scale: Floats

    @classmethod
    def of(cls, information: FisherInformation) -> Precision:
        """From the eigenvalues of the information, each parameter in units of what would be known of it alone."""
        scale = np.sqrt(
            np.where(information.diagonal_known_states > 0.0, information.diagonal_known_states, 1.0)
        )
        values, vectors = np.linalg.eigh(information.fisher / np.outer(scale, scale))
        told = values > _BLIND
        return cls(vectors[:, told] / np.sqrt(values[told]) / scale[:, None], vectors[:, ~told], scale)

    def variance(self, gradient: Floats) -> Floats:
        """(...) of gradient (..., p) times theta; infinite where blind directions have a part in it."""
        scaled = gradient / self.scale
        lost = np.linalg.norm(scaled @ self.null_directions, axis=-1)
        variance = np.sum((gradient @ self.root) ** 2, axis=-1)
        return np.where(lost > _SEEN_TOGETHER * np.linalg.norm(scaled, axis=-1), np.inf, variance)

    @property
    def confounded(self) -> tuple[Indices, ...]:
        """Groups of parameters that are seen only together; a group of one leaves no trace at all."""
        shares = np.linalg.norm(self.null_directions, axis=1)
        lost = np.flatnonzero(shares > _SEEN_TOGETHER)
        part = self.null_directions[lost] / shares[lost, None]
        _, labels = scipy.sparse.csgraph.connected_components(
            np.abs(part @ part.T) > _RELATED, directed=False
        )
        return tuple(lost[labels == label] for label in range(labels.max(initial=-1) + 1))


def fisher_information(segments: Segments, point: Iterate, scales: Scales) -> FisherInformation:
    """What `segments` (one step of the flow a sample) tell of theta at the truth, `point`, whatever their starts.

    The sensitivities of a segment are reduced by QR, not by normal equations, so that what states explain is taken off
    without losing digits; order 4 in the step, as the tangents are.
    """
    p, m = segments.system.parameters.size, len(scales.state)
    per_segment = segments.observed[..., 0].size * (m + p)
    size = max(1, _NUMBERS // per_segment)
    fisher, beside = np.zeros((p, p)), np.zeros(p)
    for first in range(0, segments.count, size):
        rows = _sensitivities(segments, point, scales, slice(first, min(first + size, segments.count)))
        triangle: Floats = np.asarray(np.linalg.qr(rows, mode="r"))
        left = triangle[:, m:, m:].reshape(-1, p)
        fisher += left.T @ left
        beside += np.sum(triangle[..., m:] ** 2, axis=(0, 1))
    unit = scales.theta
    return FisherInformation(fisher / np.outer(unit, unit), beside / unit**2)


def _sensitivities(segments: Segments, point: Iterate, scales: Scales, part: slice) -> Floats:
    """(k, rows, 2n + p) of all samples that are seen, in noise deviations, by scaled states and theta."""
    blocks = list(_samples(segments, point, scales, part))
    return np.concatenate(blocks, axis=1)


def _samples(segments: Segments, point: Iterate, scales: Scales, part: slice) -> Iterator[Floats]:
    """(k, C, 2n + p) sample by sample."""
    mechanics, step = segments.system.at(point.theta), segments.step[part]
    orbit = flow(mechanics, point.nodes[..., part], step, segments.steps, segments.inputs.part(part))
    seen, sensors = segments.observed[..., part], segments.sensors
    rates = {X: np.ones_like(step), V: 1.0 / step, A: 1.0 / step**2}
    for sample, (state, acceleration) in enumerate(
        tangents(mechanics, orbit, step, scales.state, scales.theta)
    ):
        if acceleration is None or not seen[sample].any():
            continue
        motion = {X: state[0], V: state[1], A: acceleration}
        rows = np.empty((len(step), len(sensors.kind), state.shape[2]))
        for channel, (kind, mass) in enumerate(zip(sensors.kind, sensors.mass, strict=True)):
            weight = seen[sample, channel] * rates[kind] / scales.sigma[channel]
            rows[:, channel] = (motion[kind][mass] * weight).T
        yield rows
