"""An answer as a Python module that needs nothing but NumPy."""

from __future__ import annotations

import builtins
import keyword
from pathlib import Path

from linkwise.display import on_one_line
from linkwise.export.answer import ExportedAnswer, identifiers
from linkwise.export.equations import Assignments, EquationsOfMotion, Notation
from linkwise.expression.tree import NUMPY, to_code, to_text
from linkwise.model.link import Link

_RESERVED = ("d", "v", "np", *keyword.kwlist, *keyword.softkwlist, *dir(builtins))
_DOCSTRING = """Forces of the links of a structure, identified by linkwise {version}.

force_LINK(d, v) is the force f in {force} at the elongation d = x_first - x_second in {d} and its rate v in {v}, numbers
or arrays; -f acts on the first end of the link and f on the second. A link with memory takes its states behind v, and
rates_LINK(d, v, states) are their rates; signals that a law names come last. Coefficients are keywords, so that others can
be tried. An end that is a point of a host moves by its modes, each times its shape in POINTS.{note}
"""
_HEAD = """{docstring}

import numpy as np

NAME = {name}
MASSES = {masses}
BETWEEN = {between}
POINTS = {points}
COEFFICIENTS = {coefficients}
UNITS = {units}
STANDARD_ERRORS = {errors}
COVARIANCE_NAMES = {names}
COVARIANCE = np.array({covariance}, dtype=float).reshape(len(COVARIANCE_NAMES), len(COVARIANCE_NAMES))
"""


def write(answer: ExportedAnswer, path: Path, name: str) -> None:
    """Write the module; `name` is not needed in it."""
    links, every = answer.structure.links, answer.coefficients
    functions = identifiers((link.name for link in links), ())
    errors = {f"{one.owner}.{one.name}": one.error for one in every if one.error is not None}
    note = f"\n\n{answer.note}" if answer.note else ""
    head = _HEAD.format(
        docstring=_docstring(_DOCSTRING.format(version=answer.version, note=note, **answer.quantities)),
        name=ascii(answer.structure.name),
        masses=ascii({one.owner: one.value for one in every if one.name == "mass"}),
        points=ascii(answer.points),
        between=ascii({link.name: link.between for link in links}),
        coefficients=ascii({link.name: link.values for link in links}),
        units=ascii({link.name: {key: link.law.units[key] for key in link.values} for link in links}),
        errors=ascii(errors),
        names=ascii(list(answer.names)),
        covariance=ascii(answer.covariance.tolist()),
    )
    texts = [_functions(link, functions[link.name]) for link in links]
    tables = [f"FORCES = {_table('force', functions)}\n"]
    moving = {link.name: functions[link.name] for link in links if link.law.states}
    if moving:
        tables.append(f"RATES = {_table('rates', moving)}\n")
    path.write_text("\n\n".join([head, *texts, "".join(tables)]), encoding="utf-8", newline="\n")


def _table(kind: str, functions: dict[str, str]) -> str:
    return "{" + ", ".join(f"{name!a}: {kind}_{own}" for name, own in functions.items()) + "}"


def _functions(link: Link, own: str) -> str:
    """The function of the force, and that of the rates of a link with memory."""
    law, values = link.law, link.values
    names = identifiers((*law.variables[2:], *law.coefficients), _RESERVED) | {"d": "d", "v": "v"}
    variables = ["d", "v", *(names[key] for key in law.variables[2:])]
    keywords = [f"{names[key]}={values[key]!r}" for key in law.coefficients]
    arguments = ", ".join([*variables, *(["*", *keywords] if keywords else [])])
    arrays = "".join(f"    {name} = np.asarray({name}, dtype=float)\n" for name in variables)
    force = (
        f'@np.errstate(all="ignore")\ndef force_{own}({arguments}):\n'
        f"    {_docstring(f'{to_text(law.expression)}, in {law.force_unit}.')}\n{arrays}"
        f"    return {to_code(law.expression, NUMPY, names)} + 0.0*d*v\n"
    )
    if not law.states:
        return force
    rates = ", ".join(to_code(rate.expression, NUMPY, names) for rate in law.rates)
    states = ", ".join(law.states)
    return (
        f'{force}\n\n@np.errstate(all="ignore")\ndef rates_{own}({arguments}):\n'
        f"    {_docstring(f'Rates of {states}.')}\n{arrays}    return ({rates},)\n"
    )


def _docstring(text: str) -> str:
    """The docstring that reads as `text`, whatever that holds."""
    escaped = text.replace("\\", r"\\").replace('"', r"\"")
    seen = (char if char.isprintable() or char == "\n" else ascii(char)[1:-1] for char in escaped)
    return f'"""{"".join(seen)}"""'


_EQUATIONS = """Equations of motion z' = f(t, z, u; p) of a structure, exported by linkwise {version}.

rhs(t, z, u, p) is f, jacobian its derivatives by z, input_jacobian those by u. z has the states named by STATES, (D,) or
(D, N), in UNITS; u the inputs named by INPUTS, an array or a function of t, all 0 where it is not given; p the parameters by
name.

    from scipy.integrate import solve_ivp
    solve_ivp(rhs, (0.0, 1.0), INITIAL, method='DOP853', rtol=1e-10, atol=1e-12, args=(u,))

{notes}
"""
_EQUATIONS_HEAD = """{docstring}

import numpy as np

NAME = {name}
STATES = {states}
INPUTS = {inputs}
UNITS = {units}
INITIAL = np.array({initial})
PARAMETERS = {parameters}


def _inputs(t, u):
    if u is None:
        return [0.0] * len(INPUTS)
    return u(t) if callable(u) else u
"""


def write_equations(equations: EquationsOfMotion, path: Path, name: str) -> None:
    """Write the module of the equations; `name` is not needed in it."""
    names = equations.identifiers(_RESERVED)
    notes = "\n".join(equations.notes) or "Every law is smooth."
    head = _EQUATIONS_HEAD.format(
        docstring=_docstring(_EQUATIONS.format(version=equations.answer.version, notes=notes)),
        name=ascii(equations.structure.name),
        states=ascii(list(equations.states)),
        inputs=ascii(list(equations.inputs)),
        units=ascii({**equations.states, **equations.inputs, **equations.units}),
        initial=equations.initial,
        parameters=ascii(equations.parameters),
    )
    functions = [_function(equations, names, *function) for function in equations.functions]
    path.write_text("\n\n".join([head, *functions]), encoding="utf-8", newline="\n")


_NOTATION = Notation(
    NUMPY,
    "    {}",
    lambda array, place: f"{array}[{', '.join(map(str, place))}]",
    lambda text: f"    # {on_one_line(text)}",
)


def _function(
    equations: EquationsOfMotion, names: dict[str, str], own: str, assignments: Assignments, columns: int
) -> str:
    needed = (key for key in equations.parameters if key in assignments.inputs)
    arrays = {name: entries for name, entries in equations.arrays.items() if name != "p"}
    shape = (len(equations.states),) if own == "rhs" else (len(equations.states), columns)
    lines = [
        f'@np.errstate(all="ignore")\ndef {own}(t, z, u=None, p=PARAMETERS):',
        "    z, u = np.asarray(z, dtype=float), _inputs(t, u)",
        f"    result = np.zeros({shape} + z.shape[1:])",
        *(f"    {names[key]} = p[{key!a}]" for key in needed),
        *_NOTATION.lines(assignments, arrays, names, "    result"),
        "    return result\n",
    ]
    return "\n".join(lines)
