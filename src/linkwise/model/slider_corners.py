"""Rates of sliders with the corner between sticking and sliding rounded over a small part of their largest force.

The rate of a slider, `k*v*(1 - 0.25*(1 + sign(abs(q) - Fs))*(1 + sign(q*v)))`, jumps where the force reaches Fs: its
derivative by Fs is 0 wherever it exists, and an integrator with fixed steps leaves the force where the step ended that passed
Fs. Estimators take a ramp in place of the jump. It begins a little below Fs and goes on beyond it, so that a force too large
is pulled back to Fs. It is wider where the slider slides so fast that explicit steps could not follow it. Simulation ends its
steps at the corner and takes the rate as it is written.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial

from linkwise.expression import (
    Call,
    Expression,
    Number,
    Power,
    Product,
    Program,
    Sum,
    Symbol,
    add,
    call,
    differentiate,
    multiply,
    power,
    symbols,
)
from linkwise.model.law import Law

#: Of a sample: how long a force that slides fast may lag behind its corner.
LAG = 0.125
_ROUNDED = 0.03  # of the largest force; at the corner 3 % divided by e = 1.1 % of it are missing
_HALVES = Number(-0.25)  # of the product of two parts that are 0 or 2
_ONE = Number(1.0)


@lru_cache(maxsize=512)
def smooth_rates(law: Law, lag: float = 0.0) -> tuple[Expression, ...]:
    """The rates of the states of a law for an estimator; those without a slider as they are.

    A force that slides fast may lag by `lag` in s behind its corner: explicit steps not much longer follow it.
    """
    moving = frozenset(law.variables)
    rounded = []
    for rate in law.rates:
        slope = differentiate(_replaced(rate.expression, moving, lambda *_: Number(0.0)), "v")
        passed = multiply(Number(lag), call("abs", multiply(slope, Symbol("v"))))
        rounded.append(_replaced(rate.expression, moving, partial(_ramp, passed)))
    return tuple(rounded)


@lru_cache(maxsize=512)
def slider_parts(law: Law) -> Program | None:
    """What sets the states of a law, all of which are sliders, each a stiffness times d held within a largest size: from
    the coefficients all stiffnesses, then all sizes; None for other laws.
    """
    moving = frozenset(law.variables)
    stiffness, largest = [], []
    for name, rate in law.named_rates:
        own: list[Expression] = []
        sticking = _replaced(rate, moving, partial(_none_of, own, name))
        slope = differentiate(sticking, "v")
        if len(own) != 1 or moving & set(symbols(slope)) or sticking != multiply(slope, Symbol("v")):
            return None
        stiffness.append(slope)
        largest += own
    return Program([*stiffness, *largest], law.coefficients) if stiffness else None


def _ramp(passed: Expression, beyond: Expression, largest: Expression, way: Expression) -> Expression:
    """The ramp in place of the jump."""
    beyond_in_ramps = multiply(beyond, power(add(multiply(Number(_ROUNDED), largest), passed), -1))
    return multiply(Number(-0.5), call("max", Number(0.0), add(_ONE, beyond_in_ramps)), way)


def _none_of(
    largest: list[Expression], name: str, beyond: Expression, own: Expression, way: Expression
) -> Expression:
    """Nothing in place of the jump of a state; its largest size is put into `largest`."""
    forward = call("sign", multiply(Symbol(name), Symbol("v")))
    if name in symbols(beyond) and way == add(_ONE, forward):
        largest.append(own)
    return Number(0.0)


def _replaced(
    tree: Expression,
    moving: frozenset[str],
    corner: Callable[[Expression, Expression, Expression], Expression],
) -> Expression:
    """The tree with every jump of a slider replaced."""
    match tree:
        case Sum(parts):
            return add(*(_replaced(part, moving, corner) for part in parts))
        case Product((factor, Sum((Call("sign", (beyond,)), unit)), Sum((Call("sign", _), _)) as way)) if (
            factor == _HALVES and unit == _ONE
        ):
            largest = _largest(beyond, moving)
            return tree if largest is None else corner(beyond, largest, way)
        case Product(factors):
            return multiply(*(_replaced(factor, moving, corner) for factor in factors))
        case Power(base, exponent):
            return power(_replaced(base, moving, corner), exponent)
    return tree


def _largest(beyond: Expression, moving: frozenset[str]) -> Expression | None:
    """The largest size of a state in `abs(state) - largest`; None where it is not of this form."""
    match beyond:
        case Sum((Call("abs", (Symbol(),)), *rest)):
            largest = multiply(Number(-1.0), add(*rest))
            return None if moving & set(symbols(largest)) else largest
    return None
