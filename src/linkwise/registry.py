"""Tables of named things that can be extended, and names and modules that load on first use, so that a command pays only
for what it touches.

The names of a package do so by PEP 562 (`lazy_names`); `lazy_module` is for what has no such door and most runs never
need. Both are used at module level, so that the imports of a file are still all at its top.
"""

from __future__ import annotations

from collections import UserDict
from collections.abc import Callable, Mapping
from importlib import import_module
from pkgutil import resolve_name
from typing import Any, TypeVar, cast, final

from linkwise.display import near_miss
from linkwise.errors import LinkwiseError

T = TypeVar("T")


@final
class Registry(UserDict[str, T]):
    """Things of one `kind` by name, in the order in which they were registered.

    An entry is the thing itself or a text "package.module:attribute" ("package.module" for a module), which is imported when
    the entry is asked for: names can be listed without loading anything. `error` is what `lookup` raises for a name that is
    not there.

    >>> shapes = Registry("window", {"hann": 0.5})
    >>> shapes.lookup("hamming")
    Traceback (most recent call last):
    linkwise.errors.LinkwiseError: unknown window 'hamming'; choose from 'hann'
    """

    def __init__(
        self, kind: str, entries: Mapping[str, T | str], error: type[LinkwiseError] = LinkwiseError
    ) -> None:
        self.kind, self.error, self.data = kind, error, cast(dict[str, T], dict(entries))

    def lookup(self, name: str) -> T:
        """The entry of that name; raises `error`, which lists those there are."""
        if name in self:
            return self[name]
        choices = ", ".join(map(repr, self))
        raise self.error(f"unknown {self.kind} {name!r}{near_miss(name, self)}; choose from {choices}")

    def __getitem__(self, name: str) -> T:
        entry = self.data[name]
        if isinstance(entry, str):
            entry = self.data[name] = cast(T, resolve_name(entry))
        return entry


class _LazyModule:
    """Stands for a module, which is imported when an attribute is asked of it; keeps none, since one may be replaced."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        return getattr(import_module(self._name), attribute)


def lazy_module(name: str) -> Any:
    """The module of this full dotted name, imported when an attribute of it is first read."""
    return _LazyModule(name)


def lazy_names(package: str, stub: str) -> tuple[list[str], Callable[[str], object], Callable[[], list[str]]]:
    """The `__all__`, `__getattr__` and `__dir__` of `package`, which import each name from its module on first use.

    `stub` is the path of the file for type checkers that lists the names, see `listed_names`. AttributeError is raised, as
    Python does, for any other name.
    """
    homes = listed_names(stub)

    def load(name: str) -> object:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        if homes[name] == package:  # a package inside it
            return import_module(f"{package}.{name}")
        value = getattr(import_module(homes[name]), name)
        setattr(import_module(package), name, value)
        return value

    return sorted(homes), load, lambda: sorted(homes)


def listed_names(stub: str) -> dict[str, str]:
    """The module of each name that a file for type checkers exports, by lines `from MODULE import NAME as NAME`."""
    with open(stub, encoding="utf-8") as file:
        exports = [line.split() for line in file if " as " in line and line.startswith("from ")]
    return {name: module for _, module, _, name, *_ in exports}
