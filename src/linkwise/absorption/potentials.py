"""The energies of many structures of one shape over their motions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from linkwise.absorption.barriers import Barriers, barriers
from linkwise.arrays import Floats, Indices
from linkwise.model.structure import Structure


@dataclass(frozen=True, eq=False)
class Potentials:
    """The potentials of L links in W structures of the shape of `first`: `values` (W,) of each coefficient by link, `masses`
    (n, W) in kg, and the `barriers` of each link, (W, K) and (W,).
    """

    first: Structure
    values: tuple[dict[str, Floats], ...]
    masses: Floats
    barriers: tuple[Barriers, ...]

    @classmethod
    def of(cls, structures: Sequence[Structure]) -> Potentials:
        """Those of structures of one shape."""
        first = structures[0]
        values = tuple(
            {name: np.array([each.links[number].values[name] for each in structures]) for name in link.coefficients}
            for number, link in enumerate(first.links)
        )  # fmt: skip
        masses = np.stack([each.mass_values for each in structures], axis=1)
        found = (
            barriers(link.law, each, len(structures)) for link, each in zip(first.links, values, strict=True)
        )
        return cls(first, values, masses, tuple(found))

    @property
    def floor(self) -> Floats:
        """(W,) J: all links in their lowest wells."""
        return np.asarray(np.sum([each.floor for each in self.barriers], axis=0))

    def tops(self, run: int) -> list[Floats]:
        """(K,) m of each link in one structure."""
        return [each.tops[run][np.isfinite(each.tops[run])] for each in self.barriers]

    def rows(self, which: Indices) -> Potentials:
        """Those of some of the structures."""
        return Potentials(
            self.first,
            tuple({name: value[which] for name, value in each.items()} for each in self.values),
            self.masses[:, which],
            tuple(Barriers(each.tops[which], each.floor[which]) for each in self.barriers),
        )

    def stored(self, x: Floats, base: Floats | None) -> Floats:
        """(N, W) J above the lowest wells at displacements (N, n, W); `base` (N,) in m where there is one."""
        d = elongations(self.first, x, base)
        energy = np.zeros((x.shape[0], x.shape[2]))
        for number, (link, values) in enumerate(zip(self.first.links, self.values, strict=True)):
            energy += link.law.potential(d[..., number], values)
        return energy - self.floor

    def kinetic(self, v: Floats) -> Floats:
        """(N, W) J at velocities (N, n, W)."""
        return np.asarray(0.5 * np.einsum("tiw,iw->tw", v * v, self.masses))


def elongations(structure: Structure, x: Floats, base: Floats | None) -> Floats:
    """(N, W, L) m of all links in W runs at displacements (N, n, W); `base` (N,) in m where there is one."""
    points, size, runs = x.shape
    where = None if base is None else np.repeat(base, runs)
    flat = structure.elongations(x.transpose(0, 2, 1).reshape(-1, size), where)
    return flat.reshape(points, runs, -1)
