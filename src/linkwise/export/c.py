"""The equations of motion in C99, without dependencies."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from linkwise.display import on_one_line
from linkwise.export.answer import rendered
from linkwise.export.equations import EquationsOfMotion, Notation
from linkwise.expression.tree import CodeStyle

_FUNCTIONS = {"abs": "fabs", "sign": "sign_of", "max": "larger", "min": "smaller"}
C = CodeStyle("*", "/", "pow({}, {})", "raised({}, {})", lambda name: _FUNCTIONS.get(name, name))
KEYWORDS = (
    "auto", "break", "case", "char", "const", "continue", "default", "do", "double", "else", "enum", "extern", "float", "for",
    "goto", "if", "inline", "int", "long", "register", "restrict", "return", "short", "signed", "sizeof", "static", "struct",
    "switch", "typedef", "union", "unsigned", "void", "volatile", "while",
)  # fmt: skip
_RESULTS = {"rhs": "dz", "jacobian": "dfdz", "input_jacobian": "dfdu"}


def write_equations(equations: EquationsOfMotion, path: Path, name: str) -> None:
    """Write the file; `name` is not needed in it."""
    path.write_text(source(equations), encoding="ascii", newline="\n")


def source(equations: EquationsOfMotion) -> str:
    """The text of the file."""
    names = equations.identifiers(KEYWORDS)
    functions = []
    for function, assignments, columns in equations.functions:
        lines = _notation(columns).lines(assignments, equations.arrays, names, f"    {_RESULTS[function]}")
        functions.append((function, _RESULTS[function], columns, "\n".join(lines)))
    written = {"comment": _comment, "strings": _strings, "numbers": _numbers, "functions": functions}
    return rendered("equations.c.jinja", equations=equations, **written)


def _notation(columns: int) -> Notation:
    return Notation(
        C,
        "    const double {}",
        lambda array, place: f"{array}[{place[0] * columns + place[1] if len(place) == 2 else place[0]}]",
        lambda text: f"    // {_comment(text)}",
        ";",
    )


def literal(text: str) -> str:
    """A text as a string of C in UTF-8, in which nothing but plain letters stands unescaped."""
    plain = "".join(
        letter if letter.isascii() and (letter.isalnum() or letter in " _.,:-+*/^()") else
        "".join(f"\\{byte:03o}" for byte in letter.encode("utf-8", "replace"))
        for letter in on_one_line(text)
    )  # fmt: skip
    return f'"{plain}"'


def _comment(text: str) -> str:
    """A text for the rest of a line: of ASCII, and without what joins it to the next one, a backslash or its trigraph."""
    plain = on_one_line(text).encode("ascii", "replace").decode().replace("\\", "/")
    return plain.replace("??", "? ?").replace("??", "? ?")


def _numbers(values: Iterable[float]) -> str:
    return ", ".join(map(repr, [*values, 0.0]))


def _strings(texts: Iterable[str]) -> str:
    return ", ".join([*map(literal, texts), "NULL"])
