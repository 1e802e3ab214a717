"""The expression tree: six final node classes, and the constructors that keep every tree in one canonical form.

Build trees with `add`, `multiply`, `power`, `call` (or `parse`), not with the classes: the constructors flatten sums and
products, fold constants, collect like terms and equal bases, and drop zeros and ones. A walker has to know only this:

- a difference is a `Sum` with a `Product` that starts with a negative `Number`; the constant of a sum comes last;
- a product starts with its `Number`, if it has one; factors `Power(b, -n)`, the divisors, come last;
- `Power.exponent` is an `int` (neither 0 nor 1), a `float` that is not an integer, or an `Expression` other than a `Number`;
- a function has one argument or two, as its entry in `FUNCTIONS` says.

Constants are folded in double precision. What is not finite (1/0) is not folded, so that its evaluation gives the infinity
where the user wrote it.

A function is added by one entry: the parser, evaluation, derivatives, antiderivatives, units, the places where a law is not
smooth and the integrator read it from here. Rules are texts in `x` (and `y` for the second argument) that may use the other
functions of the table.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import final

import numpy as np


@final
@dataclass(frozen=True, kw_only=True)
class LawFunction:
    """A function that laws may call, of one argument `x`, or of two, `x` and `y`.

    A function of two arguments must be associative, commutative and idempotent, as max is: of more arguments it is nested.

    Parameters
    ----------
    value
        The NumPy ufunc that evaluates it; constants are folded with it too.
    derivatives
        The partial derivative by each argument, as texts; at a kink the mean of both sides.
    antiderivative
        An antiderivative by `x`, continuous wherever the function is finite; None where there is none in closed form.
    degree
        How the value scales with the argument, f(a x) = a**degree f(x) for a > 0: the value has the unit of the argument to
        this power. None for a function of a pure number.
    kink
        Zero where the function is not smooth, as a text; None where it is smooth everywhere. Then `branch` is the function on
        either side, with `s` the sign of the kink.
    flat
        Arguments beyond which the function or its derivatives are lost in rounding, so that a Taylor series taken there does
        not see what comes: an integration step has to end at them.
    writable
        Whether a law may contain it; if not, only derivatives and antiderivatives do.
    """

    value: np.ufunc
    derivatives: tuple[str, ...]
    antiderivative: str | None = None
    degree: Fraction | None = None
    kink: str | None = None
    branch: str = ""
    flat: tuple[float, ...] = ()
    writable: bool = True


_FLAT_TANH = 15.0  # up to which its slope, computed as 1 - tanh^2, still has digits; tanh is 1 - 2e-13 there
_FLAT_EXP = -40.0  # below which it is nothing beside rounding

FUNCTIONS = {
    "abs": LawFunction(
        value=np.absolute,
        derivatives=("sign(x)",),
        antiderivative="0.5*x*abs(x)",
        degree=Fraction(1),
        kink="x",
        branch="s*x",
    ),
    "sign": LawFunction(
        value=np.sign, derivatives=("0",), antiderivative="abs(x)", degree=Fraction(0), kink="x", branch="s"
    ),
    "sqrt": LawFunction(
        value=np.sqrt, derivatives=("0.5/sqrt(x)",), antiderivative="2/3*x*sqrt(x)", degree=Fraction(1, 2)
    ),
    "exp": LawFunction(value=np.exp, derivatives=("exp(x)",), antiderivative="exp(x)", flat=(_FLAT_EXP,)),
    "tanh": LawFunction(
        value=np.tanh,
        derivatives=("1 - tanh(x)**2",),
        # log(cosh(x)) + log(2), written so that it neither overflows nor cancels far from 0
        antiderivative="abs(x) + log(1 + exp(-2*abs(x)))",
        flat=(_FLAT_TANH, -_FLAT_TANH),
    ),
    "sin": LawFunction(value=np.sin, derivatives=("cos(x)",), antiderivative="-cos(x)"),
    "cos": LawFunction(value=np.cos, derivatives=("-sin(x)",), antiderivative="sin(x)"),
    "max": LawFunction(
        value=np.maximum,
        derivatives=("0.5 + 0.5*sign(x - y)", "0.5 - 0.5*sign(x - y)"),
        degree=Fraction(1),
        kink="x - y",
        branch="(0.5 + 0.5*s)*x + (0.5 - 0.5*s)*y",
    ),
    "min": LawFunction(
        value=np.minimum,
        derivatives=("0.5 - 0.5*sign(x - y)", "0.5 + 0.5*sign(x - y)"),
        degree=Fraction(1),
        kink="x - y",
        branch="(0.5 - 0.5*s)*x + (0.5 + 0.5*s)*y",
    ),
    "log": LawFunction(value=np.log, derivatives=("1/x",), writable=False),
}


def writable_functions() -> tuple[str, ...]:
    """The names of the functions that a law may contain."""
    return tuple(name for name, function in FUNCTIONS.items() if function.writable)


class Expression:
    """A node. Immutable, hashable, compared by structure.

    Examples
    --------
    >>> import linkwise as lw
    >>> first, second = (lw.Law.parse(text).expression for text in ("k*d + c*v", "c*v + k*d"))
    >>> isinstance(first, lw.model.Expression), first == second
    (True, False)
    """

    __slots__ = ()

    def __add__(self, other: Expression | float) -> Expression:
        return add(self, as_expression(other))

    def __sub__(self, other: Expression | float) -> Expression:
        return add(self, -as_expression(other))

    def __mul__(self, other: Expression | float) -> Expression:
        return multiply(self, as_expression(other))

    def __truediv__(self, other: Expression | float) -> Expression:
        return multiply(self, power(as_expression(other), -1))

    def __rtruediv__(self, other: float) -> Expression:
        return as_expression(other) / self

    def __pow__(self, other: Expression | float) -> Expression:
        return power(self, other)

    def __neg__(self) -> Expression:
        return multiply(MINUS_ONE, self)

    __radd__, __rmul__ = __add__, __mul__


@final
@dataclass(frozen=True, slots=True)
class Number(Expression):
    """A finite constant in SI units."""

    value: float


@final
@dataclass(frozen=True, slots=True)
class Symbol(Expression):
    """A variable or a coefficient."""

    name: str


@final
@dataclass(frozen=True, slots=True)
class Sum(Expression):
    """The sum of two or more parts."""

    parts: tuple[Expression, ...]


@final
@dataclass(frozen=True, slots=True)
class Product(Expression):
    """The product of two or more factors."""

    factors: tuple[Expression, ...]


@final
@dataclass(frozen=True, slots=True)
class Power(Expression):
    """`base ** exponent`; a quotient is a product with the divisor to a negative power."""

    base: Expression
    exponent: int | float | Expression


@final
@dataclass(frozen=True, slots=True)
class Call(Expression):
    """A function of `FUNCTIONS` (or `log`, which only derivatives and integrals contain) and its arguments."""

    function: str
    arguments: tuple[Expression, ...]


ZERO, ONE, MINUS_ONE = Number(0.0), Number(1.0), Number(-1.0)


def as_expression(exponent: int | float | Expression) -> Expression:
    """A number or an exponent as a node."""
    return exponent if isinstance(exponent, Expression) else Number(float(exponent))


def add(*parts: Expression) -> Expression:
    """The canonical sum of any number of parts."""
    scales: dict[Expression, float] = {}
    constants: list[float] = []
    for scale, rest in (piece for part in parts for piece in _pieces(part, 1.0)):
        if rest is ONE:
            constants.append(scale)
        else:
            scales[rest] = scales.get(rest, 0.0) + scale
    terms = [multiply(Number(scale), rest) for rest, scale in scales.items() if scale != 0.0]
    constant = sum(constants)
    if not math.isfinite(constant):
        terms += [Number(value) for value in constants]
    elif constant != 0.0:
        terms.append(Number(constant))
    if len(terms) < 2:
        return terms[0] if terms else ZERO
    return Sum(tuple(terms))


def _pieces(part: Expression, scale: float) -> Iterator[tuple[float, Expression]]:
    """The terms of `scale * part` as (number, rest); the rest of a constant is ONE."""
    match part:
        case Number(value):
            yield scale * value, ONE
        case Sum(parts):
            for inner in parts:
                yield from _pieces(inner, scale)
        case Product((Number(value), Sum() as inner)) if math.isfinite(scale * value):
            yield from _pieces(inner, scale * value)
        case Product((Number(value), *rest)) if math.isfinite(scale * value) and value != 0.0:
            yield scale * value, rest[0] if len(rest) == 1 else Product(tuple(rest))
        case _:
            yield scale, part


def multiply(*factors: Expression) -> Expression:
    """The canonical product of any number of factors."""
    numbers: list[float] = []
    over: dict[Expression, int] = {}  # base -> positive exponent
    under: dict[Expression, int] = {}  # base -> negative exponent; never cancelled, d/d stays undefined at 0
    for factor in factors:
        for item in factor.factors if isinstance(factor, Product) else (factor,):
            match item:
                case Number(value):
                    numbers.append(value)
                case Power(base, int() as exponent):
                    group = over if exponent > 0 else under
                    group[base] = group.get(base, 0) + exponent
                case _:
                    over[item] = over.get(item, 0) + 1
    if 0.0 in numbers:
        return Product((ZERO, Power(ZERO, -1))) if ZERO in under else ZERO
    constant = math.prod(numbers)
    if math.isfinite(constant) and constant != 0.0:
        numbers = [] if constant == 1.0 else [constant]
    items: list[Expression] = [Number(value) for value in numbers]
    items += [base if exponent == 1 else Power(base, exponent) for base, exponent in over.items()]
    items += [Power(base, exponent) for base, exponent in under.items()]
    if len(items) < 2:
        return items[0] if items else ONE
    return Product(tuple(items))


def power(base: Expression, exponent: int | float | Expression) -> Expression:
    """The canonical power."""
    if isinstance(exponent, Number):
        exponent = exponent.value
    if isinstance(exponent, Expression):
        return ONE if base == ONE else Power(base, exponent)
    if float(exponent).is_integer():
        exponent = int(exponent)
    if exponent == 0:
        return ONE
    if exponent == 1:
        return base
    match base:
        case Number(value):
            try:
                folded = float(value) ** exponent
            except (ZeroDivisionError, OverflowError):
                return Power(base, exponent)
            real = isinstance(folded, float) and math.isfinite(folded)
            return Number(folded) if real else Power(base, exponent)
        case Power(inner, int() as first) if isinstance(exponent, int):
            return power(inner, first * exponent)
        case Power(inner, float() as first) if exponent == -1:
            return power(inner, -first)
    return Power(base, exponent)


def call(function: str, *arguments: Expression) -> Expression:
    """The canonical call; one of more than two arguments becomes nested calls of two."""
    if len(arguments) > 2:
        return call(function, call(function, *arguments[:-1]), arguments[-1])
    if len(arguments) == 2 and arguments[0] == arguments[1]:
        return arguments[0]
    values = [argument.value for argument in arguments if isinstance(argument, Number)]
    if len(values) == len(arguments):
        with np.errstate(all="ignore"):
            folded = float(FUNCTIONS[function].value(*values))
        if math.isfinite(folded):
            return Number(folded)
    return Call(function, arguments)


def children(expression: Expression) -> tuple[Expression, ...]:
    """The nodes directly below, from left to right."""
    match expression:
        case Sum(below) | Product(below) | Call(_, below):
            return below
        case Power(base, Expression() as exponent):
            return base, exponent
        case Power(base, _):
            return (base,)
    return ()


def walk(expression: Expression) -> Iterator[Expression]:
    """Every node of the tree, a node before those below it, from left to right."""
    yield expression
    for below in children(expression):
        yield from walk(below)


def symbols(expression: Expression) -> tuple[str, ...]:
    """The names in the tree, each once, in order of appearance."""
    return tuple(dict.fromkeys(node.name for node in walk(expression) if isinstance(node, Symbol)))


def rebuilt(node: Expression, below: Sequence[Expression]) -> Expression:
    """The node over other children, in canonical form."""
    match node:
        case Sum():
            return add(*below)
        case Product():
            return multiply(*below)
        case Power(_, exponent):
            return power(below[0], below[1] if len(below) > 1 else exponent)
        case Call(function, _):
            return call(function, *below)
    return node


def substitute(expression: Expression, replacements: Mapping[str, Expression]) -> Expression:
    """The tree with symbols replaced, in canonical form again."""
    if isinstance(expression, Symbol):
        return replacements.get(expression.name, expression)
    return rebuilt(expression, [substitute(below, replacements) for below in children(expression)])


_MAY_BE_COMPLEX = ("sqrt", "log")


@dataclass(frozen=True)
class CodeStyle:
    """How a language writes arithmetic on numbers or arrays.

    `power` is a template of a base and an exponent, `integer_power` one for an exponent of digits; `function` gives the name
    of a function of laws, `number` a number; `real` is what a value is wrapped in that may turn complex, which is not a number
    here.
    """

    times: str
    over: str
    power: str
    integer_power: str
    function: Callable[[str], str]
    real: str = ""
    number: Callable[[float], str] = repr


def _shortest(value: float) -> str:
    return str(int(value)) if value.is_integer() and abs(value) < 1e15 else repr(value)


_LAW = CodeStyle("*", "/", "{}**{}", "{}**{}", str, number=_shortest)
NUMPY = CodeStyle("*", "/", "{}**{}", "{}**{}", lambda name: f"np.{FUNCTIONS[name].value.__name__}")
MATLAB = CodeStyle(".*", "./", "{}.^{}", "{}.^{}", str, real="real_or_nan")


def to_text(expression: Expression) -> str:
    """The text that `parse` reads back as an equal tree, except `log`, which only derivatives contain."""
    return to_code(expression, _LAW)


def to_code(expression: Expression, style: CodeStyle, names: Mapping[str, str] | None = None) -> str:
    """The text of an expression in a language; `names` are those that its symbols have there."""
    match expression:
        case Number(value):
            return style.number(float(value))
        case Symbol(name):
            return name if names is None else names[name]
        case Call(function, arguments):
            inner = ", ".join(to_code(argument, style, names) for argument in arguments)
            text = f"{style.function(function)}({inner})"
            return f"{style.real}({text})" if style.real and function in _MAY_BE_COMPLEX else text
        case Sum(parts):
            first, *others = (to_code(part, style, names) for part in parts)
            signed = (f" - {term[1:]}" if term.startswith("-") else f" + {term}" for term in others)
            return first + "".join(signed)
        case Product(factors):
            return _product(factors, style, names)
        case Power(base, int() as exponent):
            if exponent < 0:
                return _product((expression,), style, names)
            return style.integer_power.format(_atom(base, style, names), exponent)
        case Power(base, exponent):
            write = _atom if isinstance(exponent, Expression) else to_code
            raised = write(as_expression(exponent), style, names)
            text = style.power.format(_atom(base, style, names), raised)
            return f"{style.real}({text})" if style.real else text
    raise TypeError(f"not an expression: {expression!r}")


def _product(factors: tuple[Expression, ...], style: CodeStyle, names: Mapping[str, str] | None) -> str:
    over, under = [], ""
    for factor in factors:
        match factor:
            case Power(base, int() as exponent) if exponent < 0:
                divisor, raised = _atom(base, style, names), style.integer_power
                if exponent == -1:
                    under += f"{style.over}{divisor}"
                elif isinstance(base, Number) and style is _LAW:  # 0**2 would fold, and not come back
                    under += style.times + raised.format(divisor, exponent)
                else:
                    under += style.over + raised.format(divisor, -exponent)
            case _:
                text = to_code(factor, style, names)
                over.append(f"({text})" if isinstance(factor, Sum) else text)
    if factors[0] == MINUS_ONE and len(over) > 1:
        over[:2] = [f"-{over[1]}"]
    return (style.times.join(over) or style.number(1.0)) + under


def _atom(expression: Expression, style: CodeStyle, names: Mapping[str, str] | None) -> str:
    positive = isinstance(expression, Number) and expression.value >= 0
    text = to_code(expression, style, names)
    return text if positive or isinstance(expression, Symbol | Call) else f"({text})"
