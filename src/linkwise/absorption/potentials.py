"""The energies of many structures of one shape over their motions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from linkwise.absorption.barriers import Barriers, barriers
from linkwise.absorption.places import moving_alike
from linkwise.arrays import Floats, Indices
from linkwise.model.structure import Structure


@dataclass(frozen=True, eq=False)
class Potentials:
    """The potentials of L links in W `structures` of one shape.

    `values` (W,) of each coefficient by link, `masses` (n, W) kg, and the `barriers` of each link, (W, K) m and (W,) J.
    """

    structures: tuple[Structure, ...]
    values: tuple[dict[str, Floats], ...]
    masses: Floats
    barriers: tuple[Barriers, ...]

    @classmethod
    def of(cls, structures: Sequence[Structure]) -> Potentials:
        """The potentials of structures of one shape."""
        first = structures[0]
        values = tuple(
            {
                name: np.array([structure.links[number].values[name] for structure in structures])
                for name in link.coefficients
            }
            for number, link in enumerate(first.links)
        )
        masses = np.stack([structure.mass_values for structure in structures], axis=1)
        return cls(
            tuple(structures),
            values,
            masses,
            tuple(
                barriers(link.law, numbers, len(structures))
                for link, numbers in zip(first.links, values, strict=True)
            ),
        )

    @property
    def floor(self) -> Floats:
        """(W,) J: the potential energy with all links in their lowest wells."""
        return np.asarray(np.sum([link.floor for link in self.barriers], axis=0))

    def tops(self, run: int) -> list[Floats]:
        """(K,) m: the tops of the barriers of each link in one structure."""
        return [link.tops[run][np.isfinite(link.tops[run])] for link in self.barriers]

    def of_runs(self, runs: Indices) -> Potentials:
        """The potentials of some of the structures."""
        return Potentials(
            tuple(self.structures[run] for run in runs),
            tuple({name: value[runs] for name, value in values.items()} for values in self.values),
            self.masses[:, runs],
            tuple(Barriers(link.tops[runs], link.floor[runs]) for link in self.barriers),
        )

    def stored(self, x: Floats, x_base: Floats | None) -> Floats:
        """(N, W) J above the lowest wells at displacements `x` (N, n, W) m; `x_base` (N,) m, None if the base rests."""
        d = elongations(self.structures, x, x_base)
        energy = np.zeros((x.shape[0], x.shape[2]))
        for number, (link, values) in enumerate(zip(self.structures[0].links, self.values, strict=True)):
            energy += link.law.potential(d[..., number], values)
        return energy - self.floor

    def kinetic(self, v: Floats) -> Floats:
        """(N, W) J at velocities `v` (N, n, W) m/s."""
        return np.asarray(0.5 * np.einsum("tiw,iw->tw", v * v, self.masses))


def elongations(structures: Sequence[Structure], x: Floats, x_base: Floats | None) -> Floats:
    """(N, W, L) m: elongations of all links in W structures at displacements `x` (N, n, W) m; `x_base` (N,) m of the base."""
    parts = []
    for structure, alike in moving_alike(structures):
        samples, size, runs = x[..., alike].shape
        repeated = None if x_base is None else np.repeat(x_base, runs)
        flat = structure.elongations(x[..., alike].transpose(0, 2, 1).reshape(-1, size), repeated)
        parts.append(flat.reshape(samples, runs, -1))
    return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)
