"""Names and values of coefficients and masses: known, known to within, or unknown with an optional start and bounds."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import Any, TypeVar

import msgspec

from linkwise.display import near_miss
from linkwise.errors import LinkwiseError, StructureError, expect, located
from linkwise.model.toml import decode, joined
from linkwise.units import to_si

Text = TypeVar("Text", bound=str)  # of mappings by name, whose keys may be texts or read already
MASS = "mass"
SHAPE = "shape."
"""What the names of shapes in their mode begin with; the name of the point follows."""


def by_constructor(whole: Any) -> tuple[type[Any], tuple[Any, ...]]:
    """What pickles a frozen dataclass by its constructor, of which tables that nobody may change are part."""
    values = (getattr(whole, member.name) for member in fields(whole))
    return type(whole), tuple(dict(v) if isinstance(v, MappingProxyType) else v for v in values)


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
        hint = near_miss(name, indices)
        raise StructureError(f'unknown {kind} "{name}"{hint}; the {kinds} are {quoted(indices)}')
    return indices[name]


def quoted(names: Iterable[str]) -> str:
    """The names in quotes; of a long list the middle is left out."""
    listed = [f'"{name}"' for name in names]
    shown = listed if len(listed) <= 12 else [*listed[:10], "...", listed[-1]]
    return ", ".join(shown) if shown else "none"


@dataclass(frozen=True)
class Coefficient:
    """A coefficient of a law, or a mass, in SI units; use the constructors `number`, `unknown` and `shared`.

    Parameters
    ----------
    value : float or None
        The number if `known`, else the start value of the search; None for no start value.
    known : bool
        Whether the coefficient is known.
    lower, upper : float, optional
        Bounds of an unknown.
    same_as : Name, optional
        Full name of another coefficient, such as ``"nes1.alpha"``, that this one is equal to. In a `Structure` the other
        fields repeat those of that coefficient.
    sigma : float, optional
        Standard deviation of a Gaussian prior about the start value of an unknown, in SI units; infinite for none.

    Raises
    ------
    StructureError
        If the value is not a finite number, or the bounds exclude it.

    Examples
    --------
    >>> import linkwise as lw
    >>> lw.Coefficient.number(30000.0).known
    True
    >>> lw.Coefficient.unknown(0.02, lower=0.0).lower
    0.0
    >>> lw.Coefficient.unknown(0.01, sigma=1e-4).sigma
    0.0001
    """

    value: float | None
    known: bool
    lower: float = -math.inf
    upper: float = math.inf
    same_as: Name | None = None
    sigma: float = math.inf

    @staticmethod
    def number(value: float) -> Coefficient:
        """A known coefficient.

        Parameters
        ----------
        value : float
            The number in SI units.

        Returns
        -------
        Coefficient
            The coefficient.
        """
        return Coefficient(value, known=True)

    @staticmethod
    def unknown(
        start: float | None = None,
        *,
        lower: float = -math.inf,
        upper: float = math.inf,
        sigma: float = math.inf,
    ) -> Coefficient:
        """A coefficient to be identified.

        Parameters
        ----------
        start : float, optional
            Start value of the search in SI units.
        lower, upper : float, optional
            Bounds in SI units.
        sigma : float, optional
            Standard deviation in SI units to which the start value is known beforehand: a Gaussian prior.

        Returns
        -------
        Coefficient
            The coefficient.
        """
        return Coefficient(start, known=False, lower=lower, upper=upper, sigma=sigma)

    @staticmethod
    def shared(same_as: str) -> Coefficient:
        """A coefficient that is equal to another one.

        Parameters
        ----------
        same_as : str
            Full name of the other coefficient, such as ``"nes1.alpha"``.

        Returns
        -------
        Coefficient
            The coefficient.
        """
        return Coefficient(None, known=False, same_as=Name.parse(same_as))

    def __post_init__(self) -> None:
        expect("coefficient: known", self.known, bool)
        for field in ("value", "lower", "upper", "sigma"):
            given = getattr(self, field)
            if given is None and field == "value":
                continue
            object.__setattr__(self, field, _number(given, field))
        if self.value is not None and not math.isfinite(self.value):
            raise StructureError(f"a coefficient must be a finite number, got {self.value!r}")
        if self.known and self.value is None and self.same_as is None:
            advice = 'write "unknown" if it is to be identified'
            raise StructureError(f"a known coefficient needs a value; {advice}")
        if not self.sigma > 0.0:
            raise StructureError(
                f"the standard deviation sigma must be positive, got {self.sigma!r}; write a number for a known coefficient"
            )
        if self.sigma < math.inf and (self.known or self.value is None):
            raise StructureError(
                "a coefficient that is known to within sigma needs a start, its most likely value, and is not a known number"
            )
        if not self.lower < self.upper:
            upper = f"the upper bound {self.upper!r}"
            raise StructureError(f"the lower bound {self.lower!r} must be below {upper}")
        if self.value is not None and not self.lower <= self.value <= self.upper:
            role = "value" if self.known else "start"
            message = f"the {role} {self.value!r} is outside the bounds {self.lower!r} to {self.upper!r}; change one of them"
            raise StructureError(message)

    def __repr__(self) -> str:
        if self.same_as is not None:
            return f"Coefficient.shared({str(self.same_as)!r})"
        if self.known:
            return f"Coefficient.number({self.value!r})"
        stated = (("lower", self.lower), ("upper", self.upper), ("sigma", self.sigma))
        parts = [] if self.value is None else [repr(self.value)]
        parts += [f"{name}={value!r}" for name, value in stated if math.isfinite(value)]
        return f"Coefficient.unknown({', '.join(parts)})"

    @property
    def plain(self) -> float | str | dict[str, float]:
        """What a structure file states: a number, "=NAME" of another one, "unknown", or a table of what is known."""
        if self.same_as is not None:
            return f"={self.same_as}"
        if self.known and self.value is not None:
            return self.value
        stated = {"start": self.value, "lower": self.lower, "upper": self.upper, "sigma": self.sigma}
        table = {key: own for key, own in stated.items() if own is not None and math.isfinite(own)}
        return table or "unknown"

    def freed(self) -> Coefficient:
        """This coefficient as an unknown without value, start or prior; bounds and sharing are kept.

        Returns
        -------
        Coefficient
            The unknown.
        """
        return Coefficient(None, known=False, lower=self.lower, upper=self.upper, same_as=self.same_as)


class _UnknownTable(msgspec.Struct, forbid_unknown_fields=True):
    """An unknown with start value, bounds and standard deviation, in SI units or as text with a unit."""

    start: float | str | None = None
    lower: float | str | None = None
    upper: float | str | None = None
    sigma: float | str | None = None


def as_coefficient(given: Coefficient | float | str, where: str, unit: str | None = None) -> Coefficient:
    """A coefficient, known where a plain number is given; `where` names one that is not finite.

    Where its SI unit is stated a text is one too, as in a structure file: "30 kN/m", "unknown", "=nes1.alpha".
    """
    expect(where, given, Coefficient, float, *(() if unit is None else (str,)))
    if isinstance(given, Coefficient):
        return given
    if isinstance(given, str):
        return coefficient_of(given, unit or "", "", where)
    with located(where):
        return Coefficient.number(given)


def coefficient_of(given: object, unit: str, source: str, path: str) -> Coefficient:
    """The coefficient for a value of the file, in SI units `unit`."""
    try:
        if isinstance(given, dict):
            decode(given, _UnknownTable, source, path, StructureError)
            numbers = {key: _si(value, unit) for key, value in given.items() if key != "sigma"}
            if (sigma := given.get("sigma")) is not None:
                of_start = "start" in given and str(sigma).rstrip().endswith("%")
                part = 0.01 * percentage(sigma) if of_start else 1.0
                numbers["sigma"] = part * abs(numbers["start"]) if of_start else _si(sigma, unit)
            return Coefficient.unknown(**numbers)
        if isinstance(given, str):
            if given.strip() == "unknown":
                return Coefficient.unknown()
            if given.startswith("="):
                return Coefficient.shared(given[1:].strip())
        if isinstance(given, str | int | float) and not isinstance(given, bool):
            return Coefficient.number(_si(given, unit))
    except StructureError as error:
        raise StructureError(error.message, error.where or joined(source, path)) from None
    raise StructureError(
        f'expected a number, a text such as "unknown", "30 kN/m" or "=link.coefficient", or a table of start, lower, upper, '
        f"sigma; got {given!r}",
        joined(source, path),
    )


def percentage(text: str, where: str = "") -> float:
    """The number of a percentage such as "2 %". Raises StructureError with the place `where`."""
    number, percent, rest = text.partition("%")
    try:
        return float(number if percent and not rest.strip() else "")
    except ValueError:
        raise StructureError(f'expected a percentage, such as "2 %", got {text!r}', where) from None


def _si(given: float | str, unit: str) -> float:
    """A number unchanged, a text converted to `unit`."""
    if not isinstance(given, str):
        return given
    try:
        return float(to_si(given, unit))
    except LinkwiseError as error:
        hint = near_miss(given.strip().lower(), ["unknown"])
        raise StructureError(f"{error}{hint}") from None


def _number(given: object, field: str) -> float:
    """`given` as a float that is not NaN."""
    try:
        number = math.nan if isinstance(given, bool) else float(given)  # type: ignore[arg-type]  # refused below
    except (TypeError, ValueError):
        number = math.nan
    except OverflowError:
        number = math.inf
    if math.isnan(number):
        raise StructureError(f"the {field} of a coefficient must be a number, got {given!r}")
    return number
