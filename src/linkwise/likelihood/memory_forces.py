"""Forces with memory along a motion: what a law of displacement and velocity lacks where a joint slips or a mount relaxes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dtbtrs

from linkwise.arrays import Bools, Floats


class MemoryForce(ABC):
    """A force of unit size whose state decays by a part of itself over each piece of the motion, and is driven by the rest.

    Its state is zero at the begin of each record; what it was there fades. `text` is what a diagnosis calls it, and `law` the
    name of a law that has it.
    """

    text: str
    law: str

    @abstractmethod
    def pieces(
        self, change: Floats, duration: Floats, motion: tuple[Floats, Floats]
    ) -> tuple[Floats, Floats]:
        """The part (N, L, K) of the state that is left after each piece, and what the piece adds.

        Parameters
        ----------
        change : array of shape (N, L, K)
            The change of the elongation in m over each piece; the first piece, between segments, takes no time.
        duration : array of shape (K,)
            The duration in s of each other piece.
        motion : tuple of array of shape (L, 1)
            The standard deviations of the elongation in m and of its rate in m/s.
        """

    def along(self, motion: Floats, step: Floats, linked: Bools) -> Floats:
        """The force along elongations of some links.

        Parameters
        ----------
        motion : array of shape (2 J + 1, 2, L, K)
            Elongations in m and their rates in m/s, at the ends of the J steps of K segments and in their middles, in turn.
        step : array of shape (K,)
            Duration of a step in s.
        linked : array of bool, shape (K - 1,)
            Which neighbouring segments follow each other.

        Returns
        -------
        array of shape (2 J + 1, L, K)
            The force there; zero where there is no motion.
        """
        path = motion[:, 0]
        spread = np.std(path, axis=(0, 2)), np.std(motion[::2, 1], axis=(0, 2))
        moves = np.isfinite(spread).all(axis=0) & (np.min(spread, axis=0) > 0.0)
        change = np.empty(path.shape)
        np.subtract(path[1:], path[:-1], out=change[1:])
        change[0, :, :1] = 0.0
        np.subtract(
            path[0, :, 1:], path[-1, :, :-1], out=change[0, :, 1:]
        )  # where a segment starts, that before it ends
        d, v = (np.where(moves, deviation, 1.0)[:, None] for deviation in spread)
        force = _states(*self.pieces(change, 0.5 * step, (d, v)), linked)
        force[:, ~moves] = 0.0
        return force


def _states(left: Floats, added: Floats, linked: Bools) -> Floats:
    """(N, L, K) z_j = left_j z_(j-1) + added_j along each of K segments, the first following the last of that before it.

    Where segments are not `linked` (K - 1,) it is zero.
    """
    states, follows = added, np.append(False, linked)
    first, states[0] = np.where(follows, added[0], 0.0), 0.0
    fades, carried = np.empty_like(left), np.empty_like(first)
    fades[0] = 1.0
    np.multiply.accumulate(left[1:], axis=0, out=fades[1:])
    for before, part, own in zip(states[:-1], left[1:], states[1:], strict=True):
        own += np.multiply(part, before, out=carried)
    first[:, 1:] += (linked * left[0, :, 1:]) * states[-1, :, :-1]
    # of a segment by that of the one before it: a system of equations with two diagonals
    by_start = np.zeros_like(first)
    by_start[:, :-1] = -(linked * left[0, :, 1:]) * fades[-1, :, :-1]
    starts, _ = dtbtrs(
        np.stack([np.ones(first.size), by_start.ravel()]), first.reshape(-1, 1), uplo="L", diag="U"
    )
    states += fades * starts.reshape(first.shape)
    return states


@dataclass(frozen=True)
class Slip(MemoryForce):
    """A slider that yields over `reach` times the deviation of the elongation, by dz = (dd - z |dd|)/x0.

    That is the model of P. R. Dahl ("A solid friction model", 1968). With a third of the deviation it resembles sliders that
    yield over a twentieth of it to all of it: beside d, d**3 and v their correlation with it is 0.7 to 1, that of sign(v),
    v*abs(v) or d**5 at most 0.7.
    """

    reach: float = 0.3
    text: str = "hysteresis"
    law: str = "bouc-wen"

    def pieces(
        self, change: Floats, duration: Floats, motion: tuple[Floats, Floats]
    ) -> tuple[Floats, Floats]:
        """Exact where the elongation is monotonic over a piece: the state decays towards the sign of the change."""
        left = np.exp(-np.abs(change) / (self.reach * motion[0]))
        return left, np.sign(change) * (1.0 - left)


@dataclass(frozen=True)
class Relaxation(MemoryForce):
    """A spring in series with a damper (Maxwell), z' = v - z/tau; tau is `time` times the ratio of the deviations of d and v.

    That is the time of a radian of a harmonic motion. Those that relax thirty times as fast or ten times as slowly resemble
    it: beside d, d**3 and v their correlation with it is 0.6 to 1. Faster it is a damper, slower a spring.
    """

    time: float = 1.0
    text: str = "relaxation"
    law: str = "zener"

    def pieces(
        self, change: Floats, duration: Floats, motion: tuple[Floats, Floats]
    ) -> tuple[Floats, Floats]:
        """Exact where the rate is constant over a piece."""
        time = self.time * motion[0] / motion[1]
        decay = np.maximum(duration / time, np.finfo(float).tiny)
        left = np.repeat(np.exp(-decay)[None], len(change), axis=0)
        added = change * (-np.expm1(-decay) / decay)
        left[0], added[0] = 1.0, change[0]
        return left, added


MEMORY_FORCES: tuple[MemoryForce, ...] = (Slip(), Relaxation())
"""What a link may lack that no function of its elongation and rate is."""

MEMORY_TERMS = {force.text: force.law for force in MEMORY_FORCES}
"""What a diagnosis calls them, and the name of a law that has each."""

PRICE_OF_REACH = 10.0
"""Of -2 log likelihood, for the reach or the time that a force with memory has beside its size: about the logarithm of the
number of samples, as of any coefficient."""
