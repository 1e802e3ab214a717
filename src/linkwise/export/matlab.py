"""An answer for MATLAB: as a function, for Octave too, and as variables in a MAT file."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import savemat

from linkwise.arrays import Floats
from linkwise.display import identifiers, on_one_line
from linkwise.errors import OutputError
from linkwise.export.answer import ExportedAnswer, rendered
from linkwise.export.equations import EquationsOfMotion, Notation
from linkwise.expression.tree import FUNCTIONS, MATLAB, to_code, to_text

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,62}")
_KEYWORDS = (
    "break", "case", "catch", "classdef", "continue", "else", "elseif", "end", "for", "function", "global", "if", "otherwise",
    "parfor", "persistent", "return", "spmd", "switch", "try", "while", "pi", "i", "j", "Inf", "NaN", "eps", "ans",
)  # fmt: skip
_OWN = ("d", "v", "states", "link", "force", "rates", "real_or_nan", "answer", "values", "nargin", "error")


def write_m(answer: ExportedAnswer, path: Path, name: str) -> None:
    """Write the function, which has the `name` of its file. Raises OutputError for one that is not that of a function."""
    _check_name(name)
    links = []
    for link in answer.structure.links:
        law = link.law
        reserved = (*_OWN, *_KEYWORDS, *FUNCTIONS)
        names = identifiers((*law.variables[2:], *law.coefficients), reserved) | {"d": "d", "v": "v"}
        rates = [to_code(rate.expression, MATLAB, names) for rate in law.rates]
        links.append((link, names, to_code(law.expression, MATLAB, names), rates))
    parts = {"answer": answer, "every": answer.coefficients, "links": links}
    text = _rendered("forces.m.jinja", name, to_text=to_text, matrix=_matrix, **parts)
    path.write_text(text, encoding="utf-8", newline="\n")


def _rendered(template: str, name: str, **parts: Any) -> str:
    """The text of a function that has the `name` of its file."""
    written = {"text": _text, "column": _column, "on_one_line": on_one_line, "repr": repr}
    return rendered(template, name=name, **written, **parts)


def _check_name(name: str) -> None:
    if not _NAME.fullmatch(name) or name in _KEYWORDS:
        raise OutputError(
            f"{name}.m: a function of MATLAB has the name of its file, and {name!r} is not the name of a function: use "
            "letters, digits and underscores after a letter"
        )


def _text(text: str) -> str:
    """A text in quotes, on one line."""
    return "'" + on_one_line(text).replace("'", "''") + "'"


def _matrix(values: Floats) -> str:
    return "[" + "; ...\n  ".join(", ".join(map(repr, row)) for row in values.tolist()) + "]"


def write_mat(answer: ExportedAnswer, path: Path, name: str) -> None:
    """Write MAT v5 with cells of names and columns of numbers; `name` is not needed in it.

    `names`, `values`, `units` and `standard_errors` (NaN where there is none) are those of all masses and coefficients, and
    `covariance` that of `covariance_names`. `links` is a struct array: name, both ends, law, and the rates of states.
    `points` of hosts move by `shapes`, with a column for each of the `coordinates`.
    """
    every = answer.coefficients
    kinds = [(key, object) for key in ("name", "first", "second", "law", "rates")]
    links = np.zeros((len(answer.structure.links), 1), dtype=kinds)
    for number, link in enumerate(answer.structure.links):
        rates = [f"{rate.name}: {rate.text}" for rate in link.law.rates]
        links[number, 0] = (link.name, *link.between, link.law.text, _cells(rates))
    content = {
        "structure": on_one_line(answer.structure.name),
        "version": answer.version,
        "note": answer.note,
        "names": _cells([coefficient.full_name for coefficient in every]),
        "values": np.array([[coefficient.value] for coefficient in every]),
        "units": _cells([coefficient.unit for coefficient in every]),
        "standard_errors": np.array([[coefficient.error] for coefficient in every], dtype=float),
        "covariance_names": _cells(list(answer.names)),
        "covariance": answer.covariance,
        "links": links,
        "points": _cells(list(answer.structure.points)),
        "coordinates": _cells(list(answer.structure.mass_names)),
        "shapes": answer.shapes,
    }
    savemat(path, content, format="5", oned_as="column", long_field_names=True)


def _cells(texts: list[str]) -> np.ndarray[tuple[int, int], np.dtype[np.object_]]:
    """A column of cells."""
    cells = np.empty((len(texts), 1), dtype=object)
    cells[:, 0] = texts
    return cells


_NOTATION = Notation(
    MATLAB,
    "{}",
    lambda array, place: f"{array}({', '.join(str(number + 1) for number in place)})",
    lambda text: f"% {on_one_line(text)}",
    ";",
)


def write_equations(equations: EquationsOfMotion, path: Path, name: str) -> None:
    """Write the function of the equations, which has the `name` of its file; OutputError where that is no function's."""
    _check_name(name)
    names = equations.identifiers((*_KEYWORDS, *FUNCTIONS, *_OWN))
    functions = []
    for function, assignments, columns in equations.functions:
        lines = _NOTATION.lines(assignments, equations.arrays, names, "result")
        functions.append(("rates" if function == "rhs" else function, columns, "\n".join(lines)))
    text = _rendered("equations.m.jinja", name, equations=equations, functions=functions)
    path.write_text(text, encoding="utf-8", newline="\n")


def _column(entries: Iterable[Any], written: Callable[[Any], str] = repr) -> str:
    """Entries of a column, NaN for None."""
    return "; ".join("NaN" if entry is None else written(entry) for entry in entries)
