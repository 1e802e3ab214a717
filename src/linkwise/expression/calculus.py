"""Symbolic derivatives, polynomials and antiderivatives of expression trees."""

from __future__ import annotations

import sys

from linkwise.expression.parser import parse_rule
from linkwise.expression.tree import (
    FUNCTIONS,
    MINUS_ONE,
    ONE,
    ZERO,
    Call,
    Expression,
    Number,
    Power,
    Product,
    Sum,
    Symbol,
    add,
    as_expression,
    call,
    children,
    multiply,
    power,
    substitute,
    symbols,
)

_TINY = Number(sys.float_info.min)
_LARGEST_EXPANSION = 64  # exponent up to which a power of a sum is multiplied out
# products of terms in one step of it; beyond that the expression is not treated as a polynomial
_LARGEST_TABLE = 1024


def differentiate(expression: Expression, name: str) -> Expression:
    """The exact partial derivative by `name`.

    At a kink it is the mean of the two one-sided derivatives: sign' = 0, abs' = sign (0 at 0), and max and min take half of
    each argument's derivative where the two are equal.
    """
    match expression:
        case Symbol(symbol):
            return ONE if symbol == name else ZERO
        case Sum(parts):
            return add(*(differentiate(part, name) for part in parts))
        case Product(factors):
            terms = []
            for index, factor in enumerate(factors):
                slope = differentiate(factor, name)
                if slope != ZERO:
                    terms.append(multiply(*factors[:index], slope, *factors[index + 1 :]))
            return add(*terms)
        case Power(base, exponent):
            inner = differentiate(base, name)
            if not isinstance(exponent, Expression):
                slope = multiply(Number(float(exponent)), power(base, exponent - 1), inner)
                return slope if inner != ZERO else ZERO
            by_base = multiply(exponent, power(base, add(exponent, MINUS_ONE)), inner)
            # base**p log(base) tends to 0 with base; the smallest normal number, lost in any other sum, keeps the logarithm
            # finite
            logarithm = call("log", add(base, _TINY))
            return add(by_base, multiply(power(base, exponent), logarithm, differentiate(exponent, name)))
        case Call(function, arguments):
            slopes = [differentiate(argument, name) for argument in arguments]
            if all(slope == ZERO for slope in slopes):
                return ZERO
            rules = FUNCTIONS[function].derivatives
            outer = (_applied(rule, arguments) for rule in rules)
            return add(*(multiply(*pair) for pair in zip(outer, slopes, strict=True)))
    return ZERO


def _applied(rule: str, arguments: tuple[Expression, ...]) -> Expression:
    """A rule of the table of functions for these arguments."""
    return substitute(parse_rule(rule), dict(zip(("x", "y"), arguments, strict=False)))


def polynomial(expression: Expression, names: tuple[str, ...]) -> dict[tuple[int, ...], Expression] | None:
    """The expression as a polynomial in `names`: exponents -> coefficient, or None if it is not one.

    `polynomial(alpha*d + beta*d**3 + c*v, ("d", "v"))` is `{(1, 0): alpha, (3, 0): beta, (0, 1): c}`. Coefficients contain
    none of `names`; terms that cancel are absent.
    """
    if not set(symbols(expression)) & set(names):
        return {} if expression == ZERO else {(0,) * len(names): expression}
    match expression:
        case Symbol(name):
            return {tuple(int(name == variable) for variable in names): ONE}
        case Sum(parts):
            total: dict[tuple[int, ...], Expression] = {}
            for part in parts:
                terms = polynomial(part, names)
                if terms is None:
                    return None
                for key, value in terms.items():
                    total[key] = add(total.get(key, ZERO), value)
            return {key: value for key, value in total.items() if value != ZERO}
        case Product(factors):
            result: dict[tuple[int, ...], Expression] | None = {(0,) * len(names): ONE}
            for factor in factors:
                result = _times(result, polynomial(factor, names))
            return result
        case Power(base, int() as exponent) if 0 < exponent <= _LARGEST_EXPANSION:
            result = terms = polynomial(base, names)
            for _ in range(exponent - 1):
                result = _times(result, terms)
            return result
    return None


def _times(
    first: dict[tuple[int, ...], Expression] | None, second: dict[tuple[int, ...], Expression] | None
) -> dict[tuple[int, ...], Expression] | None:
    if first is None or second is None or len(first) * len(second) > _LARGEST_TABLE:
        return None
    product: dict[tuple[int, ...], Expression] = {}
    for first_degrees, left in first.items():
        for second_degrees, right in second.items():
            key = tuple(a + b for a, b in zip(first_degrees, second_degrees, strict=True))
            product[key] = add(product.get(key, ZERO), multiply(left, right))
    return {key: value for key, value in product.items() if value != ZERO}


def antiderivative(expression: Expression, name: str) -> Expression | None:
    """An antiderivative by `name`, continuous wherever the expression is finite, or None where no rule is known.

    Rules: polynomials; sums; constant factors; powers of a linear argument and functions of one, where the table of functions
    has a rule; powers of `name` times abs(name) and sign(name). The value at 0 is whatever the rule gives.
    """
    terms = polynomial(expression, (name,))
    variable = Symbol(name)
    if terms is not None:
        raised = ((n + 1, value) for (n,), value in terms.items())
        return add(*(multiply(Number(1.0 / n), value, power(variable, n)) for n, value in raised))
    if isinstance(expression, Sum):
        pieces = [antiderivative(part, name) for part in expression.parts]
        return None if any(piece is None for piece in pieces) else add(*(p for p in pieces if p is not None))
    if isinstance(expression, Product):
        constant = [factor for factor in expression.factors if name not in symbols(factor)]
        varying = [factor for factor in expression.factors if name in symbols(factor)]
        inner = antiderivative(varying[0], name) if len(varying) == 1 else _signed_power(varying, variable)
        return None if inner is None else multiply(*constant, inner)
    return _of_linear_argument(expression, name)


def _signed_power(factors: list[Expression], variable: Symbol) -> Expression | None:
    """The antiderivative of a product of powers of the variable, of its abs and of its sign: each factor abs**a sign**s."""
    total: Expression = ZERO
    odd = False
    size, sign = call("abs", variable), call("sign", variable)
    for factor in factors:
        base, exponent = (factor.base, factor.exponent) if isinstance(factor, Power) else (factor, 1)
        if base == sign and isinstance(exponent, int) and exponent > 0:
            odd ^= exponent % 2 == 1
        elif base == variable and isinstance(exponent, int) and exponent > 0:
            total, odd = add(total, Number(float(exponent))), odd ^ (exponent % 2 == 1)
        elif base == size and variable.name not in symbols(as_expression(exponent)):
            total = add(total, as_expression(exponent))
        else:
            return None
    raised = add(total, ONE)
    if isinstance(raised, Number) and raised.value <= 0.0:
        return None
    primitive = multiply(power(raised, -1), power(size, raised))
    return primitive if odd else multiply(sign, primitive)


def _of_linear_argument(expression: Expression, name: str) -> Expression | None:
    if isinstance(expression, Power):
        argument, raised = expression.base, add(as_expression(expression.exponent), ONE)
        if name in symbols(raised):
            return None
        if argument == call("abs", Symbol(name)):
            return _signed_power([expression], Symbol(name))
        if raised == ZERO:
            primitive = call("log", call("abs", argument))
        else:
            primitive = multiply(power(raised, -1), power(argument, raised))
    elif isinstance(expression, Call) and (rule := FUNCTIONS[expression.function].antiderivative) is not None:
        argument = expression.arguments[0]
        primitive = _applied(rule, (argument,))
    else:
        return None
    terms = polynomial(argument, (name,))
    if terms is None or set(terms) - {(0,), (1,)}:
        return None
    return multiply(primitive, power(terms[(1,)], -1))


def kinks(expression: Expression) -> tuple[Expression, ...]:
    """Where the expression is not smooth: the zeros of these expressions, each once, inner ones first.

    They are the kinks of its functions: arguments of abs and sign, differences of the arguments of max and min.
    """
    distinct: dict[Expression, None] = {}

    def visit(node: Expression) -> None:
        for below in children(node):
            visit(below)
        match node:
            case Call(function, arguments) if FUNCTIONS[function].kink is not None:
                distinct.setdefault(kink_and_branch(function, arguments)[0])

    visit(expression)
    return tuple(distinct)


def kink_and_branch(function: str, arguments: tuple[Expression, ...]) -> tuple[Expression, Expression]:
    """Where a function with a kink is not smooth, and what it is on either side with `s` for the sign there, in `x` and `y`.

    Raises ValueError for a smooth function.
    """
    rules = FUNCTIONS[function]
    if rules.kink is None:
        raise ValueError(f"{function} is smooth")
    return _applied(rules.kink, arguments), parse_rule(rules.branch)
