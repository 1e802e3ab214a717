"""A term that a law may lack without a sign in the records, and what it would make of a coefficient; damping of hosts, too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from linkwise.model.host_damping import in_words, is_between_modes
from linkwise.model.parameters import MASS

_TOLD = 3  # coefficients, or masses; the others are listed
_OF_TERMS = "larger amplitudes, a longer record or less noise tell whether they lack such a term"
_OF_MASSES = (
    "weigh these masses to better than that, or state how well they are known, as { start = 0.01, sigma = 1e-4 }, which the "
    "intervals then include"
)


@dataclass(frozen=True)
class UnseenTerm:
    """A term that records of exact laws bound so loosely that it could move a coefficient out of its interval.

    Damping between two modes of a host that the host does not have is such a term as well, and so is the force of inertia of a
    mass that is off the stated one.

    Attributes
    ----------
    link : str
        The link whose law may lack it; of damping between modes the one that would hold it, as ``"wing.mode1+mode2"``, and
        the mass where that may be off.
    term : str
        Its form, such as ``"d**5"``; ``"v"`` of damping between modes, ``"mass"`` of a mass.
    share : float
        The largest part of the force in the link, by root mean squares, that it could make: the end of its 95 % interval that
        is farther from zero. Of damping between modes, the part of the largest that dissipates in every motion, the
        geometric mean of the damping of the two modes. Of a mass, the part of it by which it may be off, at most a fifth.
    coefficient : str
        The coefficient that a term of this size would change most, counted in standard errors.
    change : float
        That change if the term is added to the law, in the unit of the coefficient, to first order.
    standard_errors : float
        Its size in standard errors of the coefficient.
    relative_change : float
        Its size relative to the coefficient.

    Examples
    --------
    >>> import linkwise as lw
    >>> term = lw.UnseenTerm("s", "d**5", 0.004, "s.k3", change=-1.2e4, standard_errors=6.1, relative_change=0.03)
    >>> print(term.description)
    a force like d**5 in s of up to 0.4 % of the force there, which would change s.k3 by 3 % or 6.1 of its standard errors
    """

    link: str
    term: str
    share: float
    coefficient: str
    change: float
    standard_errors: float
    relative_change: float

    @property
    def description(self) -> str:
        """In words, with its sizes."""
        part = f"of up to {100.0 * self.share:.2g} %"
        change = (
            f"would change {self.coefficient} by {100.0 * self.relative_change:.2g} % or "
            f"{self.standard_errors:.2g} of its standard errors"
        )
        if self.is_mass:
            return f"a mass of {self.link} that is off by up to {100.0 * self.share:.2g} %, which {change}"
        term = f"a force like {self.term} in {self.link} {part} of the force there"
        if is_between_modes(self.link):
            term = f"damping {in_words(self.link)} {part} of the largest that dissipates"
        return f"{term}, which {change}"

    @property
    def is_mass(self) -> bool:
        """Whether it is an error of a stated mass."""
        return self.term == MASS

    def to_dict(self) -> dict[str, str | float]:
        """What result.json holds of it.

        Returns
        -------
        dict
            Its part of result.json.
        """
        return {
            "link": self.link,
            "term": self.term,
            "share_percent": 100.0 * self.share,
            "coefficient": self.coefficient,
            "change": self.change,
            "standard_errors": self.standard_errors,
            "message": self.description,
        }


def unseen_remark(terms: Sequence[UnseenTerm]) -> tuple[str, ...]:
    """What is told of `unseen_terms`: a sentence on terms, and one on masses; nothing without any."""
    masses = [term for term in terms if term.is_mass]
    return (
        *_remark([term for term in terms if not term.is_mass], "laws", "terms", _OF_TERMS),
        *_remark(masses, "masses", "masses", _OF_MASSES),
    )


def _remark(terms: Sequence[UnseenTerm], stated: str, kind: str, advice: str) -> tuple[str, ...]:
    """A sentence on the first ones that move different coefficients, or of different masses; none without any."""
    of_each: dict[str, UnseenTerm] = {}
    for term in terms:
        of_each.setdefault(term.link if term.is_mass else term.coefficient, term)
    if not terms:
        return ()
    first = list(of_each.values())[:_TOLD]
    more = f" In all, {len(terms)} such {kind} are listed in the result." if len(terms) > len(first) else ""
    return (
        f"The records do not rule out {'; '.join(term.description for term in first)}. The intervals hold for the {stated} as "
        f"stated: {advice}.{more}",
    )
