"""The force law of a link: one checked expression for simulation, regression and likelihood, with its dimensions and
compiled programs.

A law is an expression in the link's elongation `d` (m) and its rate `v` (m/s); every other name is a coefficient, except
`pi`. A link with memory has states of its own: f = f(d, v, s), s' = g(d, v, s), with a rate g for each (METHODS section
10). Recorded signals u that it names, as the voltage of a valve or a coil, are inputs of it. Its value is the force (N) on
the link's first end with reversed sign: M x'' = -B f(d, v) (paper Eq. 1, METHODS section 1).
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from linkwise.arrays import Floats
from linkwise.errors import LawError, LinkwiseError, StructureError, expect
from linkwise.expression import (
    FUNCTIONS,
    Expression,
    Number,
    Power,
    Program,
    Symbol,
    antiderivative,
    differentiate,
    kinks,
    parse_with_positions,
    substitute,
    symbols,
)
from linkwise.expression.dimensions import (
    METRE,
    METRE_PER_SECOND,
    NAMED,
    NEWTON,
    NONE,
    RADIAN,
    SECOND,
    Dimension,
    UnitConflict,
    infer,
)
from linkwise.expression.program import cached_program, integral_from_zero
from linkwise.units import base_exponents, factor_to_si

VARIABLES = ("d", "v")

_MISUSED = {
    "x": "The variables of a law are the elongation d = x_first - x_second of its link and its rate v: write d for x.",
    "t": "A law does not depend on time; a force that does is an excitation.",
}


def checked_expression(text: str, variables: tuple[str, ...]) -> Expression:
    """The expression of a law or a rate. Raises LawError for an invalid one."""
    parsed = parse_with_positions(text, variables)
    for name, advice in _MISUSED.items():
        place = parsed.position(Symbol(name))
        if place is not None:
            raise LawError(f"Unknown variable {name!r} in a law.", text, place, advice)
    # of folded parts too; what is not finite with coefficients of 1 may be with others
    names = dict.fromkeys(name for part, _ in parsed.positions for name in symbols(part))
    rest = dict.fromkeys(variables, 0.0)
    ones = dict.fromkeys(names, 1.0) | rest
    others = {name: 0.1 + (index * 0.618034) % 0.9 for index, name in enumerate(names)} | rest
    if any(np.isfinite(_at_rest(parsed.expression, values)) for values in (ones, others)):
        return parsed.expression
    infinite = (place for place in parsed.positions if not np.isfinite(_at_rest(place[0], others)))
    expression, position = next(infinite)
    reason, advice = "No finite value", "Check the argument of this function, and the constants."
    if isinstance(expression, Power):
        reason, advice = "Division by zero", "Keep the divisor away from 0, as in d/(1 + abs(d)/s)."
    raise LawError(f"{reason} at rest (d = 0, v = 0), where a law must be finite.", text, position, advice)


def _at_rest(expression: Expression, values: Mapping[str, float]) -> float:
    names = symbols(expression)
    return float(Program([expression], names)(*(values[name] for name in names))[0])


_NAME = re.compile(r"[A-Za-z]\w*")
_RESERVED = {
    "d": "the elongation",
    "v": "the rate of elongation",
    "pi": "a constant",
    "x": "not used",
    "t": "time",
    "base": "the place that moves",
}


@dataclass(frozen=True)
class LinkState:
    """A state of a link with memory: a slip, an internal force, a voltage or a current.

    Parameters
    ----------
    rate : str
        Its time derivative: an expression in d, v, the states of the link and its coefficients.
    initial : float or None, optional
        Value at the start of a simulation in SI units, 0 by default; None if it is unknown. An identification by maximum
        likelihood estimates the state at the start of each record, as it does displacements and velocities.
    unit : str, optional
        Its unit, such as ``"V"``; needed only where the law and the rates leave it open.

    Raises
    ------
    StructureError
        If the initial value is not a finite number, or the unit is not a unit.

    Examples
    --------
    >>> import linkwise as lw
    >>> slip = lw.model.LinkState("v - abs(v)*z/z0", initial=None)
    >>> law = lw.Law.parse("k*z", {"z": slip})
    >>> law.units["z0"], law.state_units["z"]
    ('m', 'm')
    """

    rate: str
    initial: float | None = 0.0
    unit: str = ""

    def __post_init__(self) -> None:
        expect("LinkState: rate", self.rate, str)
        if self.initial is not None:
            number = isinstance(self.initial, int | float) and not isinstance(self.initial, bool)
            if not number or not math.isfinite(self.initial):
                raise StructureError(
                    f"the initial value of a state must be a finite number, or None if it is unknown, got {self.initial!r}"
                )
            object.__setattr__(self, "initial", float(self.initial))
        if self.unit:
            unit_dimension(self.unit)


@dataclass(frozen=True)
class StateRate:
    """The rate of a state, parsed.

    Attributes
    ----------
    name : str
        The state.
    text : str
        Its rate as written.
    expression : Expression
        The parsed rate, in the unit of the state per s.
    unit : str
        The unit stated for the state; empty where none is.
    initial : float or None
        Its value at the start of a simulation in SI units; None where it is unknown.

    Examples
    --------
    >>> import linkwise as lw
    >>> dahl = lw.model.named_law("dahl")
    >>> rate = lw.Law.parse(dahl.law, states=dahl.states).rates[0]
    >>> rate.name, rate.text
    ('q', 'sigma*(v - abs(v)*q/Fc)')
    """

    name: str
    text: str
    expression: Expression
    unit: str = ""
    initial: float | None = 0.0


def check_symbol(name: object, kind: str) -> None:
    """Raise StructureError for a name that a law cannot have for a `kind` of what it is a function of, such as a state."""
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        valid = "letters, digits and _ after a letter"
        raise StructureError(f"{name!r} is not a valid name of a {kind}: {valid}")
    if name in _RESERVED or name in FUNCTIONS:
        meaning = f"{_RESERVED.get(name, 'a function')} in laws"
        raise StructureError(f"a {kind} cannot be named {name!r}, which is {meaning}; choose another name")


def as_link_states(given: Mapping[str, LinkState | str]) -> dict[str, LinkState]:
    """States by name, a text being a rate. Raises StructureError for a name that cannot be that of a state."""
    states = {}
    for name, state in given.items():
        check_symbol(name, "state")
        if not isinstance(state, LinkState | str):
            raise StructureError(f"state {name}: expected its rate as text or a LinkState, got {state!r}")
        states[name] = LinkState(state) if isinstance(state, str) else state
    return states


def unit_dimension(unit: str) -> Dimension:
    """The dimension of a unit such as "V". Raises StructureError for what is not a unit of mechanics or electricity."""
    if not unit:
        return NONE
    for dimension, name in NAMED.items():  # without a library of units, which takes long to load
        if unit == name:
            return dimension
    try:
        return Dimension(*base_exponents(unit))
    except LinkwiseError as error:
        raise StructureError(str(error)) from None


@lru_cache(maxsize=1024)
def partials_program(expression: Expression, names: tuple[str, ...], by: tuple[str, ...]) -> Program:
    """The force from d, v and `names`, then its derivative by d, by v and by each of `by`."""
    slopes = (differentiate(expression, name) for name in (*VARIABLES, *by))
    return Program([expression, *slopes], (*VARIABLES, *names), wide=VARIABLES)


@lru_cache(maxsize=1024)
def potential_programs(elastic: Expression, coefficients: tuple[str, ...]) -> tuple[Program | None, Program]:
    """The closed form, if there is one, and the program for quadrature: the force at v = 0 and its kinks."""
    names = ("d", *coefficients)
    elastic_kinks = [kink for kink in kinks(elastic) if "d" in symbols(kink)]
    quadrature = Program([elastic, *elastic_kinks], names, wide=("d",))
    primitive = antiderivative(elastic, "d")
    if primitive is None:
        return None, quadrature
    at_zero = substitute(primitive, {"d": Number(0.0)})
    return Program([primitive - at_zero], names, wide=("d",)), quadrature


def dissipated_power(law: Expression, states: tuple[str, ...] = ()) -> Expression:
    """The power in W that a link with this law dissipates, (f(d, v) - f(d, 0)) v; with memory, f(d, v, s) - f(d, 0, 0).

    Signals count as states: what they feed in is dissipation with another sign.

    It is formed symbolically, so that the stored part cancels exactly.
    """
    elastic = substitute(law, dict.fromkeys(("v", *states), Number(0.0)))
    return Symbol("v") * (law - elastic)


_LINEAR = ({"d": METRE, "v": METRE_PER_SECOND},)
_ANGULAR = ({"d": RADIAN, "v": RADIAN / SECOND}, {"d": NONE, "v": NONE / SECOND})
"""An angle is a number where a law needs one, as in `k*sin(d)`."""


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
    signal_units : tuple of (str, str)
        Recorded signals that the law or a rate names, and their units.

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
    signal_units: tuple[tuple[str, str], ...] = ()

    def __repr__(self) -> str:
        rates, signals = {rate.name: rate.text for rate in self.rates}, dict(self.signal_units)
        given = (f", {rates!r}" if rates else "") + (f", signals={signals!r}" if signals else "")
        return f"Law.parse({self.text!r}{given})"

    @staticmethod
    def parse(
        text: str,
        states: Mapping[str, LinkState | str] | None = None,
        *,
        units: Mapping[str, str] | None = None,
        signals: Mapping[str, str] = MappingProxyType({}),
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
        signals : mapping of str to str, optional
            Recorded signals by name, and the unit of each, such as ``{"u": "V"}``; those that the law names are its inputs.

        Returns
        -------
        Law
            The law.

        Raises
        ------
        LawError
            If an expression is invalid, or not finite at rest (d = v = 0, states 0).
        StructureError
            If a name cannot be that of a state or a signal, or a unit is none.

        Examples
        --------
        >>> import linkwise as lw
        >>> valve = lw.Law.parse("(c0 + cu*u)*v", signals={"u": "V"})
        >>> valve.signals, dict(valve.units)
        (('u',), {'c0': 'N s/m', 'cu': 's^2 A/m^2'})
        """
        given = as_link_states(states or {})
        for name, unit in signals.items():
            check_symbol(name, "signal")
            if str(unit_dimension(unit)) != unit and factor_to_si(unit, "?") != 1.0:
                raise StructureError(
                    f"signal {name}: numbers in laws are SI, and {unit!r} is no SI unit; a record may have the signal in it, "
                    f"as signal:{name}[{unit}]"
                )
            if name in given:
                raise StructureError(f"{name!r} is a state and a signal; rename one of the two")
        law = _parse(text, tuple(given.items()), tuple(signals.items()))
        return replace(law, declared=tuple(units.items())) if units else law

    def __str__(self) -> str:
        return self.text

    def __hash__(self) -> int:
        return hash(self.text)

    @cached_property
    def states(self) -> tuple[str, ...]:
        """Names of the states of a link with memory, in the order of all arrays."""
        return tuple(rate.name for rate in self.rates)

    @cached_property
    def named_rates(self) -> tuple[tuple[str, Expression], ...]:
        """The rate of each state by name, parsed."""
        return tuple((rate.name, rate.expression) for rate in self.rates)

    @property
    def trees(self) -> tuple[Expression, ...]:
        """The law and the rate of each state, parsed."""
        return (self.expression, *(rate.expression for rate in self.rates))

    @property
    def equations(self) -> str:
        """The law as text and, with memory, the rates of its states: "q; q' = k*(v - q/c)"."""
        return "; ".join([self.text, *(f"{rate.name}' = {rate.text}" for rate in self.rates)])

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the recorded signals that the law or a rate names, in the order in which they were declared."""
        return tuple(name for name, _ in self.signal_units)

    @property
    def variables(self) -> tuple[str, ...]:
        """d, v, the states and the signals."""
        return (*VARIABLES, *self.states, *self.signals)

    @property
    def is_plain(self) -> bool:
        """Whether it is a function of d and v alone, without states and signals."""
        return len(self.variables) == len(VARIABLES)

    @cached_property
    def linear(self) -> tuple[str, ...]:
        """Coefficients in which the law is jointly linear, f = sum c_j g_j + g_0, chosen greedily from left to right."""
        slopes: dict[str, set[str]] = {}
        in_rates = {name for rate in self.rates for name in symbols(rate.expression)}
        for name in self.coefficients:
            if name in in_rates:
                continue
            names = set(symbols(differentiate(self.expression, name)))
            in_others = any(name in slope for slope in slopes.values())
            if name not in names and not in_others and not names & set(slopes):
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
        known |= {name: unit_dimension(unit) for name, unit in self.signal_units}
        dimensions = coefficient_dimensions(self, known).items()
        return {name: "?" if dimension is None else str(dimension) for name, dimension in dimensions}

    @cached_property
    def elastic(self) -> Expression:
        """The law at v = 0 and at states and signals of 0: the part that stores energy."""
        return substitute(self.expression, dict.fromkeys(self.variables[1:], Number(0.0)))

    @cached_property
    def kinks(self) -> tuple[Expression, ...]:
        """Expressions in d, v, states and signals at whose zeros the force or a rate is not smooth, without repetition."""
        distinct = dict.fromkeys(kink for tree in self.trees for kink in kinks(tree))
        return tuple(kink for kink in distinct if set(symbols(kink)) & set(self.variables))

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
        program = cached_program((self.expression,), (*VARIABLES, *self._named), wide=VARIABLES)
        return program(d, v, *self._ordered(values))[0][()]

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
        program = cached_program(rates, (*VARIABLES, *self._named), wide=self.variables)
        return program(d, v, *self._ordered(values))

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

    def potential(self, d: ArrayLike, values: Mapping[str, ArrayLike]) -> Floats:
        """Stored energy: the integral of the force at v = 0, and at states and signals of 0, from 0 to d.

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
        others = self.variables[len(VARIABLES) :]
        ordered = self._ordered({**dict.fromkeys(others, 0.0), **values})[len(others) :]
        closed, quadrature = potential_programs(self.elastic, self.coefficients)
        if closed is not None:
            energy = closed(d, *ordered)[0]
            if np.all(np.isfinite(energy)):
                return energy[()]
        return integral_from_zero(quadrature, d, ordered)[()]

    @cached_property
    def _named(self) -> tuple[str, ...]:
        """States, signals and coefficients: what the law needs besides d and v."""
        return (*self.variables[len(VARIABLES) :], *self.coefficients)

    def _ordered(self, values: Mapping[str, ArrayLike]) -> list[ArrayLike]:
        missing = [name for name in self._named if name not in values]
        if missing:
            place = parse_with_positions(self.text, self.variables).position(Symbol(missing[0]))
            given = ", ".join(values) or "none"
            kinds = dict.fromkeys(self.states, "state") | dict.fromkeys(self.signals, "signal")
            kind = kinds.get(missing[0], "coefficient")
            advice = f"Values are given for: {given}."
            raise LawError(f"The {kind} {missing[0]!r} has no value.", self.text, place, advice)
        return [values[name] for name in self._named]


@lru_cache(maxsize=1024)
def _parse(
    text: str, states: tuple[tuple[str, LinkState], ...], signals: tuple[tuple[str, str], ...] = ()
) -> Law:
    variables = (*VARIABLES, *(name for name, _ in (*states, *signals)))
    expression = checked_expression(text, variables)
    parsed = tuple(
        StateRate(name, state.rate, checked_expression(state.rate, variables), state.unit, state.initial)
        for name, state in states
    )
    trees = (expression, *(rate.expression for rate in parsed))
    names = dict.fromkeys(name for tree in trees for name in symbols(tree))
    coefficients = tuple(name for name in names if name not in variables)
    used = tuple(pair for pair in dict.fromkeys(signals) if pair[0] in names)
    return Law(text, expression, coefficients, parsed, signal_units=used)


def coefficient_dimensions(law: Law, known: Mapping[str, Dimension]) -> dict[str, Dimension | None]:
    """Dimension of each coefficient and state of a law, given those of some.

    Parameters
    ----------
    law : Law
        The law.
    known : mapping of str to Dimension
        The dimensions that are stated.

    Returns
    -------
    dict of str to Dimension or None
        All of them; None where any is consistent.

    Raises
    ------
    LawError
        If none are consistent; it has the place where they disagree.
    """
    rates = {rate.name: rate.expression for rate in law.rates}
    force = NEWTON * METRE if law.angular else NEWTON
    conflicts = []
    for variables in _ANGULAR if law.angular else _LINEAR:
        try:
            return infer(law.expression, variables, force, rates=rates, known=known)
        except UnitConflict as error:
            conflicts.append(error)
    first = conflicts[0]
    faulty = (law.text, *(rate.text for rate in law.rates))[first.equation]
    place = parse_with_positions(faulty, (*VARIABLES, *rates, *known)).position(first.part)
    raise LawError(first.reason, faulty, place, "Give each term a coefficient of its own.") from None
