"""Programs that evaluate laws, compiled once for laws of equal expression."""

from __future__ import annotations

from functools import lru_cache

from linkwise.expression import (
    Expression,
    Number,
    Program,
    Symbol,
    add,
    antiderivative,
    differentiate,
    kinks,
    multiply,
    substitute,
    symbols,
)
from linkwise.model.law_text import VARIABLES


@lru_cache(maxsize=1024)
def rates_program(rates: tuple[Expression, ...], names: tuple[str, ...], wide: tuple[str, ...]) -> Program:
    """The rates from d, v and `names`: states, then coefficients."""
    return Program(rates, (*VARIABLES, *names), wide=wide)


@lru_cache(maxsize=1024)
def force_program(expression: Expression, names: tuple[str, ...]) -> Program:
    """The force from d, v and `names`."""
    return Program([expression], (*VARIABLES, *names), wide=VARIABLES)


@lru_cache(maxsize=1024)
def forces_program(expressions: tuple[Expression, ...]) -> Program:
    """Several forces without coefficients, from d and v."""
    return Program(expressions, VARIABLES)


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
    return Program([add(primitive, multiply(Number(-1.0), at_zero))], names, wide=("d",)), quadrature


def dissipated_power(law: Expression, states: tuple[str, ...] = ()) -> Expression:
    """The power in W that a link with this law dissipates, (f(d, v) - f(d, 0)) v; with memory, f(d, v, s) - f(d, 0, 0).

    It is formed symbolically, so that the stored part cancels exactly.
    """
    elastic = substitute(law, dict.fromkeys(("v", *states), Number(0.0)))
    return multiply(Symbol("v"), add(law, multiply(Number(-1.0), elastic)))
