"""The force of slip along a motion: what a law of displacement and velocity lacks where a joint has memory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dtbtrs

from linkwise.arrays import Bools, Floats


@dataclass(frozen=True)
class Slip:
    """A slider of unit force that yields over `reach` times the root mean square of the elongation.

    Its state follows dz = (dd - z |dd|) / x0, the model of P. R. Dahl ("A solid friction model", 1968), and is zero at the
    begin of each record; what it was there fades over the first few x0 of motion. With a third of the deviation it resembles,
    beside d, d**3 and v, sliders that yield over a twentieth of it to all of it: their correlation with it is 0.7 to 1, that
    with sign(v), v*abs(v) or d**5 at most 0.7.
    """

    reach: float = 0.3
    text: str = "hysteresis"

    def along(self, ends: Floats, middles: Floats, linked: Bools) -> tuple[Floats, Floats]:
        """The force along elongations of some links.

        Parameters
        ----------
        ends : array of shape (J + 1, L, K)
            Elongations in m at the ends of the J steps of K segments.
        middles : array of shape (J, L, K)
            The same in the middles of the steps.
        linked : array of bool, shape (K - 1,)
            Which neighbouring segments follow each other.

        Returns
        -------
        starts, between : array of shape (J + 1, L, K), (J, L, K)
            The force at the ends of the steps and in their middles.
        """
        steps, links, segments = middles.shape
        path = np.empty((links, segments, 2 * steps + 1))
        path[..., ::2], path[..., 1::2] = ends.transpose(1, 2, 0), middles.transpose(1, 2, 0)
        follows = np.zeros((segments, 2 * steps + 1), dtype=bool)
        follows[:, 1:] = True
        follows[1:, 0] = linked
        force = np.stack([self._of_one(motion.ravel(), follows.ravel()) for motion in path])
        force = force.reshape(path.shape).transpose(2, 0, 1)
        return force[::2], force[1::2]

    def _of_one(self, elongation: Floats, follows: Bools) -> Floats:
        """(N,) z along one motion, exact where the elongation is monotonic between its values; it restarts where none follows.

        Over a change it decays towards its sign: z_k = a_k z_(k-1) + sign_k (1 - a_k) with a_k = exp(-|change_k| / x0), which
        is a system of equations with two diagonals.
        """
        scale = self.reach * float(np.std(elongation))
        if not (np.isfinite(scale) and scale > 0.0):
            return np.zeros_like(elongation)
        change = np.diff(elongation, prepend=elongation[0])
        decay = np.where(follows, np.exp(-np.abs(change) / scale), 0.0)
        driven = np.where(follows, np.sign(change) * (1.0 - decay), 0.0)
        bands = np.stack([np.ones_like(decay), -np.append(decay[1:], 0.0)])
        force, _ = dtbtrs(bands, driven[:, None], uplo="L", diag="U")
        return np.asarray(force[:, 0])
