"""An answer as a Python module that needs nothing but NumPy."""

from __future__ import annotations

import builtins
import keyword
from pathlib import Path
from typing import Any

from linkwise.display import identifiers, on_one_line
from linkwise.export.answer import ExportedAnswer, rendered
from linkwise.export.equations import EquationsOfMotion, Notation
from linkwise.expression.tree import NUMPY, to_code, to_text
from linkwise.model.link import Link

_RESERVED = ("d", "v", "np", *keyword.kwlist, *keyword.softkwlist, *dir(builtins))


def write(answer: ExportedAnswer, path: Path, name: str) -> None:
    """Write the module; `name` is not needed in it."""
    links, every = answer.structure.links, answer.coefficients
    functions = identifiers((link.name for link in links), ())
    tables = {
        "NAME": answer.structure.name,
        "MASSES": {one.owner: one.value for one in every if one.name == "mass"},
        "BETWEEN": {link.name: link.between for link in links},
        "POINTS": answer.points,
        "COEFFICIENTS": {link.name: link.values for link in links},
        "UNITS": {link.name: {key: link.law.units[key] for key in link.values} for link in links},
        "STANDARD_ERRORS": {one.full_name: one.error for one in every if one.error is not None},
    }
    written = [_functions(link, functions[link.name]) for link in links]
    moving = {link.name: functions[link.name] for link in links if link.law.states}
    parts = {"answer": answer, "tables": tables, "functions": functions, "moving": moving, "links": written}
    text = _rendered("forces.py.jinja", to_text=to_text, **parts)
    path.write_text(text, encoding="utf-8", newline="\n")


def _rendered(template: str, **parts: Any) -> str:
    return rendered(template, docstring=_docstring, ascii=ascii, **parts)


def _functions(link: Link, own: str) -> tuple[Link, str, list[str], str, str, list[str]]:
    """What the functions of a link, called by its `own` name, take and return."""
    law, values = link.law, link.values
    names = identifiers((*law.variables[2:], *law.coefficients), _RESERVED) | {"d": "d", "v": "v"}
    variables = ["d", "v", *(names[key] for key in law.variables[2:])]
    keywords = [f"{names[key]}={values[key]!r}" for key in law.coefficients]
    arguments = ", ".join([*variables, *(["*", *keywords] if keywords else [])])
    rates = [to_code(rate.expression, NUMPY, names) for rate in law.rates]
    return link, own, variables, arguments, to_code(law.expression, NUMPY, names), rates


def _docstring(text: str) -> str:
    """The docstring that reads as `text`, whatever that holds."""
    escaped = text.replace("\\", r"\\").replace('"', r"\"")
    seen = (char if char.isprintable() or char == "\n" else ascii(char)[1:-1] for char in escaped)
    return f'"""{"".join(seen)}"""'


def write_equations(equations: EquationsOfMotion, path: Path, name: str) -> None:
    """Write the module of the equations; `name` is not needed in it."""
    names = equations.identifiers(_RESERVED)
    functions, size = [], len(equations.states)
    arrays = {name: entries for name, entries in equations.arrays.items() if name != "p"}
    for own, assignments, columns in equations.functions:
        needed = [(names[key], key) for key in equations.parameters if key in assignments.inputs]
        lines = _NOTATION.lines(assignments, arrays, names, "    result")
        functions.append((own, (size,) if own == "rhs" else (size, columns), needed, "\n".join(lines)))
    units = {**equations.states, **equations.inputs, **equations.units}
    text = _rendered("equations.py.jinja", equations=equations, units=units, functions=functions)
    path.write_text(text, encoding="utf-8", newline="\n")


_NOTATION = Notation(
    NUMPY,
    "    {}",
    lambda array, place: f"{array}[{', '.join(map(str, place))}]",
    lambda text: f"    # {on_one_line(text)}",
)
