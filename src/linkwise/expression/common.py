"""Assignments in which nothing is computed twice."""

from __future__ import annotations

from collections.abc import Mapping

from linkwise.expression.tree import Call, Expression, Number, Power, Product, Sum, Symbol, children

COMMON = "common:"
"""What the names of common subexpressions begin with; no name of a law does."""


def with_common_subexpressions(assignments: Mapping[str, Expression]) -> dict[str, Expression]:
    """The assignments in their order, each after those of the parts that occur more than once, ``common:1`` and on.

    An expression may contain the names that are assigned before it.

    >>> from linkwise.expression import parse, to_text
    >>> shared = with_common_subexpressions({"f": parse("k*exp(d)"), "g": parse("v + exp(d)")})
    >>> {name: to_text(part) for name, part in shared.items()}
    {'common:1': 'exp(d)', 'f': 'k*common:1', 'g': 'v + common:1'}
    """
    seen: set[Expression] = set()
    repeated: set[Expression] = set()

    def count(node: Expression) -> None:
        if isinstance(node, Number | Symbol):
            return
        if node in seen:
            repeated.add(node)
            return
        seen.add(node)
        for below in children(node):
            count(below)

    for expression in assignments.values():
        count(expression)
    result: dict[str, Expression] = {}
    names: dict[Expression, Symbol] = {}

    def written(node: Expression) -> Expression:
        if node in names:
            return names[node]
        inner = _rebuilt(node, [written(below) for below in children(node)])
        if node not in repeated:
            return inner
        names[node] = Symbol(f"{COMMON}{len(names) + 1}")
        result[names[node].name] = inner
        return names[node]

    for name, expression in assignments.items():
        result[name] = written(expression)
    return result


def _rebuilt(node: Expression, below: list[Expression]) -> Expression:
    """The node over other children, as it is and not in canonical form, which would take sums apart."""
    match node:
        case Sum():
            return Sum(tuple(below))
        case Product():
            return Product(tuple(below))
        case Call(function, _):
            return Call(function, tuple(below))
        case Power(_, Expression()):
            return Power(below[0], below[1])
        case Power(_, exponent):
            return Power(below[0], exponent)
    return node
