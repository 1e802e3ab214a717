"""Monomials: products of powers of named variables, counted, named and evaluated (the paper's Eq. 3)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement
from math import comb

import numpy as np
from numpy.typing import NDArray

from linkwise.errors import IdentificationError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Monomials:
    """All monomials in `variables` (q names) up to `order`, the constant "1" included, degree by degree.

    `len` counts them, C(q + order, order), without building any. Raises IdentificationError for an order below 0 or a
    name given twice.
    """

    variables: tuple[str, ...]
    order: int

    def __post_init__(self) -> None:
        if self.order < 0 or len(set(self.variables)) < len(self.variables):
            raise IdentificationError(
                f"no monomials of order {self.order} in {', '.join(self.variables)}: "
                "the order must be 0 or more and the names must differ"
            )

    def __len__(self) -> int:
        return comb(len(self.variables) + self.order, self.order)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """(p,) names such as "1", "x1", "x1*v2", "x1**2*x2"."""
        return tuple(
            _product(self.variables, chosen)
            for degree in range(self.order + 1)
            for chosen in combinations_with_replacement(range(len(self.variables)), degree)
        )

    def evaluate(self, values: Array) -> Array:
        """Columns (B, p) in Fortran order at values (B, q) of the variables, each one product away from a column before it."""
        samples, count = values.shape
        columns = np.empty((len(self), samples))
        columns[0] = 1.0
        variables = np.ascontiguousarray(values.T)
        last = 1  # where the columns of the degree before end
        for degree in range(1, self.order + 1):
            position = last
            for variable in range(count):
                # Of the degree before, those that begin with this variable or a later one stand at the end.
                many = comb(count - variable + degree - 2, degree - 1)
                np.multiply(
                    columns[last - many : last], variables[variable], out=columns[position : position + many]
                )
                position += many
            last = position
        return columns.T


def tags(masses: tuple[str, ...]) -> tuple[str, ...]:
    """What stands after x and v in the names of states: the number in m1, m2, ..., else "_" and the whole name."""
    numbered = all(mass[:1] == "m" and mass[1:].isdecimal() for mass in masses)
    return tuple(mass[1:] if numbered else f"_{mass}" for mass in masses)


def _product(variables: tuple[str, ...], chosen: tuple[int, ...]) -> str:
    """The name of a monomial, its variables by rising index: (0, 0, 1) is "x1**2*v1"."""
    powers = {index: chosen.count(index) for index in chosen}
    factors = [variables[index] + (f"**{power}" if power > 1 else "") for index, power in powers.items()]
    return "*".join(factors) or "1"
