"""Expressions in a few variables and coefficients: trees, text, derivatives, and evaluation on arrays."""

from __future__ import annotations

from linkwise.expression.calculus import antiderivative, differentiate, kink_and_branch, kinks, polynomial
from linkwise.expression.parser import parse, parse_with_positions
from linkwise.expression.program import Operation, Program
from linkwise.expression.tree import (
    FUNCTIONS,
    Call,
    Expression,
    LawFunction,
    Number,
    Power,
    Product,
    Sum,
    Symbol,
    add,
    call,
    multiply,
    power,
    substitute,
    symbols,
    to_text,
    walk,
)

__all__ = [
    "FUNCTIONS", "Call", "Expression", "LawFunction", "Number", "Operation", "Power", "Product", "Program", "Sum", "Symbol",
    "add", "antiderivative", "call", "differentiate", "kink_and_branch", "kinks", "multiply", "parse", "parse_with_positions",
    "polynomial", "power", "substitute", "symbols", "to_text", "walk",
]  # fmt: skip
