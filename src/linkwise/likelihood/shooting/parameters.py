"""The linear map from parameters to the coefficients of links and to masses."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.likelihood.shooting.law_group import LawGroup
from linkwise.model.names import MASS, Name
from linkwise.model.structure import Structure


@dataclass(frozen=True, eq=False)
class Parameters:
    """Parameters theta (p,): coefficients = constant + map @ theta, masses = mass_constant + mass_map @ theta.

    Attributes
    ----------
    names, units : tuple of Name, of str
        Names of the parameters and their SI units.
    constant, map : array of shape (c,), (c, p)
        Map to the c coefficients.
    mass_constant, mass_map : array of shape (n,), (n, p)
        Map to the masses.
    stated_masses : array of shape (n,)
        Values of the masses in the structure, 0 of those without one.
    lower, upper : array of shape (p,)
        Bounds.
    """

    names: tuple[Name, ...]
    units: tuple[str, ...]
    constant: Floats
    map: Floats
    mass_constant: Floats
    mass_map: Floats
    stated_masses: Floats
    lower: Floats
    upper: Floats

    @property
    def size(self) -> int:
        """Number of parameters p."""
        return len(self.names)

    @classmethod
    def of(cls, structure: Structure, groups: list[LawGroup], order: Indices, rows: int) -> Parameters:
        """Those of a structure whose links, in this `order`, have `rows` coefficients in the groups."""
        position_of = {int(index): position for position, index in enumerate(order)}
        row_of = {}
        for group in groups:
            for index in order[group.links]:
                for name in group.law.coefficients:
                    row_of[int(index), name] = (
                        group.row(name).start + position_of[int(index)] - group.links.start
                    )
        free = structure.parameters
        map_, mass_map = np.zeros((rows, len(free))), np.zeros((structure.size, len(free)))
        for column, parameter in enumerate(free):
            for index, name in parameter.members:
                if index < 0 and name == MASS:
                    mass_map[-1 - index, column] = 1.0
                elif index >= 0:
                    map_[row_of[index, name], column] = 1.0
        constant = np.zeros(rows)
        for (index, name), row in row_of.items():
            constant[row] = 0.0 if map_[row].any() else structure.links[index].coefficients[name].value or 0.0
        masses = np.array([mass.mass.value or 0.0 for mass in structure.masses])
        return cls(
            names=tuple(parameter.name for parameter in free),
            units=tuple(parameter.unit for parameter in free),
            constant=constant,
            map=map_,
            mass_constant=np.where(mass_map.any(axis=1), 0.0, masses),
            mass_map=mass_map,
            stated_masses=masses,
            lower=np.array([parameter.lower for parameter in free]),
            upper=np.array([parameter.upper for parameter in free]),
        )

    def known(self, coefficients: Floats, masses: Floats) -> Parameters:
        """None, with all coefficients (c,) and masses (n,) known."""
        nothing = np.empty(0)
        return replace(
            self,
            names=(),
            units=(),
            constant=coefficients,
            map=np.empty((len(coefficients), 0)),
            mass_constant=masses,
            mass_map=np.empty((len(masses), 0)),
            lower=nothing,
            upper=nothing,
        )
