"""The positions at which the primary masses come to rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from linkwise.absorption.places import place_motion
from linkwise.absorption.potentials import Potentials
from linkwise.analysis.equilibria import equilibria
from linkwise.arrays import Floats
from linkwise.errors import StructureError
from linkwise.model.structure import Structure


@dataclass(frozen=True, eq=False)
class RestPositions:
    """Displacements `x` (E, P) m of the primary masses in the stable equilibria of a structure, its base at zero."""

    x: Floats

    def nearest(self, x: Floats) -> Floats:
        """(P,) m: the rest position nearest to the displacements `x` (P,) m."""
        return np.asarray(self.x[np.square(self.x - x).sum(axis=1).argmin()])


def rest_positions(structures: Sequence[Structure], primaries: Sequence[str]) -> list[RestPositions]:
    """The rest positions of the masses `primaries` in each of several structures of one shape.

    Zero if all links have their only well at zero elongation; otherwise equilibria are searched. Zero, too, for a structure
    without a stable equilibrium, or with too many equilibria to count.
    """
    potentials = Potentials.of(structures)
    at_zero = np.ones(len(structures), dtype=bool)
    for number, barriers in enumerate(potentials.barriers):
        alike = [structure.links[number] for structure in structures]
        at_zero &= (barriers.floor == 0.0) & ~np.isfinite(barriers.tops).any(axis=1)
        at_zero &= np.array([float(link.force(0.0, states=link.zero_states)) == 0.0 for link in alike])
    zero = RestPositions(np.zeros((1, len(primaries))))
    return [
        zero if simple else _stable(structure, primaries)
        for structure, simple in zip(structures, at_zero, strict=True)
    ]


def _stable(structure: Structure, primaries: Sequence[str]) -> RestPositions:
    try:
        stable = [
            place_motion([structure], point.x[None, :, None], primaries)[0, :, 0]
            for point in equilibria(structure).stable
        ]
    except StructureError:
        stable = []
    return RestPositions(np.unique(np.array(stable), axis=0) if stable else np.zeros((1, len(primaries))))
