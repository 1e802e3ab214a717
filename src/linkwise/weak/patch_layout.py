"""Terms in the equations of a patch of masses: their coefficients, kernels, signs and nodes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from linkwise.arrays import Bools, Floats, Indices
from linkwise.weak.weak_form import PHI_2, WeakLaw, WeakPart


@dataclass(frozen=True, eq=False)
class TermCoefficients:
    """Coefficients of m terms: parameters or known numbers.

    Attributes
    ----------
    parameter : array of int, shape (m,)
        Indices of the parameters; -1 where the number is known.
    known : array of shape (m,)
        The known numbers.
    """

    parameter: Indices
    known: Floats

    def at(self, values: Floats) -> Floats:
        """Numbers of the terms.

        Parameters
        ----------
        values : array of shape (p,)
            The parameters.

        Returns
        -------
        array of shape (m,)
            The numbers.
        """
        return np.where(self.parameter < 0, self.known, values[self.parameter]) if len(values) else self.known

    @classmethod
    def joined(cls, parts: Iterable[TermCoefficients]) -> TermCoefficients:
        """Concatenate coefficients.

        Parameters
        ----------
        parts : iterable of TermCoefficients
            The parts in order.

        Returns
        -------
        TermCoefficients
            All of them.
        """
        pairs = [(part.parameter, part.known) for part in parts]
        parameter, known = (np.concatenate(arrays) for arrays in zip(*pairs, strict=True))
        return cls(parameter, known)


@dataclass(frozen=True, eq=False)
class WeakLawGroup:
    """Links that share a law and the set of its nonlinear coefficients that are unknown.

    Attributes
    ----------
    weak_law : WeakLaw
        Weak form of the law.
    positions : array of int, shape (m,)
        Positions of the links in the list from which the group was formed.
    links : array of int, shape (m,)
        Indices of the links in the structure.
    coefficients : mapping of str to TermCoefficients
        The coefficients of the law at these links.
    """

    weak_law: WeakLaw
    positions: Indices
    links: Indices
    coefficients: Mapping[str, TermCoefficients]


@dataclass(frozen=True, eq=False)
class GroupTerms:
    """One part of the law of a group, at all its links.

    Attributes
    ----------
    part : WeakPart
        The part.
    group : int
        Index of the group.
    terms : slice
        Its terms in the layout.
    """

    part: WeakPart
    group: int
    terms: slice


@dataclass(frozen=True, eq=False)
class NoiseCoupling:
    """How noise enters the equation of one mass.

    Attributes
    ----------
    terms : array of int, shape (s,)
        Its terms with a parameter, as positions in `PatchLayout.free_terms`.
    parameter : array of int, shape (s,)
        Indices of their parameters.
    sign : array of shape (s,)
        Their signs.
    links : array of int, shape (k,)
        Its k links, as positions in `PatchLayout.links`.
    sources : array of int, shape (s,)
        The nodes or channels whose noise enters, that of the mass itself first.
    inertia : array of shape (s,)
        Their weights in the displacement of the mass.
    passed : array of shape (s, k)
        Their weights in the elongations of the links, times those of the links in the equation.
    inner : array of bool, shape (k,)
        The links that act under phi in place of an eliminated state.
    """

    terms: Indices
    parameter: Indices
    sign: Floats
    links: Indices
    sources: Indices
    inertia: Floats
    passed: Floats
    inner: Bools

    def of_sources(self, chosen: Bools) -> NoiseCoupling:
        """The coupling of those of the sources that are `chosen` (s,)."""
        return replace(
            self,
            sources=self.sources[chosen],
            inertia=self.inertia[chosen],
            passed=self.passed[chosen],
        )

    def through(self, weights: Floats) -> NoiseCoupling:
        """The coupling of channels with these weights (n + 2, C) in the displacements of nodes."""
        own = weights[self.sources]
        sources = np.flatnonzero(own.any(axis=0))
        own = own[:, sources]
        return replace(self, sources=sources, inertia=self.inertia @ own, passed=own.T @ self.passed)


@dataclass(frozen=True, eq=False)
class NoisePaths:
    """The ways by which noise enters the equations of a patch: pairs of an equation and a node or channel.

    Attributes
    ----------
    equation : array of int, shape (w,)
        Positions of the masses in the patch.
    source : array of int, shape (w,)
        The nodes or channels.
    inertia : array of shape (w,)
        Their weights in the displacement of the mass.
    passed : array of shape (w, l)
        Their weights in the elongations of the links, times those of the links in the equation.
    """

    equation: Indices
    source: Indices
    inertia: Floats
    passed: Floats

    @classmethod
    def of(cls, couplings: Sequence[NoiseCoupling], links: int) -> NoisePaths:
        """The paths of the couplings of each mass of a patch with so many links."""
        count = [len(coupling.sources) for coupling in couplings]
        passed, last = np.zeros((sum(count), links)), np.cumsum(count)
        for coupling, size, stop in zip(couplings, count, last.tolist(), strict=True):
            passed[stop - size : stop, coupling.links] = coupling.passed
        return cls(
            np.repeat(np.arange(len(count)), count),
            np.concatenate([coupling.sources for coupling in couplings]),
            np.concatenate([coupling.inertia for coupling in couplings]),
            passed,
        )

    def chosen(self, which: Bools) -> NoisePaths:
        """Some of the paths."""
        return NoisePaths(self.equation[which], self.source[which], self.inertia[which], self.passed[which])


@dataclass(frozen=True, eq=False)
class PatchLayout:
    """The q terms in the equations of m masses with l links: terms of laws, inertia and applied forces.

    A term is a function of the displacement between two nodes, filtered by a kernel and multiplied by a coefficient.

    Attributes
    ----------
    masses : array of int, shape (m,)
        Indices of the masses.
    links : array of int, shape (l,)
        Indices of their links.
    forced : tuple of int
        The masses with an applied force.
    groups : tuple of WeakLawGroup
        The links by law.
    group_terms : tuple of GroupTerms
        The terms of the laws.
    inertia : TermCoefficients
        The masses in kg.
    kernel : array of int, shape (q,)
        Index of the kernel of each term.
    signs : array of shape (m, q)
        Signs of the terms in the equations.
    coefficients : TermCoefficients
        The q coefficients.
    increment : array of bool, shape (q,)
        True where the coefficient is the step of a parameter from its present value.
    nodes : array of int, shape (c,)
        The nodes: masses and modes, and n for the base.
    incidence : array of shape (q, c)
        Weights of the nodes in what each term is a function of: 1 and -1 for the ends of a link between masses.
    readings : array of shape (l, c)
        Weights of the nodes in the elongations of the links.
    link_incidence : array of shape (m, l)
        Weights of the links in the equations.
    inner : array of bool, shape (l,)
        The links that act under phi in place of an eliminated state.
    eliminating : slice
        The terms that a change of the a of an eliminated state adds: three kernels of each of its parameters.
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
    readings: Floats
    link_incidence: Floats
    inner: Bools
    eliminating: slice

    @cached_property
    def free_terms(self) -> Indices:
        """The terms with a parameter."""
        return np.flatnonzero(self.coefficients.parameter >= 0)

    @cached_property
    def free_parameters(self) -> Indices:
        """The parameters of those terms."""
        return self.coefficients.parameter[self.free_terms]

    @cached_property
    def free_kinds(self) -> tuple[Floats, Indices]:
        """Kinds of terms with a parameter: their signs (k, m) in the equations, and the kind of each term."""
        signs, kind = np.unique(self.signs[:, self.free_terms].T, axis=0, return_inverse=True)
        return signs, kind.ravel()

    @cached_property
    def free_terms_by_kernel(self) -> tuple[Indices, ...]:
        """The terms with a parameter under each of the kernels."""
        last = int(self.kernel.max(initial=PHI_2))
        return tuple(self.free_terms[self.kernel[self.free_terms] == kernel] for kernel in range(last + 1))

    @cached_property
    def noise_couplings(self) -> tuple[NoiseCoupling, ...]:
        """One for each mass."""
        couplings = []
        for mass, signs, incident in zip(
            self.masses, self.signs[:, self.free_terms], self.link_incidence, strict=True
        ):
            terms, links = np.flatnonzero(signs), np.flatnonzero(incident)
            readings, own = self.readings[links], self.nodes == mass
            others = np.flatnonzero(readings.any(axis=0) & ~own)
            near = np.concatenate([np.flatnonzero(own), others])
            couplings.append(
                NoiseCoupling(
                    terms=terms,
                    parameter=self.free_parameters[terms],
                    sign=signs[terms],
                    links=links,
                    sources=self.nodes[near],
                    inertia=own[near].astype(float),
                    passed=(incident[links, None] * readings[:, near]).T,
                    inner=self.inner[links],
                )
            )
        return tuple(couplings)

    @cached_property
    def noise_paths(self) -> NoisePaths:
        """Those of all masses."""
        return NoisePaths.of(self.noise_couplings, len(self.links))
