"""What runs come to, as numbers: one value a run, the same for one run as for ten thousand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from linkwise.absorption.barriers import Barriers, barriers
from linkwise.absorption.decay import Decay
from linkwise.absorption.rest import RestingPlaces
from linkwise.absorption.runs import Runs
from linkwise.structure import Structure

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Potentials:
    """The potentials of L links in W structures of one shape, and the tops and wells in them."""

    structures: Sequence[Structure]

    @cached_property
    def _values(self) -> list[dict[str, Floats]]:
        """Per link: (W,) of each coefficient."""
        return [
            {
                name: np.array([each.links[number].values[name] for each in self.structures])
                for name in link.coefficients
            }
            for number, link in enumerate(self.structures[0].links)
        ]

    @cached_property
    def barriers(self) -> list[Barriers]:
        """Of each link, (W, K) and (W,); of a law without coefficients one row for all."""
        laws = (link.law for link in self.structures[0].links)
        return [barriers(law, values) for law, values in zip(laws, self._values, strict=True)]

    @cached_property
    def floor(self) -> Floats:
        """(W,) J: all links in their lowest wells."""
        total = np.zeros(len(self.structures))
        for each in self.barriers:
            total += each.floor
        return total

    def tops(self, run: int) -> list[Floats]:
        """(K,) m of each link in one structure."""
        rows = (each.tops[run if len(each.tops) > 1 else 0] for each in self.barriers)
        return [row[np.isfinite(row)] for row in rows]

    def stored(self, x: Floats, base: Floats | None) -> Floats:
        """(N, W) J above the lowest wells at displacements (N, n, W); `base` (N,) in m where there is one."""
        first = self.structures[0]
        d = np.stack([first.elongations(x[..., run], base) for run in range(x.shape[2])], axis=-1)
        energy = np.zeros((x.shape[0], x.shape[2]))
        for number, link in enumerate(first.links):
            energy += link.law.potential(d[:, number], self._values[number])
        return energy - self.floor

    def kinetic(self, v: Floats) -> Floats:
        """(N, W) J at velocities (N, n, W)."""
        masses = np.stack([each.mass_values for each in self.structures], axis=1)
        return np.asarray(0.5 * np.einsum("tiw,iw->tw", v * v, masses))


@dataclass(frozen=True, eq=False)
class Vibration:
    """The primary masses of W runs about the places where they come to rest."""

    runs: Runs
    columns: Sequence[int]
    resting: RestingPlaces

    @cached_property
    def rest(self) -> Floats:
        """(P, W) m."""
        return self.resting.nearest(self.runs.x[-1, list(self.columns)])

    @cached_property
    def decay(self) -> Decay:
        """Excursions (N, P, W)."""
        columns = list(self.columns)
        return Decay(self.runs.time, self.runs.x[:, columns] - self.rest, self.runs.v[:, columns])

    @property
    def peak(self) -> Floats:
        """(P, W) m."""
        return self.decay.peak

    @cached_property
    def rms(self) -> Floats:
        """(P, W) m."""
        return np.sqrt(self.decay.mean_square)

    def settled(self, level: Floats) -> Floats:
        """(P, W) s; NaN where a mass does not settle below `level` (P, W)."""
        return self.decay.settled(level)


def reduction(with_sinks: Floats, without: Floats) -> Floats:
    """By what part something is smaller with sinks than without; NaN where there is nothing without."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(without > 0.0, 1.0 - with_sinks / without, np.nan))


def together(values: Floats) -> Floats:
    """(W,) root of the sum of squares over the masses of (P, W)."""
    return np.asarray(np.sqrt(np.square(values).sum(axis=0)))
