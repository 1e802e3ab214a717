"""Units of coefficients, from what an expression does with them.

Every coefficient has an unknown dimension, and every sum, function and the whole put a linear equation on the exponents,
solved exactly in fractions. A number may have a dimension too: the gap in `max(abs(d) - 0.001, 0)` is a length, the 1000 in
`1000*d + c*v` a stiffness, and a bare `d**3` beside `k*d` has a silent 1 N/m^3 before it. A number keeps a dimension only
where the equations force it to; those that need not have one are made pure one after the other: silent ones first, then
numbers that stand alone in a sum, then factors. So `k*d*(1 + d/0.01)` is read with a pure 1 and a length of 0.01.
"""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import NamedTuple

from linkwise.expression.dimension import NONE, Dimension
from linkwise.expression.functions import FUNCTIONS
from linkwise.expression.tree import (
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

_SILENT, _ALONE, _FACTOR = range(3)  # the order in which numbers are made pure


class UnitConflict(Exception):
    """No units of the coefficients fit: `reason` says why, `place` is the sub-expression that does not."""

    def __init__(self, reason: str, place: Expression) -> None:
        super().__init__(reason)
        self.reason, self.place = reason, place


def infer(
    expression: Expression, variables: Mapping[str, Dimension], whole: Dimension
) -> dict[str, Dimension | None]:
    """The dimension of every symbol that is no variable, in order of appearance; None where any would do.

    Raises UnitConflict where none does.
    """
    reader = _Reader(variables)
    reader.equate(reader.term(expression), _Form({}, whole), expression, f"the force must be in {whole}")
    for _, unknown in sorted(reader.numbers):
        reader.system.add(_Form({unknown: Fraction(1)}, NONE))
    return {
        name: reader.system.resolve(reader.coefficient(name))
        for name in symbols(expression)
        if name not in variables
    }


class _Form(NamedTuple):
    """A dimension that depends linearly on unknown ones: the product of unknown**fraction, and of a known one."""

    unknowns: Mapping[int, Fraction]
    known: Dimension

    def times(self, other: _Form, exponent: Fraction = Fraction(1)) -> _Form:
        total = dict(self.unknowns)
        for unknown, share in other.unknowns.items():
            total[unknown] = total.get(unknown, Fraction(0)) + exponent * share
        return _Form({u: share for u, share in total.items() if share}, self.known * other.known**exponent)


_UNIT = _Form({}, NONE)


class _System:
    """Linear equations in reduced form: each solved for one unknown that appears in no other."""

    def __init__(self) -> None:
        self.solved: dict[int, _Form] = {}

    def reduce(self, form: _Form) -> _Form:
        for unknown in [u for u in form.unknowns if u in self.solved]:
            share = form.unknowns[unknown]
            form = form.times(_Form({unknown: Fraction(1)}, NONE), -share).times(self.solved[unknown], share)
        return form

    def add(self, form: _Form) -> Dimension:
        """Demand that `form` has no dimension. Returns what it has by force instead; then nothing is changed."""
        form = self.reduce(form)
        if not form.unknowns:
            return form.known
        unknown, share = next(iter(form.unknowns.items()))
        rest = _UNIT.times(form, -1 / share).times(_Form({unknown: Fraction(1)}, NONE))
        self.solved[unknown] = rest
        self.solved = {key: self.reduce(value) for key, value in self.solved.items()}
        return NONE

    def resolve(self, form: _Form) -> Dimension | None:
        form = self.reduce(form)
        return None if form.unknowns else form.known


class _Reader:
    """Walks the tree once and puts its equations into the system."""

    def __init__(self, variables: Mapping[str, Dimension]) -> None:
        self.variables = variables
        self.system = _System()
        self.count = 0
        self.names: dict[str, _Form] = {}
        self.numbers: list[tuple[int, int]] = []  # (order in which to make it pure, unknown)

    def new(self, order: int | None = None) -> _Form:
        self.count += 1
        if order is not None:
            self.numbers.append((order, self.count))
        return _Form({self.count: Fraction(1)}, NONE)

    def coefficient(self, name: str) -> _Form:
        return self.names.setdefault(name, self.new())

    def equate(self, form: _Form, other: _Form, place: Expression, demand: str) -> None:
        excess = self.system.add(form.times(other, Fraction(-1)))
        if excess != NONE:
            raise UnitConflict(
                f"No units of the coefficients fit: {demand}, here it is off by {excess}.", place
            )

    def term(self, expression: Expression) -> _Form:
        """An expression that stands where a silent 1 with a unit may stand before it."""
        if isinstance(expression, Number):
            return self.new(_ALONE if expression.value else None)
        form = self.read(expression)
        factors = expression.factors if isinstance(expression, Product) else (expression,)
        if any(isinstance(factor, Number) and factor != MINUS_ONE for factor in factors) or self.carries(
            expression
        ):
            return form
        return form.times(self.new(_SILENT))

    def carries(self, expression: Expression) -> bool:
        """Whether a coefficient contributes its unit."""
        match expression:
            case Symbol(name):
                return name not in self.variables
            case Call(function, _) if not FUNCTIONS[
                function
            ].degree:  # the value has no unit, whatever the argument
                return False
        return any(self.carries(below) for below in children(expression))

    def read(self, expression: Expression) -> _Form:
        match expression:
            case Number():
                return self.new(_FACTOR)
            case Symbol(name):
                return _Form({}, self.variables[name]) if name in self.variables else self.coefficient(name)
            case Sum(parts):
                return self.equal(parts)
            case Product(factors):
                fixed = self.carries(expression)
                total = _UNIT
                for factor in factors:
                    if not (isinstance(factor, Number) and (fixed or factor == MINUS_ONE)):
                        total = total.times(self.read(factor))
                return total
            case Power(base, Expression() as exponent):
                self.equate(self.term(exponent), _UNIT, exponent, "an exponent has no unit")
                self.term(base)
                return _UNIT if isinstance(base, Number) else self.new()
            case Power(base, exponent):
                return _UNIT.times(self.read(base), Fraction(repr(exponent)))
            case Call(function, arguments):
                return self.call(function, arguments)
        raise TypeError(f"no expression: {expression!r}")

    def call(self, function: str, arguments: tuple[Expression, ...]) -> _Form:
        degree = FUNCTIONS[function].degree
        if degree:
            common = self.equal(arguments) if len(arguments) > 1 else self.read(arguments[0])
            return _UNIT.times(common, degree)
        for argument in arguments:
            inner = self.term(argument)
            if degree is None:
                self.equate(inner, _UNIT, argument, f"the argument of {function} has no unit")
        return _UNIT

    def equal(self, parts: tuple[Expression, ...]) -> _Form:
        first = self.term(parts[0])
        for part in parts[1:]:
            self.equate(
                self.term(part),
                first,
                part,
                f"{to_text(part)!r} must be in the unit of {to_text(parts[0])!r}",
            )
        return first
