"""Expressions as lines of other languages, written from the tree, so that nothing but arithmetic can be in them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from linkwise.expression.functions import FUNCTIONS
from linkwise.expression.tree import Call, Expression, Number, Power, Product, Sum, Symbol

_MAY_BE_COMPLEX = ("sqrt", "log")


@dataclass(frozen=True)
class CodeStyle:
    """How a language writes arithmetic on arrays.

    `function` gives the name of a function of laws; `real` is what a value is wrapped in that may turn complex, which is not a
    number here.
    """

    times: str
    over: str
    power: str
    function: Callable[[str], str]
    real: str = ""


NUMPY = CodeStyle("*", "/", "**", lambda name: f"np.{FUNCTIONS[name].value.__name__}")
MATLAB = CodeStyle(".*", "./", ".^", str, real="real_or_nan")


def to_code(expression: Expression, style: CodeStyle, names: Mapping[str, str]) -> str:
    """The line for an expression; `names` are those that its symbols have there."""
    match expression:
        case Number(value):
            return repr(float(value)) if value >= 0.0 else f"({float(value)!r})"
        case Symbol(name):
            return names[name]
        case Call(function, arguments):
            inner = ", ".join(to_code(argument, style, names) for argument in arguments)
            text = f"{style.function(function)}({inner})"
            return f"{style.real}({text})" if style.real and function in _MAY_BE_COMPLEX else text
        case Sum(parts):
            return f"({' + '.join(to_code(part, style, names) for part in parts)})"
        case Product(factors):
            return _product(factors, style, names)
        case Power(base, int() as exponent):
            if exponent < 0:
                return _product((expression,), style, names)
            return f"({to_code(base, style, names)}){style.power}{exponent}"
        case Power(base, exponent):
            raised = exponent if isinstance(exponent, Expression) else Number(exponent)
            text = f"({to_code(base, style, names)}){style.power}({to_code(raised, style, names)})"
            return f"{style.real}({text})" if style.real else text
    raise TypeError(f"not an expression: {expression!r}")


def _product(factors: tuple[Expression, ...], style: CodeStyle, names: Mapping[str, str]) -> str:
    over, under = [], []
    for factor in factors:
        match factor:
            case Power(base, int() as exponent) if exponent < 0:
                power = f"{style.power}{-exponent}" if exponent < -1 else ""
                under.append(f"({to_code(base, style, names)}){power}")
            case _:
                over.append(to_code(factor, style, names))
    text = style.times.join(over) if over else "1.0"
    return "(" + style.over.join([text, *under]) + ")"
