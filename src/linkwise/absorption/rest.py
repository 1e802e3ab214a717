"""Where the primary masses come to rest."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from linkwise.equilibria import equilibria
from linkwise.errors import StructureError
from linkwise.structure import Structure

Floats = NDArray[np.float64]


class RestingPlaces:
    """The stable equilibria of a structure without its sinks, base at zero.

    A sink on whose mass nothing else hangs exerts no force at rest, so its host rests where it would without the sink. A
    structure with no stable equilibrium, or with too many to count, is looked at from zero.
    """

    def __init__(self, structure: Structure, primaries: Sequence[str]) -> None:
        columns = [structure.mass_names.index(name) for name in primaries]
        try:
            found = [point.x[columns] for point in equilibria(structure).stable]
        except StructureError:
            found = []
        self.places: Floats = np.array(found) if found else np.zeros((1, len(columns)))

    def nearest(self, x: Floats) -> Floats:
        """(P, W) m: for each run the place nearest to its last displacements `x` (P, W)."""
        apart = np.square(self.places[:, :, None] - x[None]).sum(axis=1)
        return np.ascontiguousarray(self.places[apart.argmin(axis=0)].T)
