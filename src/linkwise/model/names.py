"""Names of coefficients, masses and links: lookup with suggestions, prefixes and uniqueness."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import TypeVar

from linkwise.display import near_miss
from linkwise.errors import StructureError

Text = TypeVar("Text", bound=str)  # of mappings by name, whose keys may be texts or read already
MASS = "mass"
SHAPE = "shape."
"""What the names of shapes in their mode begin with; the name of the point follows."""


class Name(str):
    """The full name of a coefficient, a text that is equal to any other of the same characters, in its two parts.

    Parameters
    ----------
    owner : str
        The link, mass or mode.
    key : str
        Its name there: that in the law, "mass", or "shape." and a point.

    Examples
    --------
    >>> import linkwise as lw
    >>> name = lw.bnes_chain(2).unknown("nes").parameters[0].name
    >>> name, name.owner, name.key
    ('nes1.alpha', 'nes1', 'alpha')
    """

    __slots__ = ("key", "owner")
    owner: str
    key: str

    def __new__(cls, owner: str, key: str) -> Name:
        name = super().__new__(cls, f"{owner}.{key}" if owner else key)
        object.__setattr__(name, "owner", owner)
        object.__setattr__(name, "key", key)
        return name

    def __reduce__(self) -> tuple[type[Name], tuple[str, str]]:
        return Name, (self.owner, self.key)

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"the {name} of a name cannot be changed")

    @classmethod
    def parse(cls, text: str) -> Name:
        """Read a full name.

        Parameters
        ----------
        text : str
            OWNER.KEY, such as "nes1.alpha" or "wing.mode1.shape.tip".

        Returns
        -------
        Name
            The name; of a text without a dot one without an owner.
        """
        if isinstance(text, Name):
            return text
        owner, _, point = text.partition(f".{SHAPE}")
        return cls(owner, f"{SHAPE}{point}") if point else cls(*text.rpartition(".")[::2])

    @property
    def is_shape(self) -> bool:
        """Whether it is that of the shape of a mode at a point of its host."""
        return self.key.startswith(SHAPE)


def matching(names: Iterable[str], typed: str) -> list[str]:
    """`typed` alone if it is one of the names, else all names that begin with it."""
    names = list(names)
    return [typed] if typed in names else [name for name in names if typed and name.startswith(typed)]


def check_unique(names: tuple[str, ...], kind: str) -> None:
    for name, count in Counter(names).items():
        if count > 1:
            raise StructureError(f"the name is used {count} times; names must be unique", f'{kind} "{name}"')


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
