"""The force law of a link: one expression for simulation, regression and likelihood.

A law is an expression in the link's elongation `d` (m) and its rate `v` (m/s); every other name is a coefficient, except `pi`.
Its value is the force (N) on the link's first end with reversed sign: M x'' = -B f(d, v) (paper Eq. 1, METHODS section 1).
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
    parse_with_positions,
    substitute,
    symbols,
)
from linkwise.expression.dimension import METRE, METRE_PER_SECOND, NEWTON
from linkwise.expression.inference import UnitConflict, infer
from linkwise.expression.parser import Parsed
from linkwise.expression.quadrature import integral_from_zero

VARIABLES = ("d", "v")

_MISUSED = {
    "x": "The variables of a law are the elongation d = x_first - x_second of its link and its rate v: write d for x.",
    "t": "A law does not depend on time; a force that does is an excitation.",
}


class Partials(NamedTuple):
    """The force of a law and its partial derivatives, all of the broadcast shape of d, v and the coefficients.

    Attributes
    ----------
    force : array
        Force in N.
    by_d, by_v : array
        Derivatives by elongation in N/m and by rate in N s/m.
    by_coefficient : dict of str to array
        Derivative by each coefficient.
    """

    force: Floats
    by_d: Floats
    by_v: Floats
    by_coefficient: dict[str, Floats]


@dataclass(frozen=True)
class Law:
    """The force law of a link, built with `Law.parse`. Laws of equal text share compiled code.

    Attributes
    ----------
    text : str
        The law as written.
    expression : Expression
        The parsed law.
    coefficients : tuple of str
        Names of the coefficients in order of appearance, which is the order of all mappings.

    Examples
    --------
    >>> import linkwise as lw
    >>> law = lw.Law.parse("alpha*d + beta*d**3 + c*v")
    >>> law.coefficients
    ('alpha', 'beta', 'c')
    >>> law.units["beta"]
    'N/m^3'
    >>> float(law.force(0.5, 0.0, {"alpha": -4.0, "beta": 16.0, "c": 0.02}))
    0.0
    """

    text: str
    expression: Expression
    coefficients: tuple[str, ...]

    @staticmethod
    def parse(text: str) -> Law:
        """Parse a law.

        Parameters
        ----------
        text : str
            An expression in d, v, coefficients, numbers, ``+ - * / **`` and the functions of laws.

        Returns
        -------
        Law
            The law.

        Raises
        ------
        LawError
            If the expression is invalid, or not finite at rest (d = v = 0).
        """
        return _parse(text)

    def __str__(self) -> str:
        return self.text

    def __hash__(self) -> int:
        return hash(self.text)

    def __add__(self, other: Law) -> Law:
        """The sum of two laws; a name in both is one coefficient, so its unit must be the same."""
        if not isinstance(other, Law):
            return NotImplemented
        shared = [name for name in self.coefficients if name in other.coefficients]
        for name in shared:
            if self.units[name] != other.units[name]:
                raise LawError(
                    f"The coefficient {name!r} is in {self.units[name]} in {self.text!r}, but in {other.units[name]} here.",
                    other.text,
                    parse_with_positions(other.text, VARIABLES).position(Symbol(name)),
                    f"Rename one of the two before adding the laws, for instance to {name}2.",
                )
        return _parse(f"{self.text} + {other.text}")

    @cached_property
    def linear(self) -> tuple[str, ...]:
        """Coefficients in which the law is jointly linear, f = sum c_j g_j + g_0, chosen greedily from left to right."""
        slopes: dict[str, set[str]] = {}
        for name in self.coefficients:
            names = set(symbols(differentiate(self.expression, name)))
            if (
                name not in names
                and not any(name in other for other in slopes.values())
                and not names & set(slopes)
            ):
                slopes[name] = names
        return tuple(slopes)

    @cached_property
    def nonlinear(self) -> tuple[str, ...]:
        """The other coefficients, such as gaps, arguments of tanh and exponents."""
        return tuple(name for name in self.coefficients if name not in self.linear)

    @cached_property
    def basis(self) -> Mapping[str, Expression]:
        """For each linear coefficient, the expression it multiplies, in d, v and the nonlinear coefficients."""
        return {name: differentiate(self.expression, name) for name in self.linear}

    @cached_property
    def remainder(self) -> Expression:
        """The law with every linear coefficient set to 0."""
        return substitute(self.expression, dict.fromkeys(self.linear, Number(0.0)))

    @cached_property
    def units(self) -> Mapping[str, str]:
        """SI unit of each coefficient, such as ``"N/m"``; ``"?"`` where any unit is consistent.

        Raises LawError if no units of the coefficients make the law a force, as in ``k*d + k*v``.
        """
        try:
            dimensions = infer(self.expression, {"d": METRE, "v": METRE_PER_SECOND}, NEWTON)
        except UnitConflict as error:
            place = parse_with_positions(self.text, VARIABLES).position(error.part)
            advice = "Give each term a coefficient of its own."
            raise LawError(error.reason, self.text, place, advice) from None
        return {name: "?" if dimension is None else str(dimension) for name, dimension in dimensions.items()}

    @cached_property
    def elastic(self) -> Expression:
        """The law at v = 0, the part that stores energy."""
        return substitute(self.expression, {"v": Number(0.0)})

    @cached_property
    def kinks(self) -> tuple[Expression, ...]:
        """Expressions in d and v at whose zeros the force is not smooth, without repetition."""
        return tuple(kink for kink in kinks(self.expression) if set(symbols(kink)) & set(VARIABLES))

    def force(self, d: ArrayLike, v: ArrayLike, values: Mapping[str, ArrayLike]) -> Floats:
        """Force in N at elongation `d` in m and rate `v` in m/s.

        Parameters
        ----------
        d, v : array
            Elongation in m and rate in m/s.
        values : mapping of str to array
            Value of each coefficient; further names are ignored.

        Returns
        -------
        array
            Force in N, of the broadcast shape of d, v and the coefficients; read-only.

        Raises
        ------
        LawError
            If a coefficient has no value.
        """
        return _force_program(self.expression, self.coefficients)(d, v, *self._ordered(values))[0][()]

    def partials(self, d: ArrayLike, v: ArrayLike, values: Mapping[str, ArrayLike]) -> Partials:
        """Force and exact derivatives by d, v and every coefficient.

        At a kink the derivative is the mean of the two one-sided derivatives.

        Parameters
        ----------
        d, v, values
            As of `force`.

        Returns
        -------
        Partials
            The force and its derivatives, read-only.

        Raises
        ------
        LawError
            If a coefficient has no value.
        """
        outputs = _partials_program(self.expression, self.coefficients)(d, v, *self._ordered(values))
        force, by_d, by_v, *others = outputs
        return Partials(force, by_d, by_v, dict(zip(self.coefficients, others, strict=True)))

    def potential(self, d: ArrayLike, values: Mapping[str, ArrayLike]) -> Floats:
        """Stored energy: the integral of the force at v = 0 from 0 to d.

        In closed form if there is one and it is finite; otherwise by Gauss-Legendre quadrature between the kinks of the law.

        Parameters
        ----------
        d : array
            Elongation in m.
        values
            As of `force`.

        Returns
        -------
        array
            Energy in J, of the broadcast shape of d and the coefficients.

        Raises
        ------
        LawError
            If a coefficient has no value.
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
            place = parse_with_positions(self.text, VARIABLES).position(Symbol(missing[0]))
            given = ", ".join(values) or "none"
            raise LawError(
                f"The coefficient {missing[0]!r} has no value.",
                self.text,
                place,
                f"Values are given for: {given}.",
            )
        return [values[name] for name in self.coefficients]


def dissipated_power(law: Expression) -> Expression:
    """The power in W that a link with this law dissipates, (f(d, v) - f(d, 0)) v.

    It is formed symbolically, so that the stored part cancels exactly.
    """
    elastic = substitute(law, {"v": Number(0.0)})
    return multiply(Symbol("v"), add(law, multiply(Number(-1.0), elastic)))


@lru_cache(maxsize=1024)
def _parse(text: str) -> Law:
    parsed = parse_with_positions(text, VARIABLES)
    expression = parsed.expression
    for name, advice in _MISUSED.items():
        place = parsed.position(Symbol(name))
        if place is not None:
            raise LawError(f"Unknown variable {name!r} in a law.", text, place, advice)
    _check_rest(text, parsed)
    return Law(text, expression, tuple(name for name in symbols(expression) if name not in VARIABLES))


def _check_rest(text: str, parsed: Parsed) -> None:
    """Raise LawError for a law that is not finite at d = v = 0, neither with coefficients of 1 nor with others."""
    names = dict.fromkeys(
        name for part, _ in parsed.positions for name in symbols(part)
    )  # of folded parts too
    ones = dict.fromkeys(names, 1.0)
    others = {name: 0.1 + (index * 0.618034) % 0.9 for index, name in enumerate(names)}
    if any(np.isfinite(_at_rest(parsed.expression, values)) for values in (ones, others)):
        return
    expression, position = next(
        place for place in parsed.positions if not np.isfinite(_at_rest(place[0], others))
    )
    reason, advice = "No finite value", "Check the argument of this function, and the constants."
    if isinstance(expression, Power):
        reason, advice = "Division by zero", "Keep the divisor away from 0, as in d/(1 + abs(d)/s)."
    raise LawError(f"{reason} at rest (d = 0, v = 0), where a law must be finite.", text, position, advice)


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
    """The closed form, if there is one, and the program for quadrature: the force at v = 0 and its kinks."""
    names = ("d", *coefficients)
    elastic_kinks = [kink for kink in kinks(elastic) if "d" in symbols(kink)]
    quadrature = Program([elastic, *elastic_kinks], names, wide=("d",))
    primitive = antiderivative(elastic, "d")
    if primitive is None:
        return None, quadrature
    at_zero = substitute(primitive, {"d": Number(0.0)})
    return Program([add(primitive, multiply(Number(-1.0), at_zero))], names, wide=("d",)), quadrature
