"""The weak form of laws, and the terms that they give the equations of a patch of masses.

The terms of a law are multiplied by phi and integrated. Those in d alone are kept; those linear in v are integrated by parts,
so that no signal is differentiated:

    int phi g(d)        as it is
    int phi v g(d)  = - int phi' G(d),   G' = g
    int phi g(d, v, u)  as it is, with a smoothed v, where neither rule applies (v**2, tanh(v/s), u*v of a recorded signal u)

White noise e of variance s^2 on d biases a curved function: E h(d + e) = exp(s^2/2 D^2) h(d). The inverse of that operator
gives an unbiased function of the noisy d; for d^k it is the Hermite polynomial of METHODS section 4. It commutes with D: its
derivatives are the unbiased estimates of those of h, which the bias of products of terms needs (`equations`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from linkwise.arrays import Bools, Floats, Indices
from linkwise.expression.calculus import antiderivative, differentiate, polynomial
from linkwise.expression.program import Program
from linkwise.expression.tree import (
    ZERO,
    Expression,
    Number,
    Symbol,
    add,
    multiply,
    substitute,
    symbols,
)
from linkwise.model.law import VARIABLES, Law

PHI, PHI_1, PHI_2 = 0, 1, 2  # phi, phi', phi'': rows of Window.kernels

_HIGHEST = 3  # derivatives kept: products of cubic laws are then unbiased, others to order s^6
_SERIES = 3  # terms of exp(-s^2/2 D^2), enough for polynomials up to d^7
_VARIANCE = "s^2"  # not a valid name in a law
_ELONGATION = Symbol("d")


@dataclass(frozen=True)
class WeakPart:
    """One part of the weak form of a law: sign * int kernel * function(d, v), multiplied by a coefficient.

    Attributes
    ----------
    coefficient : str or None
        Name of the coefficient; None for a factor of 1.
    increment : bool
        True where the coefficient enters the law nonlinearly: the function is the derivative of the law with respect to it,
        and the multiplier is its step from the present value.
    kernel : int
        PHI, PHI_1 or PHI_2.
    sign : float
        1 or -1.
    function : Expression
        Function of d and v.
    """

    coefficient: str | None
    increment: bool
    kernel: int
    sign: float
    function: Expression

    @property
    def needs_rate(self) -> bool:
        """Whether the function needs a smoothed v."""
        return "v" in symbols(self.function)

    @property
    def plain(self) -> bool:
        """Whether the function is d itself."""
        return self.function == _ELONGATION

    @property
    def curved(self) -> bool:
        """Whether the function must be evaluated at every sample, unlike d itself and constants."""
        return not (self.plain or isinstance(self.function, Number))


@dataclass(frozen=True)
class WeakLaw:
    """Weak form of a law, and the program that evaluates it.

    Attributes
    ----------
    law : Law
        The law.
    parts : tuple of WeakPart
        Its parts.
    """

    law: Law
    parts: tuple[WeakPart, ...]

    @cached_property
    def needs_rate(self) -> bool:
        """Whether some part needs a smoothed v."""
        return any(part.needs_rate for part in self.parts)

    @cached_property
    def curved(self) -> bool:
        """Whether some part must be evaluated at every sample."""
        return any(part.curved for part in self.parts)

    @cached_property
    def _derivatives(self) -> tuple[tuple[Expression, ...], ...]:
        """For each part its unbiased function and the derivatives of that by d which are not zero."""
        return tuple(tuple(_chain(part.function)) for part in self.parts)

    @cached_property
    def inside(self) -> tuple[str, ...]:
        """Names inside the functions beside d and v: signals, nonlinear coefficients and, where these are unknown, factors."""
        used = {name for part in self.parts for name in symbols(part.function)}
        return tuple(name for name in (*self.law.coefficients, *self.law.signals) if name in used)

    @cached_property
    def _program(self) -> Program:
        every = (function for chain in self._derivatives for function in chain)
        varying = [function for function in every if not isinstance(function, Number)]
        signals = [name for name in self.law.signals if name in self.inside]
        return Program(varying, ("d", "v", _VARIANCE, *self.inside), wide=(*VARIABLES, *signals))

    def evaluate(
        self, d: Floats, v: Floats | float, variance: Floats, values: Mapping[str, Floats]
    ) -> list[list[Floats | float]]:
        """Evaluate the unbiased functions of all parts and their derivatives.

        Parameters
        ----------
        d, v : array of shape (m, N)
            Elongations in m and rates in m/s of m links.
        variance : array of shape (m, 1)
            Variances in m^2 of the noise in d.
        values : mapping of str to array of shape (m, 1) or (N,)
            The coefficients and signals `inside`.

        Returns
        -------
        list of list of array or float
            For each part h, h', h'', ...: arrays of the shape of d, or numbers where constant.
        """
        arguments = [d, v, variance, *(values[name] for name in self.inside)]
        arrays = iter(self._program(*arguments))
        return [
            [function.value if isinstance(function, Number) else next(arrays) for function in chain]
            for chain in self._derivatives
        ]

    def rate_slopes(
        self, d: Floats, v: Floats, variance: Floats, deviation: Floats, values: Mapping[str, Floats]
    ) -> list[Floats | None]:
        """Evaluate the mean slopes by v, over its noise, of the functions that need a rate: also that of a jump is finite.

        Parameters
        ----------
        d, v, variance, values
            As in `evaluate`.
        deviation : array of shape (m, 1)
            Standard deviations in m/s of the noise in v, not zero.

        Returns
        -------
        list of (array or None)
            For each part the slope, of the shape of d; None where it needs no rate.
        """
        above, below = (self.evaluate(d, v + sign * deviation, variance, values) for sign in (1.0, -1.0))
        return [
            (high - low) / (2.0 * deviation) if part.needs_rate else None
            for part, (high, *_), (low, *_) in zip(self.parts, above, below, strict=True)
        ]


@lru_cache(maxsize=512)
def weak_law(law: Law, free: frozenset[str]) -> WeakLaw:
    """Weak form of a law.

    A linear coefficient has a term of its own, known or not; the terms without one have the coefficient 1; each unknown
    nonlinear coefficient adds the derivative of the law with respect to it.

    Parameters
    ----------
    law : Law
        The law.
    free : frozenset of str
        Names of the unknown coefficients that enter nonlinearly.

    Returns
    -------
    WeakLaw
        The weak form; the same object for equal arguments.
    """
    terms: list[tuple[str | None, bool, Expression]] = [(name, False, law.basis[name]) for name in law.linear]
    if law.remainder != ZERO:
        terms.append((None, False, law.remainder))
    terms += [(name, True, differentiate(law.expression, name)) for name in law.nonlinear if name in free]
    return WeakLaw(law, tuple(part for term in terms for part in _parts(*term, law.signals)))


def _parts(
    coefficient: str | None, increment: bool, term: Expression, signals: Sequence[str]
) -> list[WeakPart]:
    by_rate = differentiate(term, "v")
    if by_rate == ZERO:
        return [WeakPart(coefficient, increment, PHI, 1.0, term)]
    along_time = {"v", *signals}.intersection(symbols(by_rate))
    primitive = None if along_time else antiderivative(by_rate, "d")
    if primitive is None:
        return [WeakPart(coefficient, increment, PHI, 1.0, term)]
    parts = [WeakPart(coefficient, increment, PHI_1, -1.0, primitive)]
    at_rest = substitute(term, {"v": ZERO})
    if at_rest != ZERO:
        parts.append(WeakPart(coefficient, increment, PHI, 1.0, at_rest))
    return parts


def _chain(function: Expression) -> Iterator[Expression]:
    """The unbiased function and the derivatives of that by d which are not zero."""
    current = _without_bias(function)
    for _ in range(_HIGHEST + 1):
        yield current
        current = differentiate(current, "d")
        if current == ZERO:
            return


def _without_bias(function: Expression) -> Expression:
    """exp(-s^2/2 D^2) of a function of d: exact for polynomials, to the second order in s for others."""
    terms, current = [function], function
    factor: Expression = Number(1.0)
    for order in range(1, (_SERIES if polynomial(function, ("d",)) is not None else 1) + 1):
        current = differentiate(differentiate(current, "d"), "d")
        if current == ZERO:
            break
        factor = multiply(factor, Number(-0.5 / order), Symbol(_VARIANCE))
        terms.append(multiply(factor, current))
    return add(*terms)


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
        """(m,) numbers of the terms with parameters `values` (p,)."""
        return np.where(self.parameter < 0, self.known, values[self.parameter]) if len(values) else self.known

    @classmethod
    def joined(cls, parts: Iterable[TermCoefficients]) -> TermCoefficients:
        """The coefficients of all parts, in their order."""
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
    law_parts : tuple of (WeakPart, slice)
        The parts of the laws of the groups, one after the other, and the terms of each: one for each of its links.
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
    """

    masses: Indices
    links: Indices
    forced: tuple[int, ...]
    groups: tuple[WeakLawGroup, ...]
    law_parts: tuple[tuple[WeakPart, slice], ...]
    inertia: TermCoefficients
    kernel: Indices
    signs: Floats
    coefficients: TermCoefficients
    increment: Bools
    nodes: Indices
    incidence: Floats
    readings: Floats
    link_incidence: Floats

    @property
    def inertial(self) -> slice:
        """The terms of inertia, one for each mass, which those of applied forces follow."""
        end = len(self.kernel) - len(self.forced)
        return slice(end - len(self.masses), end)

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
        """The terms with a parameter under each of the kernels."""
        kernels = self.kernel[self.free_terms]
        return tuple(self.free_terms[kernels == kernel] for kernel in (PHI, PHI_1, PHI_2))

    def noise_paths(self, weights: Floats) -> NoisePaths:
        """The paths of noise of channels with these weights (n + 2, C) in the displacements of nodes."""
        inertia = (self.nodes == self.masses[:, None]).astype(float)
        passed = self.link_incidence[:, None] * self.readings.T
        own = weights[self.nodes]
        present = ((inertia != 0.0) | passed.any(axis=2)) @ (own != 0.0)
        equation, source = np.nonzero(present)
        return NoisePaths(equation, source, (inertia @ own)[present], (own.T @ passed)[present])
