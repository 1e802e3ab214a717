"""Modules that load on first use, so that a command pays only for what it touches.

The names of a package do so by PEP 562 (`lazy_names`); `lazy_module` and `LazyFunction` are for what has no such door and most
runs never need. All are used at module level, so that the imports of a file are still all at its top.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
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


@dataclass(frozen=True)
class LazyFunction:
    """Stands for a function of a module; the first call imports it. It can be pickled, as the function can."""

    module: str
    name: str

    def __call__(self, *arguments: Any, **keywords: Any) -> Any:
        """Call the function."""
        return getattr(import_module(self.module), self.name)(*arguments, **keywords)


def lazy_names(package: str, homes: Mapping[str, Sequence[str]]) -> Callable[[str], object]:
    """A `__getattr__` for `package` that imports each name from its module on first use.

    `homes` are the names by module, relative to the package. Raises AttributeError, as Python does, for any other name.
    """
    home = {name: place for place, names in homes.items() for name in names}

    def load(name: str) -> object:
        if name not in home:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(f"{package}.{home[name]}"), name)
        setattr(import_module(package), name, value)
        return value

    return load
