"""The force law of a link: one expression for simulation, regression and likelihood.

A law is an expression in the link's elongation `d` (m) and its rate `v` (m/s); every other name is a coefficient, except `pi`.
A link with memory has states of its own: f = f(d, v, s), s' = g(d, v, s), with a rate g for each (METHODS section 10).
Its value is the force (N) on the link's first end with reversed sign: M x'' = -B f(d, v) (paper Eq. 1, METHODS section 1).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from linkwise.argument_types import checked
from linkwise.arrays import Floats
from linkwise.errors import LawError
from linkwise.expression import (
    Expression,
    Number,
    Symbol,
    differentiate,
    kinks,
    parse_with_positions,
    substitute,
    symbols,
)
from linkwise.expression.program import integral_from_zero
from linkwise.model.law_dimensions import law_dimensions
from linkwise.model.law_programs import force_program, partials_program, potential_programs, rates_program
from linkwise.model.law_text import VARIABLES, checked_expression
from linkwise.model.link_state import LinkState, StateRate, as_link_states, unit_dimension


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

    Examples
    --------
    >>> import linkwise as lw
    >>> partials = lw.Law.parse("k*d + c*v").partials(0.1, 2.0, {"k": 400.0, "c": 0.5})
    >>> float(partials.force), float(partials.by_d), float(partials.by_v), float(partials.by_coefficient["k"])
    (41.0, 400.0, 0.5, 0.1)
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
        Names of the coefficients in order of appearance, which is the order of all mappings; those of the rates follow.
    rates : tuple of StateRate
        The rates of the states of a link with memory; empty without memory.
    declared : tuple of (str, str)
        Coefficients with a unit that is declared, where numbers in the law have units of their own.
    angular : bool
        Whether it is a moment (N m) by an angle (rad) and its rate (rad/s), between ends that turn; a structure sets it.

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
    rates: tuple[StateRate, ...] = ()
    declared: tuple[tuple[str, str], ...] = ()
    angular: bool = False

    @staticmethod
    @checked
    def parse(
        text: str,
        states: Mapping[str, LinkState | str] | None = None,
        *,
        units: Mapping[str, str] | None = None,
    ) -> Law:
        """Parse a law.

        Parameters
        ----------
        text : str
            An expression in d, v, coefficients, numbers, ``+ - * / **`` and the functions of laws.
        states : mapping of str to LinkState or str, optional
            The states of a link with memory and their rates: expressions in d, v, the states and coefficients.
        units : mapping of str to str, optional
            The SI unit of every coefficient, where numbers in the law have units; inferred by default.

        Returns
        -------
        Law
            The law.

        Raises
        ------
        LawError
            If an expression is invalid, or not finite at rest (d = v = 0, states 0).
        StructureError
            If a name cannot be that of a state.
        """
        rates = {name: (state.rate, state.unit) for name, state in as_link_states(states or {}).items()}
        law = _parse(text, tuple((name, *rate) for name, rate in rates.items()))
        return replace(law, declared=tuple(units.items())) if units else law

    def __str__(self) -> str:
        return self.text

    def __hash__(self) -> int:
        return hash(self.text)

    def __add__(self, other: Law) -> Law:
        """The sum of two laws; a name in both is one coefficient, so its unit must be the same."""
        if not isinstance(other, Law):
            return NotImplemented
        if self.rates or other.rates:
            raise LawError(
                "A law with states cannot be added.",
                self.text,
                None,
                "Write the sum and its states out in one law.",
            )
        shared = [name for name in self.coefficients if name in other.coefficients]
        for name in shared:
            if self.units[name] != other.units[name]:
                raise LawError(
                    f"The coefficient {name!r} is in {self.units[name]} in {self.text!r}, but in {other.units[name]} here.",
                    other.text,
                    parse_with_positions(other.text, VARIABLES).position(Symbol(name)),
                    f"Rename one of the two before adding the laws, for instance to {name}2.",
                )
        total = _parse(f"{self.text} + {other.text}", ())
        return replace(total, angular=True) if self.angular or other.angular else total

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states of a link with memory, in the order of all arrays."""
        return tuple(rate.name for rate in self.rates)

    @cached_property
    def named_rates(self) -> tuple[tuple[str, Expression], ...]:
        """The rate of each state by name, parsed."""
        return tuple((rate.name, rate.expression) for rate in self.rates)

    @property
    def equations(self) -> str:
        """The law as text and, with memory, the rates of its states: "q; q' = k*(v - q/c)"."""
        return "; ".join([self.text, *(f"{rate.name}' = {rate.text}" for rate in self.rates)])

    @property
    def variables(self) -> tuple[str, ...]:
        """d, v and the states."""
        return (*VARIABLES, *self.states)

    @cached_property
    def linear(self) -> tuple[str, ...]:
        """Coefficients in which the law is jointly linear, f = sum c_j g_j + g_0, chosen greedily from left to right."""
        slopes: dict[str, set[str]] = {}
        in_rates = {name for rate in self.rates for name in symbols(rate.expression)}
        for name in self.coefficients:
            if name in in_rates:
                continue
            names = set(symbols(differentiate(self.expression, name)))
            if (
                name not in names
                and not any(name in names_of_slope for names_of_slope in slopes.values())
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

    @property
    def motion_units(self) -> tuple[str, str]:
        """SI units of d and v."""
        return ("rad", "rad/s") if self.angular else ("m", "m/s")

    @property
    def force_unit(self) -> str:
        """SI unit of the force, which is a moment where the ends turn."""
        return "N m" if self.angular else "N"

    @property
    def units(self) -> Mapping[str, str]:
        """SI unit of each coefficient, such as ``"N/m"``; ``"?"`` where any unit is consistent.

        Raises LawError if no units of the coefficients make the law a force, as in ``k*d + k*v``, or a rate one of its state.
        """
        return {name: self._dimensions[name] for name in self.coefficients}

    @property
    def state_units(self) -> Mapping[str, str]:
        """SI unit of each state, ``""`` for none; ``"?"`` where any unit is consistent. Raises LawError as `units` does."""
        return {name: self._dimensions[name] for name in self.states}

    @cached_property
    def _dimensions(self) -> Mapping[str, str]:
        """Unit of each coefficient and state."""
        if self.declared:
            return dict(self.declared)
        known = {rate.name: unit_dimension(rate.unit) for rate in self.rates if rate.unit}
        dimensions = law_dimensions(self.text, self.expression, self.rates, known, angular=self.angular)
        return {name: "?" if dimension is None else str(dimension) for name, dimension in dimensions.items()}

    @cached_property
    def elastic(self) -> Expression:
        """The law at v = 0 and, with memory, at states of 0: the part that stores energy."""
        return substitute(self.expression, dict.fromkeys(self.variables[1:], Number(0.0)))

    @cached_property
    def kinks(self) -> tuple[Expression, ...]:
        """Expressions in d, v and states at whose zeros the force or a rate is not smooth, without repetition."""
        trees = (self.expression, *(rate.expression for rate in self.rates))
        distinct = dict.fromkeys(kink for tree in trees for kink in kinks(tree))
        return tuple(kink for kink in distinct if set(symbols(kink)) & set(self.variables))

    @checked
    def force(self, d: ArrayLike, v: ArrayLike, values: Mapping[str, ArrayLike]) -> Floats:
        """Force in N at elongation `d` in m and rate `v` in m/s.

        Parameters
        ----------
        d, v : array
            Elongation in m and rate in m/s.
        values : mapping of str to array
            Value of each coefficient and state; further names are ignored.

        Returns
        -------
        array
            Force in N, of the broadcast shape of d, v and the coefficients; read-only.

        Raises
        ------
        LawError
            If a coefficient or a state has no value.
        """
        return force_program(self.expression, self._named)(d, v, *self._ordered(values))[0][()]

    @checked
    def state_rates(self, d: ArrayLike, v: ArrayLike, values: Mapping[str, ArrayLike]) -> tuple[Floats, ...]:
        """Rate of each state in its unit per second.

        Parameters
        ----------
        d, v : array
            Elongation in m and rate in m/s.
        values : mapping of str to array
            Value of each coefficient and state; further names are ignored.

        Returns
        -------
        tuple of array
            The rates in the order of `states`, each of the broadcast shape of d, v and the coefficients; read-only.

        Raises
        ------
        LawError
            If a coefficient or a state has no value.
        """
        rates = tuple(rate.expression for rate in self.rates)
        return rates_program(rates, self._named, self.variables)(d, v, *self._ordered(values))

    @checked
    def partials(
        self, d: ArrayLike, v: ArrayLike, values: Mapping[str, ArrayLike], *, by: Sequence[str] | None = None
    ) -> Partials:
        """Force and exact derivatives by d, v and coefficients.

        At a kink the derivative is the mean of the two one-sided derivatives.

        Parameters
        ----------
        d, v : array
            Elongation in m and rate in m/s.
        values : mapping of str to array
            Value of each coefficient and state; further names are ignored.
        by : sequence of str, optional
            Coefficients to differentiate by; by default all.

        Returns
        -------
        Partials
            The force and its derivatives, read-only.

        Raises
        ------
        LawError
            If a coefficient has no value.
        """
        names = self.coefficients if by is None else tuple(by)
        program = partials_program(self.expression, self._named, names)
        force, by_d, by_v, *others = program(d, v, *self._ordered(values))
        return Partials(force, by_d, by_v, dict(zip(names, others, strict=True)))

    @checked
    def potential(self, d: ArrayLike, values: Mapping[str, ArrayLike]) -> Floats:
        """Stored energy: the integral of the force at v = 0, and at states of 0, from 0 to d.

        In closed form if there is one and it is finite; otherwise by Gauss-Legendre quadrature between the kinks of the law.

        Parameters
        ----------
        d : array
            Elongation in m.
        values : mapping of str to array
            Value of each coefficient and state; further names are ignored.

        Returns
        -------
        array
            Energy in J, of the broadcast shape of d and the coefficients.

        Raises
        ------
        LawError
            If a coefficient has no value.
        """
        ordered = self._ordered({**dict.fromkeys(self.states, 0.0), **values})[len(self.rates) :]
        closed, quadrature = potential_programs(self.elastic, self.coefficients)
        if closed is not None:
            energy = closed(d, *ordered)[0]
            if np.all(np.isfinite(energy)):
                return energy[()]
        return integral_from_zero(quadrature, d, ordered)[()]

    @cached_property
    def _named(self) -> tuple[str, ...]:
        """States and coefficients: what the law needs besides d and v."""
        return (*self.states, *self.coefficients)

    def _ordered(self, values: Mapping[str, ArrayLike]) -> list[ArrayLike]:
        missing = [name for name in self._named if name not in values]
        if missing:
            place = parse_with_positions(self.text, self.variables).position(Symbol(missing[0]))
            given = ", ".join(values) or "none"
            kind = "state" if missing[0] in self.states else "coefficient"
            advice = f"Values are given for: {given}."
            raise LawError(f"The {kind} {missing[0]!r} has no value.", self.text, place, advice)
        return [values[name] for name in self._named]


@lru_cache(maxsize=1024)
def _parse(text: str, rates: tuple[tuple[str, str, str], ...]) -> Law:
    variables = (*VARIABLES, *(name for name, _, _ in rates))
    expression = checked_expression(text, variables)
    parsed = tuple(
        StateRate(name, rate, checked_expression(rate, variables), unit) for name, rate, unit in rates
    )
    trees = (expression, *(rate.expression for rate in parsed))
    names = dict.fromkeys(name for tree in trees for name in symbols(tree))
    return Law(text, expression, tuple(name for name in names if name not in variables), parsed)
