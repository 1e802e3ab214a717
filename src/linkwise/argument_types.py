"""The types of the main arguments of public functions: what has another type, or is swapped, is told at the door."""

from __future__ import annotations

from pathlib import Path

from linkwise.text import shortened

_MAKERS = {  # of texts
    "Record": "read_record(path) reads one from a file",
    "Structure": "read_structure(path) reads one from a file",
    "Law": "Law.parse(text) makes one of a text",
    "Coefficient": "Coefficient.unknown() makes one to be identified",
}


def check_type(call: str, argument: str, value: object, *types: type) -> None:
    """TypeError unless the value is of one of the types; `call` shows their order, as "validate(record, answer)"."""
    if isinstance(value, types):
        return
    names = [kind.__name__ for kind in types]
    expected = " or ".join(filter(None, [", ".join(names[:-1]), names[-1]]))
    if isinstance(value, str | Path):
        given = shortened(repr(value)) + "".join([f"; {_MAKERS[name]}" for name in names if name in _MAKERS])
    elif isinstance(value, int | float):
        given = repr(value) + ("; Coefficient.number(value) makes one" if names == ["Coefficient"] else "")
    else:
        given = getattr(value, "__name__", type(value).__name__)
    raise TypeError(f"{call}: {argument} must be of type {expected}, got {given}")
