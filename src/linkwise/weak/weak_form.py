"""The weak form of one law: which test function meets which function of d, and what noise does to it.

Multiply a law's term by phi and integrate. What depends on d alone stays; what is linear in v is integrated by parts, so that
no signal is differentiated:

    int phi g(d)        stays
    int phi v g(d)  = - int phi' G(d),   G' = g
    int phi g(d, v)     stays, with a smoothed v, where neither rule applies (v**2, tanh(v/s))

White noise e of variance s^2 on d biases a curved function: E h(d + e) = exp(s^2/2 D^2) h(d). The inverse of that operator,
exp(-s^2/2 D^2), applied to h gives a function of the noisy d that is right on average; for d^k it is the Hermite polynomial
of METHODS section 4. It commutes with D, so its derivatives are the unbiased estimates of the derivatives of h; `moments` of
products need them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache

from linkwise.arrays import Floats
from linkwise.expression.calculus import antiderivative, differentiate, polynomial
from linkwise.expression.program import Program
from linkwise.expression.tree import ZERO, Expression, Number, Symbol, add, multiply, substitute, symbols
from linkwise.model.law import Law

PHI, PHI_1, PHI_2 = 0, 1, 2  # phi, phi', phi'': rows of Window.kernels

_HIGHEST = 3  # derivatives kept: with them the products of cubic laws are free of bias, steeper ones to s^6
_SERIES = 3  # terms of exp(-s^2/2 D^2), enough for polynomials up to d^7
_VARIANCE = "s^2"  # no name that a law can have
_ELONGATION = Symbol("d")


@dataclass(frozen=True)
class WeakPart:
    """sign * int kernel * function(d, v), to be multiplied by a coefficient of the law, or by 1 where that is None.

    `increment`: the coefficient enters the law nonlinearly, and what multiplies the function (the law's slope by it) is the
    step from its present value.
    """

    coefficient: str | None
    increment: bool
    kernel: int
    sign: float
    function: Expression

    @property
    def needs_rate(self) -> bool:
        """Whether the function wants a smoothed v."""
        return "v" in symbols(self.function)

    @property
    def plain(self) -> bool:
        """Whether the function is d itself."""
        return self.function == _ELONGATION

    @property
    def curved(self) -> bool:
        """Whether the function must be worked out sample by sample, unlike d itself and constants."""
        return not (self.plain or isinstance(self.function, Number))


@dataclass(frozen=True)
class WeakLaw:
    """The parts of a law and the code that evaluates them; see `weak_law`."""

    law: Law
    parts: tuple[WeakPart, ...]

    @cached_property
    def needs_rate(self) -> bool:
        """Whether some part wants a smoothed v."""
        return any(part.needs_rate for part in self.parts)

    @cached_property
    def curved(self) -> bool:
        """Whether some part must be worked out sample by sample."""
        return any(part.curved for part in self.parts)

    @cached_property
    def _derivatives(self) -> tuple[tuple[Expression, ...], ...]:
        """For each part its unbiased function and the derivatives of that by d which are not zero."""
        found = []
        for part in self.parts:
            chain = [_without_bias(part.function)]
            while len(chain) <= _HIGHEST and (following := differentiate(chain[-1], "d")) != ZERO:
                chain.append(following)
            found.append(tuple(chain))
        return tuple(found)

    @cached_property
    def inside(self) -> tuple[str, ...]:
        """The coefficients that stand inside the functions: nonlinear ones and, where those are to be found, their factors."""
        held = {name for part in self.parts for name in symbols(part.function)}
        return tuple(name for name in self.law.coefficients if name in held)

    @cached_property
    def _program(self) -> Program:
        varying = [each for chain in self._derivatives for each in chain if not isinstance(each, Number)]
        return Program(varying, ("d", "v", _VARIANCE, *self.inside), wide=("d", "v"))

    def evaluate(
        self, d: Floats, v: Floats | float, variance: Floats, values: Mapping[str, Floats]
    ) -> list[list[Floats | float]]:
        """For each part [h, h', h'', ...]: arrays of the shape of `d` (links, N), or a number where it is constant.

        `variance` (links, 1) is that of the noise in d; `values` (links, 1) those of the coefficients `inside`.
        """
        given = [d, v, variance, *(values[name] for name in self.inside)]
        arrays = iter(self._program(*given))
        return [
            [each.value if isinstance(each, Number) else next(arrays) for each in chain]
            for chain in self._derivatives
        ]


@lru_cache(maxsize=512)
def weak_law(law: Law, free: frozenset[str]) -> WeakLaw:
    """The weak form of `law` where the coefficients `free` are to be found.

    A linear coefficient has a term of its own, free or not; what is left without them is a term with the coefficient 1;
    every free nonlinear coefficient adds the law's slope by it.
    """
    terms: list[tuple[str | None, bool, Expression]] = [(name, False, law.basis[name]) for name in law.linear]
    if law.remainder != ZERO:
        terms.append((None, False, law.remainder))
    terms += [(name, True, differentiate(law.expression, name)) for name in law.nonlinear if name in free]
    return WeakLaw(law, tuple(part for term in terms for part in _parts(*term)))


def _parts(coefficient: str | None, increment: bool, term: Expression) -> list[WeakPart]:
    by_rate = differentiate(term, "v")
    if by_rate == ZERO:
        return [WeakPart(coefficient, increment, PHI, 1.0, term)]
    primitive = antiderivative(by_rate, "d") if "v" not in symbols(by_rate) else None
    if primitive is None:
        return [WeakPart(coefficient, increment, PHI, 1.0, term)]
    parts = [WeakPart(coefficient, increment, PHI_1, -1.0, primitive)]
    at_rest = substitute(term, {"v": ZERO})
    if at_rest != ZERO:
        parts.append(WeakPart(coefficient, increment, PHI, 1.0, at_rest))
    return parts


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
