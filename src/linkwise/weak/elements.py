"""What acts in weak equations: the laws of links, and of links with memory their parts.

A link without memory is one element: its law, a function of its elongation, acts on the masses that it joins. Where states of
a link are measured and enter law and rates linearly,

    f = f0(d, v) + sum_k p_k s_k,    s_j' = g0(d, v) + sum_k q_k s_k,

each summand is an element: f0 and g0 are functions of the elongation, the others of a state as if it were one. A state has an
equation of its own, that of a node without mass, s_j' - g0 - sum_k q_k s_k = 0, in which s_j' is the element with the law v.
A single state that is not measured, z' = g0(d, v) + a z, is eliminated: D - a, applied to the equations, makes p g0 of p z.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from linkwise.errors import IdentificationError, StructureError
from linkwise.expression import (
    Expression,
    Number,
    Program,
    Symbol,
    differentiate,
    multiply,
    substitute,
    symbols,
    to_text,
)
from linkwise.model.law import VARIABLES, Law
from linkwise.model.link import Link
from linkwise.model.structure import Structure, Weights

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
    inner : bool, optional
        Whether it is p g0 of an eliminated state.
    """

    link: int
    law: Law
    reading: Weights
    action: Weights
    inner: bool = False


@dataclass(frozen=True)
class Elimination:
    """A state z' = g0(d, v) + a z of a link that the equations do not contain.

    Attributes
    ----------
    link : int
        The number of the link.
    state : str
        The name of the state.
    relaxation : Law
        a in 1/s, of coefficients of the link alone.
    drive : Law
        g0.
    """

    link: int
    state: str
    relaxation: Law
    drive: Law

    def relaxation_at(
        self, structure: Structure, unknown: Mapping[str, float]
    ) -> tuple[float, dict[str, float]]:
        """The value of a in 1/s, and its derivatives by the coefficients in it, with values of `unknown` ones, NaN for none.

        Raises IdentificationError if one of these has no value.
        """
        link, expression = structure.links[self.link], self.relaxation.expression
        names = self.relaxation.coefficients
        given = {name: coefficient.value for name, coefficient in link.coefficients.items()} | dict(unknown)
        values = np.array([given[name] for name in names], dtype=float).tolist()
        for name, value in zip(names, values, strict=True):
            if np.isnan(value):
                raise IdentificationError(
                    f'link "{link.name}": {name} enters the rate of {self.state}, which is not measured, and needs a start: '
                    f"write {name} = {{ start = ... }} among its coefficients"
                )
        program = Program([expression, *(differentiate(expression, name) for name in names)], names)
        a, *slopes = (float(np.asarray(number)) for number in program(*values))
        return a, dict(zip(names, slopes, strict=True))


def elimination_of(structure: Structure, hidden: Sequence[str]) -> Elimination | None:
    """What eliminates the state whose channel a record does not have, by `hidden` channels; None where all are measured.

    Raises StructureError if a state does not enter its law and the rates linearly, IdentificationError if there are several.
    """
    if not hidden:
        return None
    elements_of(structure)  # refuses states that are not linear, which measuring them would not change
    states = structure.topology.states
    if len(states) > 1:
        raise IdentificationError(
            f"the record has no {', '.join(hidden)}: the weak form eliminates the single state of a structure, and this one "
            f'has {len(states)}; measure all of them, or use method "ml", which finds states',
            arguments=("channels",),
        )
    [(number, name)] = states
    link = structure.links[number]
    rate = dict(link.law.named_rates)[name]
    drive = substitute(rate, {name: Number(0.0)})
    return Elimination(number, name, _law(link, differentiate(rate, name)), _law(link, drive))


def elements_of(structure: Structure, elimination: Elimination | None = None) -> tuple[Element, ...]:
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
        if elimination is not None:
            of_state = differentiate(link.law.expression, elimination.state)
            at_zero = substitute(link.law.expression, {elimination.state: Number(0.0)})
            driven = _law(link, multiply(of_state, elimination.drive.expression))
            elements.append(Element(number, _law(link, at_zero), reading, column))
            of_states.append(Element(number, driven, reading, column, inner=True))
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
