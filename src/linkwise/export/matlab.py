"""An answer for MATLAB: as a function, for Octave too, and as variables in a MAT file."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from scipy.io import savemat

from linkwise.arrays import Floats
from linkwise.display import on_one_line
from linkwise.errors import OutputError
from linkwise.export.answer import ExportedAnswer, identifiers
from linkwise.export.equations import Assignments, EquationsOfMotion, Notation
from linkwise.expression.tree import FUNCTIONS, MATLAB, to_code, to_text
from linkwise.model.link import Link

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,62}")
_KEYWORDS = (
    "break", "case", "catch", "classdef", "continue", "else", "elseif", "end", "for", "function", "global", "if", "otherwise",
    "parfor", "persistent", "return", "spmd", "switch", "try", "while", "pi", "i", "j", "Inf", "NaN", "eps", "ans",
)  # fmt: skip
_OWN = ("d", "v", "states", "link", "force", "rates", "real_or_nan", "answer", "values", "nargin", "error")
_HEAD = """function [force, rates] = {name}(link, d, v, states)
%{title}  Forces of the links of a structure, identified by linkwise {version}.
%   force = {name}(link, d, v) is the force in {force} of the link of that name at the elongation d = x_first - x_second
%   in {d} and its rate v in {v}, numbers or arrays of one size; -force acts on the first end of the link and
%   force on the second.
%   [force, rates] = {name}(link, d, v, states) is for a link with memory: states and rates are cells with one array a state;
%   signals that a law names are behind its states.
%   answer = {name}() is a struct of the coefficients in SI units with their standard errors and covariance;
%   points of hosts move by the product of answer.shapes and the motion of answer.coordinates.{note}
if nargin == 0
    force = values();
    return
end
rates = {{}};
switch link
"""
_TAIL = """    otherwise
        error('unknown link: %s', link);
end
end

function r = real_or_nan(z)
r = real(z);
r(imag(z) ~= 0) = NaN;
end
"""


def write_m(answer: ExportedAnswer, path: Path, name: str) -> None:
    """Write the function, which has the `name` of its file. Raises OutputError for one that is not that of a function."""
    _check_name(name)
    note = f"\n%   {on_one_line(answer.note)}" if answer.note else ""
    head = _HEAD.format(name=name, title=name.upper(), version=answer.version, note=note, **answer.quantities)
    cases = "".join(_case(link) for link in answer.structure.links)
    path.write_text(f"{head}{cases}{_TAIL}\n{_values(answer)}", encoding="utf-8", newline="\n")


def _check_name(name: str) -> None:
    if not _NAME.fullmatch(name) or name in _KEYWORDS:
        raise OutputError(
            f"{name}.m: a function of MATLAB has the name of its file, and {name!r} is not the name of a function: use "
            "letters, digits and underscores after a letter"
        )


def _text(text: str) -> str:
    """A text in quotes, on one line."""
    return "'" + on_one_line(text).replace("'", "''") + "'"


def _case(link: Link) -> str:
    law, values = link.law, link.values
    reserved = (*_OWN, *_KEYWORDS, *FUNCTIONS)
    names = identifiers((*law.variables[2:], *law.coefficients), reserved) | {"d": "d", "v": "v"}
    lines = [f"    case {_text(link.name)}", f"        % {to_text(law.expression)}"]
    lines += [f"        {names[key]} = {values[key]!r};" for key in law.coefficients]
    lines += [f"        {names[key]} = states{{{n}}};" for n, key in enumerate(law.variables[2:], start=1)]
    lines.append(f"        force = {to_code(law.expression, MATLAB, names)} + 0.0.*d.*v;")
    if law.states:
        rates = ", ".join(to_code(rate.expression, MATLAB, names) for rate in law.rates)
        lines.append(f"        rates = {{{rates}}};")
    return "\n".join([*lines, ""])


def _values(answer: ExportedAnswer) -> str:
    """The function of the numbers."""
    every = answer.coefficients
    errors = ["NaN" if coefficient.error is None else repr(coefficient.error) for coefficient in every]
    lines = [
        "function answer = values()",
        f"answer.structure = {_text(answer.structure.name)};",
        f"answer.names = {{{'; '.join(_text(f'{coefficient.owner}.{coefficient.name}') for coefficient in every)}}};",
        f"answer.values = [{'; '.join(repr(coefficient.value) for coefficient in every)}];",
        f"answer.units = {{{'; '.join(_text(coefficient.unit) for coefficient in every)}}};",
        f"answer.standard_errors = [{'; '.join(errors)}];",
        f"answer.covariance_names = {{{'; '.join(map(_text, answer.names))}}};",
        f"answer.covariance = {_matrix(answer.covariance)};",
        f"answer.points = {{{'; '.join(map(_text, answer.structure.points))}}};",
        f"answer.coordinates = {{{'; '.join(map(_text, answer.structure.mass_names))}}};",
        f"answer.shapes = {_matrix(answer.shapes)};",
        "end",
    ]
    return "\n".join([*lines, ""])


def _matrix(values: Floats) -> str:
    rows = ["  " + ", ".join(map(repr, row)) for row in values.tolist()]
    return "[" + "; ...\n".join(["", *rows]).removeprefix("; ...\n").strip() + "]"


def write_mat(answer: ExportedAnswer, path: Path, name: str) -> None:
    """Write MAT v5 with cells of names and columns of numbers; `name` is not needed in it.

    `names`, `values`, `units` and `standard_errors` (NaN where there is none) are those of all masses and coefficients, and
    `covariance` that of `covariance_names`. `links` is a struct array: name, both ends, law, and the rates of states.
    `points` of hosts move by `shapes`, with a column for each of the `coordinates`.
    """
    every = answer.coefficients
    kinds = [("name", object), ("first", object), ("second", object), ("law", object), ("rates", object)]
    links = np.zeros((len(answer.structure.links), 1), dtype=kinds)
    for number, link in enumerate(answer.structure.links):
        rates = [f"{rate.name}: {rate.text}" for rate in link.law.rates]
        links[number, 0] = (link.name, *link.between, link.law.text, _cells(rates))
    content = {
        "structure": on_one_line(answer.structure.name),
        "version": answer.version,
        "note": answer.note,
        "names": _cells([f"{coefficient.owner}.{coefficient.name}" for coefficient in every]),
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


_EQUATIONS_HEAD = """function [value, jacobian, input_jacobian] = {name}(t, z, u, p, what)
%{title}  Equations of motion z' = f(t, z, u; p) of a structure, exported by linkwise {version}.
%   dz = {name}(t, z, u, p) is f for states z and inputs u, a vector or a function of t; all inputs are 0 where u is left out
%   or []. p is a vector of parameters. [dz, J, G] = {name}(t, z, u, p) also has the derivatives by z and by u.
%   J = {name}(t, z, u, p, 'jacobian') is for solvers:
%       info = {name}();
%       options = odeset('Jacobian', @(t, z) {name}(t, z, [], [], 'jacobian'));
%       [t, z] = ode45(@{name}, [0 1], info.initial, options);
%   info = {name}() names states, inputs and parameters, with units and values. In Simulink it is a MATLAB Function block
%   dz = {name}(t, z, u) before an integrator.
%   {notes}
if nargin == 0
    value = information();
    return
end
if nargin < 3 || isempty(u)
    u = zeros({inputs}, 1);
elseif isa(u, 'function_handle')
    u = u(t);
end
if nargin < 4 || isempty(p)
    p = {parameters};
end
if nargin == 5 && strcmp(what, 'jacobian')
    value = jacobian_of(z, u, p);
    return
end
value = rates_of(z, u, p);
if nargout > 1
    jacobian = jacobian_of(z, u, p);
end
if nargout > 2
    input_jacobian = input_jacobian_of(z, u, p);
end
end
"""
_REAL = """
function r = real_or_nan(z)
r = real(z);
r(imag(z) ~= 0) = NaN;
end
"""
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
    head = _EQUATIONS_HEAD.format(
        name=name,
        title=name.upper(),
        version=equations.answer.version,
        notes=on_one_line(" ".join(equations.notes)) or "Every law is smooth.",
        inputs=len(equations.inputs),
        parameters=_column(map(repr, equations.parameters.values())),
    )
    functions = [_function(equations, names, *function) for function in equations.functions]
    text = "\n".join([head, *functions, _information(equations)])
    path.write_text(text + _REAL, encoding="utf-8", newline="\n")


def _function(
    equations: EquationsOfMotion, names: dict[str, str], own: str, assignments: Assignments, columns: int
) -> str:
    statements = _NOTATION.lines(assignments, equations.arrays, names, "result")
    called = "rates_of" if own == "rhs" else f"{own}_of"
    head = f"function result = {called}(z, u, p)\nresult = zeros({len(equations.states)}, {columns});"
    return "\n".join([head, *statements, "end\n"])


def _information(equations: EquationsOfMotion) -> str:
    tables = {"states": equations.states, "inputs": equations.inputs, "parameters": equations.units}
    lines = ["function info = information()", f"info.structure = {_text(equations.structure.name)};"]
    for name, units in tables.items():
        lines.append(f"info.{name} = {_column(map(_text, units), '{}')};")
        lines.append(f"info.{name.removesuffix('s')}_units = {_column(map(_text, units.values()), '{}')};")
    lines.append(f"info.values = {_column(map(repr, equations.parameters.values()))};")
    lines.append(f"info.initial = {_column(map(repr, equations.initial))};")
    return "\n".join([*lines, "end\n"])


def _column(entries: Iterable[str], brackets: str = "[]") -> str:
    return f"{brackets[0]}{'; '.join(entries)}{brackets[1]}"
