"""TOML texts of users: read, parsed, and decoded strictly, with the line or the key of what is wrong."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin

import msgspec

from linkwise.display import near_miss
from linkwise.errors import RecordError, StructureError, StudyError

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
        raise error(message, joined(source, position.rstrip(")"))) from None


_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


def toml_text(value: Any) -> str:
    """A number, a text, a list or a table as TOML writes it on one line."""
    match value:
        case dict():
            keys = ((name if _BARE_KEY.fullmatch(name) else toml_text(name)) for name in value)
            pairs = (f"{key} = {toml_text(own)}" for key, own in zip(keys, value.values(), strict=True))
            return f"{{ {', '.join(pairs)} }}"
        case list():
            return f"[{', '.join(map(toml_text, value))}]"
        case float():
            return repr(float(value))
    # a text as JSON writes it, but for DEL
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
        raise error(message, joined(source, f"{path}{place.rstrip('`')}".lstrip("."))) from None


def _check_keys(data: object, kind: type[msgspec.Struct], source: str, path: str, error: FileError) -> None:
    """Raise `error` for an unknown or missing key, or a value that is none of the choices, here or in tables below."""
    if not isinstance(data, dict):
        return
    fields = {field.name: field for field in msgspec.structs.fields(kind)}
    for key in data:
        if key not in fields:
            message = f'unknown key "{key}"{near_miss(str(key), fields)}; the keys are {", ".join(fields)}'
            raise error(message, joined(source, path))
    for name, field in fields.items():
        place, value, choices = f"{path}.{name}".lstrip("."), data.get(name), get_args(field.type)
        one_of = f"one of {', '.join(choices)}" if get_origin(field.type) is Literal else ""
        if name not in data and field.required:
            raise error(f"the key `{name}` is missing{', ' * bool(one_of)}{one_of}", joined(source, path))
        if one_of and isinstance(value, str) and value not in choices:
            raise error(f"expected {one_of}; got {value!r}{near_miss(value, choices)}", joined(source, place))
        of_tables = choices and isinstance(choices[0], type) and issubclass(choices[0], msgspec.Struct)
        if get_origin(field.type) is list and isinstance(value, list) and of_tables:
            for index, entry in enumerate(value):
                _check_keys(entry, choices[0], source, f"{place}[{index}]", error)


def joined(source: str, place: str) -> str:
    return f"{source}, {place}" if place else source
