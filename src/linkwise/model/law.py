"""The force law of a link: one text that simulation sums, regression lists by columns and the likelihood differentiates.

A law is an expression in the link's elongation `d` (m) and its rate `v` (m/s); `pi` is the number, every other name a
coefficient. Its value is the force (N) on the link's first end with reversed sign: M x'' = -B f(d, v) (paper Eq. 1,
METHODS section 1).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from linkwise.arrays import Floats
from linkwise.errors import LawError
from linkwise.expression import (
    Expression,
    Number,
    Power,
    Program,
    Symbol,
    add,
    antiderivative,
    differentiate,
    kinks,
    multiply,
    parse_with_places,
    substitute,
    symbols,
)
from linkwise.expression.dimension import METRE, METRE_PER_SECOND, NEWTON
from linkwise.expression.inference import UnitConflict, infer
from linkwise.expression.parser import Parsed
from linkwise.expression.quadrature import integral_from_zero

VARIABLES = ("d", "v")

_MISUSED = {
    "x": "A law knows the elongation of its link, d = x_first - x_second, and its rate v: write d for x.",
    "t": "A law does not depend on time. A force that does is an excitation: give it to the simulation.",
}


class Partials(NamedTuple):
    """A law's force (N) and its partial derivatives, all of the shape that d, v and the coefficients broadcast to."""

    force: Floats
    by_d: Floats
    by_v: Floats
    by_coefficient: dict[str, Floats]


@dataclass(frozen=True)
class Law:
    """A parsed law. Build it with `Law.parse`; laws of equal text share everything that is compiled.

    `coefficients` are the names other than d and v in order of appearance; all mappings follow this order.
    """

    text: str
    expression: Expression
    coefficients: tuple[str, ...]

    @staticmethod
    def parse(text: str) -> Law:
        """The law that `text` says. Raises LawError with a caret under the place that cannot be.

        Besides the syntax, a law must be finite at rest (d = v = 0, every coefficient 1).
        """
        return _parse(text)

    def __str__(self) -> str:
        return self.text

    def __hash__(self) -> int:
        return hash(self.text)

    def __add__(self, other: Law) -> Law:
        """Both laws acting together; a name that both use is one coefficient, so its unit must be the same in both."""
        if not isinstance(other, Law):
            return NotImplemented
        shared = [name for name in self.coefficients if name in other.coefficients]
        for name in shared:
            if self.units[name] != other.units[name]:
                raise LawError(
                    f"The coefficient {name!r} is in {self.units[name]} in {self.text!r} and in {other.units[name]} here.",
                    other.text,
                    parse_with_places(other.text, VARIABLES).place(Symbol(name)),
                    f"Rename one of the two before adding the laws: {name}2, for instance.",
                )
        return _parse(f"{self.text} + {other.text}")

    @cached_property
    def linear(self) -> tuple[str, ...]:
        """The coefficients in which the law is jointly linear, f = sum c_j g_j + g_0, chosen greedily from left to right."""
        slopes: dict[str, set[str]] = {}
        for name in self.coefficients:
            held = set(symbols(differentiate(self.expression, name)))
            if (
                name not in held
                and not any(name in other for other in slopes.values())
                and not held & set(slopes)
            ):
                slopes[name] = held
        return tuple(slopes)

    @cached_property
    def nonlinear(self) -> tuple[str, ...]:
        """The other coefficients: gaps, slopes inside tanh, exponents."""
        return tuple(name for name in self.coefficients if name not in self.linear)

    @cached_property
    def basis(self) -> Mapping[str, Expression]:
        """For each linear coefficient the expression it multiplies, in d, v and the nonlinear coefficients."""
        return {name: differentiate(self.expression, name) for name in self.linear}

    @cached_property
    def remainder(self) -> Expression:
        """What is left of the law when every linear coefficient is 0."""
        return substitute(self.expression, dict.fromkeys(self.linear, Number(0.0)))

    @cached_property
    def units(self) -> Mapping[str, str]:
        """The SI unit of each coefficient as text: d in m, v in m/s, the law in N; "?" where any unit would do.

        Raises LawError where no units make the law a force, as in `k*d + k*v`.
        """
        try:
            found = infer(self.expression, {"d": METRE, "v": METRE_PER_SECOND}, NEWTON)
        except UnitConflict as error:
            place = parse_with_places(self.text, VARIABLES).place(error.place)
            advice = "Give each term a coefficient of its own."
            raise LawError(error.reason, self.text, place, advice) from None
        return {name: "?" if dimension is None else str(dimension) for name, dimension in found.items()}

    @cached_property
    def elastic(self) -> Expression:
        """The law at v = 0: the part that stores energy."""
        return substitute(self.expression, {"v": Number(0.0)})

    @cached_property
    def kinks(self) -> tuple[Expression, ...]:
        """Expressions in d and v at whose zeros the force is not smooth, each once."""
        return tuple(kink for kink in kinks(self.expression) if set(symbols(kink)) & set(VARIABLES))

    def force(self, d: ArrayLike, v: ArrayLike, values: Mapping[str, ArrayLike]) -> Floats:
        """The force in N at elongation d (m) and rate v (m/s), broadcast with the coefficients; read-only.

        Raises LawError where `values` lacks a coefficient; further names in it are ignored.
        """
        return _force_program(self.expression, self.coefficients)(d, v, *self._ordered(values))[0][()]

    def partials(self, d: ArrayLike, v: ArrayLike, values: Mapping[str, ArrayLike]) -> Partials:
        """The force and its exact derivatives by d, v and every coefficient, as `force`; at a kink the mean of both sides."""
        outputs = _partials_program(self.expression, self.coefficients)(d, v, *self._ordered(values))
        force, by_d, by_v, *others = outputs
        return Partials(force, by_d, by_v, dict(zip(self.coefficients, others, strict=True)))

    def potential(self, d: ArrayLike, values: Mapping[str, ArrayLike]) -> Floats:
        """The energy (J) stored at elongation d (m): the integral of the force at v = 0 from 0 to d.

        In closed form where one is known; else, and where that form is not finite, by Gauss-Legendre quadrature between the
        law's kinks.
        """
        ordered = self._ordered(values)
        closed, quadrature = _potential_programs(self.elastic, self.coefficients)
        if closed is not None:
            energy = closed(d, *ordered)[0]
            if np.all(np.isfinite(energy)):
                return energy[()]
        return integral_from_zero(quadrature, d, ordered)[()]

    def _ordered(self, values: Mapping[str, ArrayLike]) -> list[ArrayLike]:
        missing = [name for name in self.coefficients if name not in values]
        if missing:
            place = parse_with_places(self.text, VARIABLES).place(Symbol(missing[0]))
            given = ", ".join(values) or "none"
            raise LawError(
                f"The coefficient {missing[0]!r} has no value.",
                self.text,
                place,
                f"Values are given for: {given}.",
            )
        return [values[name] for name in self.coefficients]


@lru_cache(maxsize=1024)
def _parse(text: str) -> Law:
    parsed = parse_with_places(text, VARIABLES)
    expression = parsed.expression
    for name, advice in _MISUSED.items():
        place = parsed.place(Symbol(name))
        if place is not None:
            raise LawError(f"{name!r} is not known to a law.", text, place, advice)
    _check_rest(text, parsed)
    return Law(text, expression, tuple(name for name in symbols(expression) if name not in VARIABLES))


def _check_rest(text: str, parsed: Parsed) -> None:
    """Refuse a law that is not finite at d = v = 0, neither with coefficients of 1 nor with others, all different."""
    names = dict.fromkeys(name for part, _ in parsed.places for name in symbols(part))  # of folded parts too
    ones = dict.fromkeys(names, 1.0)
    others = {name: 0.1 + (index * 0.618034) % 0.9 for index, name in enumerate(names)}
    if any(np.isfinite(_at_rest(parsed.expression, values)) for values in (ones, others)):
        return
    expression, position = next(
        place for place in parsed.places if not np.isfinite(_at_rest(place[0], others))
    )
    reason, advice = "No finite value", "Check the argument of this function, and the constants."
    if isinstance(expression, Power):
        reason, advice = "Division by zero", "Keep the divisor away from 0, as in d/(1 + abs(d)/s)."
    raise LawError(f"{reason} at rest (d = 0, v = 0); a law must be finite there.", text, position, advice)


def _at_rest(expression: Expression, values: Mapping[str, float]) -> float:
    names = symbols(expression)
    given = (0.0 if name in VARIABLES else values[name] for name in names)
    return float(Program([expression], names)(*given)[0])


@lru_cache(maxsize=1024)
def _force_program(expression: Expression, coefficients: tuple[str, ...]) -> Program:
    return Program([expression], (*VARIABLES, *coefficients), wide=VARIABLES)


@lru_cache(maxsize=1024)
def _partials_program(expression: Expression, coefficients: tuple[str, ...]) -> Program:
    names = (*VARIABLES, *coefficients)
    return Program([expression, *(differentiate(expression, name) for name in names)], names, wide=VARIABLES)


@lru_cache(maxsize=1024)
def _potential_programs(elastic: Expression, coefficients: tuple[str, ...]) -> tuple[Program | None, Program]:
    """The closed form, if there is one, and what a quadrature needs: the force at v = 0 and its kinks."""
    names = ("d", *coefficients)
    turns = [kink for kink in kinks(elastic) if "d" in symbols(kink)]
    quadrature = Program([elastic, *turns], names, wide=("d",))
    primitive = antiderivative(elastic, "d")
    if primitive is None:
        return None, quadrature
    at_zero = substitute(primitive, {"d": Number(0.0)})
    return Program([add(primitive, multiply(Number(-1.0), at_zero))], names, wide=("d",)), quadrature
