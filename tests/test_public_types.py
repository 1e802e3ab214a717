"""Every linkwise type that a public function returns or a public attribute holds is public itself."""

import inspect
from collections.abc import Iterator
from typing import Any, Literal, get_args, get_origin, get_type_hints

import pytest
from public import public

import linkwise as lw

LATE = {"Structure": lw.Structure}  # what a module imports for type checkers alone


def classes(annotation: object) -> Iterator[type]:
    """All classes in a type: `list[Unlisted | None]` has three."""
    parts = annotation if isinstance(annotation, list | tuple) else get_args(annotation)
    if get_origin(annotation) is not Literal:
        for part in (get_origin(annotation), getattr(annotation, "__bound__", None), *parts):
            yield from classes(part) if part is not None else ()
    if isinstance(annotation, type):
        yield annotation


def returned(function: Any) -> Iterator[type]:
    """The classes in what a function returns."""
    yield from classes(get_type_hints(inspect.unwrap(function), localns=LATE).get("return"))


def attribute_types(owner: type) -> Iterator[tuple[str, type]]:
    """The public attributes of a class, inherited ones included, and the classes in what they give."""
    for name, annotation in get_type_hints(owner, localns=LATE).items():
        yield from ((name, kind) for kind in classes(annotation) if not name.startswith("_"))
    for base in owner.__mro__:
        for name, value in vars(base).items():
            getter = next(
                (part for key in ("fget", "func", "__func__") if (part := getattr(value, key, None))), value
            )
            if (
                not name.startswith("_")
                and inspect.isfunction(getter)
                and base.__module__.partition(".")[0] in ("linkwise", owner.__module__.partition(".")[0])
            ):
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
