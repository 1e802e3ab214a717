"""Physical dimensions, and their inference for coefficients and states from the equations that they appear in.

Every coefficient, and every state of a link with memory, has an unknown dimension; every sum, every function, every rate
of a state and the expression as a whole give a linear equation for the exponents, solved exactly in fractions. A number
may have a dimension too: the gap in `max(abs(d) - 0.001, 0)` is a length, the 1000 in `1000*d + c*v` a stiffness, and a
plain `d**3` next to `k*d` has an implicit factor of 1 N/m^3. A number has a dimension only where the equations require
one. The others are made dimensionless one by one: implicit factors first, then numbers that are terms of a sum, then
factors. So `k*d*(1 + d/0.01)` has a dimensionless 1 and a length of 0.01.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple, dataclass
from fractions import Fraction
from operator import add
from typing import NamedTuple, final

from linkwise.expression.tree import (
    FUNCTIONS,
    MINUS_ONE,
    Call,
    Expression,
    Number,
    Power,
    Product,
    Sum,
    Symbol,
    children,
    symbols,
    to_text,
)


@final
@dataclass(frozen=True, slots=True)
class Dimension:
    """Exponents of kilogram, metre, second, ampere and radian; `str` is the SI unit, in newtons wherever a mass takes part.

    >>> str(NEWTON / METRE**3), str(NEWTON * SECOND / METRE), str(KILOGRAM), str(NONE)
    ('N/m^3', 'N s/m', 'kg', '')
    >>> str(VOLT / AMPERE), str(NEWTON / VOLT), str(NEWTON / AMPERE)
    ('ohm', 'N/V', 'N/A')
    >>> str(NEWTON * METRE / RADIAN**3), str(RADIAN / SECOND)
    ('N m/rad^3', 'rad/s')
    """

    kilogram: Fraction
    metre: Fraction
    second: Fraction
    ampere: Fraction = Fraction(0)
    radian: Fraction = Fraction(0)

    def __mul__(self, other: Dimension) -> Dimension:
        return Dimension(*map(add, astuple(self), astuple(other)))

    def __truediv__(self, other: Dimension) -> Dimension:
        return self * other**-1

    def __pow__(self, exponent: int | Fraction) -> Dimension:
        return Dimension(*(own * exponent for own in astuple(self)))

    def __str__(self) -> str:
        if self in NAMED:
            return NAMED[self]
        spellings = [self._spelled("A", AMPERE)]
        if self.ampere:
            spellings.append(self._spelled("V", VOLT))
        return min(spellings, key=len)

    def _spelled(self, name: str, electrical: Dimension) -> str:
        """The unit in newton, metre, second and one electrical unit."""
        share = self.ampere / electrical.ampere
        rest = self / electrical**share
        newton = rest.kilogram  # N = kg m / s^2
        exponents = {"N": newton, "m": rest.metre - newton, "rad": rest.radian, "s": rest.second + 2 * newton}
        exponents[name] = share
        over = [_raised(unit, exponent) for unit, exponent in exponents.items() if exponent > 0]
        under = [_raised(unit, -exponent) for unit, exponent in exponents.items() if exponent < 0]
        if not under:
            return " ".join(over)
        below = under[0] if len(under) == 1 else f"({' '.join(under)})"
        return f"{' '.join(over) or '1'}/{below}"


def _raised(name: str, exponent: Fraction) -> str:
    if exponent == 1:
        return name
    return f"{name}^{exponent}" if exponent.denominator == 1 else f"{name}^({exponent})"


def _dimension(kilogram: int, metre: int, second: int, ampere: int = 0) -> Dimension:
    return Dimension(Fraction(kilogram), Fraction(metre), Fraction(second), Fraction(ampere))


NONE = _dimension(0, 0, 0)
KILOGRAM = _dimension(1, 0, 0)
METRE = _dimension(0, 1, 0)
SECOND = _dimension(0, 0, 1)
AMPERE = _dimension(0, 0, 0, 1)
RADIAN = Dimension(*map(Fraction, (0, 0, 0, 0, 1)))
METRE_PER_SECOND = METRE / SECOND
NEWTON = KILOGRAM * METRE / SECOND**2
VOLT = NEWTON * METRE / SECOND / AMPERE
NAMED = {
    KILOGRAM: "kg", NEWTON: "N", METRE: "m", AMPERE: "A", VOLT: "V", VOLT / AMPERE: "ohm", AMPERE * SECOND / VOLT: "F",
    VOLT * SECOND / AMPERE: "H",
}  # fmt: skip
"""Units with a name of one word."""


_IMPLICIT, _TERM, _FACTOR = range(3)  # the order in which numbers are made dimensionless


class UnitConflict(Exception):
    """No units of the coefficients are consistent.

    `reason` says why, `part` is the sub-expression at fault, and `equation` the number of the equation that it is in.
    """

    def __init__(self, reason: str, part: Expression, equation: int = 0) -> None:
        super().__init__(reason)
        self.reason, self.part, self.equation = reason, part, equation


def infer(
    expression: Expression,
    variables: Mapping[str, Dimension],
    whole: Dimension,
    *,
    rates: Mapping[str, Expression] | None = None,
    known: Mapping[str, Dimension] | None = None,
) -> dict[str, Dimension | None]:
    """The dimension of every symbol that is not a variable, in order of appearance; None where any is consistent.

    `variables` gives the dimensions of the variables, `whole` that of the expression, `rates` the rate of each state, which is
    in the unit of the state per second, and `known` dimensions that are stated. Raises UnitConflict where none is consistent:
    equation 0 is the expression, those of the rates follow.
    """
    constraints = _Constraints(variables)
    requirement = f"the force must be in {whole}"
    constraints.equate(constraints.term(expression), _Monomial({}, whole), expression, requirement)
    for name, dimension in (known or {}).items():
        requirement = f"{name} is in {str(dimension) or '1'}"
        constraints.equate(constraints.coefficient(name), _Monomial({}, dimension), Symbol(name), requirement)
    for number, (name, rate) in enumerate((rates or {}).items(), start=1):
        constraints.equation = number
        per_second = constraints.coefficient(name).times(_Monomial({}, SECOND), Fraction(-1))
        requirement = f"the rate of {name} must be in the unit of {name} per second"
        constraints.equate(constraints.term(rate), per_second, rate, requirement)
    for _, unknown in sorted(constraints.numbers):
        constraints.system.add(_Monomial({unknown: Fraction(1)}, NONE))
    trees = (expression, *(rates or {}).values())
    names = dict.fromkeys([*(name for tree in trees for name in symbols(tree)), *(rates or {})])
    asked = [name for name in names if name not in variables]
    return {name: constraints.system.resolve(constraints.coefficient(name)) for name in asked}


class _Monomial(NamedTuple):
    """A dimension as a product of powers: unknown dimensions to fractions, times a known one."""

    unknowns: Mapping[int, Fraction]
    known: Dimension

    def times(self, factor: _Monomial, exponent: Fraction = Fraction(1)) -> _Monomial:
        total = dict(self.unknowns)
        for unknown, share in factor.unknowns.items():
            total[unknown] = total.get(unknown, Fraction(0)) + exponent * share
        unknowns = {u: share for u, share in total.items() if share}
        return _Monomial(unknowns, self.known * factor.known**exponent)


_DIMENSIONLESS = _Monomial({}, NONE)


class _LinearEquations:
    """Linear equations in reduced row echelon form: each is solved for one unknown that appears in no other."""

    def __init__(self) -> None:
        self.solved: dict[int, _Monomial] = {}

    def reduce(self, form: _Monomial) -> _Monomial:
        for unknown in [u for u in form.unknowns if u in self.solved]:
            share, alone = form.unknowns[unknown], _Monomial({unknown: Fraction(1)}, NONE)
            form = form.times(alone, -share).times(self.solved[unknown], share)
        return form

    def add(self, form: _Monomial) -> Dimension:
        """Require `form` to be dimensionless. Where it cannot be, return its dimension and change nothing."""
        form = self.reduce(form)
        if not form.unknowns:
            return form.known
        unknown, share = next(iter(form.unknowns.items()))
        rest = _DIMENSIONLESS.times(form, -1 / share).times(_Monomial({unknown: Fraction(1)}, NONE))
        self.solved[unknown] = rest
        self.solved = {key: self.reduce(value) for key, value in self.solved.items()}
        return NONE

    def resolve(self, form: _Monomial) -> Dimension | None:
        form = self.reduce(form)
        return None if form.unknowns else form.known


class _Constraints:
    """Walks the tree once and collects its equations."""

    def __init__(self, variables: Mapping[str, Dimension]) -> None:
        self.variables = variables
        self.equation = 0
        self.system = _LinearEquations()
        self.count = 0
        self.names: dict[str, _Monomial] = {}
        self.numbers: list[tuple[int, int]] = []  # (order in which to make it dimensionless, unknown)

    def new(self, order: int | None = None) -> _Monomial:
        self.count += 1
        if order is not None:
            self.numbers.append((order, self.count))
        return _Monomial({self.count: Fraction(1)}, NONE)

    def coefficient(self, name: str) -> _Monomial:
        return self.names.setdefault(name, self.new())

    def equate(self, form: _Monomial, expected: _Monomial, part: Expression, requirement: str) -> None:
        excess = self.system.add(form.times(expected, Fraction(-1)))
        if excess != NONE:
            message = f"No units of the coefficients are consistent: {requirement}, but differs by {excess}."
            raise UnitConflict(message, part, self.equation)

    def term(self, expression: Expression) -> _Monomial:
        """The dimension of a term, which may have an implicit factor of 1 with a unit."""
        if isinstance(expression, Number):
            return self.new(_TERM if expression.value else None)
        form = self.read(expression)
        factors = expression.factors if isinstance(expression, Product) else (expression,)
        scaled = any(isinstance(factor, Number) and factor != MINUS_ONE for factor in factors)
        if scaled or self.carries(expression):
            return form
        return form.times(self.new(_IMPLICIT))

    def carries(self, expression: Expression) -> bool:
        """Whether a coefficient contributes its unit."""
        match expression:
            case Symbol(name):
                return name not in self.variables
            case Call(function, _) if not FUNCTIONS[function].degree:
                # the value has no unit, whatever the argument
                return False
        return any(self.carries(below) for below in children(expression))

    def read(self, expression: Expression) -> _Monomial:
        match expression:
            case Number():
                return self.new(_FACTOR)
            case Symbol(name):
                known = self.variables.get(name)
                return self.coefficient(name) if known is None else _Monomial({}, known)
            case Sum(parts):
                return self.equal(parts)
            case Product(factors):
                fixed = self.carries(expression)
                total = _DIMENSIONLESS
                for factor in factors:
                    if not (isinstance(factor, Number) and (fixed or factor == MINUS_ONE)):
                        total = total.times(self.read(factor))
                return total
            case Power(base, Expression() as exponent):
                self.equate(self.term(exponent), _DIMENSIONLESS, exponent, "an exponent must have no unit")
                self.term(base)
                return _DIMENSIONLESS if isinstance(base, Number) else self.new()
            case Power(base, exponent):
                return _DIMENSIONLESS.times(self.read(base), Fraction(repr(exponent)))
            case Call(function, arguments):
                return self.call(function, arguments)
        raise TypeError(f"not an expression: {expression!r}")

    def call(self, function: str, arguments: tuple[Expression, ...]) -> _Monomial:
        degree = FUNCTIONS[function].degree
        if degree:
            common = self.equal(arguments) if len(arguments) > 1 else self.read(arguments[0])
            return _DIMENSIONLESS.times(common, degree)
        for argument in arguments:
            inner = self.term(argument)
            if degree is None:
                self.equate(inner, _DIMENSIONLESS, argument, f"the argument of {function} must have no unit")
        return _DIMENSIONLESS

    def equal(self, parts: tuple[Expression, ...]) -> _Monomial:
        first = self.term(parts[0])
        for part in parts[1:]:
            problem = f"{to_text(part)!r} must be in the unit of {to_text(parts[0])!r}"
            self.equate(self.term(part), first, part, problem)
        return first
