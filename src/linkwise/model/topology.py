"""A structure as arrays: the one numbering of masses, ground and base, and the links grouped by law."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from linkwise.arrays import Indices
from linkwise.expression import Expression
from linkwise.model.law import Law
from linkwise.model.link import BASE, GROUND, Link

GROUND_INDEX = -1
BASE_INDEX = -2


class LinkShape(NamedTuple):
    """What the equations of motion of a link are compiled from.

    Attributes
    ----------
    first, second : int
        Numbers of the ends, as in `Topology.ends`.
    law : Expression
        The law, parsed.
    rates : tuple of (str, Expression)
        The rate of each state of a link with memory, by name.

    Examples
    --------
    >>> import linkwise as lw
    >>> masses, shapes = lw.bnes_chain(2).shape_key
    >>> masses, shapes[0].first, shapes[0].states
    (2, 0, ())
    """

    first: int
    second: int
    law: Expression
    rates: tuple[tuple[str, Expression], ...] = ()

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states."""
        return tuple(name for name, _ in self.rates)


@dataclass(frozen=True, eq=False)
class Topology:
    """Which links join which masses, by number.

    Attributes
    ----------
    index : mapping of str to int
        The number of each mass by name, from 0; that of "ground" is -1, of "base" -2.
    ends : array of int, shape (L, 2)
        Numbers of the first and the second end of each link.
    by_law : tuple of (Law, array of int)
        Each law with the numbers (m,) of its links, in order of first appearance.
    states : tuple of (int, str)
        The states (S,) of links with memory, each as number of the link and name.

    Examples
    --------
    >>> import linkwise as lw
    >>> topology = lw.bnes_chain(4).topology
    >>> topology.size, topology.ends.tolist()
    (4, [[0, -1], [1, 0], [2, 0], [3, 2]])
    """

    index: Mapping[str, int]
    ends: Indices
    by_law: tuple[tuple[Law, Indices], ...]
    states: tuple[tuple[int, str], ...] = ()

    @classmethod
    def of(cls, mass_names: Sequence[str], links: Sequence[Link]) -> Topology:
        """Number the masses and links of a structure.

        Parameters
        ----------
        mass_names : sequence of str
            The n masses, in order.
        links : sequence of Link
            The L links.

        Returns
        -------
        Topology
            The numbering.
        """
        index = {name: number for number, name in enumerate(mass_names)}
        index |= {GROUND: GROUND_INDEX, BASE: BASE_INDEX}
        ends = np.array([[index[end] for end in link.between] for link in links], dtype=np.intp)
        ends = ends.reshape(-1, 2)
        ends.flags.writeable = False
        members: dict[Law, list[int]] = {}
        for number, link in enumerate(links):
            members.setdefault(link.law, []).append(number)
        by_law = tuple((law, np.array(numbers, dtype=np.intp)) for law, numbers in members.items())
        states = tuple((number, name) for number, link in enumerate(links) for name in link.law.states)
        return cls(index, ends, by_law, states)

    @property
    def dimension(self) -> int:
        """Number of displacements, velocities and states of links, 2n + S."""
        return 2 * self.size + len(self.states)

    @property
    def size(self) -> int:
        """Number of masses."""
        return len(self.index) - 2

    @cached_property
    def links_at(self) -> tuple[tuple[int, ...], ...]:
        """Numbers of the links that have each mass as an end, (n,)."""
        links: list[list[int]] = [[] for _ in range(self.size)]
        for number, pair in enumerate(self.ends.tolist()):
            for end in pair:
                if end >= 0:
                    links[end].append(number)
        return tuple(tuple(numbers) for numbers in links)
