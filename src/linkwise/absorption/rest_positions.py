"""Where the primary masses come to rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from linkwise.absorption.potentials import Potentials
from linkwise.analysis.equilibria import equilibria
from linkwise.arrays import Floats
from linkwise.errors import StructureError
from linkwise.model.structure import Structure


@dataclass(frozen=True, eq=False)
class RestPositions:
    """The displacements (E, P) in m of the primary masses in the stable equilibria of a structure, its base at zero."""

    places: Floats

    def nearest(self, x: Floats) -> Floats:
        """(P,) m: the place nearest to last displacements `x` (P,)."""
        return np.asarray(self.places[np.square(self.places - x).sum(axis=1).argmin()])


def rest_positions(structures: Sequence[Structure], primaries: Sequence[str]) -> list[RestPositions]:
    """For each of several structures of one shape.

    Where all links have their only well at zero elongation, that is zero; else equilibria are searched, and a structure with
    none that is stable, or with too many to count, is looked at from zero.
    """
    potentials = Potentials.of(structures)
    plain = np.ones(len(structures), dtype=bool)
    for number, each in enumerate(potentials.barriers):
        plain &= (each.floor == 0.0) & ~np.isfinite(each.tops).any(axis=1)
        plain &= np.array([float(one.links[number].force(0.0)) == 0.0 for one in structures])
    zero = RestPositions(np.zeros((1, len(primaries))))
    pairs = zip(structures, plain, strict=True)
    return [zero if simple else _searched(structure, primaries) for structure, simple in pairs]


def _searched(structure: Structure, primaries: Sequence[str]) -> RestPositions:
    columns = [structure.mass_names.index(name) for name in primaries]
    try:
        found = [point.x[columns] for point in equilibria(structure).stable]
    except StructureError:
        found = []
    return RestPositions(np.unique(np.array(found), axis=0) if found else np.zeros((1, len(columns))))
