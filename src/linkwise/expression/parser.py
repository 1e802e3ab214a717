"""Text to expression tree. The grammar is that of Python's arithmetic; nothing is evaluated."""

from __future__ import annotations

import difflib
import keyword
import math
import re
import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

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
    r"(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)|(?P<name>[^\W\d]\w*)|(?P<sign>\*\*|//|[-+*/(),])|(?P<other>\S)|\Z"
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
    parser = _Parser(text, variables, writable_functions())
    return Parsed(parser.chain(0), tuple(parser.positions))


@cache
def parse_rule(text: str) -> Expression:
    """The tree of a rule in the table of functions, which may contain functions that a law may not."""
    return _Parser(text, (), FUNCTIONS).chain(0)


class _Token(NamedTuple):
    """A number, a name, a sign or another character at its `position`; empty at the end of the text."""

    kind: str
    text: str
    position: int


_SUM, _PRODUCT = ("+", "-"), ("*", "/")


class _Parser:
    """Reads a text once, from left to right, and raises at the first token that is out of place."""

    def __init__(self, text: str, variables: tuple[str, ...], functions: Iterable[str]) -> None:
        self.text, self.variables, self.functions = text, variables, tuple(functions)
        matches = _TOKEN.finditer(text)
        self.tokens = [_Token(match.lastgroup or "end", match[0], match.start()) for match in matches]
        self.last, self.next = _Token("", "", 0), self.tokens.pop(0)
        # positions of open parentheses, and whether each is that of a call
        self.open: list[tuple[int, bool]] = []
        self.positions: list[tuple[Expression, int]] = []

    def error(self, reason: str, position: int, advice: str) -> LawError:
        return LawError(reason, self.text, position, advice)

    def take(self) -> _Token:
        """The next token."""
        self.last, self.next = self.next, self.tokens.pop(0) if self.tokens else self.next
        return self.last

    def placed(self, expression: Expression, position: int) -> Expression:
        self.positions.append((expression, position))
        return expression

    def chain(self, depth: int, signs: tuple[str, str] = _SUM) -> Expression:
        """A sum or a product, read in a loop: it is long, not deep. `depth` counts calls, signs and powers above it."""
        start, items = self.next.position, []
        sign = signs[0]
        while True:
            place = self.next.position
            item = self.chain(depth, _PRODUCT) if signs is _SUM else self.signed(depth)
            if sign == signs[1]:
                item = self.placed(power(item, -1) if sign == "/" else multiply(MINUS_ONE, item), place)
            items.append(item)
            if self.next.text not in signs:
                break
            sign = self.take().text
        if len(items) == 1:
            return items[0]
        return self.placed(add(*items) if signs is _SUM else multiply(*items), start)

    def signed(self, depth: int) -> Expression:
        """A power, or an operand with a sign before it."""
        if depth > MAX_DEPTH:
            reason = f"The expression is nested deeper than {MAX_DEPTH} levels."
            raise self.error(reason, self.next.position, "Multiply the inner levels out.")
        start = self.next.position
        if self.next.text in _SUM:
            negative = self.take().text == "-"
            operand = self.signed(depth + 1)
            return self.placed(multiply(MINUS_ONE, operand) if negative else operand, start)
        base = self.operand(depth)
        if self.next.text != "**":
            return base
        self.take()
        return self.placed(power(base, self.signed(depth + 1)), start)

    def operand(self, depth: int) -> Expression:
        """A number, a name, a call, or a sum in parentheses."""
        before, token = self.last, self.take()
        if token.kind == "number":
            read = self.placed(self.number(token), token.position)
        elif token.kind == "name" and self.next.text == "(":
            read = self.placed(self.function(token, depth), token.position)
        elif token.kind == "name":
            read = self.placed(self.name(token), token.position)
        elif token.text == "(":
            self.enter(token, of_call=False)
            read = self.chain(depth)
            self.take()
            self.open.pop()
        else:
            raise self.no_operand(before, token)
        self.check_what_follows()
        return read

    def enter(self, parenthesis: _Token, *, of_call: bool) -> None:
        self.open.append((parenthesis.position, of_call))
        if len(self.open) > MAX_DEPTH:
            reason = f"Parentheses are nested deeper than {MAX_DEPTH} levels."
            raise self.error(reason, parenthesis.position, "Multiply the inner ones out.")

    def number(self, token: _Token) -> Expression:
        if token.text.isdigit() and token.text.startswith("0") and token.text.strip("0"):
            raise self.error("Invalid syntax: leading zeros of a number.", token.position, _ALLOWED)
        if not math.isfinite(float(token.text)):
            reason = "This number is too large for double precision."
            raise self.error(reason, token.position, "The largest is 1.8e308.")
        return Number(float(token.text))

    def name(self, token: _Token) -> Expression:
        name = unicodedata.normalize("NFKC", token.text)  # as in Python
        if name.startswith("_") or not token.text.isidentifier():
            advice = "Names begin with a letter: k, alpha, c2."
            raise self.error(f"{token.text!r} is not a valid name.", token.position, advice)
        if keyword.iskeyword(name):
            advice = f"Choose another name, such as {name}_."
            raise self.error(f"{name!r} is a reserved word.", token.position, advice)
        if name in self.functions:
            advice = f"Write {name}(...), or rename the coefficient."
            raise self.error(f"{name!r} is a function, not a name.", token.position, advice)
        return Number(math.pi) if name == "pi" else Symbol(name)

    def function(self, token: _Token, depth: int) -> Expression:
        if token.text not in self.functions:
            self.name(token)
            raise self.unknown_function(token)
        self.enter(self.take(), of_call=True)
        arguments = [self.chain(depth + 1)]
        while self.next.text == ",":
            self.take()
            arguments.append(self.chain(depth + 1))
        self.take()
        self.open.pop()
        least = len(FUNCTIONS[token.text].derivatives)
        if len(arguments) < least or (least == 1 and len(arguments) > 1):
            wanted = "one argument" if least == 1 else "two or more arguments"
            reason = f"{token.text!r} takes {wanted}, not {len(arguments)}."
            raise self.error(reason, token.position, "Check commas and parentheses.")
        return call(token.text, *arguments)

    def unknown_function(self, token: _Token) -> LawError:
        name, known = token.text, self.functions
        near = difflib.get_close_matches(name.lower(), known, n=1)
        advice = f"The functions are {', '.join(known)}. For a product write {name}*(...)."
        if name in self.variables:
            advice = f"{name} is a variable: for a product write {name}*(...)."
        elif near:
            advice = f"Did you mean {near[0]}? {advice}"
        return self.error(f"{name!r} is not a function.", token.position, advice)

    def no_operand(self, before: _Token, token: _Token) -> LawError:
        """What is wrong with a token where an operand is expected."""
        self.check_token(token)
        if token.text and token.text not in "),":
            between = (
                f"between {before.text!r} and {token.text!r}" if before.text else f"before {token.text!r}"
            )
            return self.error(f"Something is missing {between}.", token.position, "Add the operand.")
        if before.text == "(":
            return self.error("These parentheses are empty.", before.position, "Add an expression.")
        return self.error(f"Something is missing after {before.text!r}.", before.position, "Add its operand.")

    def check_what_follows(self) -> None:
        """Raise LawError for a token that cannot stand behind an operand."""
        token, before = self.next, self.last.text
        self.check_token(token)
        if token.kind in ("number", "name") or token.text == "(":
            product = "." if token.text == "(" else f": {before}*{token.text}."
            reason = f"An operator is missing between {before!r} and {token.text!r}."
            raise self.error(reason, token.position, f"A product is written with a star{product}")
        if token.kind == "end" and self.open:
            raise self.error("This parenthesis is never closed.", self.open[-1][0], "Add the missing ')'.")

    def check_token(self, token: _Token) -> None:
        """Raise LawError for a token that can stand nowhere, or not outside of the parentheses that are open."""
        if token.kind == "other":
            advice = _ADVICE.get(token.text, _ALLOWED)
            raise self.error(f"Unexpected character {token.text!r}.", token.position, advice)
        if token.text == "//":
            advice = "A quotient is written with one slash: d/g."
            raise self.error("'//' is not a supported operator.", token.position, advice)
        if token.text == "," and not (self.open and self.open[-1][1]):
            around = self.text[: token.position], self.text[token.position + 1 :]
            decimal = re.search(r"\d$", around[0]) and re.match(r"\d", around[1])
            advice = "Decimals have a point: 1.5." if decimal else "Write one expression."
            raise self.error("A comma may only separate the arguments of a function.", token.position, advice)
        if token.text == ")" and not self.open:
            advice = "Remove it, or add the missing '('."
            raise self.error("This parenthesis was never opened.", token.position, advice)
