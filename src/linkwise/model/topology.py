"""A structure as arrays: the one numbering of masses, points, ground and base, and the links grouped by law."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy

from linkwise.arrays import Floats, Indices
from linkwise.errors import StructureError
from linkwise.expression import Expression
from linkwise.model.host import Host
from linkwise.model.law import Law
from linkwise.model.link import BASE, GROUND, Link

GROUND_INDEX = -1
BASE_INDEX = -2
FIRST_POINT = -3
"""The number of the first point of a host; those of others go down from there."""

Weights = tuple[tuple[int, float], ...]
"""How a place moves: numbers of masses or modes, and their parts in it."""


class LinkShape(NamedTuple):
    """What the equations of motion of a link are compiled from.

    Attributes
    ----------
    weights : tuple of (int, float)
        Numbers of the masses and modes in its elongation, and their weights: the column of the incidence.
    base : float
        Weight of the base in its elongation.
    law : Expression
        The law, parsed.
    rates : tuple of (str, Expression)
        The rate of each state of a link with memory, by name.
    signals : tuple of str
        The recorded signals that the law or a rate names.

    Examples
    --------
    >>> import linkwise as lw
    >>> masses, shapes = lw.bnes_chain(2).shape_key
    >>> masses, shapes[1].weights, shapes[1].states
    (2, ((1, 1.0), (0, -1.0)), ())
    """

    weights: Weights
    base: float
    law: Expression
    rates: tuple[tuple[str, Expression], ...] = ()
    signals: tuple[str, ...] = ()

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
        The number of each mass by name, from 0; that of "ground" is -1, of "base" -2, of points of hosts from -3 down.
    ends : array of int, shape (L, 2)
        Numbers of the first and the second end of each link.
    by_law : tuple of (Law, array of int)
        Each law with the numbers (m,) of its links, in order of first appearance.
    states : tuple of (int, str)
        The states (S,) of links with memory, each as number of the link and name.
    points : tuple of tuple of (int, float)
        For each point of a host the numbers of its modes and their shapes there; then modes in the other direction.

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
    points: tuple[Weights, ...] = ()

    @classmethod
    def of(cls, mass_names: Sequence[str], links: Sequence[Link], hosts: Sequence[Host] = ()) -> Topology:
        """Number the masses and links of a structure.

        Parameters
        ----------
        mass_names : sequence of str
            The n masses, in order.
        links : sequence of Link
            The L links.
        hosts : sequence of Host, optional
            The hosts, whose modes are among the masses.

        Returns
        -------
        Topology
            The numbering.

        Raises
        ------
        StructureError
            If no motion of a host stretches a link.
        """
        index = {name: number for number, name in enumerate(mass_names)}
        index |= {GROUND: GROUND_INDEX, BASE: BASE_INDEX}
        parts = {point: host.shape(point).items() for host in hosts for point in host.points}
        shapes = {
            point: tuple((index[mode], part) for mode, part in own if part) for point, own in parts.items()
        }
        shapes |= {place: ((index[mode], -1.0),) for host in hosts for place, mode in host.negated.items()}
        index |= {point: FIRST_POINT - number for number, point in enumerate(shapes)}
        ends = np.array([[index[end] for end in link.between] for link in links], dtype=np.intp)
        ends = ends.reshape(-1, 2)
        ends.flags.writeable = False
        members: dict[Law, list[int]] = {}
        for number, link in enumerate(links):
            members.setdefault(link.law, []).append(number)
        by_law = tuple((law, np.array(numbers, dtype=np.intp)) for law, numbers in members.items())
        states = tuple((number, name) for number, link in enumerate(links) for name in link.law.states)
        topology = cls(index, ends, by_law, states, tuple(shapes.values()))
        for link, column in zip(links, topology.columns, strict=True) if hosts else ():
            if not column:
                message = (
                    f"both ends, {' and '.join(link.between)}, move alike in every mode: nothing stretches it"
                )
                raise StructureError(message, f'link "{link.name}"')
        return topology

    @property
    def dimension(self) -> int:
        """Number of displacements, velocities and states of links, 2n + S."""
        return 2 * self.size + len(self.states)

    @property
    def size(self) -> int:
        """Number of masses and modes."""
        return len(self.index) - 2 - len(self.points)

    def weights(self, number: int) -> Weights:
        """How a mass, a point or a support moves.

        Parameters
        ----------
        number : int
            Its number.

        Returns
        -------
        tuple of (int, float)
            Numbers of masses and modes, and their parts in its motion; none for the ground and the base.
        """
        if number >= 0:
            return ((number, 1.0),)
        return self.points[FIRST_POINT - number] if number <= FIRST_POINT else ()

    def row(self, name: str) -> Floats:
        """How a mass or a point moves, as an array.

        Parameters
        ----------
        name : str
            Its name.

        Returns
        -------
        array of shape (n,)
            The parts of masses and modes in its motion.
        """
        row = np.zeros(self.size)
        for number, part in self.weights(self.index[name]):
            row[number] = part
        return row

    @cached_property
    def columns(self) -> tuple[Weights, ...]:
        """For each link the masses and modes in its elongation, and their weights."""
        columns = []
        for first, second in self.ends.tolist():
            column = dict(self.weights(first))
            for number, part in self.weights(second):
                column[number] = column.get(number, 0.0) - part
            columns.append(tuple((number, part) for number, part in column.items() if part))
        return tuple(columns)

    @cached_property
    def incidence(self) -> scipy.sparse.csr_array:
        """Incidence matrix B of masses and modes, sparse, shape (n, L)."""
        parts = [(row, link, part) for link, column in enumerate(self.columns) for row, part in column]
        rows, links, weights = zip(*parts, strict=True) if parts else ((), (), ())
        return scipy.sparse.csr_array((weights, (rows, links)), shape=(self.size, len(self.ends)))

    @cached_property
    def base_incidence(self) -> Floats:
        """Incidence e of the base, shape (L,)."""
        on_base = self.ends == BASE_INDEX
        incidence: Floats = on_base[:, 0].astype(float) - on_base[:, 1]
        incidence.flags.writeable = False
        return incidence
