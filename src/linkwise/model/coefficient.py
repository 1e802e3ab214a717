"""A coefficient of a law, or a mass: a number that is known, or one that is to be found.

Known or unknown is data on the coefficient; whoever estimates moves what is known aside and never asks again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from linkwise.errors import StructureError


@dataclass(frozen=True)
class Coefficient:
    """One coefficient in SI units.

    `value` is the number when `known`, else the start of its search (None: no start). `lower` and `upper` bound an unknown.
    `same_as` ("nes1.alpha") makes it equal to another coefficient; inside a `Structure` the other fields then repeat those of
    the one it follows. Raises StructureError for a value that is no finite number and for bounds that exclude it.
    """

    value: float | None
    known: bool
    lower: float = -math.inf
    upper: float = math.inf
    same_as: str | None = None

    @staticmethod
    def number(value: float) -> Coefficient:
        """A known coefficient."""
        return Coefficient(value, known=True)

    @staticmethod
    def unknown(
        start: float | None = None, *, lower: float = -math.inf, upper: float = math.inf
    ) -> Coefficient:
        """A coefficient to be identified, from `start` and within the bounds where they are given."""
        return Coefficient(start, known=False, lower=lower, upper=upper)

    @staticmethod
    def shared(same_as: str) -> Coefficient:
        """The coefficient named `same_as`, "link.coefficient", used a second time."""
        return Coefficient(None, known=False, same_as=same_as)

    def __post_init__(self) -> None:
        for field in ("value", "lower", "upper"):
            given = getattr(self, field)
            if given is None and field == "value":
                continue
            object.__setattr__(self, field, _number(given, field))
        if self.value is not None and not math.isfinite(self.value):
            raise StructureError(f"a coefficient must be a finite number, got {self.value!r}")
        if self.known and self.value is None and self.same_as is None:
            raise StructureError(
                'a known coefficient needs a value; write "unknown" if it is to be identified'
            )
        if not self.lower < self.upper:
            raise StructureError(
                f"the lower bound {self.lower!r} must be below the upper bound {self.upper!r}"
            )
        if self.value is not None and not self.lower <= self.value <= self.upper:
            what = "value" if self.known else "start"
            raise StructureError(
                f"the bounds {self.lower!r} to {self.upper!r} exclude the {what} {self.value!r}; widen them or move the {what}"
            )

    def following(self, leader: Coefficient) -> Coefficient:
        """This shared coefficient with the fields of the one that it follows."""
        return Coefficient(leader.value, leader.known, leader.lower, leader.upper, same_as=self.same_as)

    def freed(self) -> Coefficient:
        """The same coefficient as an unknown without value or start; bounds and sharing stay."""
        return Coefficient(None, known=False, lower=self.lower, upper=self.upper, same_as=self.same_as)


def _number(given: object, field: str) -> float:
    """`given` as a float that is not NaN."""
    if isinstance(given, bool):
        raise StructureError(f"the {field} of a coefficient must be a number, got {given!r}")
    try:
        number = float(given)  # type: ignore[arg-type]  # what is no number is refused below
    except (TypeError, ValueError):
        raise StructureError(f"the {field} of a coefficient must be a number, got {given!r}") from None
    except OverflowError:
        raise StructureError(
            f"the {field} of a coefficient must be a finite number, got one too large"
        ) from None
    if math.isnan(number):
        raise StructureError(f"the {field} of a coefficient is NaN (not a number); give a number")
    return number
