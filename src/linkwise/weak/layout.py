"""What weak equations take from the structure alone: their terms, whose these are, and where they act.

It is worked out once per structure, so that a campaign over many records of one structure does not repeat it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np

from linkwise.arrays import Bools, Floats, Indices
from linkwise.model.law import Law
from linkwise.model.structure import Structure
from linkwise.model.topology import GROUND_INDEX
from linkwise.weak.weak_form import PHI, PHI_2, WeakLaw, WeakPart, weak_law


@dataclass(frozen=True, eq=False)
class TermCoefficients:
    """Numbers (m,): parameter number `parameter` (m,) or, where that is -1, `known` (m,)."""

    parameter: Indices
    known: Floats

    def at(self, values: Floats) -> Floats:
        """(m,) at the parameters (p,)."""
        return np.where(self.parameter < 0, self.known, values[self.parameter]) if len(values) else self.known

    @classmethod
    def joined(cls, parts: Iterable[TermCoefficients]) -> TermCoefficients:
        """One after the other."""
        pairs = [(part.parameter, part.known) for part in parts]
        parameter, known = (np.concatenate(each) for each in zip(*pairs, strict=True))
        return cls(parameter, known)


@dataclass(frozen=True, eq=False)
class WeakLawGroup:
    """Links, `positions` (m,) of some that are looked at, that share a law and which of its nonlinear coefficients are to
    be found.

    `links` (m,) are their numbers in the structure.
    """

    weak_law: WeakLaw
    positions: Indices
    links: Indices
    coefficients: Mapping[str, TermCoefficients]


@dataclass(frozen=True, eq=False)
class GroupTerms:
    """One `part` of the law of group number `group`, at all its links: the terms `terms` of a layout."""

    part: WeakPart
    group: int
    terms: slice


@dataclass(frozen=True, eq=False)
class NoiseCoupling:
    """How noise enters the equation of one mass.

    Through its terms with a parameter, at `terms` (s,) of `PatchLayout.free_terms`, of `parameter` (s,) with `sign` (s,),
    and over its links, at `links` (k,) of `PatchLayout.links`, from the masses `far_ends` (k) at their other ends.
    """

    terms: Indices
    parameter: Indices
    sign: Floats
    links: Indices
    far_ends: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class PatchLayout:
    """The q terms in the equations of `masses` (m,), which `links` (l,) hold: those of the laws, inertia, forces.

    The laws' are listed by `group_terms`; the masses in `forced` feel a force. A term has `signs` (m, q) in the equations,
    meets kernel number `kernel` (q,) and is multiplied by `coefficients` (q,), less the parameter's present value where it
    is an `increment` (q,). It is a function of the displacement between two of the `nodes` (c,) (masses, -1 the ground, -2
    the base), 1 and -1 in `incidence` (q, c). `link_incidence` (m, l) is the incidence of the links, and `far_ends` (m, l)
    what they hold on to at their other ends, the ground where they do not hold the mass.
    """

    masses: Indices
    links: Indices
    forced: tuple[int, ...]
    groups: tuple[WeakLawGroup, ...]
    group_terms: tuple[GroupTerms, ...]
    inertia: TermCoefficients
    kernel: Indices
    signs: Floats
    coefficients: TermCoefficients
    increment: Bools
    nodes: Indices
    incidence: Floats
    link_incidence: Floats
    far_ends: Indices

    @cached_property
    def free_terms(self) -> Indices:
        """The terms with a parameter."""
        return np.flatnonzero(self.coefficients.parameter >= 0)

    @cached_property
    def free_parameters(self) -> Indices:
        """The parameters of those terms."""
        return self.coefficients.parameter[self.free_terms]

    @cached_property
    def free_terms_by_kernel(self) -> tuple[Indices, ...]:
        """The terms with a parameter that meet each of the kernels."""
        return tuple(self.free_terms[self.kernel[self.free_terms] == kernel] for kernel in range(3))

    @cached_property
    def noise_couplings(self) -> tuple[NoiseCoupling, ...]:
        """One for each mass."""
        found = []
        for signs, holds, others in zip(
            self.signs[:, self.free_terms], self.link_incidence, self.far_ends, strict=True
        ):
            terms, links = np.flatnonzero(signs), np.flatnonzero(holds)
            found.append(
                NoiseCoupling(
                    terms, self.free_parameters[terms], signs[terms], links, tuple(others[links].tolist())
                )
            )
        return tuple(found)


@dataclass(frozen=True, eq=False)
class StructureLayout:
    """The parameters of `structure`, its masses and its links by number.

    `names` (p,) are the parameters, `parameter_index` the number of the parameter at a (link, or -1 - mass; coefficient)
    that has one. `ends` (L, 2) are the masses at the ends of the links (-1 the ground, -2 the base), `links_at` the links
    that hold a mass.
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
        """The masses whose equation holds a parameter."""
        asked = {index for index, _ in self.parameter_index}
        return frozenset(
            mass for mass, links in enumerate(self.links_at) if not asked.isdisjoint((*links, -1 - mass))
        )

    @cached_property
    def masses_needing_rate(self) -> frozenset[int]:
        """The masses whose equation holds a law that wants a smoothed v."""
        groups = self.groups(range(len(self.ends)))
        rated = {link for group in groups if group.weak_law.needs_rate for link in group.links.tolist()}
        return frozenset(mass for mass, links in enumerate(self.links_at) if not rated.isdisjoint(links))

    def values(self, given: Mapping[str, float]) -> Floats:
        """(p,) the parameters as `given` by name, else their starts, else NaN."""
        found = (given.get(each.name, each.start) for each in self.structure.parameters)
        return np.array([np.nan if value is None else value for value in found], dtype=float)

    @cached_property
    def neighbourhoods(self) -> tuple[frozenset[int], ...]:
        """Every mass with what its links hold on to."""
        ends = self.ends.tolist()
        return tuple(
            frozenset((mass, *(end for link in links for end in ends[link])))
            for mass, links in enumerate(self.links_at)
        )

    def groups(self, links: Sequence[int] | Indices) -> Iterator[WeakLawGroup]:
        """The `links` by their laws."""
        found: dict[tuple[Law, frozenset[str]], list[int]] = {}
        looked = np.array(links, dtype=np.intp)
        for at, index in enumerate(looked.tolist()):
            law = self.structure.links[index].law
            free = frozenset(name for name in law.nonlinear if (index, name) in self.parameter_index)
            found.setdefault((law, free), []).append(at)
        for (law, free), places in found.items():
            which = looked[places].tolist()
            coefficients = {
                name: self._numbers((index, name) for index in which) for name in law.coefficients
            }
            yield WeakLawGroup(weak_law(law, free), np.array(places), looked[places], coefficients)

    def layout(self, masses: Iterable[int], forced: Iterable[int]) -> PatchLayout:
        """The layout of the equations of `masses`, of which those in `forced` feel a force."""
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
        sizes = [*(each.terms.stop - each.terms.start for each in parts), len(masses), len(forced)]
        between = [*(self.ends[groups[each.group].links] for each in parts), *_nodes_of(masses, forced)]
        nodes, incidence = _incidence(np.concatenate([*between, self.ends[links]]))
        acting = incidence[:, np.searchsorted(nodes, masses)].T
        signs, holds = acting[:, : sum(sizes)].copy(), acting[:, sum(sizes) :]
        signs[:, sum(sizes) - len(forced) :] = masses[:, None] == np.array(forced, dtype=int)
        return PatchLayout(
            masses=masses,
            links=links,
            forced=forced,
            groups=groups,
            group_terms=tuple(parts),
            inertia=inertia,
            kernel=np.repeat([*(each.part.kernel for each in parts), PHI_2, PHI], sizes),
            signs=signs,
            coefficients=TermCoefficients.joined([*numbers, inertia, forces]),
            increment=np.repeat([*(each.part.increment for each in parts), False, False], sizes),
            nodes=nodes,
            incidence=incidence[: sum(sizes)],
            link_incidence=holds,
            far_ends=np.where(holds == 0.0, GROUND_INDEX, self.ends[links].sum(axis=1) - masses[:, None]),
        )

    def _numbers(self, where: Iterable[tuple[int, str]]) -> TermCoefficients:
        """The coefficients at these places: parameters, or what the structure says."""
        places = list(where)
        links, masses = self.structure.links, self.structure.masses
        known = [
            links[index].coefficients[name].value if index >= 0 else masses[-1 - index].mass.value
            for index, name in places
        ]
        parameter = [self.parameter_index.get(place, -1) for place in places]
        return TermCoefficients(
            np.array(parameter), np.array([np.nan if each is None else each for each in known])
        )


@lru_cache(maxsize=32)
def structure_layout(structure: Structure) -> StructureLayout:
    """The layout of a structure, the same one for equal structures."""
    topology = structure.topology
    parameters = structure.parameters
    return StructureLayout(
        structure=structure,
        names=tuple(parameter.name for parameter in parameters),
        parameter_index={place: number for number, each in enumerate(parameters) for place in each.members},
        ends=topology.ends,
        links_at=topology.links_at,
    )


def _multipliers(group: WeakLawGroup, part: WeakPart) -> TermCoefficients:
    """What multiplies the terms of a part at the links of its group."""
    if part.coefficient is None:
        return TermCoefficients(np.full(len(group.links), -1), np.ones(len(group.links)))
    return group.coefficients[part.coefficient]


def _nodes_of(masses: Indices, forced: tuple[int, ...]) -> tuple[Indices, Indices]:
    """Between which nodes inertia (m, 2) and forces (f, 2) lie: a mass and the ground; nowhere."""
    return np.stack([masses, np.full(len(masses), GROUND_INDEX)], axis=1), np.full(
        (len(forced), 2), GROUND_INDEX
    )


def _incidence(ends: Indices) -> tuple[Indices, Floats]:
    """The nodes (c,) between which `ends` (q, 2) lie, and (q, c): 1 at the first of them, -1 at the second."""
    nodes, at = np.unique(ends, return_inverse=True)
    at, every = at.reshape(ends.shape), np.arange(len(ends))
    incidence = np.zeros((len(ends), len(nodes)))
    incidence[every, at[:, 0]] += 1.0
    incidence[every, at[:, 1]] -= 1.0
    return nodes, incidence
