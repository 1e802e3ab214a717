"""Terms in the equations of a patch of masses: their coefficients, kernels, signs and nodes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from linkwise.arrays import Bools, Floats, Indices
from linkwise.weak.weak_form import WeakLaw, WeakPart


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
        Its links, as positions in `PatchLayout.links`.
    far_ends : tuple of int
        The k nodes at the other ends of these links.
    """

    terms: Indices
    parameter: Indices
    sign: Floats
    links: Indices
    far_ends: tuple[int, ...]


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
        The nodes: masses, -1 the ground, -2 the base.
    incidence : array of shape (q, c)
        1 and -1 at the two nodes of each term.
    link_incidence : array of shape (m, l)
        Incidence of the links.
    far_ends : array of int, shape (m, l)
        Node at the other end of each link; the ground where the link does not end at the mass.
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
        """The terms with a parameter under each of the three kernels."""
        return tuple(self.free_terms[self.kernel[self.free_terms] == kernel] for kernel in range(3))

    @cached_property
    def noise_couplings(self) -> tuple[NoiseCoupling, ...]:
        """One for each mass."""
        couplings = []
        for signs, incident, others in zip(
            self.signs[:, self.free_terms], self.link_incidence, self.far_ends, strict=True
        ):
            terms, links = np.flatnonzero(signs), np.flatnonzero(incident)
            couplings.append(
                NoiseCoupling(
                    terms, self.free_parameters[terms], signs[terms], links, tuple(others[links].tolist())
                )
            )
        return tuple(couplings)
