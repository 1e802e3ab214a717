"""Coefficients of laws, and masses: known numbers, known to within, or unknowns with an optional start and bounds."""

from __future__ import annotations

import math
from dataclasses import dataclass

from linkwise.errors import StructureError, expect, located
from linkwise.model.names import Name


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
            raise StructureError(
                'a known coefficient needs a value; write "unknown" if it is to be identified'
            )
        if not self.sigma > 0.0:
            raise StructureError(
                f"the standard deviation sigma must be positive, got {self.sigma!r}; write a number for a known coefficient"
            )
        if self.sigma < math.inf and (self.known or self.value is None):
            raise StructureError(
                "a coefficient that is known to within sigma needs a start, its most likely value, and is not a known number"
            )
        if not self.lower < self.upper:
            raise StructureError(
                f"the lower bound {self.lower!r} must be below the upper bound {self.upper!r}"
            )
        if self.value is not None and not self.lower <= self.value <= self.upper:
            role = "value" if self.known else "start"
            raise StructureError(
                f"the {role} {self.value!r} is outside the bounds {self.lower!r} to {self.upper!r}; change one of them"
            )

    def following(self, leader: Coefficient) -> Coefficient:
        """This shared coefficient with the fields of the coefficient it is equal to.

        Parameters
        ----------
        leader : Coefficient
            The coefficient it is equal to.

        Returns
        -------
        Coefficient
            The coefficient, still shared.
        """
        return Coefficient(
            leader.value, leader.known, leader.lower, leader.upper, same_as=self.same_as, sigma=leader.sigma
        )

    def freed(self) -> Coefficient:
        """This coefficient as an unknown without value, start or prior; bounds and sharing are kept.

        Returns
        -------
        Coefficient
            The unknown.
        """
        return Coefficient(None, known=False, lower=self.lower, upper=self.upper, same_as=self.same_as)


def as_coefficient(given: Coefficient | float, where: str) -> Coefficient:
    """A coefficient, known where a plain number is given; `where` names one that is not finite."""
    expect(where, given, Coefficient, float)
    if isinstance(given, Coefficient):
        return given
    with located(where):
        return Coefficient.number(given)


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
