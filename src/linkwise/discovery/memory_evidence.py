"""The evidence that a link has memory, and for the law of it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from linkwise.verdict import Decision

#: Rise of the criterion that makes the decision certain, as that for a term.
_CERTAIN = 10.0


@dataclass(frozen=True)
class MemoryEvidence:
    """The evidence that a link has memory, by a named law.

    Margins are on the scale of -2 log likelihood. A fit that stops before it converges, since it leaves too much, gives a
    lower bound of one.

    Attributes
    ----------
    link : str
        The name of the link, "m2-m1".
    between : tuple of str
        Its ends.
    law : str
        The name of the law, "bouc-wen".
    kept : bool
        Whether the discovered structure has this law; the others explain the records as well.
    coefficients : tuple of str
        The names of the coefficients of the part with memory, "m2-m1.F".
    over_links : float
        By how much the criterion rises if the best other link has memory in its place; infinite if there is no other.
    over_laws : float
        By how much it rises with the best other law on this link; infinite if no other was tried, below zero for a law that
        was not kept.
    over_none : float
        By how much it rises if no link has memory, whatever usual forms of d and v this link has in place of it.
    unambiguous : bool
        Whether the fit can be trusted.

    References
    ----------
    R. E. Kass and A. E. Raftery, "Bayes factors", J. Am. Stat. Assoc. 90 (1995), for the scale of the margins.

    Examples
    --------
    >>> import linkwise as lw
    >>> evidence = lw.discovery.MemoryEvidence(
    ...     "m1-ground", ("m1", "ground"), "dahl", True, ("m1-ground.Fc",), 250.0, 3.0, 120.0, True
    ... )
    >>> evidence.decision is lw.discovery.Decision.CERTAIN, evidence.law_certain
    (True, False)
    """

    link: str
    between: tuple[str, str]
    law: str
    kept: bool
    coefficients: tuple[str, ...]
    over_links: float
    over_laws: float
    over_none: float
    unambiguous: bool

    @property
    def decision(self) -> Decision:
        """How firm it is that this link has memory, whatever the law."""
        firm = self.unambiguous and min(self.over_links, self.over_none) > _CERTAIN
        return Decision.CERTAIN if firm else Decision.DOUBTFUL

    @property
    def certain(self) -> bool:
        """Whether it is certain that this link has memory."""
        return self.decision is Decision.CERTAIN

    @property
    def law_certain(self) -> bool:
        """Whether no other law that was tried explains the records as well."""
        return self.certain and self.over_laws > _CERTAIN

    @property
    def margin(self) -> float:
        """The least of the margins over other links and over no memory."""
        return min(self.over_links, self.over_none)

    def to_dict(self) -> dict[str, Any]:
        """The evidence as plain data.

        Returns
        -------
        dict
            The attributes, and "decision".
        """
        plain = asdict(self)
        plain["between"], plain["coefficients"] = list(self.between), list(self.coefficients)
        return {**plain, "decision": self.decision.value, "law_certain": self.law_certain}
