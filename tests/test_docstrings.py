"""Every public name is documented in numpydoc sections, with examples, and every public member of a public class too."""

import ast
import inspect
import re
import textwrap
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from functools import cached_property
from typing import Any

from public import public


def undocumented(rate: float) -> float:
    """A function of one line."""
    return rate


CALLABLE = [(name, value) for name, value in public() if callable(value)]


def sections(value: object) -> dict[str, list[str]]:
    """The lines of each section of a docstring, by heading."""
    lines = (inspect.getdoc(value) or "").splitlines()
    lines_by_heading: dict[str, list[str]] = {"": []}
    heading = ""
    for number, line in enumerate(lines):
        underline = lines[number + 1] if number + 1 < len(lines) else ""
        if line and underline == "-" * len(line):
            heading = line
            lines_by_heading[heading] = []
        else:
            lines_by_heading[heading].append(line)
    return lines_by_heading


def described(documented: dict[str, list[str]], *headings: str) -> set[str]:
    """The names that sections describe: "lower, upper : float" are two."""
    entries = [
        line for heading in headings for line in documented.get(heading, []) if re.match(r"[\w*]", line)
    ]
    return {name.strip().lstrip("*") for entry in entries for name in entry.partition(" : ")[0].split(",")}


def untyped(documented: dict[str, list[str]]) -> list[str]:
    """Entries of parameters that do not say what type they have; keywords that are handed on have none."""
    lines = documented.get("Parameters", [])
    return [line for line in lines if re.match(r"\w", line) and " : " not in line]


def raises(function: Callable[..., object]) -> bool:
    """Whether the body of a function raises an exception that it makes."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    return any(isinstance(node, ast.Raise) and node.exc is not None for node in ast.walk(tree))


def lacking(function: Callable[..., object], *, example: bool) -> list[str]:
    """What the docstring of a function lacks."""
    public, function = inspect.signature(function), inspect.unwrap(function)
    documented = sections(function)
    if not any(documented[""]):
        return ["summary"]
    named = described(documented, "Parameters")
    parameters = [name for name in public.parameters if name not in ("self", "cls")]
    gives = public.return_annotation not in (None, "None")
    return [
        *(f"parameter {name}" for name in parameters if name not in named),
        *(f"type of {entry}" for entry in untyped(documented)),
        *(["Returns"] if gives and not {"Returns", "Yields"} & documented.keys() else []),
        *(["Raises"] if raises(function) and "Raises" not in documented else []),
        *(["Examples"] if example and "Examples" not in documented else []),
    ]


def members(owner: type) -> Iterator[tuple[str, object]]:
    """The public methods and properties of a class and of those of linkwise that it extends."""
    for base in (base for base in owner.__mro__ if base.__module__.partition(".")[0] != "builtins"):
        if base.__module__.partition(".")[0] == owner.__module__.partition(".")[0]:
            yield from ((name, value) for name, value in vars(base).items() if not name.startswith("_"))


def gaps(name: str, value: Any) -> Iterator[str]:
    """What the docstrings of a public name and of its members lack."""
    if not isinstance(value, type):
        yield from (f"{name}: {gap}" for gap in lacking(value, example=True))
        return
    documented = sections(value)
    if value.__doc__ is None or value.__doc__.startswith(f"{value.__name__}("):  # what dataclass writes
        yield f"{name}: summary"
        return
    if "Examples" not in documented:
        yield f"{name}: Examples"
    named = described(documented, "Parameters", "Attributes")
    yield from (f"{name}: type of {entry}" for entry in untyped(documented))
    field_names = [field.name for field in fields(value)] if is_dataclass(value) else []
    yield from (
        f"{name}: field {field_name}"
        for field_name in field_names
        if not field_name.startswith("_") and field_name not in named
    )
    for member, kind in members(value):
        function = getattr(kind, "__func__", kind)  # of a class method
        if isinstance(kind, property | cached_property):
            if not inspect.getdoc(kind):
                yield f"{name}.{member}: summary"
        elif inspect.isfunction(function):
            own = inspect.getdoc(getattr(value, member))  # a method that overrides one may take its docstring
            if not own:
                yield f"{name}.{member}: summary"
            elif function.__doc__:
                yield from (f"{name}.{member}: {gap}" for gap in lacking(function, example=False))


def test_every_public_name_is_documented() -> None:
    assert len(CALLABLE) > 150
    assert [gap for name, value in CALLABLE for gap in gaps(name, value)] == []


def test_the_walk_sees_what_it_must_refuse() -> None:
    assert list(gaps("f", undocumented)) == ["f: parameter rate", "f: Returns", "f: Examples"]
