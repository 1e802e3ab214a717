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
from linkwise.expression.tree import (
    FUNCTIONS,
    MINUS_ONE,
    Expression,
    Number,
    Symbol,
    add,
    call,
    multiply,
    power,
    writable_functions,
)

MAX_DEPTH = 50  # levels of brackets, calls, signs and powers; far below the limit of Python's recursion
MAX_LENGTH = 2000  # characters

_TOKEN = re.compile(
    r"(?P<space>\s+)|(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|(?P<name>[^\W\d]\w*)|(?P<sign>\*\*|//|[-+*/(),])"
)
_ADVICE = {
    "^": "A power is written with two stars: d**3.",
    "=": "Write only the right-hand side, the expression itself.",
    ".": "Names have no attributes; a decimal point needs a digit next to it.",
    **dict.fromkeys("[]{}", "Use parentheses."),
    "|": "An absolute value is written abs(d).",
    **dict.fromkeys("·×", "A product is written with a star: k*d."),
    "−": "This is a typographic minus sign; use a hyphen.",
    **dict.fromkeys("<>", "Comparisons are not supported; use max, min or sign."),
}
_ALLOWED = "An expression has names, numbers, + - * / **, parentheses and functions."


@dataclass(frozen=True)
class Parsed:
    """A tree, and the positions of its sub-expressions in the text, inner ones before those around them."""

    expression: Expression
    positions: tuple[tuple[Expression, int], ...]

    def position(self, expression: Expression) -> int | None:
        """Position of the first sub-expression equal to `expression`, or None."""
        return next((position for part, position in self.positions if part == expression), None)


def parse(text: str, variables: tuple[str, ...] = ()) -> Expression:
    """The tree of `text`. Every name except `pi` and those of functions is a symbol: a variable or a coefficient.

    `variables` are mentioned in error messages. Raises LawError with the position of the error.
    """
    return parse_with_positions(text, variables).expression


def parse_with_positions(text: str, variables: tuple[str, ...] = ()) -> Parsed:
    """As `parse`, with the positions of the sub-expressions, for errors that are detected later."""
    if not isinstance(text, str):
        raise LawError(
            "An expression must be a string.", repr(text), None, 'Write it in quotes: "k*d + c*v".'
        )
    if not text.strip():
        raise LawError("The expression is empty.", text, None, 'Write one, for instance "k*d + c*v".')
    if len(text) > MAX_LENGTH:
        raise LawError(
            f"The expression has {len(text)} characters; at most {MAX_LENGTH} are supported.", text, MAX_LENGTH,
            "Split it into several links between the same two masses: their forces add.",
        )  # fmt: skip
    _TokenChecker(text, variables).run()
    line = "(" + re.sub(r"\s", " ", text) + ")"  # one line, same columns
    try:
        body = ast.parse(line, mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        offset = getattr(error, "offset", None)
        reason = getattr(error, "msg", None) or "too complicated"
        raise LawError(f"Invalid syntax: {reason}.", text, offset and max(offset - 2, 0), _ALLOWED) from None
    builder = _TreeBuilder(text, line)
    return Parsed(builder.read(body, 0), tuple(builder.positions))


@cache
def parse_rule(text: str) -> Expression:
    """The tree of a rule in the table of functions, which may contain functions that a law may not."""
    line = f"({text})"
    return _TreeBuilder(text, line).read(ast.parse(line, mode="eval").body, 0)


class _TokenChecker:
    """Goes over the tokens once and raises at the first one that is out of place.

    What it accepts, Python's parser accepts too but for a few oddities, and without warnings.
    """

    def __init__(self, text: str, variables: tuple[str, ...]) -> None:
        self.text, self.variables = text, variables
        # position of each open parenthesis, and whether it is that of a call
        self.open: list[tuple[int, bool]] = []
        self.kind, self.token, self.position = "", "", 0  # the last token other than white space

    def run(self) -> None:
        position = 0
        while position < len(self.text):
            match = _TOKEN.match(self.text, position)
            if match is None:
                character = self.text[position]
                raise self.error(
                    f"Unexpected character {character!r}.", position, _ADVICE.get(character, _ALLOWED)
                )
            kind, token = str(match.lastgroup), match.group()
            if kind != "space":
                self.check(kind, token, position)
                self.kind, self.token, self.position = kind, token, position
            position = match.end()
        if self.expects_operand:
            raise self.missing()
        if self.open:
            raise self.error("This parenthesis is never closed.", self.open[-1][0], "Add the missing ')'.")

    @property
    def expects_operand(self) -> bool:
        return self.kind not in ("number", "name") and self.token != ")"

    def error(self, reason: str, position: int, advice: str) -> LawError:
        return LawError(reason, self.text, position, advice)

    def missing(self) -> LawError:
        if self.token == "(":
            return self.error("These parentheses are empty.", self.position, "Add an expression.")
        return self.error(f"Something is missing after {self.token!r}.", self.position, "Add its operand.")

    def check(self, kind: str, token: str, position: int) -> None:
        if kind in ("number", "name"):
            self.check_operand(kind, token, position)
        elif token == "(":
            self.check_open(position)
        elif token in (")", ","):
            self.check_close(token, position)
        elif token == "//":
            raise self.error(
                "'//' is not a supported operator.", position, "A quotient is written with one slash: d/g."
            )
        elif self.expects_operand and token not in ("+", "-"):
            before = f"between {self.token!r} and {token!r}" if self.token else f"before {token!r}"
            raise self.error(f"Something is missing {before}.", position, "Add the operand.")

    def check_operand(self, kind: str, token: str, position: int) -> None:
        if not self.expects_operand:
            raise self.error(
                f"An operator is missing between {self.token!r} and {token!r}.", position,
                f"A product is written with a star: {self.token}*{token}.",
            )  # fmt: skip
        if kind == "name" and token.startswith("_"):
            raise self.error(
                f"{token!r} is not a valid name.", position, "Names begin with a letter: k, alpha, c2."
            )
        if kind == "name" and keyword.iskeyword(token):
            raise self.error(
                f"{token!r} is a reserved word.", position, f"Choose another name, such as {token}_."
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
        if len(self.open) > MAX_DEPTH:
            raise self.error(
                f"Parentheses are nested deeper than {MAX_DEPTH} levels.",
                position,
                "Multiply the inner ones out.",
            )

    def unknown_function(self) -> LawError:
        name = self.token
        known = writable_functions()
        near = difflib.get_close_matches(name.lower(), known, n=1)
        advice = f"The functions are {', '.join(known)}. For a product write {name}*(...)."
        if name in self.variables:
            advice = f"{name} is a variable: for a product write {name}*(...)."
        elif near:
            advice = f"Did you mean {near[0]}? {advice}"
        return self.error(f"{name!r} is not a function.", self.position, advice)

    def check_close(self, token: str, position: int) -> None:
        if token == "," and not (self.open and self.open[-1][1]):
            decimal = re.search(r"\d$", self.text[:position]) and re.match(r"\d", self.text[position + 1 :])
            advice = "Decimals have a point: 1.5." if decimal else "Write one expression."
            raise self.error("A comma may only separate the arguments of a function.", position, advice)
        if token == ")" and not self.open:
            raise self.error(
                "This parenthesis was never opened.", position, "Remove it, or add the missing '('."
            )
        if self.expects_operand:
            raise self.missing()
        if token == ")":
            self.open.pop()


class _TreeBuilder:
    """Converts Python's syntax tree to an expression tree; refuses every node that is not part of an expression."""

    def __init__(self, text: str, line: str) -> None:
        self.text, self.bytes = text, line.encode()
        self.positions: list[tuple[Expression, int]] = []

    def position(self, node: ast.expr) -> int:
        """Position in the text: Python counts bytes, and one column is the parenthesis added in front."""
        return len(self.bytes[: node.col_offset].decode()) - 1

    def error(self, reason: str, node: ast.expr, advice: str) -> LawError:
        return LawError(reason, self.text, self.position(node), advice)

    def read(self, node: ast.expr, depth: int) -> Expression:
        """The tree of `node`; `depth` counts calls, signs and powers above it."""
        if depth > MAX_DEPTH:
            raise self.error(
                f"The expression is nested deeper than {MAX_DEPTH} levels.",
                node,
                "Multiply the inner levels out.",
            )
        match node:
            case ast.Constant(value=value):
                parsed = self.number(value, node)
            case ast.Name(id=name):
                parsed = self.name(name, node)
            case ast.BinOp(op=ast.Add() | ast.Sub() | ast.Mult() | ast.Div()):
                parsed = self.chain(node, depth)
            case ast.BinOp(op=ast.Pow()):
                parsed = power(self.read(node.left, depth + 1), self.read(node.right, depth + 1))
            case ast.UnaryOp(op=ast.USub()):
                parsed = multiply(MINUS_ONE, self.read(node.operand, depth + 1))
            case ast.UnaryOp(op=ast.UAdd()):
                parsed = self.read(node.operand, depth + 1)
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]) if name in FUNCTIONS:
                parsed = self.function(name, arguments, node, depth)
            case _:
                raise self.error("This is not part of an expression.", node, _ALLOWED)
        self.positions.append((parsed, self.position(node)))
        return parsed

    def chain(self, node: ast.BinOp, depth: int) -> Expression:
        """A chain of + and -, or of * and /, read in a loop: it is long, not deep."""
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
                self.positions.append((item, self.position(below)))
            items.append(item)
        return multiply(*items) if inverse is ast.Div else add(*items)

    def number(self, value: object, node: ast.expr) -> Expression:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.error("This is not a number.", node, _ALLOWED)
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
                f"{name!r} is a function, not a name.", node, f"Write {name}(...), or rename the coefficient."
            )
        return Number(math.pi) if name == "pi" else Symbol(name)

    def function(self, name: str, arguments: list[ast.expr], node: ast.expr, depth: int) -> Expression:
        least = len(FUNCTIONS[name].derivatives)
        if len(arguments) < least or (least == 1 and len(arguments) > 1):
            wanted = "one argument" if least == 1 else "two or more arguments"
            raise self.error(
                f"{name!r} takes {wanted}, not {len(arguments)}.", node, "Check commas and parentheses."
            )
        return call(name, *(self.read(argument, depth + 1) for argument in arguments))
