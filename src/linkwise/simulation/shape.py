"""What equations of motion are compiled for, and where their run-time parameters stand."""

from __future__ import annotations

from typing import NamedTuple

from linkwise.expression import (
    FUNCTIONS,
    Call,
    Expression,
    Number,
    Symbol,
    add,
    multiply,
    substitute,
    symbols,
    walk,
)

SCALE = 2.0**-40  # m, a power of two so that scaling rounds nothing


class Shape(NamedTuple):
    """What is compiled for: `masses`, per link (first end, second end, law) with ends as mass numbers, -1 the ground and
    -2 the base (`Structure.shape_key`), and `inputs`: per driven mass (-2: the base) an expression of t or, for a piecewise
    polynomial, its order.
    """

    masses: int
    links: tuple[tuple[int, int, Expression], ...]
    inputs: tuple[tuple[int, Expression | int], ...] = ()


class ParameterLayout:
    """Where each run-time parameter of a shape stands in the vector of parameters.

    Coefficients link by link in the order of the law, sigma of every kink, what is added to every kink that shall not be
    watched, of every piecewise input its start and its coefficients, lowest power first, and 1/(m s) of every mass (which
    every integrator uses: heyoka wants the last parameter to be used).
    """

    def __init__(self, shape: Shape, kinks: int) -> None:
        self.coefficients = [coefficient_names(law) for _, _, law in shape.links]
        self.values = slice(0, sum(len(names) for names in self.coefficients))
        self.branches = slice(self.values.stop, self.values.stop + kinks)
        self.muted = slice(self.branches.stop, self.branches.stop + kinks)
        self.inputs: list[slice] = []
        end = self.muted.stop
        for _, kind in shape.inputs:
            width = kind + 2 if isinstance(kind, int) else 0
            self.inputs.append(slice(end, end + width))
            end += width
        self.pieces = slice(self.muted.stop, end)
        self.inverse_masses = slice(end, end + shape.masses)
        self.size = end + shape.masses


def coefficient_names(law: Expression) -> tuple[str, ...]:
    return tuple(name for name in symbols(law) if name not in ("d", "v"))


def edges(tree: Expression) -> list[Expression]:
    """Where an exponential or a tanh comes out of the flat part of its graph: zeros of these expressions.

    Far out its derivatives are lost in rounding, so a Taylor series does not see what comes and would step over it: a pulse
    in time, or the reversal of a steep F*tanh(v/s). A step has to end where it wakes up.
    """
    return [
        add(argument, Number(-end))
        for node in walk(tree)
        if isinstance(node, Call)
        for argument in node.arguments
        for end in FUNCTIONS[node.function].flat
    ]


def power_lost(law: Expression) -> Expression:
    """(f(d, v) - f(d, 0)) v, what a link turns into heat; taken in symbols, so that what is stored drops out."""
    elastic = substitute(law, {"v": Number(0.0)})
    return multiply(Symbol("v"), add(law, multiply(Number(-1.0), elastic)))
