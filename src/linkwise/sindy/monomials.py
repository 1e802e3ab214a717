"""Monomials: products of powers of named variables, counted, named and evaluated (the paper's Eq. 3)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement
from math import comb

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.errors import IdentificationError


@dataclass(frozen=True)
class Monomials:
    """All monomials in some variables up to an order, the constant "1" included, degree by degree.

    ``len`` counts them without forming any: sum over k of C(q, k) C(order, k), k up to `mixing`, which is C(q + order, order)
    without a limit.

    Parameters
    ----------
    variables : tuple of str
        Names of the q variables.
    order : int
        Highest degree.
    mixing : int, optional
        Largest number of different variables in a monomial: 1 keeps powers such as x1**3, 2 adds x1**2*v1 but not x1*v1*x2.

    Raises
    ------
    IdentificationError
        If `order` is negative, `mixing` is not positive or a name is listed twice.
    """

    variables: tuple[str, ...]
    order: int
    mixing: int | None = None

    def __post_init__(self) -> None:
        if self.order < 0 or len(set(self.variables)) < len(self.variables):
            raise IdentificationError(
                f"monomials need an order of 0 or more and names that differ, got order {self.order} in "
                f"{', '.join(self.variables)}"
            )
        if self.mixing is not None and self.mixing < 1:
            raise IdentificationError(
                f"mixing must be positive, got {self.mixing}; mixing=1 keeps powers of single variables, None all monomials"
            )

    def __len__(self) -> int:
        return sum(comb(len(self.variables), k) * comb(self.order, k) for k in range(self._limit + 1))

    @property
    def _limit(self) -> int:
        return self.order if self.mixing is None else min(self.mixing, self.order)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """(p,) names such as "1", "x1", "x1*v2", "x1**2*x2"."""
        return tuple(_product(self.variables, chosen) for degree in self._degrees for chosen in degree)

    def evaluate(self, values: Floats) -> Floats:
        """Evaluate all monomials, each as one product of a variable and a monomial of lower degree.

        Parameters
        ----------
        values : array of shape (B, q)
            Values of the variables.

        Returns
        -------
        array of shape (B, p)
            The columns, in Fortran order.
        """
        columns = np.empty((len(self), len(values)))
        columns[0] = 1.0
        variables = np.ascontiguousarray(values.T)
        first = 1
        for variable, parents, many in self._products:
            np.multiply(columns[parents], variables[variable], out=columns[first : first + many])
            first += many
        return columns.T

    @cached_property
    def _degrees(self) -> list[list[tuple[int, ...]]]:
        """The monomials of each degree as rising indices of their variables."""
        indices = range(len(self.variables))
        return [
            [
                chosen
                for chosen in combinations_with_replacement(indices, degree)
                if len(set(chosen)) <= self._limit
            ]
            for degree in range(self.order + 1)
        ]

    @cached_property
    def _products(self) -> list[tuple[int, slice | Indices, int]]:
        """In the order of the columns: a variable, the columns of the degree below that it multiplies, and their number.

        These are the monomials that begin with this variable or a later one, where `mixing` admits the product.
        """
        steps: list[tuple[int, slice | Indices, int]] = []
        first = 0
        for before in self._degrees[:-1]:
            for variable in range(len(self.variables)):
                parents = np.array(
                    [
                        first + index
                        for index, chosen in enumerate(before)
                        if variable <= min(chosen, default=variable)
                        and len({variable, *chosen}) <= self._limit
                    ],
                    dtype=np.intp,
                )
                if parents.size:
                    last = int(parents[-1]) + 1
                    run = last - int(parents[0]) == parents.size
                    steps.append((variable, slice(int(parents[0]), last) if run else parents, parents.size))
            first += len(before)
        return steps


def tags(masses: tuple[str, ...]) -> tuple[str, ...]:
    """Suffixes of x and v in the names of states.

    Parameters
    ----------
    masses : tuple of str
        Names of the masses.

    Returns
    -------
    tuple of str
        The numbers of m1, m2, ... where all names have this form, else "_" and the whole name.
    """
    numbered = all(mass[:1] == "m" and mass[1:].isdecimal() for mass in masses)
    return tuple(mass[1:] if numbered else f"_{mass}" for mass in masses)


def _product(variables: tuple[str, ...], chosen: tuple[int, ...]) -> str:
    """The name of a monomial, its variables by rising index: (0, 0, 1) is "x1**2*v1"."""
    powers = {index: chosen.count(index) for index in chosen}
    factors = [variables[index] + (f"**{power}" if power > 1 else "") for index, power in powers.items()]
    return "*".join(factors) or "1"
