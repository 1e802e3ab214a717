"""Names of masses and links: lookup with suggestions, prefixes and uniqueness."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import TypeVar

from linkwise.display import near_miss
from linkwise.errors import StructureError


def matching(names: Iterable[str], typed: str) -> list[str]:
    """`typed` alone if it is one of the names, else all names that begin with it."""
    names = list(names)
    return [typed] if typed in names else [name for name in names if typed and name.startswith(typed)]


def check_unique(names: tuple[str, ...], kind: str) -> None:
    repeated = [name for name, count in Counter(names).items() if count > 1]
    if repeated:
        count = names.count(repeated[0])
        raise StructureError(
            f"the name is used {count} times; names must be unique", f'{kind} "{repeated[0]}"'
        )


Value = TypeVar("Value")


def index_of(indices: Mapping[str, Value], name: str, kind: str, kinds: str) -> Value:
    """What stands under a name; raises StructureError with all names where there is none."""
    if name not in indices:
        raise StructureError(
            f'unknown {kind} "{name}"{near_miss(name, indices)}; the {kinds} are {quoted(indices)}'
        )
    return indices[name]


def quoted(names: Iterable[str]) -> str:
    """The names in quotes; of a long list the middle is left out."""
    listed = [f'"{name}"' for name in names]
    shown = listed if len(listed) <= 12 else [*listed[:10], "...", listed[-1]]
    return ", ".join(shown) if shown else "none"
