"""Structures as TOML files, in and out; reading what was written gives the same structure, to the last bit.

A coefficient (or a mass) is a number, a string with a unit ("30 kN/m"), "unknown", a table of `start`, `lower`, `upper` for an
unknown one, or "=link.coefficient" for one that is shared.
"""

from __future__ import annotations

import math
import re
import tomllib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import msgspec

from linkwise.errors import LinkwiseError, StructureError
from linkwise.model.coefficient import Coefficient
from linkwise.model.law import Law
from linkwise.model.link import Link, Mass, near_miss
from linkwise.model.parameters import KILOGRAM
from linkwise.model.structure import Structure
from linkwise.units import to_si

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")
_ESCAPES = {'"': '\\"', "\\": "\\\\", "\b": "\\b", "\t": "\\t", "\n": "\\n", "\f": "\\f", "\r": "\\r"}


class _Start(msgspec.Struct, forbid_unknown_fields=True):
    """An unknown with start and bounds, in SI or as text with a unit."""

    start: float | str | None = None
    lower: float | str | None = None
    upper: float | str | None = None


class _Mass(msgspec.Struct, forbid_unknown_fields=True):
    name: str
    mass: float | str | dict[str, Any]


class _Link(msgspec.Struct, forbid_unknown_fields=True):
    name: str
    between: list[str]
    law: str
    coefficients: dict[str, Any] = {}


class _Document(msgspec.Struct, forbid_unknown_fields=True):
    mass: list[_Mass]
    link: list[_Link]
    name: str = ""


class _Known(_Document, forbid_unknown_fields=True):
    link: list[_Link] = []


@dataclass(frozen=True)
class Known:
    """What is known of a structure: its masses, and some of its links, which need not hold them all."""

    masses: tuple[Mass, ...]
    links: tuple[Link, ...]


def read_structure(path: str | Path) -> Structure:
    """The structure in a TOML file. Raises StructureError with file, and line or key, for whatever is wrong in it."""
    return parse_structure(_text(path), str(path))


def read_known(path: str | Path) -> Known:
    """What a TOML file states of a structure that is to be discovered: as `read_structure`, but links may be missing."""
    document = _document(_text(path), _Known, str(path))
    return Known(*_parts(document, str(path)))


def _text(path: str | Path) -> str:
    try:
        return Path(path).read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise StructureError("there is no such file", str(path)) from None
    except UnicodeDecodeError as error:
        raise StructureError(
            f"it is not UTF-8 text (byte {error.start}); save it as UTF-8", str(path)
        ) from None
    except OSError as error:
        raise StructureError(f"it cannot be read: {error.strerror}", str(path)) from None


def write_structure(structure: Structure, path: str | Path) -> None:
    """Write `structure` as TOML; `read_structure` gives it back equal."""
    Path(path).write_text(format_structure(structure), encoding="utf-8", newline="\n")


def parse_structure(text: str, source: str = "structure") -> Structure:
    """The structure in a TOML text; `source` is what errors call it."""
    document = _document(text, _Document, source)
    masses, links = _parts(document, source)
    try:
        return Structure(document.name, masses, links)
    except StructureError as error:
        raise StructureError(error.message, _join(source, error.where)) from None


def _document(text: str, kind: type[_Document], source: str) -> Any:
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        reason, _, place = str(error).partition(" (at ")
        where = f"{source}, {place.rstrip(')')}" if place else source
        raise StructureError(f"this is no TOML: {reason[:1].lower()}{reason[1:]}", where) from None
    return _decode(data, kind, source, "")


def _parts(document: _Document, source: str) -> tuple[tuple[Mass, ...], tuple[Link, ...]]:
    masses = tuple(_mass(entry, index, source) for index, entry in enumerate(document.mass))
    links = tuple(_link(entry, index, source) for index, entry in enumerate(document.link))
    return masses, links


def format_structure(structure: Structure) -> str:
    """The TOML text of a structure."""
    blocks = [f"name = {_string(structure.name)}\n"]
    for mass in structure.masses:
        blocks.append(f"[[mass]]\nname = {_string(mass.name)}\nmass = {_coefficient_text(mass.mass)}\n")
    for link in structure.links:
        pairs = ", ".join(
            f"{_key(name)} = {_coefficient_text(value)}" for name, value in link.coefficients.items()
        )
        ends = ", ".join(_string(end) for end in link.between)
        blocks.append(
            f"[[link]]\nname = {_string(link.name)}\nbetween = [{ends}]\n"
            f"law = {_string(link.law.text)}\ncoefficients = {{ {pairs} }}\n"
        )
    return "\n".join(blocks)


def _mass(entry: _Mass, index: int, source: str) -> Mass:
    path = f"mass[{index}]"
    where = f'{source}, {path} "{entry.name}"'
    coefficient = _coefficient(entry.mass, KILOGRAM, source, f"{path}.mass")
    try:
        return Mass(entry.name, coefficient)
    except StructureError as error:
        raise StructureError(error.message, where) from None


def _link(entry: _Link, index: int, source: str) -> Link:
    path = f"link[{index}]"
    where = f'{source}, {path} "{entry.name}"'
    try:
        law = _law(entry.law)
        units = law.units
    except LinkwiseError as error:
        raise StructureError(f"its law cannot be used: {error}", where) from None
    coefficients = {
        name: _coefficient(given, units.get(name, ""), source, f"{path}.coefficients.{name}")
        for name, given in entry.coefficients.items()
    }
    try:
        return Link(entry.name, (*entry.between,), law, coefficients)  # type: ignore[arg-type]  # Link counts the ends
    except StructureError as error:
        raise StructureError(error.message, where) from None


@lru_cache(maxsize=256)
def _law(text: str) -> Law:
    """One law for all links that name it: a thousand sinks are parsed once."""
    return Law.parse(text)


def _coefficient(given: object, unit: str, source: str, path: str) -> Coefficient:
    """The coefficient that a value in the file stands for."""
    try:
        if isinstance(given, dict):
            table = _decode(given, _Start, source, path)
            start = None if table.start is None else _si(table.start, unit)
            lower = -math.inf if table.lower is None else _si(table.lower, unit)
            upper = math.inf if table.upper is None else _si(table.upper, unit)
            return Coefficient.unknown(start, lower=lower, upper=upper)
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
        f'expected a number, a text such as "unknown", "30 kN/m" or "=link.coefficient", or a table of start, lower, upper; '
        f"got {given!r}",
        f"{source}, {path}",
    )


def _si(given: float | str, unit: str) -> float:
    """A number as it is, a text converted to `unit`."""
    if not isinstance(given, str):
        return given
    try:
        return float(to_si(given, unit))
    except LinkwiseError as error:
        hint = near_miss(given.strip().lower(), ["unknown"])
        raise StructureError(f"{error}{hint}") from None


def _decode(data: object, kind: type[Any], source: str, path: str) -> Any:
    """`data` as `kind`; StructureError with the path of the key that does not fit."""
    try:
        return msgspec.convert(data, kind, strict=True)
    except msgspec.ValidationError as error:
        reason, _, place = str(error).partition(" - at `$")
        place = f"{path}{place.rstrip('`')}".lstrip(".")
        unexpected = re.search(r"unknown field `(.*)`", reason)
        if unexpected:
            owner = (
                {"": _Document, "mass": _Mass, "link": _Link}.get(place.partition("[")[0], _Start)
                if not path
                else _Start
            )
            fields = owner.__struct_fields__
            reason = f'there is no key "{unexpected[1]}"{near_miss(unexpected[1], fields)}; the keys are {", ".join(fields)}'
        missing = re.search(r"required field `(.*)`", reason)
        if missing:
            reason = f"the key `{missing[1]}` is missing"
        raise StructureError(reason[:1].lower() + reason[1:], _join(source, place)) from None


def _join(source: str, place: str) -> str:
    return f"{source}, {place}" if place else source


def _coefficient_text(coefficient: Coefficient) -> str:
    if coefficient.same_as is not None:
        return _string(f"={coefficient.same_as}")
    if coefficient.known:
        return repr(coefficient.value)
    fields = {
        "start": coefficient.value,
        "lower": coefficient.lower if coefficient.lower > -math.inf else None,
        "upper": coefficient.upper if coefficient.upper < math.inf else None,
    }
    pairs = [f"{name} = {value!r}" for name, value in fields.items() if value is not None]
    return f"{{ {', '.join(pairs)} }}" if pairs else '"unknown"'


def _key(name: str) -> str:
    return name if _BARE_KEY.fullmatch(name) else _string(name)


def _string(text: str) -> str:
    """A TOML basic string: quotes, backslashes and control characters escaped, everything else as it is."""
    escaped = "".join(
        _ESCAPES.get(character)
        or (f"\\u{ord(character):04X}" if ord(character) < 32 or ord(character) == 127 else character)
        for character in text
    )
    return f'"{escaped}"'
