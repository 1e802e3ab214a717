"""Modules that load on first use, so that a command pays only for what it touches.

The names of a package do so by PEP 562 (`lazy_names`); `lazy_module` is for what has no such door and most runs never need.
Both are used at module level, so that the imports of a file are still all at its top.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any


class _LazyModule:
    """Stands for a module; the first attribute asked of it imports it."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        value = getattr(import_module(self._name), attribute)
        setattr(self, attribute, value)
        return value


def lazy_module(name: str) -> Any:
    """The module of this full dotted name, imported when an attribute of it is first read."""
    return _LazyModule(name)


def lazy_names(package: str, stub: str) -> tuple[list[str], Callable[[str], object]]:
    """The `__all__` of `package`, and a `__getattr__` for it that imports each name from its module on first use.

    `stub` is the path of the file for type checkers that lists the names, see `listed_names`. The function raises
    AttributeError, as Python does, for any other name.
    """
    homes = listed_names(stub)

    def load(name: str) -> object:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(homes[name]), name)
        setattr(import_module(package), name, value)
        return value

    return sorted(homes), load


def listed_names(stub: str) -> dict[str, str]:
    """The module of each name that a file for type checkers exports, by lines `from MODULE import NAME as NAME`."""
    with open(stub, encoding="utf-8") as file:
        exports = [line.split() for line in file if " as " in line and line.startswith("from ")]
    return {name: module for _, module, _, name, *_ in exports}
