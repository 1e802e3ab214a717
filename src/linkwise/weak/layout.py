"""Layout of weak equations, from the structure alone: their terms, the parameters of these, and where they act.

It is computed once per structure, so that a study of many records of one structure does not repeat it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from itertools import pairwise

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.model.law import Law
from linkwise.model.memory_support import refuse_memory
from linkwise.model.structure import Structure
from linkwise.model.topology import Weights
from linkwise.weak.displacements import MeasuredDisplacements
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
    readings : tuple of tuple of (int, float)
        For each link the nodes (masses and modes, and n for the base) and their weights in its elongation.
    """

    structure: Structure
    names: tuple[str, ...]
    parameter_index: Mapping[tuple[int, str], int]
    readings: tuple[Weights, ...]
    _layouts: dict[tuple[tuple[int, ...], tuple[int, ...]], PatchLayout] = field(
        default_factory=dict, repr=False
    )

    @cached_property
    def links_at(self) -> tuple[tuple[int, ...], ...]:
        """The links that act on each mass or mode."""
        incidence = self.structure.incidence
        return tuple(
            tuple(incidence.indices[first:last].tolist())
            for first, last in pairwise(incidence.indptr.tolist())
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
        groups = self.groups(range(len(self.structure.links)))
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
        """For each mass or mode, itself and the other nodes that stretch its links; the base is node n."""
        return tuple(
            frozenset((mass, *(node for link in links for node, _ in self.readings[link])))
            for mass, links in enumerate(self.links_at)
        )

    @cached_property
    def _reading_entries(self) -> tuple[Indices, Indices, Floats]:
        """(e,) links, nodes and weights of `readings`."""
        parts = [(link, node, weight) for link, nodes in enumerate(self.readings) for node, weight in nodes]
        links, nodes, weights = zip(*parts, strict=True)
        return np.array(links), np.array(nodes), np.array(weights)

    def elongation_variance(self, motion: MeasuredDisplacements, *, floored: bool = False) -> Floats:
        """Variances of the noise in the elongations of the links.

        Parameters
        ----------
        motion : MeasuredDisplacements
            Displacements of the nodes.
        floored : bool, optional
            Whether noise is at least the `floored_variance` of the motion.

        Returns
        -------
        array of shape (L,)
            The variances in m^2.
        """
        variance = motion.floored_variance if floored else motion.source_variance
        links, nodes, weights = self._reading_entries
        if motion.source_weights is None:
            return np.bincount(links, weights**2 * variance[nodes], len(self.readings))
        of_nodes = np.zeros((len(self.readings), len(motion.source_weights)))
        of_nodes[links, nodes] = weights
        return np.asarray((of_nodes @ motion.source_weights) ** 2 @ variance)

    def elongations(self, displacements: Floats, links: Iterable[int]) -> Floats:
        """Elongations of links.

        Parameters
        ----------
        displacements : array of shape (n + 2, N)
            Displacements of the nodes, or what is linear in them.
        links : iterable of int
            Indices of the m links.

        Returns
        -------
        array of shape (m, N)
            The elongations.
        """
        chosen = [self.readings[link] for link in links]
        result = np.empty((len(chosen), displacements.shape[1]))
        for row, ((first, of_first), *others) in zip(result, chosen, strict=True):
            np.multiply(displacements[first], of_first, out=row)
            for node, weight in others:
                row += weight * displacements[node]
        return result

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
        nodes, incidence = self._incidence([*(groups[term.group].links for term in parts), links], masses)
        of_terms, of_links = incidence[:stop], incidence[stop:]
        moved = np.searchsorted(nodes, masses)
        signs = np.zeros((len(masses), sum(sizes)))
        signs[:, :stop] = of_terms[:, moved].T
        signs[:, stop : stop + len(masses)] = np.eye(len(masses))
        signs[:, stop + len(masses) :] = masses[:, None] == np.array(forced, dtype=int)
        own = np.zeros((len(masses) + len(forced), len(nodes)))
        own[np.arange(len(masses)), moved] = 1.0
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
            incidence=np.concatenate([of_terms, own]),
            readings=of_links,
            link_incidence=of_links[:, moved].T,
        )

    def _incidence(self, links: Sequence[Indices], masses: Indices) -> tuple[Indices, Floats]:
        """The nodes (c,) of links and masses, and the weights (q, c) of the nodes in the elongations of the links."""
        chosen = [self.readings[link] for link in np.concatenate(links).tolist()]
        nodes = np.unique([*masses.tolist(), *(node for reading in chosen for node, _ in reading)])
        weights = np.zeros((len(chosen), len(nodes)))
        for row, reading in zip(weights, chosen, strict=True):
            for node, weight in reading:
                row[np.searchsorted(nodes, node)] = weight
        return nodes, weights

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
    base = structure.size
    parameters = structure.parameters
    return StructureLayout(
        structure=structure,
        names=tuple(parameter.name for parameter in parameters),
        parameter_index={
            slot: number for number, parameter in enumerate(parameters) for slot in parameter.members
        },
        readings=tuple(
            (*column, (base, weight)) if weight else column
            for column, weight in zip(
                structure.topology.columns, structure.base_incidence.tolist(), strict=True
            )
        ),
    )


def _multipliers(group: WeakLawGroup, part: WeakPart) -> TermCoefficients:
    """Multipliers of the terms of a part at the links of its group."""
    if part.coefficient is None:
        return TermCoefficients(np.full(len(group.links), -1), np.ones(len(group.links)))
    return group.coefficients[part.coefficient]
