"""Physical dimensions: what is left of a unit when its size is taken away."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import final


@final
@dataclass(frozen=True, slots=True)
class Dimension:
    """Exponents of kilogram, metre, second, ampere and radian; `str` is the SI unit, in newtons wherever a mass takes part.

    >>> str(NEWTON / METRE**3), str(NEWTON * SECOND / METRE), str(KILOGRAM), str(NONE)
    ('N/m^3', 'N s/m', 'kg', '')
    >>> str(VOLT / AMPERE), str(NEWTON / VOLT), str(NEWTON / AMPERE)
    ('ohm', 'N/V', 'N/A')
    >>> str(NEWTON * METRE / RADIAN**3), str(RADIAN / SECOND)
    ('N m/rad^3', 'rad/s')
    """

    kilogram: Fraction
    metre: Fraction
    second: Fraction
    ampere: Fraction = Fraction(0)
    radian: Fraction = Fraction(0)

    def __mul__(self, other: Dimension) -> Dimension:
        return Dimension(
            self.kilogram + other.kilogram,
            self.metre + other.metre,
            self.second + other.second,
            self.ampere + other.ampere,
            self.radian + other.radian,
        )

    def __truediv__(self, other: Dimension) -> Dimension:
        return self * other**-1

    def __pow__(self, exponent: int | Fraction) -> Dimension:
        return Dimension(
            self.kilogram * exponent,
            self.metre * exponent,
            self.second * exponent,
            self.ampere * exponent,
            self.radian * exponent,
        )

    def __str__(self) -> str:
        if self in NAMED:
            return NAMED[self]
        spellings = [self._spelled("A", AMPERE)]
        if self.ampere:
            spellings.append(self._spelled("V", VOLT))
        return min(spellings, key=len)

    def _spelled(self, name: str, electrical: Dimension) -> str:
        """The unit in newton, metre, second and one electrical unit."""
        share = self.ampere / electrical.ampere
        rest = self / electrical**share
        newton = rest.kilogram  # N = kg m / s^2
        exponents = {
            "N": newton,
            "m": rest.metre - newton,
            "rad": rest.radian,
            "s": rest.second + 2 * newton,
            name: share,
        }
        over = [_raised(unit, exponent) for unit, exponent in exponents.items() if exponent > 0]
        under = [_raised(unit, -exponent) for unit, exponent in exponents.items() if exponent < 0]
        if not under:
            return " ".join(over)
        below = under[0] if len(under) == 1 else f"({' '.join(under)})"
        return f"{' '.join(over) or '1'}/{below}"


def _raised(name: str, exponent: Fraction) -> str:
    if exponent == 1:
        return name
    return f"{name}^{exponent}" if exponent.denominator == 1 else f"{name}^({exponent})"


def _dimension(kilogram: int, metre: int, second: int, ampere: int = 0) -> Dimension:
    return Dimension(Fraction(kilogram), Fraction(metre), Fraction(second), Fraction(ampere))


NONE = _dimension(0, 0, 0)
KILOGRAM = _dimension(1, 0, 0)
METRE = _dimension(0, 1, 0)
SECOND = _dimension(0, 0, 1)
AMPERE = _dimension(0, 0, 0, 1)
RADIAN = Dimension(*map(Fraction, (0, 0, 0, 0, 1)))
METRE_PER_SECOND = METRE / SECOND
NEWTON = KILOGRAM * METRE / SECOND**2
VOLT = NEWTON * METRE / SECOND / AMPERE
NAMED = {
    KILOGRAM: "kg", NEWTON: "N", METRE: "m", AMPERE: "A", VOLT: "V", VOLT / AMPERE: "ohm", AMPERE * SECOND / VOLT: "F",
    VOLT * SECOND / AMPERE: "H",
}  # fmt: skip
"""Units with a name of one word."""
