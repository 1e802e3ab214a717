"""Physical dimensions: what is left of a unit when its size is taken away."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import final


@final
@dataclass(frozen=True, slots=True)
class Dimension:
    """Exponents of kilogram, metre and second; `str` is the SI unit, in newtons wherever a mass takes part.

    >>> str(NEWTON / METRE**3), str(NEWTON * SECOND / METRE), str(KILOGRAM), str(NONE)
    ('N/m^3', 'N s/m', 'kg', '')
    """

    kilogram: Fraction
    metre: Fraction
    second: Fraction

    def __mul__(self, other: Dimension) -> Dimension:
        return Dimension(self.kilogram + other.kilogram, self.metre + other.metre, self.second + other.second)

    def __truediv__(self, other: Dimension) -> Dimension:
        return self * other**-1

    def __pow__(self, exponent: int | Fraction) -> Dimension:
        return Dimension(self.kilogram * exponent, self.metre * exponent, self.second * exponent)

    def __str__(self) -> str:
        if self == KILOGRAM:
            return "kg"
        newton = self.kilogram  # N = kg m / s^2
        exponents = {"N": newton, "m": self.metre - newton, "s": self.second + 2 * newton}
        over = [_raised(name, exponent) for name, exponent in exponents.items() if exponent > 0]
        under = [_raised(name, -exponent) for name, exponent in exponents.items() if exponent < 0]
        if not under:
            return " ".join(over)
        below = under[0] if len(under) == 1 else f"({' '.join(under)})"
        return f"{' '.join(over) or '1'}/{below}"


def _raised(name: str, exponent: Fraction) -> str:
    if exponent == 1:
        return name
    return f"{name}^{exponent}" if exponent.denominator == 1 else f"{name}^({exponent})"


def _dimension(kilogram: int, metre: int, second: int) -> Dimension:
    return Dimension(Fraction(kilogram), Fraction(metre), Fraction(second))


NONE = _dimension(0, 0, 0)
KILOGRAM = _dimension(1, 0, 0)
METRE = _dimension(0, 1, 0)
SECOND = _dimension(0, 0, 1)
METRE_PER_SECOND = METRE / SECOND
NEWTON = KILOGRAM * METRE / SECOND**2
