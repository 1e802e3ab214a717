"""Layout of weak equations, from the structure alone: what acts in them, their terms, the parameters of these, and where.

A link without memory is one element: its law, a function of its elongation, acts on the masses that it joins. Where states of
a link are measured and enter law and rates linearly,

    f = f0(d, v) + sum_k p_k s_k,    s_j' = g0(d, v) + sum_k q_k s_k,

each summand is an element: f0 and g0 are functions of the elongation, the others of a state as if it were one. A state has an
equation of its own, that of a node without mass, s_j' - g0 - sum_k q_k s_k = 0, in which s_j' is the element with the law v.

The layout is computed once per structure, so that a study of many records of one structure does not repeat it. On a record,
terms of laws are functions of the noisy elongations (`LawTerms`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np

from linkwise.arrays import Bools, Floats, Indices
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
from linkwise.model.coefficient import MASS
from linkwise.model.law import VARIABLES, Law
from linkwise.model.link import Link
from linkwise.model.structure import Structure, Weights
from linkwise.weak.displacements import MeasuredDisplacements
from linkwise.weak.weak_form import (
    PHI,
    PHI_2,
    PatchLayout,
    TermCoefficients,
    WeakLawGroup,
    WeakPart,
    weak_law,
)

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
    """A law with those coefficients and signals of a link that are in an expression."""
    names = set(symbols(expression))
    used = tuple(name for name in link.law.coefficients if name in names)
    signals = tuple(pair for pair in link.law.signal_units if pair[0] in names)
    return Law(to_text(expression), expression, used, signal_units=signals)


@dataclass(frozen=True, eq=False)
class StructureLayout:
    """Parameters, masses and links of a structure by index.

    Attributes
    ----------
    structure : Structure
        The structure.
    names : tuple of str
        Names of the p parameters.
    parameter_index : mapping of (int, str) to int
        Index of the parameter of each unknown coefficient, given as (link, or -1 - mass; name of the coefficient).
    elements : tuple of Element
        What acts in the equations: one element for each link, and those of states.
    """

    structure: Structure
    names: tuple[str, ...]
    parameter_index: Mapping[tuple[int, str], int]
    elements: tuple[Element, ...]
    _layouts: dict[tuple[tuple[int, ...], tuple[int, ...]], PatchLayout] = field(
        default_factory=dict, repr=False
    )

    @property
    def equations(self) -> int:
        """Number of nodes with an equation: n masses and modes, and S states of links; the base is the next node."""
        return self.structure.size + len(self.structure.topology.states)

    @cached_property
    def has_parameters(self) -> Bools:
        """(n + S,) whether the equation of a node has a parameter."""
        known = self.parameter_index
        unknown = [any((one.link, name) in known for name in one.law.coefficients) for one in self.elements]
        weighed = [(-1 - node, MASS) in known for node in range(self.equations)]
        return np.logical_or(self.action[:, unknown].any(axis=1), weighed)

    @cached_property
    def needs_rate(self) -> Bools:
        """(n + S,) whether the equation of a node has a law that needs a smoothed v."""
        rated = np.zeros(len(self.elements), dtype=bool)
        for group in self.groups(range(len(self.elements))):
            rated[group.links] = group.weak_law.needs_rate
        return np.asarray(self.action[:, rated].any(axis=1))

    @cached_property
    def nonlinear(self) -> frozenset[int]:
        """Numbers of the parameters that enter an element nonlinearly."""
        slots = ((element.link, name) for element in self.elements for name in element.law.nonlinear)
        return frozenset(self.parameter_index[slot] for slot in slots if slot in self.parameter_index)

    def values(self, given: Mapping[str, float]) -> Floats:
        """(p,) values of the parameters: those given by name, else the starts, else NaN."""
        parameters = self.structure.parameters
        return np.array([given.get(parameter.name, parameter.start) for parameter in parameters], dtype=float)

    @cached_property
    def neighbourhoods(self) -> Bools:
        """(n + S, n + S + 2) for each node with an equation, itself and the nodes that the elements in it read."""
        read = np.abs(self.action) @ np.abs(self.reading)
        return np.asarray(read + np.eye(*read.shape) > 0.0)

    @cached_property
    def reading(self) -> Floats:
        """(E, n + S + 2) weights of the nodes, the base and the ground in what elements read."""
        reading = np.zeros((len(self.elements), self.equations + 2))
        for row, element in zip(reading, self.elements, strict=True):
            for node, weight in element.reading:
                row[node] = weight
        return reading

    @cached_property
    def action(self) -> Floats:
        """(n + S, E) how elements act in the equations."""
        action = np.zeros((self.equations, len(self.elements)))
        for column, element in zip(action.T, self.elements, strict=True):
            for node, weight in element.action:
                column[node] = weight
        return action

    def elongation_variance(self, motion: MeasuredDisplacements, *, floored: bool = False) -> Floats:
        """(E,) variances in m^2 of the noise in what elements read, if `floored` at least those of quadrature errors."""
        variance = motion.floored_variance if floored else motion.source_variance
        return np.asarray((self.reading @ motion.source_weights) ** 2 @ variance)

    def elongations(self, displacements: Floats, elements: Sequence[int] | Indices) -> Floats:
        """(m, N) what m elements read, elongations or states, from displacements (k, N) of nodes or what is linear in them."""
        return np.asarray(self.reading[elements] @ displacements)

    def groups(self, elements: Sequence[int] | Indices) -> Iterator[WeakLawGroup]:
        """The elements of these numbers, grouped by law."""
        by_law: dict[tuple[Law, frozenset[str]], list[int]] = {}
        indices = np.array(elements, dtype=np.intp)
        for position, index in enumerate(indices.tolist()):
            law, link = self.elements[index].law, self.elements[index].link
            free = frozenset(name for name in law.nonlinear if (link, name) in self.parameter_index)
            by_law.setdefault((law, free), []).append(position)
        for (law, free), positions in by_law.items():
            which = [self.elements[index].link for index in indices[positions].tolist()]
            coefficients = {
                name: self._numbers((index, name) for index in which) for name in law.coefficients
            }
            yield WeakLawGroup(weak_law(law, free), np.array(positions), indices[positions], coefficients)

    def layout(self, masses: Iterable[int], forced: Iterable[int]) -> PatchLayout:
        """Layout of the equations of some masses, those `forced` with an applied force; computed once for equal arguments."""
        key = (tuple(masses), tuple(forced))
        if key not in self._layouts:
            self._layouts[key] = self._layout(np.array(key[0]), key[1])
        return self._layouts[key]

    def _layout(self, masses: Indices, forced: tuple[int, ...]) -> PatchLayout:
        links = np.flatnonzero(self.action[masses].any(axis=0))
        groups = tuple(self.groups(links))
        parts, numbers, chosen, stop = [], [], [], 0
        for group in groups:
            for part in group.weak_law.parts:
                start, stop = stop, stop + len(group.links)
                parts.append((part, slice(start, stop)))
                numbers.append(_multipliers(group, part))
                chosen.append(group.links)
        inertia = self._numbers((-1 - mass, MASS) for mass in masses.tolist())
        forces = TermCoefficients(np.full(len(forced), -1), np.ones(len(forced)))
        sizes = [*map(len, chosen), len(masses), len(forced)]
        numbered = np.concatenate([*chosen, links])
        # of elements and masses; what the former read of them, and how these act on the masses
        nodes = np.union1d(masses, np.flatnonzero(self.reading[numbered].any(axis=0)))
        reading, acting = self.reading[np.ix_(numbered, nodes)], self.action[np.ix_(masses, numbered)]
        # whose equation a term is in
        own = np.concatenate([masses, np.array(forced, dtype=int)])
        displaced = (own[:, None] == nodes).astype(float)
        displaced[len(masses) :] = 0.0
        return PatchLayout(
            masses=masses,
            links=links,
            forced=forced,
            groups=groups,
            law_parts=tuple(parts),
            inertia=inertia,
            kernel=np.repeat([*(part.kernel for part, _ in parts), PHI_2, PHI], sizes),
            signs=np.hstack([acting[:, :stop], masses[:, None] == own]),
            coefficients=TermCoefficients.joined([*numbers, inertia, forces]),
            increment=np.repeat([*(part.increment for part, _ in parts), False, False], sizes),
            nodes=nodes,
            incidence=np.concatenate([reading[:stop], displaced]),
            readings=reading[stop:],
            link_incidence=acting[:, stop:],
        )

    def _numbers(self, where: Iterable[tuple[int, str]]) -> TermCoefficients:
        """The coefficients of these slots: numbers of parameters, or known values."""
        slots = list(where)
        links, masses = self.structure.links, self.structure.masses
        of_masses = [*(mass.mass.value for mass in masses), *(0.0 for _ in self.structure.topology.states)]
        known = [
            links[index].coefficients[name].value if index >= 0 else of_masses[-1 - index]
            for index, name in slots
        ]
        parameter = [self.parameter_index.get(slot, -1) for slot in slots]
        return TermCoefficients(np.array(parameter), np.array(known, dtype=float))


@lru_cache(maxsize=32)
def structure_layout(structure: Structure) -> StructureLayout:
    """Layout of a structure; the same object for equal arguments."""
    parameters = structure.parameters
    return StructureLayout(
        structure=structure,
        names=tuple(parameter.name for parameter in parameters),
        parameter_index={
            slot: number for number, parameter in enumerate(parameters) for slot in parameter.members
        },
        elements=elements_of(structure),
    )


def _multipliers(group: WeakLawGroup, part: WeakPart) -> TermCoefficients:
    """Multipliers of the terms of a part at the links of its group."""
    if part.coefficient is None:
        return TermCoefficients(np.full(len(group.links), -1), np.ones(len(group.links)))
    return group.coefficients[part.coefficient]


@dataclass(frozen=True, eq=False)
class LawTerms:
    """sign * int kernel h(d) of one part of a law, at m links.

    Attributes
    ----------
    part : WeakPart
        The part.
    links : array of int, shape (m,)
        Indices of the links.
    terms : slice
        The terms in the layout.
    derivatives : tuple
        h, h', h'', ...: arrays of shape (m, N) over all samples, numbers where constant.
    rate_slope : array of shape (m, N) or None
        The mean slope of h with respect to a noisy v; None for parts that need no rate.
    """

    part: WeakPart
    links: Indices
    terms: slice
    derivatives: tuple[Floats | float, ...]
    rate_slope: Floats | None = None

    @property
    def slope(self) -> Floats | float:
        """First derivative h'."""
        return self.derivatives[1] if len(self.derivatives) > 1 else 0.0
