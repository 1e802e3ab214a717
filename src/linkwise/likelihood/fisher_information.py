"""Fisher information of theta in segments with free initial states: the bound on estimates that do not link segments.

The full-record bound is useless for a chaotic structure, whose sensitivities of 1e20 make it collapse; segments of a quarter
of a second with free states are not (METHODS section 5).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from linkwise.arrays import Floats, Indices
from linkwise.likelihood.shooting.normal_equations import chunks
from linkwise.likelihood.shooting.residuals import Gaussian, evaluate
from linkwise.likelihood.shooting.segments import Iterate, Scales, Segments
from linkwise.likelihood.shooting.tangents import CandidateForces, whitened_jacobian


@dataclass(frozen=True, eq=False)
class RandomInputs:
    """Forces (c) beside the laws, and what makes `sums` (c, d) of them: d independent normal amplitudes of size one."""

    forces: CandidateForces
    sums: Floats


_SINGULAR = 1e-9  # eigenvalue, relative to the information with known states, that single precision cannot tell from 0
_IN_NULL_SPACE = 1e-3  # share of a combination in the null space that makes it unidentifiable
_CONFOUNDED = 0.01  # cosine between the null-space parts of two parameters that are confounded


@dataclass(frozen=True, eq=False)
class FisherInformation:
    """`fisher` (p, p) with the initial states of all segments unknown; `diagonal_known_states` (p,), its diagonal with
    these known.
    """

    fisher: Floats
    diagonal_known_states: Floats

    def with_prior(self, deviation: Floats) -> FisherInformation:
        """The same with what is known beforehand to standard deviations (p,), infinite where nothing is."""
        known = 1.0 / deviation**2
        return FisherInformation(self.fisher + np.diag(known), self.diagonal_known_states + known)

    @property
    def precision(self) -> Precision:
        """The covariance at the bound, from the eigenvalues of the information in units of `diagonal_known_states`."""
        known = self.diagonal_known_states
        scale = np.sqrt(np.where(known > 0.0, known, 1.0))
        values, vectors = np.linalg.eigh(self.fisher / np.outer(scale, scale))
        determined = values > _SINGULAR
        root = vectors[:, determined] / np.sqrt(values[determined]) / scale[:, None]
        return Precision(root, vectors[:, ~determined], scale)


@dataclass(frozen=True, eq=False)
class Precision:
    """The covariance of p parameters at the bound, and the combinations of them that the sensors do not determine.

    Attributes
    ----------
    root : array of shape (p, r)
        A root of the covariance, which is ``root @ root.T`` in SI units, over the r directions that are determined.
    null_directions : array of shape (p, p - r)
        Orthonormal directions of ``scale * theta`` (no unit) that leave no trace in the sensors.
    scale : array of shape (p,)
        What each parameter theta is multiplied by, in the inverse of its SI unit.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> planned = lw.limit(chain, duration=0.5, rate=1000.0, noise=40.0, unknown=["nes"], release={"v:m1": 1.0})
    >>> planned.precision.null_directions.shape[1], planned.precision.confounded
    (0, ())
    """

    root: Floats
    null_directions: Floats
    scale: Floats

    def variance(self, gradient: Floats) -> Floats:
        """The variance of linear combinations of the parameters at the bound.

        Parameters
        ----------
        gradient : array of shape (..., p)
            The combinations: derivatives by each parameter, in the inverse of its SI unit.

        Returns
        -------
        array of shape (...)
            The variances (no unit where `gradient` has that of a relative change); infinite for combinations that the sensors
            do not determine.
        """
        scaled = gradient / self.scale
        in_null_space = np.linalg.norm(scaled @ self.null_directions, axis=-1)
        variance = np.sum((gradient @ self.root) ** 2, axis=-1)
        undetermined = in_null_space > _IN_NULL_SPACE * np.linalg.norm(scaled, axis=-1)
        return np.where(undetermined, np.inf, variance)

    @property
    def confounded(self) -> tuple[Indices, ...]:
        """Indices of parameters that only a combination of is determined, group by group; one alone leaves no trace."""
        shares = np.linalg.norm(self.null_directions, axis=1)
        undetermined = np.flatnonzero(shares > _IN_NULL_SPACE)
        part = self.null_directions[undetermined] / shares[undetermined, None]
        _, labels = scipy.sparse.csgraph.connected_components(
            np.abs(part @ part.T) > _CONFOUNDED, directed=False
        )
        return tuple(undetermined[labels == label] for label in range(labels.max(initial=-1) + 1))


def fisher_information(
    segments: Segments, point: Iterate, scales: Scales, random: RandomInputs | None = None
) -> FisherInformation:
    """The information on theta in `segments` (one step of the flow a sample) at the truth, `point`, for any initial states.

    The sensitivities of a segment are reduced by QR, not by normal equations, which projects the initial states out without
    loss of digits; of order 4 in the step, as the tangents are. Amplitudes of `random` inputs are projected out with them.
    """
    p, m = segments.system.parameters.size, len(scales.state)
    forces, d = (None, 0) if random is None else (random.forces, random.sums.shape[1])
    misfit = evaluate(segments, point, scales, Gaussian())
    fisher, diagonal = np.zeros((p, p)), np.zeros(p)
    for part in chunks(segments, p + (0 if forces is None else len(forces.first))):
        rows, _ = whitened_jacobian(misfit, part, forces)
        states, theta, acting = np.split(rows[..., :-1].astype(float), [m, m + p], axis=2)
        if random is not None:
            known = np.broadcast_to(np.eye(d), (len(rows), d, d))
            acting = np.concatenate([acting @ random.sums, known], axis=1)
            states, theta = (np.pad(own, ((0, 0), (0, d), (0, 0))) for own in (states, theta))
        triangle: Floats = np.asarray(np.linalg.qr(np.concatenate([states, acting, theta], axis=2), mode="r"))
        projected = triangle[:, m + d :, m + d :].reshape(-1, p)
        fisher += projected.T @ projected
        diagonal += np.sum(theta**2, axis=(0, 1))
    unit = scales.theta
    return FisherInformation(fisher / np.outer(unit, unit), diagonal / unit**2)
