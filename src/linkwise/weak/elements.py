"""What acts in weak equations: the laws of links, and of links with memory their parts.

A link without memory is one element: its law, a function of its elongation, acts on the masses that it joins. Where states of
a link are measured and enter law and rates linearly,

    f = f0(d, v) + sum_k p_k s_k,    s_j' = g0(d, v) + sum_k q_k s_k,

each summand is an element: f0 and g0 are functions of the elongation, the others of a state as if it were one. A state has an
equation of its own, that of a node without mass, s_j' - g0 - sum_k q_k s_k = 0, in which s_j' is the element with the law v.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from linkwise.errors import StructureError
from linkwise.expression import (
    Expression,
    Number,
    Symbol,
    differentiate,
    multiply,
    substitute,
    symbols,
    to_text,
)
from linkwise.model.law import VARIABLES, Law
from linkwise.model.link import Link
from linkwise.model.structure import Structure
from linkwise.model.topology import Weights

_RATE = Law.parse("v")


@dataclass(frozen=True)
class Element:
    """A function of the motion of some nodes that acts in some equations.

    Attributes
    ----------
    link : int
        The number of the link whose coefficients it has.
    law : Law
        The function, of what it reads as d and of the rate of that as v.
    reading : tuple of (int, float)
        Nodes, and their weights in what it reads: masses and modes, after them states of links, and the base.
    action : tuple of (int, float)
        Nodes in whose equations it acts, and its weights there.
    """

    link: int
    law: Law
    reading: Weights
    action: Weights


def elements_of(structure: Structure) -> tuple[Element, ...]:
    """What acts in the weak equations of a structure: an element for each link, in their order, and then those of states.

    Raises StructureError if a state does not enter its law and the rates linearly.
    """
    topology = structure.topology
    node_of_state = {state: structure.size + number for number, state in enumerate(topology.states)}
    base = structure.size + len(topology.states)
    elements, of_states = [], []
    every = zip(structure.links, topology.columns, structure.base_incidence.tolist(), strict=True)
    for number, (link, column, based) in enumerate(every):
        reading = (*column, (base, based)) if based else column
        if not link.law.states:
            elements.append(Element(number, link.law, reading, column))
            continue
        nodes = {name: node_of_state[number, name] for name in link.law.states}
        whole, *others = _linear_parts(link, number, link.law.expression, reading, column, nodes)
        elements.append(whole)
        of_states += others
        for name, rate in link.law.named_rates:
            own = nodes[name]
            of_states.append(Element(number, _RATE, ((own, 1.0),), ((own, 1.0),)))
            of_states += _linear_parts(link, number, rate, reading, ((own, -1.0),), nodes)
    return (*elements, *of_states)


def _linear_parts(
    link: Link, number: int, expression: Expression, reading: Weights, action: Weights, nodes: dict[str, int]
) -> Iterator[Element]:
    """What an expression in d, v and states of a link adds: the part without states, and that of each state."""
    at_zero = substitute(expression, dict.fromkeys(nodes, Number(0.0)))
    yield Element(number, _law(link, at_zero), reading, action)
    for name, node in nodes.items():
        slope = differentiate(expression, name)
        if set(symbols(slope)) & {*VARIABLES, *nodes}:
            raise StructureError(
                f"the law has memory (state {name}), which is not supported in the weak form where a state does not enter "
                "its law and the rates linearly; maximum likelihood takes it",
                f'link "{link.name}"',
            )
        if slope != Number(0.0):
            yield Element(number, _law(link, multiply(slope, Symbol("d"))), ((node, 1.0),), action)


def _law(link: Link, expression: Expression) -> Law:
    """A law with those coefficients of a link that are in an expression."""
    names = set(symbols(expression))
    used = tuple(name for name in link.law.coefficients if name in names)
    return Law(to_text(expression), expression, used)
