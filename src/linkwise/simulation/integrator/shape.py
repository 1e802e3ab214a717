"""What equations of motion are compiled for, and the layout of their run-time parameters."""

from __future__ import annotations

from typing import NamedTuple

from linkwise.expression import FUNCTIONS, Call, Expression, Number, add, symbols, walk
from linkwise.model.law_text import VARIABLES
from linkwise.model.topology import LinkShape, Weights

SCALE = 2.0**-40  # m, a power of two so that scaling causes no rounding


BASE_INPUT: Weights = ()
"""Where the motion of the base acts: on no mass but through links."""


class SystemShape(NamedTuple):
    """The key of compiled equations of motion; structures of equal shape share compiled code.

    `masses` is their number; `links` has for each link its weights, its law and the rates of its states, with masses numbered
    as in `Structure.topology`; `inputs` has for each driven place the weights of the masses, `BASE_INPUT` for the base, and an
    expression of t or, for a piecewise polynomial, its order.
    """

    masses: int
    links: tuple[LinkShape, ...]
    inputs: tuple[tuple[Weights, Expression | int], ...] = ()

    @property
    def states(self) -> list[tuple[int, str]]:
        """The states of links, each as number of the link and name, in the order of the state vector."""
        return [(number, name) for number, link in enumerate(self.links) for name in link.states]

    @property
    def dimension(self) -> int:
        """Length of the state vector: displacements, velocities and states of links, 2n + S."""
        return 2 * self.masses + len(self.states)


class ParameterLayout:
    """Slices of the vector of run-time parameters of a shape.

    In this order: `values`, the coefficients link by link in the order of the law; `branches`, the sign of every kink;
    `unwatched`, an offset for every kink whose crossings are not to be detected; `pieces`, for every piecewise input its start
    and its coefficients, lowest power first; `inverse_masses`, 1/(m s) of every mass. The last are used by every integrator,
    as heyoka requires of the last parameter.
    """

    def __init__(self, shape: SystemShape, kinks: int) -> None:
        self.coefficients = [coefficient_names(link) for link in shape.links]
        self.values = slice(0, sum(len(names) for names in self.coefficients))
        self.branches = slice(self.values.stop, self.values.stop + kinks)
        self.unwatched = slice(self.branches.stop, self.branches.stop + kinks)
        self.inputs: list[slice] = []
        end = self.unwatched.stop
        for _, kind in shape.inputs:
            width = kind + 2 if isinstance(kind, int) else 0
            self.inputs.append(slice(end, end + width))
            end += width
        self.pieces = slice(self.unwatched.stop, end)
        self.inverse_masses = slice(end, end + shape.masses)
        self.size = end + shape.masses


def coefficient_names(link: LinkShape) -> tuple[str, ...]:
    """The coefficients of a law, and of the rates of its states, in order of appearance."""
    trees = (link.law, *(rate for _, rate in link.rates))
    names = dict.fromkeys(name for tree in trees for name in symbols(tree))
    return tuple(name for name in names if name not in (*VARIABLES, *link.states))


def flat_ends(tree: Expression) -> list[Expression]:
    """Expressions whose zeros are the ends of the flat parts of functions such as exp and tanh.

    On a flat part derivatives are lost in rounding, so a Taylor step taken there would pass over what follows: a pulse in
    time, or the reversal of a steep F*tanh(v/s). Steps have to end there.
    """
    return [
        add(argument, Number(-end))
        for node in walk(tree)
        if isinstance(node, Call)
        for argument in node.arguments
        for end in FUNCTIONS[node.function].flat
    ]
