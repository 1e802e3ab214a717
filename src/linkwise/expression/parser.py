"""Text to expression tree. The text is read by Python's grammar and never evaluated."""

from __future__ import annotations

import ast
import difflib
import keyword
import math
import re
from dataclasses import dataclass
from functools import cache

from linkwise.errors import LawError
from linkwise.expression.functions import FUNCTIONS, writable_functions
from linkwise.expression.tree import (
    MINUS_ONE,
    Expression,
    Number,
    Symbol,
    add,
    call,
    multiply,
    power,
)

DEEPEST = 50  # levels of brackets, calls, signs and powers; far below what Python's recursion bears
LONGEST = 2000  # characters

_TOKEN = re.compile(
    r"(?P<space>\s+)|(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|(?P<name>[^\W\d]\w*)|(?P<sign>\*\*|//|[-+*/(),])"
)
_STRANGE = {
    "^": "A power is written with two stars: d**3.",
    "=": "Write only the right-hand side, the expression itself.",
    ".": "A name has no attributes; a decimal point needs a digit beside it.",
    "[": "Use round brackets.",
    "]": "Use round brackets.",
    "{": "Use round brackets.",
    "}": "Use round brackets.",
    "|": "An absolute value is written abs(d).",
    "·": "A product is written with a star: k*d.",
    "×": "A product is written with a star: k*d.",
    "−": "This is a typographic minus; use the hyphen of the keyboard.",
    "<": "There are no comparisons; use max, min or sign to switch.",
    ">": "There are no comparisons; use max, min or sign to switch.",
}
_ALLOWED = "An expression has names, numbers, + - * / **, round brackets and functions."


@dataclass(frozen=True)
class Parsed:
    """A tree and the places in the text where its sub-expressions stand, inner ones before those around them."""

    expression: Expression
    places: tuple[tuple[Expression, int], ...]

    def place(self, expression: Expression) -> int | None:
        """Where an equal sub-expression stands first, or None."""
        return next((position for found, position in self.places if found == expression), None)


def parse(text: str, variables: tuple[str, ...] = ()) -> Expression:
    """The tree of `text`. Every name that is no function and not `pi` is a symbol: a variable or a coefficient.

    `variables` are named in advice to the user. Raises LawError, with a caret under the place.
    """
    return parse_with_places(text, variables).expression


def parse_with_places(text: str, variables: tuple[str, ...] = ()) -> Parsed:
    """As `parse`, with the places of the sub-expressions for errors that are found later."""
    if not isinstance(text, str):
        raise LawError("An expression must be a text.", repr(text), None, 'Write it in quotes: "k*d + c*v".')
    if not text.strip():
        raise LawError("The expression is empty.", text, None, 'Write one, for instance "k*d + c*v".')
    if len(text) > LONGEST:
        raise LawError(
            f"The expression has {len(text)} characters, more than the {LONGEST} that are read.", text, LONGEST,
            "Split it into several links between the same two masses: their forces add.",
        )  # fmt: skip
    _Scan(text, variables).run()
    line = "(" + re.sub(r"\s", " ", text) + ")"  # one line, same columns
    try:
        body = ast.parse(line, mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        offset = getattr(error, "offset", None)
        reason = getattr(error, "msg", None) or "too complicated"
        raise LawError(
            f"This cannot be read: {reason}.", text, offset and max(offset - 2, 0), _ALLOWED
        ) from None
    walker = _Walker(text, line)
    return Parsed(walker.read(body, 0), tuple(walker.places))


@cache
def parse_rule(text: str) -> Expression:
    """The tree of a rule in the table of functions, which may contain functions that a law may not."""
    line = f"({text})"
    return _Walker(text, line).read(ast.parse(line, mode="eval").body, 0)


class _Scan:
    """Goes over the tokens once and raises at the first that cannot stand where it stands.

    After it Python's grammar has nothing left to object to but oddities, and no warning to give.
    """

    def __init__(self, text: str, variables: tuple[str, ...]) -> None:
        self.text, self.variables = text, variables
        self.open: list[tuple[int, bool]] = []  # position of each open bracket, and whether it is a call's
        self.kind, self.token, self.position = "", "", 0  # the last token that is no space

    def run(self) -> None:
        position = 0
        while position < len(self.text):
            found = _TOKEN.match(self.text, position)
            if found is None:
                character = self.text[position]
                raise self.error(
                    f"{character!r} cannot stand here.", position, _STRANGE.get(character, _ALLOWED)
                )
            kind, token = str(found.lastgroup), found.group()
            if kind != "space":
                self.check(kind, token, position)
                self.kind, self.token, self.position = kind, token, position
            position = found.end()
        if self.expects_operand:
            raise self.missing()
        if self.open:
            raise self.error("This bracket is never closed.", self.open[-1][0], "Add the missing ')'.")

    @property
    def expects_operand(self) -> bool:
        return self.kind not in ("number", "name") and self.token != ")"

    def error(self, reason: str, position: int, advice: str) -> LawError:
        return LawError(reason, self.text, position, advice)

    def missing(self) -> LawError:
        if self.token == "(":
            return self.error(
                "There is nothing in this bracket.", self.position, "Put an expression into it."
            )
        return self.error(
            f"Something is missing after {self.token!r}.", self.position, "Add what it acts on."
        )

    def check(self, kind: str, token: str, position: int) -> None:
        if kind in ("number", "name"):
            self.check_operand(kind, token, position)
        elif token == "(":
            self.check_open(position)
        elif token in (")", ","):
            self.check_close(token, position)
        elif token == "//":
            raise self.error(
                "'//' is no operator here.", position, "A quotient is written with one stroke: d/g."
            )
        elif self.expects_operand and token not in ("+", "-"):
            before = f"between {self.token!r} and {token!r}" if self.token else f"before {token!r}"
            raise self.error(f"Something is missing {before}.", position, "Add what the operator acts on.")

    def check_operand(self, kind: str, token: str, position: int) -> None:
        if not self.expects_operand:
            raise self.error(
                f"An operator is missing between {self.token!r} and {token!r}.", position,
                f"A product is written with a star: {self.token}*{token}.",
            )  # fmt: skip
        if kind == "name" and token.startswith("_"):
            raise self.error(f"{token!r} is no name.", position, "Names begin with a letter: k, alpha, c2.")
        if kind == "name" and keyword.iskeyword(token):
            raise self.error(
                f"{token!r} is a reserved word.", position, f"Name it otherwise, {token}_ for instance."
            )

    def check_open(self, position: int) -> None:
        called = self.kind == "name"
        if called and self.token not in writable_functions():
            raise self.unknown_function()
        if not called and not self.expects_operand:
            raise self.error(
                f"An operator is missing between {self.token!r} and '('.",
                position,
                "A product is written with a star.",
            )
        self.open.append((position, called))
        if len(self.open) > DEEPEST:
            raise self.error(
                f"Brackets are nested deeper than {DEEPEST} levels.", position, "Multiply the inner ones out."
            )

    def unknown_function(self) -> LawError:
        name = self.token
        known = writable_functions()
        near = difflib.get_close_matches(name.lower(), known, n=1)
        if name in self.variables:
            advice = f"{name} is a variable: for a product write {name}*(...)."
        elif near:
            advice = f"Did you mean {near[0]}? The functions are {', '.join(known)}. For a product write {name}*(...)."
        else:
            advice = f"The functions are {', '.join(known)}. For a product write {name}*(...)."
        return self.error(f"{name!r} is not a function.", self.position, advice)

    def check_close(self, token: str, position: int) -> None:
        if token == "," and not (self.open and self.open[-1][1]):
            decimal = re.search(r"\d$", self.text[:position]) and re.match(r"\d", self.text[position + 1 :])
            advice = "Decimals have a point: 1.5." if decimal else "Write one expression."
            raise self.error("A comma stands only between the arguments of a function.", position, advice)
        if token == ")" and not self.open:
            raise self.error("This bracket was never opened.", position, "Remove it, or add the missing '('.")
        if self.expects_operand:
            raise self.missing()
        if token == ")":
            self.open.pop()


class _Walker:
    """Turns Python's syntax tree into ours; refuses every node that is not an expression's."""

    def __init__(self, text: str, line: str) -> None:
        self.text, self.bytes = text, line.encode()
        self.places: list[tuple[Expression, int]] = []

    def position(self, node: ast.expr) -> int:
        """Python counts bytes; one column is the bracket that was put around the text."""
        return len(self.bytes[: node.col_offset].decode()) - 1

    def error(self, reason: str, node: ast.expr, advice: str) -> LawError:
        return LawError(reason, self.text, self.position(node), advice)

    def read(self, node: ast.expr, depth: int) -> Expression:
        """The tree of `node`; `depth` counts calls, signs and powers above it."""
        if depth > DEEPEST:
            raise self.error(
                f"The expression is nested deeper than {DEEPEST} levels.",
                node,
                "Multiply the inner levels out.",
            )
        match node:
            case ast.Constant(value=value):
                found = self.number(value, node)
            case ast.Name(id=name):
                found = self.name(name, node)
            case ast.BinOp(op=ast.Add() | ast.Sub()):
                found = self.chain(node, depth)
            case ast.BinOp(op=ast.Mult() | ast.Div()):
                found = self.chain(node, depth)
            case ast.BinOp(op=ast.Pow()):
                found = power(self.read(node.left, depth + 1), self.read(node.right, depth + 1))
            case ast.UnaryOp(op=ast.USub()):
                found = multiply(MINUS_ONE, self.read(node.operand, depth + 1))
            case ast.UnaryOp(op=ast.UAdd()):
                found = self.read(node.operand, depth + 1)
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]) if name in FUNCTIONS:
                found = self.function(name, arguments, node, depth)
            case _:
                raise self.error("This is no part of an expression.", node, _ALLOWED)
        self.places.append((found, self.position(node)))
        return found

    def chain(self, node: ast.BinOp, depth: int) -> Expression:
        """A run of + and -, or of * and /, read in a loop: it is long, not deep."""
        inverse, kinds = (ast.Sub, (ast.Add, ast.Sub)) if isinstance(node.op, ast.Add | ast.Sub) else (
            ast.Div, (ast.Mult, ast.Div))  # fmt: skip
        links: list[tuple[bool, ast.expr]] = []
        left: ast.expr = node
        while isinstance(left, ast.BinOp) and isinstance(left.op, kinds):
            links.append((isinstance(left.op, inverse), left.right))
            left = left.left
        links.append((False, left))
        items = []
        for inverted, below in reversed(links):
            item = self.read(below, depth)
            if inverted:
                item = power(item, -1) if inverse is ast.Div else multiply(MINUS_ONE, item)
                self.places.append((item, self.position(below)))
            items.append(item)
        return multiply(*items) if inverse is ast.Div else add(*items)

    def number(self, value: object, node: ast.expr) -> Expression:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.error("This is no number.", node, _ALLOWED)
        try:
            converted = float(value)
        except OverflowError:
            converted = math.inf
        if not math.isfinite(converted):
            raise self.error(
                "This number is too large for double precision.", node, "The largest is 1.8e308."
            )
        return Number(converted)

    def name(self, name: str, node: ast.expr) -> Expression:
        if name in writable_functions():
            raise self.error(
                f"{name!r} is a function, not a name.",
                node,
                f"Write {name}(...) or name the coefficient otherwise.",
            )
        return Number(math.pi) if name == "pi" else Symbol(name)

    def function(self, name: str, arguments: list[ast.expr], node: ast.expr, depth: int) -> Expression:
        least = FUNCTIONS[name].arity
        if len(arguments) < least or (least == 1 and len(arguments) > 1):
            wanted = "one argument" if least == 1 else "two or more arguments"
            raise self.error(
                f"{name!r} takes {wanted}, not {len(arguments)}.", node, "Check its commas and brackets."
            )
        return call(name, *(self.read(argument, depth + 1) for argument in arguments))
