"""The public names: those of linkwise and of the packages among them."""

from collections.abc import Iterator
from types import ModuleType
from typing import Any

import linkwise as lw

PACKAGES = [value for name in lw.__all__ if isinstance(value := getattr(lw, name), ModuleType)]


def public(module: ModuleType = lw, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Public names and their values, those of a public package as `plot.force`."""
    for name in module.__all__:
        value = getattr(module, name)
        if isinstance(value, ModuleType):
            yield from public(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value
