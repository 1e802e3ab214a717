"""The equations of motion in C99, without dependencies."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from linkwise.display import on_one_line
from linkwise.export.equations import Assignments, EquationsOfMotion, Notation
from linkwise.expression.tree import CodeStyle

_FUNCTIONS = {"abs": "fabs", "sign": "sign_of", "max": "larger", "min": "smaller"}
C = CodeStyle("*", "/", "pow({}, {})", "raised({}, {})", lambda name: _FUNCTIONS.get(name, name))
KEYWORDS = (
    "auto", "break", "case", "char", "const", "continue", "default", "do", "double", "else", "enum", "extern", "float", "for",
    "goto", "if", "inline", "int", "long", "register", "restrict", "return", "short", "signed", "sizeof", "static", "struct",
    "switch", "typedef", "union", "unsigned", "void", "volatile", "while",
)  # fmt: skip
_HEAD = """// Equations of motion z' = f(t, z, u; p) of a structure, exported by linkwise {version}: {name}
// rhs writes f into dz[STATES], jacobian its derivatives by z into dfdz[STATES * STATES], row by row, and input_jacobian those
// by u into dfdu[STATES * INPUTS]. Where u is NULL all inputs are 0, and where p is NULL the parameters are `parameters`.
// Compile with a C99 compiler and link the mathematical library (-lm).
{notes}
#include <math.h>
#include <stddef.h>

#define STATES {states}
#define INPUTS {inputs}
#define PARAMETERS {parameters}

{tables}
"""
_TOOLS = """
static const double no_inputs[INPUTS + 1] = {0.0};

static inline double raised(double x, int n)
{
    double result = 1.0;
    for (; n > 0; n /= 2, x *= x)
        if (n % 2)
            result *= x;
    return result;
}

static inline double sign_of(double x) { return x != x ? x : (double)((x > 0.0) - (x < 0.0)); }

static inline double larger(double x, double y) { return x >= y || x != x ? x : y; }

static inline double smaller(double x, double y) { return x <= y || x != x ? x : y; }
"""


_RESULTS = {"rhs": "dz", "jacobian": "dfdz", "input_jacobian": "dfdu"}


def write_equations(equations: EquationsOfMotion, path: Path, name: str) -> None:
    """Write the file; `name` is not needed in it."""
    path.write_text(source(equations), encoding="ascii", newline="\n")


def source(equations: EquationsOfMotion) -> str:
    """The text of the file."""
    names = equations.identifiers(KEYWORDS)
    tables = {"state": equations.states, "input": equations.inputs, "parameter": equations.units}
    lines = [
        f"const char *const {table}_{column}[] = {{{', '.join([*map(literal, texts), 'NULL'])}}};"
        for table, units in tables.items()
        for column, texts in (("names", units), ("units", units.values()))
    ]
    lines.append(f"const double parameters[] = {{{_numbers(equations.parameters.values())}}};")
    lines.append(f"const double initial[] = {{{_numbers(equations.initial)}}};")
    head = _HEAD.format(
        version=equations.answer.version,
        name=_comment(equations.structure.name),
        notes="\n".join(f"// {_comment(note)}" for note in equations.notes or ["Every law is smooth."]),
        states=len(equations.states),
        inputs=len(equations.inputs),
        parameters=len(equations.parameters),
        tables="\n".join(lines),
    )
    functions = [_function(equations, names, *function) for function in equations.functions]
    return "".join([head, _TOOLS, *functions])


def _function(
    equations: EquationsOfMotion, names: dict[str, str], own: str, assignments: Assignments, columns: int
) -> str:
    result, rows = _RESULTS[own], len(equations.states)
    notation = Notation(
        C,
        "    const double {}",
        lambda array, place: f"{array}[{place[0] * columns + place[1] if len(place) == 2 else place[0]}]",
        lambda text: f"    // {_comment(text)}",
        ";",
    )
    return "\n".join([
        f"\nvoid {own}(double t, const double *z, const double *u, const double *p, double *{result})",
        "{",
        "    u = u ? u : no_inputs;",
        "    p = p ? p : parameters;",
        "    (void)t, (void)z, (void)u, (void)p;",
        f"    for (int k = 0; k < {rows * columns}; k++)",
        f"        {result}[k] = 0.0;",
        *notation.lines(assignments, equations.arrays, names, f"    {result}"),
        "}\n",
    ])  # fmt: skip


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
