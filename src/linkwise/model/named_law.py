"""A law of the literature: its text and states, and what its coefficients mean."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple, final

from linkwise.argument_types import checked_class
from linkwise.model.coefficient import Coefficient, as_coefficient
from linkwise.model.law import Law
from linkwise.model.link import Link
from linkwise.model.link_state import LinkState


class LawText(NamedTuple):
    """A law as text, and the states beside it.

    Attributes
    ----------
    law : str
        The law.
    states : mapping of str to LinkState
        Its states by name; empty for a law without memory.

    Examples
    --------
    >>> import linkwise as lw
    >>> lw.named_law("dahl").text.law
    'q + c*v'
    """

    law: str
    states: Mapping[str, LinkState]


@checked_class
@final
@dataclass(frozen=True, kw_only=True)
class NamedLaw:
    """A law of the literature.

    Parameters
    ----------
    title : str
        What it describes.
    source : str
        Where it comes from.
    coefficients : mapping of str to str
        Meaning of each coefficient.
    formula : LawText or callable
        The law; for a family a function of its number of branches.
    branches : int, optional
        Number of branches by default of a family, such as the sliders of Iwan's law; 0 of a single law.
    bounds : mapping of str to tuple, optional
        Bounds in SI units of coefficients that have some, within which they are searched for.
    wider : str, optional
        The named law that also takes what the bounds of this one exclude; empty where there is none.

    Examples
    --------
    >>> import linkwise as lw
    >>> law = lw.named_law("dahl")
    >>> law.law, law.states["q"].rate
    ('q + c*v', 'sigma*(v - abs(v)*q/Fc)')
    """

    title: str
    source: str
    coefficients: Mapping[str, str]
    formula: LawText | Callable[[int], LawText]
    branches: int = 0
    bounds: Mapping[str, tuple[float, float]] | None = None
    wider: str = ""

    @property
    def text(self) -> LawText:
        """The law and its states."""
        return self.formula if isinstance(self.formula, LawText) else self.formula(self.branches)

    @property
    def law(self) -> str:
        """The law as text."""
        return self.text.law

    @property
    def states(self) -> Mapping[str, LinkState]:
        """The states by name; empty for a law without memory."""
        return self.text.states

    def coefficient(self, name: str) -> Coefficient:
        """The coefficient of that name as an unknown within its bounds.

        Parameters
        ----------
        name : str
            Its name.

        Returns
        -------
        Coefficient
            The unknown.
        """
        return self.within_bounds(name, Coefficient.unknown())

    def within_bounds(self, name: str, given: Coefficient) -> Coefficient:
        """An unknown as it is given, within the bounds of the law where it has none of its own.

        Parameters
        ----------
        name : str
            Its name.
        given : Coefficient
            The coefficient. A number stays as it is, as does one that is equal to another coefficient.

        Returns
        -------
        Coefficient
            The coefficient.

        Raises
        ------
        StructureError
            If a start is outside the bounds.
        """
        lower, upper = (self.bounds or {}).get(name, (-math.inf, math.inf))
        if given.known or given.same_as is not None:
            return given
        return replace(
            given,
            lower=given.lower if given.lower > -math.inf else lower,
            upper=given.upper if given.upper < math.inf else upper,
        )

    def link(
        self,
        name: str,
        between: tuple[str, str],
        coefficients: Mapping[str, Coefficient | float] | None = None,
    ) -> Link:
        """A link with this law.

        Parameters
        ----------
        name : str
            Name of the link.
        between : tuple of two str
            Its ends.
        coefficients : mapping of str to Coefficient or float, optional
            Coefficients, within the bounds of the law where they have none; a number is known, and the others are unknown.

        Returns
        -------
        Link
            The link.

        Raises
        ------
        StructureError
            As of `Link`.

        Examples
        --------
        >>> import linkwise as lw
        >>> link = lw.named_law("jenkins").link("joint", ("m1", "ground"), {"k": 1e4})
        >>> [name for name, coefficient in link.coefficients.items() if not coefficient.known]
        ['Fs']
        """
        law = Law.parse(self.law, self.states)
        given = {key: self.coefficient(key) for key in law.coefficients}
        given |= {
            key: self.within_bounds(key, as_coefficient(coefficient, f'link "{name}", coefficient {key}'))
            for key, coefficient in (coefficients or {}).items()
        }
        return Link(name, between, law, given, self.states)
