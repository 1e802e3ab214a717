"""Every linkwise type that a public function returns or a public attribute holds is public itself."""

import ast
import inspect
import sys
from collections.abc import Iterator
from functools import cache, cached_property
from importlib import import_module
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import pytest
from public import public


class Unlisted:
    """A type of linkwise's tests that no public name leads to."""


class Leaky:
    """Every way by which a class can hand out a type."""

    field: dict[str, tuple[Unlisted | None, ...]]
    _field: Unlisted

    def method(self) -> list[Unlisted]:
        """A type inside another one."""
        return []

    @property
    def one(self) -> Unlisted:
        """From a property."""
        return Unlisted()

    @cached_property
    def cached(self) -> Unlisted:
        """From a property that is computed once."""
        return Unlisted()

    @classmethod
    def made(cls) -> Unlisted:
        """From a class."""
        return Unlisted()

    def _private(self) -> Unlisted:
        return Unlisted()


def leaky() -> Unlisted | None:
    """A function that hands out a type."""
    return None


@cache
def namespace(module: str) -> dict[str, Any]:
    """The names that annotations of a module use, those that are imported for type checkers only included."""
    file = sys.modules[module].__file__
    nodes = ast.walk(ast.parse(Path(str(file)).read_text(encoding="utf-8")))
    imports = [node for node in nodes if isinstance(node, ast.ImportFrom)]
    names = {
        alias.asname or alias.name: getattr(import_module(str(node.module)), alias.name)
        for node in imports
        for alias in node.names
    }
    return names | vars(sys.modules[module])


def evaluated(annotation: object, module: str) -> object:
    """The type that an annotation means."""
    text = annotation if isinstance(annotation, str) else getattr(annotation, "__forward_arg__", None)
    return annotation if text is None else eval(text, namespace(module))


def classes(annotation: object, module: str) -> Iterator[type]:
    """All classes in a type: `list[Unlisted | None]` has three."""
    annotation = evaluated(annotation, module)
    if isinstance(annotation, list | tuple):  # the arguments of a callable
        for part in annotation:
            yield from classes(part, module)
        return
    if get_origin(annotation) is Literal:
        return
    for part in (get_origin(annotation), getattr(annotation, "__bound__", None), *get_args(annotation)):
        if part is not None:
            yield from classes(part, module)
    if isinstance(annotation, type):
        yield annotation


def returned(function: Any) -> Iterator[type]:
    """The classes in what a function returns."""
    function = inspect.unwrap(function)
    yield from classes(function.__annotations__["return"], function.__module__)


def attribute_types(owner: type) -> Iterator[tuple[str, type]]:
    """The public attributes of a class, inherited ones included, and the classes in what they give."""
    for base in (
        base for base in owner.__mro__ if base.__module__.partition(".")[0] == "linkwise" or base is owner
    ):
        for name, annotation in inspect.get_annotations(base).items():
            if not name.startswith("_"):
                yield from ((name, kind) for kind in classes(annotation, base.__module__))
        for name, value in vars(base).items():
            getter = next(
                (part for key in ("fget", "func", "__func__") if (part := getattr(value, key, None))), value
            )
            if not name.startswith("_") and inspect.isfunction(getter):
                yield from ((name, kind) for kind in returned(getter))


def given(name: str, value: Any) -> Iterator[tuple[str, type]]:
    """Where a public name hands out classes, and which."""
    if isinstance(value, type):
        yield from ((f"{name}.{attribute}", kind) for attribute, kind in attribute_types(value))
    elif inspect.isroutine(value):
        yield from ((name, kind) for kind in returned(value))


def unlisted(names: dict[str, Any], package: str) -> dict[str, set[str]]:
    """The classes of `package` that `names` hand out and do not hold, and where."""
    listed = {value for value in names.values() if isinstance(value, type)}
    leaks: dict[str, set[str]] = {}
    for name, value in names.items():
        for where, kind in given(name, value):
            if kind.__module__.partition(".")[0] == package and kind not in listed:
                leaks.setdefault(f"{kind.__module__}.{kind.__qualname__}", set()).add(where)
    return leaks


@pytest.mark.slow
def test_every_type_that_public_names_hand_out_is_public() -> None:
    names = dict(public())
    assert sum(len(list(given(name, value))) for name, value in names.items()) > 500
    assert unlisted(names, "linkwise") == {}


def test_the_walk_sees_what_it_must_refuse() -> None:
    leaks = unlisted({"Leaky": Leaky, "leaky": leaky}, __name__.partition(".")[0])
    ways = {"Leaky.field", "Leaky.method", "Leaky.one", "Leaky.cached", "Leaky.made", "leaky"}
    assert leaks == {f"{__name__}.Unlisted": ways}
    assert unlisted({"Leaky": Leaky, "leaky": leaky, "Unlisted": Unlisted}, __name__.partition(".")[0]) == {}
