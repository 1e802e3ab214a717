"""Layout of weak equations, from the structure alone: their terms, the parameters of these, and where they act.

It is computed once per structure, so that a study of many records of one structure does not repeat it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.model.host_support import refuse_hosts
from linkwise.model.law import Law
from linkwise.model.memory_support import refuse_memory
from linkwise.model.structure import Structure
from linkwise.model.topology import GROUND_INDEX
from linkwise.weak.patch_layout import GroupTerms, PatchLayout, TermCoefficients, WeakLawGroup
from linkwise.weak.weak_form import PHI, PHI_2, WeakPart, weak_law


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
    ends : array of int, shape (L, 2)
        Nodes at the ends of the links: masses, -1 the ground, -2 the base.
    links_at : tuple of tuple of int
        The links of each mass.
    """

    structure: Structure
    names: tuple[str, ...]
    parameter_index: Mapping[tuple[int, str], int]
    ends: Indices
    links_at: tuple[tuple[int, ...], ...]
    _layouts: dict[tuple[tuple[int, ...], tuple[int, ...]], PatchLayout] = field(
        default_factory=dict, repr=False
    )

    @cached_property
    def masses_with_parameters(self) -> frozenset[int]:
        """Masses whose equation has a parameter."""
        unknown = {index for index, _ in self.parameter_index}
        return frozenset(
            mass for mass, links in enumerate(self.links_at) if not unknown.isdisjoint((*links, -1 - mass))
        )

    @cached_property
    def masses_needing_rate(self) -> frozenset[int]:
        """Masses whose equation has a law that needs a smoothed v."""
        groups = self.groups(range(len(self.ends)))
        rated = {link for group in groups if group.weak_law.needs_rate for link in group.links.tolist()}
        return frozenset(mass for mass, links in enumerate(self.links_at) if not rated.isdisjoint(links))

    def values(self, given: Mapping[str, float]) -> Floats:
        """Values of the parameters.

        Parameters
        ----------
        given : mapping of str to float
            Values by name.

        Returns
        -------
        array of shape (p,)
            The given values, else the starts, else NaN.
        """
        parameters = self.structure.parameters
        chosen = (given.get(parameter.name, parameter.start) for parameter in parameters)
        return np.array([np.nan if value is None else value for value in chosen], dtype=float)

    @cached_property
    def neighbourhoods(self) -> tuple[frozenset[int], ...]:
        """For each mass, itself and the nodes at the other ends of its links."""
        ends = self.ends.tolist()
        return tuple(
            frozenset((mass, *(end for link in links for end in ends[link])))
            for mass, links in enumerate(self.links_at)
        )

    def groups(self, links: Sequence[int] | Indices) -> Iterator[WeakLawGroup]:
        """Group links by law.

        Parameters
        ----------
        links : sequence of int
            Indices of the links.

        Yields
        ------
        WeakLawGroup
            Links that share a law.
        """
        by_law: dict[tuple[Law, frozenset[str]], list[int]] = {}
        indices = np.array(links, dtype=np.intp)
        for position, index in enumerate(indices.tolist()):
            law = self.structure.links[index].law
            free = frozenset(name for name in law.nonlinear if (index, name) in self.parameter_index)
            by_law.setdefault((law, free), []).append(position)
        for (law, free), positions in by_law.items():
            which = indices[positions].tolist()
            coefficients = {
                name: self._numbers((index, name) for index in which) for name in law.coefficients
            }
            yield WeakLawGroup(weak_law(law, free), np.array(positions), indices[positions], coefficients)

    def layout(self, masses: Iterable[int], forced: Iterable[int]) -> PatchLayout:
        """Layout of the equations of some masses; computed once for equal arguments.

        Parameters
        ----------
        masses : iterable of int
            The masses.
        forced : iterable of int
            Those of them with an applied force.

        Returns
        -------
        PatchLayout
            The layout.
        """
        key = (tuple(masses), tuple(forced))
        if key not in self._layouts:
            self._layouts[key] = self._layout(np.array(key[0]), key[1])
        return self._layouts[key]

    def _layout(self, masses: Indices, forced: tuple[int, ...]) -> PatchLayout:
        links = np.unique([link for mass in masses for link in self.links_at[mass]])
        groups = tuple(self.groups(links))
        parts, numbers, stop = [], [], 0
        for index, group in enumerate(groups):
            for part in group.weak_law.parts:
                start, stop = stop, stop + len(group.links)
                parts.append(GroupTerms(part, index, slice(start, stop)))
                numbers.append(_multipliers(group, part))
        inertia = self._numbers((-1 - mass, "mass") for mass in masses.tolist())
        forces = TermCoefficients(np.full(len(forced), -1), np.ones(len(forced)))
        sizes = [*(term.terms.stop - term.terms.start for term in parts), len(masses), len(forced)]
        between = [*(self.ends[groups[term.group].links] for term in parts), *_nodes_of(masses, forced)]
        nodes, incidence = _incidence(np.concatenate([*between, self.ends[links]]))
        acting = incidence[:, np.searchsorted(nodes, masses)].T
        signs, link_incidence = acting[:, : sum(sizes)].copy(), acting[:, sum(sizes) :]
        signs[:, sum(sizes) - len(forced) :] = masses[:, None] == np.array(forced, dtype=int)
        return PatchLayout(
            masses=masses,
            links=links,
            forced=forced,
            groups=groups,
            group_terms=tuple(parts),
            inertia=inertia,
            kernel=np.repeat([*(term.part.kernel for term in parts), PHI_2, PHI], sizes),
            signs=signs,
            coefficients=TermCoefficients.joined([*numbers, inertia, forces]),
            increment=np.repeat([*(term.part.increment for term in parts), False, False], sizes),
            nodes=nodes,
            incidence=incidence[: sum(sizes)],
            link_incidence=link_incidence,
            far_ends=np.where(
                link_incidence == 0.0, GROUND_INDEX, self.ends[links].sum(axis=1) - masses[:, None]
            ),
        )

    def _numbers(self, where: Iterable[tuple[int, str]]) -> TermCoefficients:
        """The coefficients of these slots: numbers of parameters, or known values."""
        slots = list(where)
        links, masses = self.structure.links, self.structure.masses
        known = [
            links[index].coefficients[name].value if index >= 0 else masses[-1 - index].mass.value
            for index, name in slots
        ]
        parameter = [self.parameter_index.get(slot, -1) for slot in slots]
        return TermCoefficients(
            np.array(parameter), np.array([np.nan if value is None else value for value in known])
        )


@lru_cache(maxsize=32)
def structure_layout(structure: Structure) -> StructureLayout:
    """Layout of a structure; the same object for equal structures.

    Parameters
    ----------
    structure : Structure
        The structure.

    Returns
    -------
    StructureLayout
        Its layout.
    """
    refuse_memory(structure.links, "the weak form")
    refuse_hosts(structure, "the weak form")
    topology = structure.topology
    parameters = structure.parameters
    return StructureLayout(
        structure=structure,
        names=tuple(parameter.name for parameter in parameters),
        parameter_index={
            slot: number for number, parameter in enumerate(parameters) for slot in parameter.members
        },
        ends=topology.ends,
        links_at=topology.links_at,
    )


def _multipliers(group: WeakLawGroup, part: WeakPart) -> TermCoefficients:
    """Multipliers of the terms of a part at the links of its group."""
    if part.coefficient is None:
        return TermCoefficients(np.full(len(group.links), -1), np.ones(len(group.links)))
    return group.coefficients[part.coefficient]


def _nodes_of(masses: Indices, forced: tuple[int, ...]) -> tuple[Indices, Indices]:
    """Nodes of inertia terms (m, 2), a mass and the ground, and of force terms (f, 2), the ground twice."""
    return np.stack([masses, np.full(len(masses), GROUND_INDEX)], axis=1), np.full(
        (len(forced), 2), GROUND_INDEX
    )


def _incidence(ends: Indices) -> tuple[Indices, Floats]:
    """The nodes (c,) in `ends` (q, 2), and the incidence (q, c): 1 at the first end, -1 at the second."""
    nodes, position = np.unique(ends, return_inverse=True)
    position, term = position.reshape(ends.shape), np.arange(len(ends))
    incidence = np.zeros((len(ends), len(nodes)))
    incidence[term, position[:, 0]] += 1.0
    incidence[term, position[:, 1]] -= 1.0
    return nodes, incidence
