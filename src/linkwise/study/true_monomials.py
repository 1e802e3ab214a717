"""The equations of motion of a structure written out in monomials of the states, to compare a monomial model with."""

from __future__ import annotations

from linkwise.errors import IdentificationError
from linkwise.expression import Expression, Number, Symbol, add, multiply, polynomial, substitute
from linkwise.model.law_text import VARIABLES
from linkwise.model.link import BASE, GROUND, Link
from linkwise.model.structure import Structure
from linkwise.sindy.monomials import tags

_ROUNDING = 1e-9  # of the largest coefficient of an equation: what cancels but for rounding


def true_monomials(structure: Structure) -> set[tuple[str, str]]:
    """The monomials with a coefficient that is not 0, each beside its equation: ("x1''", "x1**2*v2").

    Parameters
    ----------
    structure : Structure
        Masses on links without memory, every coefficient a number.

    Returns
    -------
    set of (str, str)
        Equations and columns by the names that `monomial_equations` gives them. Applied forces are none of them.

    Raises
    ------
    IdentificationError
        If a law is not a polynomial.
    """
    names = dict(zip(structure.mass_names, tags(structure.mass_names), strict=True))
    ends = {**names, BASE: "b"}
    variables = tuple(f"{kind}{tag}" for tag in (*names.values(), "b") for kind in "xv")
    monomials: set[tuple[str, str]] = set()
    for mass, tag in names.items():
        forces = [_force(link, mass, ends) for link in structure.links if mass in link.between]
        terms = polynomial(add(*forces), variables) if forces else {}
        if terms is None:
            raise IdentificationError(
                f"a law of a link of {mass} is not a polynomial in d and v, so no monomials represent it; use the library "
                '"links"'
            )
        sizes = {key: abs(value.value) for key, value in terms.items() if isinstance(value, Number)}
        least = _ROUNDING * max(sizes.values(), default=0.0)
        monomials |= {(f"x{tag}''", _name(variables, key)) for key, size in sizes.items() if size > least}
    return monomials


def _force(link: Link, mass: str, ends: dict[str, str]) -> Expression:
    """What a link adds to M x'' of a mass, with its numbers, in the states of its ends."""
    numbers: dict[str, Expression] = {name: Number(value) for name, value in link.values.items()}
    elongations = {
        variable: add(*(part for part in _signed(link, kind, ends)))
        for variable, kind in zip(VARIABLES, "xv", strict=True)
    }
    sign = Number(-1.0 if mass == link.between[0] else 1.0)
    return multiply(sign, substitute(substitute(link.law.expression, numbers), elongations))


def _signed(link: Link, kind: str, ends: dict[str, str]) -> list[Expression]:
    """The states, "x" or "v", of the ends of a link, the first less the second; the ground has none."""
    return [
        multiply(Number(sign), Symbol(f"{kind}{ends[end]}"))
        for sign, end in zip((1.0, -1.0), link.between, strict=True)
        if end != GROUND
    ]


def _name(variables: tuple[str, ...], exponents: tuple[int, ...]) -> str:
    factors = [
        name + (f"**{exponent}" if exponent > 1 else "")
        for name, exponent in zip(variables, exponents, strict=True)
        if exponent
    ]
    return "*".join(factors) or "1"
