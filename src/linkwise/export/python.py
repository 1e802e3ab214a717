"""An answer as a Python module that needs nothing but NumPy."""

from __future__ import annotations

import builtins
import keyword
from pathlib import Path

from linkwise.export.answer import ExportedAnswer, identifiers
from linkwise.expression.tree import NUMPY, to_code, to_text
from linkwise.model.link import Link

_RESERVED = ("d", "v", "np", *keyword.kwlist, *keyword.softkwlist, *dir(builtins))
_DOCSTRING = """Forces of the links of a structure, identified by linkwise {version}.

force_LINK(d, v) is the force f in {force} at the elongation d = x_first - x_second in {d} and its rate v in {v}, numbers
or arrays; -f acts on the first end of the link and f on the second. A link with memory takes its states behind v, and
rates_LINK(d, v, states) are their rates. Coefficients are keywords, so that others can be tried. An end that is a point of
a host moves by its modes, each times its shape in POINTS.{note}
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
    functions = identifiers((link.name for link in answer.structure.links), ())
    every = answer.coefficients
    note = f"\n\n{answer.note}" if answer.note else ""
    head = _HEAD.format(
        docstring=_docstring(_DOCSTRING.format(version=answer.version, note=note, **answer.quantities)),
        name=ascii(answer.structure.name),
        masses=ascii(
            {coefficient.owner: coefficient.value for coefficient in every if coefficient.name == "mass"}
        ),
        points=ascii(answer.points),
        between=ascii({link.name: link.between for link in answer.structure.links}),
        coefficients=ascii({link.name: link.values for link in answer.structure.links}),
        units=ascii(
            {link.name: {key: link.law.units[key] for key in link.values} for link in answer.structure.links}
        ),
        errors=ascii(
            {
                f"{coefficient.owner}.{coefficient.name}": coefficient.error
                for coefficient in every
                if coefficient.error is not None
            }
        ),
        names=ascii(list(answer.names)),
        covariance=ascii(answer.covariance.tolist()),
    )
    texts = [_functions(link, functions[link.name]) for link in answer.structure.links]
    tables = [f"FORCES = {_table('force', functions)}\n"]
    moving = {link.name: functions[link.name] for link in answer.structure.links if link.law.states}
    if moving:
        tables.append(f"RATES = {_table('rates', moving)}\n")
    path.write_text("\n\n".join([head, *texts, "".join(tables)]), encoding="utf-8", newline="\n")


def _table(kind: str, functions: dict[str, str]) -> str:
    return "{" + ", ".join(f"{name!a}: {kind}_{own}" for name, own in functions.items()) + "}"


def _functions(link: Link, own: str) -> str:
    """The function of the force, and that of the rates of a link with memory."""
    law, values = link.law, link.values
    names = identifiers((*law.states, *law.coefficients), _RESERVED) | {"d": "d", "v": "v"}
    variables = ["d", "v", *(names[state] for state in law.states)]
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
    seen = "".join(
        letter if letter.isprintable() or letter == "\n" else ascii(letter)[1:-1] for letter in escaped
    )
    return f'"""{seen}"""'
