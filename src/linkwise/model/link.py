"""Masses and the links between them.

A link joins two masses, or a mass and the ground or the moving base. Its elongation is d = x_first - x_second; its law is the
force in N on the first end, sign reversed (METHODS section 1): m_first x'' = -f(d, d') + ...
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import cached_property
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from linkwise.arrays import Floats
from linkwise.errors import StructureError
from linkwise.model.coefficient import Coefficient
from linkwise.model.law import Law

GROUND = "ground"
"""The end of a link that is fixed in space."""
BASE = "base"
"""The end of a link that moves with a recorded or stated base motion."""

_FORBIDDEN = set("[]:=/\\")  # they have a meaning in channel headers, on the command line or in file names


@dataclass(frozen=True)
class Mass:
    """A rigid body that moves along x. `mass` in kg is positive; an unknown one is bounded below by 0."""

    name: str
    mass: Coefficient

    def __post_init__(self) -> None:
        _check_name(self.name, "mass")
        if self.name in (GROUND, BASE):
            raise StructureError(
                f'a mass cannot be named "{self.name}", the name of what links hold on to; choose another',
                "mass",
            )
        value = self.mass.value
        if value is not None and not value > 0.0:
            what = "mass" if self.mass.known else "start of the unknown mass"
            raise StructureError(f"the {what} is {value!r} kg; it must be positive", f'mass "{self.name}"')
        if not self.mass.upper > 0.0:
            raise StructureError(
                f"the upper bound {self.mass.upper!r} kg leaves no positive mass", f'mass "{self.name}"'
            )


@dataclass(frozen=True)
class Link:
    """A force law between two ends.

    `between` names the first and the second end: masses, "ground" or "base". `coefficients` holds one Coefficient for each
    name in the law, in the law's order. Raises StructureError for a coefficient too many or too few and for a link to itself.
    """

    name: str
    between: tuple[str, str]
    law: Law
    coefficients: Mapping[str, Coefficient] = field(hash=False)

    def __post_init__(self) -> None:
        _check_name(self.name, "link")
        where = f'link "{self.name}"'
        object.__setattr__(self, "between", tuple(self.between))
        if len(self.between) != 2:
            raise StructureError(f"`between` names two ends, got {list(self.between)}", where)
        if self.between[0] == self.between[1]:
            raise StructureError(
                f'both ends are "{self.between[0]}": a link to itself exerts no force', where
            )
        if set(self.between) <= {GROUND, BASE}:
            raise StructureError(
                f'"{self.between[0]}" and "{self.between[1]}" are no masses: nothing would move', where
            )
        self._check_coefficients(where)
        ordered = {name: self.coefficients[name] for name in self.law.coefficients}
        object.__setattr__(self, "coefficients", MappingProxyType(ordered))

    def __reduce__(self) -> tuple[type[Link], tuple[str, tuple[str, str], Law, dict[str, Coefficient]]]:
        return Link, (self.name, self.between, self.law, dict(self.coefficients))

    def _check_coefficients(self, where: str) -> None:
        missing = [name for name in self.law.coefficients if name not in self.coefficients]
        if missing:
            lines = ", ".join(f'{name} = "unknown"' for name in missing)
            raise StructureError(
                f"the law {self.law.text} needs {_list(missing)}: add {lines} (or a number) to its coefficients",
                where,
            )
        extra = [name for name in self.coefficients if name not in self.law.coefficients]
        if extra:
            raise StructureError(
                f"coefficient {_list(extra)} is not in the law {self.law.text}, whose coefficients are "
                f"{_list(self.law.coefficients)}{near_miss(extra[0], self.law.coefficients)}",
                where,
            )

    @cached_property
    def values(self) -> dict[str, float]:
        """The number of each coefficient, the start where it is unknown. Raises StructureError where there is neither."""
        values = {}
        for name, coefficient in self.coefficients.items():
            if coefficient.value is None:
                raise StructureError(
                    f"coefficient {name} is unknown and has no start; give it a number, or identify it first",
                    f'link "{self.name}"',
                )
            values[name] = coefficient.value
        return values

    def force(self, d: ArrayLike, v: ArrayLike = 0.0) -> Floats:
        """Force in N at elongation `d` in m and its rate `v` in m/s (shapes broadcast)."""
        return _full(self.law.force(d, v, self.values), d, v)

    def stiffness(self, d: ArrayLike) -> Floats:
        """Slope of the force by d in N/m at rest (v = 0), in the shape of `d`."""
        return self.tangent(d)[0]

    def tangent(self, d: ArrayLike, v: ArrayLike = 0.0) -> tuple[Floats, Floats]:
        """Slopes of the force by d in N/m and by v in N s/m, each in the broadcast shape of `d` and `v`."""
        partials = self.law.partials(d, v, self.values)
        return _full(partials.by_d, d, v), _full(partials.by_v, d, v)

    def potential(self, d: ArrayLike) -> Floats:
        """Energy in J stored in the elastic part f(d, 0) of the law, zero at d = 0, in the shape of `d`."""
        return _full(self.law.potential(d, self.values), d, 0.0)


def _full(values: ArrayLike, d: ArrayLike, v: ArrayLike) -> Floats:
    """`values` in the broadcast shape of `d` and `v`: a constant term gives a number where an array is asked for."""
    return np.array(np.broadcast_to(values, np.broadcast_shapes(np.shape(d), np.shape(v))), dtype=float)


def near_miss(typed: str, names: Iterable[str]) -> str:
    """'; did you mean "x"?' for the name nearest to `typed`, or nothing."""
    near = get_close_matches(typed, list(names), n=1)
    return f'; did you mean "{near[0]}"?' if near else ""


def _list(names: Iterable[str]) -> str:
    return ", ".join(names) or "none"


def _check_name(name: object, kind: str) -> None:
    if not isinstance(name, str) or not name:
        raise StructureError(f"a {kind} needs a name, got {name!r}", kind)
    if name != name.strip() or not name.isprintable() or _FORBIDDEN & set(name):
        raise StructureError(
            f"the name {name!r} cannot be used: no blanks at its ends, no control characters and none of [ ] : = / \\",
            kind,
        )
