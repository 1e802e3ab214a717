"""A link of a structure file: its table, decoded strictly, and the law, states and coefficients that it says.

A state is the text of its rate, or a table of `rate`, `initial` and `unit`. Where only the units of coefficients give the
unit of a state ("43 nF" that of a voltage), they are read first.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Collection
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin

import msgspec

from linkwise.display import near_miss
from linkwise.errors import LinkwiseError, RecordError, StructureError, StudyError, located
from linkwise.expression.dimensions import Dimension
from linkwise.model.coefficient import Coefficient
from linkwise.model.law import Law, LinkState, law_dimensions, unit_dimension
from linkwise.model.link import Link
from linkwise.model.named_laws import NamedLaw, is_law_name, named_law
from linkwise.units import to_si

Table = TypeVar("Table", bound=msgspec.Struct)
LARGEST = 50_000_000  # bytes: 300 000 masses; a pipe or a device may have no end
FileError = type[StructureError] | type[StudyError] | type[RecordError]


def read_toml_text(path: str | Path, error: FileError) -> str:
    """The text of a UTF-8 file. Raises `error` with the path if it cannot be read."""
    try:
        with Path(path).open("rb") as file:
            content = file.read(LARGEST + 1)
        if len(content) > LARGEST:
            raise error(f"has more than {LARGEST / 1e6:g} MB, more than any such file", str(path))
        return content.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except FileNotFoundError:
        raise error("there is no such file", str(path)) from None
    except UnicodeDecodeError as problem:
        advice = _if_another_file(str(path)) or "; save it as UTF-8"
        raise error(f"is not UTF-8 text (byte {problem.start}){advice}", str(path)) from None
    except OSError as problem:
        raise error(f"cannot be read: {problem.strerror}", str(path)) from None


def parse_toml(text: str, source: str, error: FileError) -> dict[str, Any]:
    """The tables of a TOML text named `source`. Raises `error` with line and column if it is not valid TOML."""
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as problem:  # also of a number too long and of tables too deep
        reason, _, position = str(problem).partition(" (at ")
        message = f"is not valid TOML: {reason[:1].lower()}{reason[1:]}{_if_another_file(source)}"
        raise error(message, _joined(source, position.rstrip(")"))) from None


def toml_text(value: str | int) -> str:
    """A number, or a text as TOML writes it, which for all but DEL is as JSON does."""
    return msgspec.json.encode(value, enc_hook=str).decode().replace("\x7f", "\\u007f")


def _if_another_file(source: str) -> str:
    """What to look at where a file is named as a record is, for a message."""
    if Path(source).suffix.lower() in ("", ".toml"):
        return ""
    return "; a TOML file is expected here: was it exchanged with a record?"


def decode(data: object, kind: type[Table], source: str, path: str, error: FileError) -> Table:
    """`data` of the key `path` as the msgspec Struct `kind`. Raises `error` with the path of a wrong key."""
    _check_keys(data, kind, source, path, error)
    try:
        return msgspec.convert(data, kind, strict=True)
    except msgspec.ValidationError as problem:
        reason, _, place = str(problem).partition(" - at `$")
        message = reason[:1].lower() + reason[1:]
        raise error(message, _joined(source, f"{path}{place.rstrip('`')}".lstrip("."))) from None


def _check_keys(data: object, kind: type[msgspec.Struct], source: str, path: str, error: FileError) -> None:
    """Raise `error` for an unknown or missing key, or a value that is none of the choices, here or in tables below."""
    if not isinstance(data, dict):
        return
    fields = {field.name: field for field in msgspec.structs.fields(kind)}
    for key in data:
        if key not in fields:
            raise error(
                f'unknown key "{key}"{near_miss(str(key), fields)}; the keys are {", ".join(fields)}',
                _joined(source, path),
            )
    for name, field in fields.items():
        place, value, choices = f"{path}.{name}".lstrip("."), data.get(name), get_args(field.type)
        one_of = f"one of {', '.join(choices)}" if get_origin(field.type) is Literal else ""
        if name not in data and field.required:
            raise error(f"the key `{name}` is missing{', ' * bool(one_of)}{one_of}", _joined(source, path))
        if one_of and isinstance(value, str) and value not in choices:
            raise error(
                f"expected {one_of}; got {value!r}{near_miss(value, choices)}", _joined(source, place)
            )
        of_tables = choices and isinstance(choices[0], type) and issubclass(choices[0], msgspec.Struct)
        if get_origin(field.type) is list and isinstance(value, list) and of_tables:
            for index, entry in enumerate(value):
                _check_keys(entry, choices[0], source, f"{place}[{index}]", error)


def _joined(source: str, place: str) -> str:
    return f"{source}, {place}" if place else source


_WITH_UNIT = re.compile(r"\s*[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?\s*[^\W\d].*")


class _UnknownTable(msgspec.Struct, forbid_unknown_fields=True):
    """An unknown with start value, bounds and standard deviation, in SI units or as text with a unit."""

    start: float | str | None = None
    lower: float | str | None = None
    upper: float | str | None = None
    sigma: float | str | None = None


class LinkTable(msgspec.Struct, forbid_unknown_fields=True):
    """A link as written: `states` and `coefficients` are decoded with the law."""

    name: str
    between: list[str]
    law: str
    coefficients: dict[str, Any] = {}
    states: dict[str, Any] = {}


class _StateTable(msgspec.Struct, forbid_unknown_fields=True):
    """A state of a link: its rate, its initial value in SI units or as text with a unit, and its unit."""

    rate: str
    initial: float | str = 0.0
    unit: str = ""


def link_of(entry: LinkTable, index: int, source: str, rotations: Collection[str] = ()) -> Link:
    """The link of entry `index` of the file `source`; at ends of `rotations` coefficients have the units of a moment and rad.

    Raises StructureError with the place of what is wrong.
    """
    path = f"link[{index}]"
    where = f'{source}, {path} "{entry.name}"'
    try:
        named = named_law(entry.law) if is_law_name(entry.law) else None
        states = _states(entry, named, source, path)
        angular = not set(rotations).isdisjoint(entry.between)
        law = _law(named.law if named else entry.law, tuple(states.items()), angular)
        known = {state.name: unit_dimension(state.unit) for state in law.rates if state.unit}
        stated = _stated_units(entry, law)
        open_states = [name for name, unit in law.state_units.items() if unit == "?"] if stated else []
        if open_states:  # the units of coefficients tell them
            inferred = law_dimensions(
                law.text, law.expression, law.rates, {**stated, **known}, angular=angular
            )
            resolved = {
                name: replace(states[name], unit=str(inferred[name]))
                for name in open_states
                if inferred[name]
            }
            states |= resolved
            law = _law(law.text, tuple(states.items()), angular)
        units = law.units
    except LinkwiseError as error:
        if isinstance(error, StructureError) and error.where:
            raise
        raise StructureError(f"invalid law: {error}", where) from None
    coefficients = {name: named.coefficient(name) for name in law.coefficients} if named else {}
    for name, given in entry.coefficients.items():
        place = f"{path}.coefficients.{name}"
        coefficient = coefficient_of(given, units.get(name, ""), source, place)
        with located(f"{source}, {place}"):
            coefficients[name] = named.within_bounds(name, coefficient) if named else coefficient
    for name, state in states.items():
        given = entry.states.get(name)
        initial = given.get("initial", 0.0) if isinstance(given, dict) else 0.0
        value = coefficient_of(initial, law.state_units[name], source, f"{path}.states.{name}.initial")
        states[name] = replace(state, initial=value.value if value.known else None)
    with located(where):
        return Link(entry.name, (*entry.between,), law, coefficients, states)  # type: ignore[arg-type]  # Link counts the ends


def _states(entry: LinkTable, named: NamedLaw | None, source: str, path: str) -> dict[str, LinkState]:
    """The states of a link; initial values are read once their units are known."""
    if named is not None:
        if entry.states:
            raise StructureError(f"the law {entry.law!r} has states of its own: write it out to change them")
        return dict(named.states)
    states: dict[str, LinkState] = {}
    for name, given in entry.states.items():
        place = f"{path}.states.{name}"
        if isinstance(given, dict):
            table = decode(given, _StateTable, source, place, StructureError)
            states[name] = LinkState(table.rate, unit=table.unit)
        elif isinstance(given, str):
            states[name] = LinkState(given)
        else:
            raise StructureError(
                f"expected a rate as text or a table of rate, initial, unit; got {given!r}",
                f"{source}, {place}",
            )
    return states


def _stated_units(entry: LinkTable, law: Law) -> dict[str, Dimension]:
    """Dimensions of the coefficients that are given with a unit."""
    return {
        name: unit_dimension(text)
        for name, given in entry.coefficients.items()
        for text in (given.values() if isinstance(given, dict) else (given,))
        if name in law.coefficients and isinstance(text, str) and _WITH_UNIT.fullmatch(text)
    }


@lru_cache(maxsize=256)
def _law(text: str, states: tuple[tuple[str, LinkState], ...], angular: bool) -> Law:
    """The law of a text, parsed once for all links that have it."""
    law = Law.parse(text, dict(states))
    return replace(law, angular=True) if angular else law


def coefficient_of(given: object, unit: str, source: str, path: str) -> Coefficient:
    """The coefficient for a value of the file, in SI units `unit`."""
    try:
        if isinstance(given, dict):
            decode(given, _UnknownTable, source, path, StructureError)
            numbers = {key: _si(value, unit) for key, value in given.items() if key != "sigma"}
            if (sigma := given.get("sigma")) is not None:
                of_start = "start" in given and str(sigma).rstrip().endswith("%")
                numbers["sigma"] = (
                    0.01 * abs(numbers["start"]) * percentage(sigma) if of_start else _si(sigma, unit)
                )
            return Coefficient.unknown(**numbers)
        if isinstance(given, str):
            if given.strip() == "unknown":
                return Coefficient.unknown()
            if given.startswith("="):
                return Coefficient.shared(given[1:].strip())
        if isinstance(given, str | int | float) and not isinstance(given, bool):
            return Coefficient.number(_si(given, unit))
    except StructureError as error:
        raise StructureError(error.message, error.where or f"{source}, {path}") from None
    raise StructureError(
        f'expected a number, a text such as "unknown", "30 kN/m" or "=link.coefficient", or a table of start, lower, upper, '
        f"sigma; got {given!r}",
        f"{source}, {path}",
    )


def percentage(text: str, where: str = "") -> float:
    """The number of a percentage such as "2 %". Raises StructureError with the place `where`."""
    number, percent, rest = text.partition("%")
    try:
        return float(number if percent and not rest.strip() else "")
    except ValueError:
        raise StructureError(f'expected a percentage, such as "2 %", got {text!r}', where) from None


def _si(given: float | str, unit: str) -> float:
    """A number unchanged, a text converted to `unit`."""
    if not isinstance(given, str):
        return given
    try:
        return float(to_si(given, unit))
    except LinkwiseError as error:
        hint = near_miss(given.strip().lower(), ["unknown"])
        raise StructureError(f"{error}{hint}") from None
