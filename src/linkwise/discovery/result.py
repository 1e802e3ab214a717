"""The result of a discovery: a structure, and the evidence for every term kept and every candidate dropped."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import nan
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from linkwise.arrays import Floats
from linkwise.discovery.memory_evidence import MemoryEvidence
from linkwise.discovery.model_average import ModelAverage
from linkwise.discovery.other_models import PathPoint, RunnerUp
from linkwise.discovery.terms import Term
from linkwise.display import JudgedView, as_text
from linkwise.estimates.causes import Cause
from linkwise.estimates.estimate import Estimate
from linkwise.model.structure import Structure
from linkwise.verdict import Decision, Verdict

#: Rise of the criterion, on the scale of -2 log likelihood, that makes a decision certain: the odds are exp(5) to 1 or better,
#: "very strong" evidence.
CERTAIN = 10.0

_SMALL, _SMALL_DAMPER = 0.01, 0.001  # of the force of a link: terms below them are as good as absent


@dataclass(frozen=True)
class TermEvidence:
    """The evidence for one candidate term.

    Attributes
    ----------
    name : str
        The name of its coefficient, "m2-m1.k3".
    link : str
        The name of its link, "m2-m1".
    between : tuple of str
        The ends of the link.
    term : str
        The function of d and v, "d**3".
    unit : str
        The SI unit of the coefficient.
    kept : bool
        Whether the term is part of the discovered structure.
    identifiable : bool
        Whether the record determines the coefficient beside the terms kept.
    unambiguous : bool
        False where the fit is not to be trusted, where an exchange of this term for or with another one, or for an error of a
        stated value, raises the criterion by less than `CERTAIN`, or where an end of its link moved so much like another mass
        that the link may be that one's.
    value : float
        The coefficient, of a dropped term the one it would have if it were added.
    standard_error : float
        Its standard error, in `unit`; of a term kept one that allows for the terms dropped from the links found.
    z : float
        `value` over its standard error beside the terms kept alone, on which the selection was based.
    margin : float
        By how much the criterion rises if the decision is reversed.
    possible_share : float
        Of a term dropped from a link: the part of the force of the link, by root mean squares, that the far end of its 95 %
        interval would have; 0 for others.

    References
    ----------
    R. E. Kass and A. E. Raftery, "Bayes factors", J. Am. Stat. Assoc. 90 (1995), for the scale of `margin`.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=2.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> discovery = lw.discover(record, {"m1": 1.0, "m2": 0.01})
    >>> term = discovery.kept[0]
    >>> term.decision is lw.discovery.Decision.CERTAIN, term.z**2 > term.penalty
    (True, True)
    """

    name: str
    link: str
    between: tuple[str, str]
    term: str
    unit: str
    kept: bool
    identifiable: bool
    unambiguous: bool
    value: float
    standard_error: float
    z: float
    margin: float
    possible_share: float = 0.0

    @property
    def decision(self) -> Decision:
        """How firm the decision to keep or drop the term is by this record."""
        if not self.identifiable:
            return Decision.NOT_IDENTIFIABLE
        firm = self.unambiguous and self.margin > CERTAIN and not self.may_matter
        return Decision.CERTAIN if firm else Decision.DOUBTFUL

    @property
    def may_matter(self) -> bool:
        """Whether the term was dropped from a link and could be there with a force that matters, unseen.

        That is 1 % of the force of the link, or 0.1 % where the term depends on v: a small damper alone stops the motion.
        """
        limit = _SMALL if Term(self.term, "a").elastic else _SMALL_DAMPER
        return self.possible_share > limit

    @property
    def certain(self) -> bool:
        """Whether the decision is certain by this record."""
        return self.decision is Decision.CERTAIN

    @property
    def penalty(self) -> float:
        """The penalty on the term in the criterion: a term is kept if z**2 exceeds it."""
        return self.z**2 - self.margin if self.kept else self.z**2 + self.margin


@dataclass(frozen=True, eq=False)
class Discovery(JudgedView):
    """The result of `discover`; printed, a table of links and the evidence for their terms.

    Attributes
    ----------
    estimate : Estimate
        The discovered structure with intervals. They are wider than those of `identify`, since each term that was dropped
        from a link found may be there as large as the record lets it.
    terms : tuple of TermEvidence
        Every candidate that was tested by likelihood: those kept, the most certain first, then those dropped, the least
        certain first. Values are those on which the selection was based; a model error may change those of `estimate`.
    path : tuple of PathPoint
        The criterion against the number of terms.
    runners_up : tuple of RunnerUp
        The next best models, best first.
    average : ModelAverage
        The models that survive beside the selected one, with weights.
    remarks : tuple of str
        Sentences on what the records cannot show.
    verdicts : tuple of Verdict
        Those of the estimate and of the search.
    rounds : int
        Rounds of fit and selection.
    seconds : float
        Computing time in s.
    memory : tuple of MemoryEvidence
        The evidence for the law with memory of the link that has one, and for others that explain the records as well; empty
        where no link has memory.
    untested : tuple of str
        The names of the candidates that were dropped without a test by likelihood, since they were significant in the equation
        of neither of their masses; of more than 12 masses only.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=2.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> discovery = lw.discover(record, {"m1": 1.0, "m2": 0.01})
    >>> discovery.trusted
    True
    >>> [(term.name, term.term) for term in sorted(discovery.kept, key=lambda term: term.name)]
    [('m1-ground.c', 'v'), ('m1-ground.k', 'd'), ('m2-m1.c', 'v'), ('m2-m1.k', 'd'), ('m2-m1.k3', 'd**3')]
    >>> discovery.decision("m2-m1")
    <Decision.CERTAIN: 'certain'>
    """

    estimate: Estimate
    terms: tuple[TermEvidence, ...]
    path: tuple[PathPoint, ...]
    runners_up: tuple[RunnerUp, ...]
    average: ModelAverage
    remarks: tuple[str, ...]
    verdicts: tuple[Verdict, ...]
    rounds: int
    seconds: float
    memory: tuple[MemoryEvidence, ...] = ()
    untested: tuple[str, ...] = ()

    @property
    def diagnosis(self) -> tuple[Cause, ...]:
        """What would explain what the laws leave, as that of `estimate`."""
        return self.estimate.diagnosis

    @property
    def structure(self) -> Structure:
        """The discovered structure, every coefficient a number."""
        return self.estimate.structure

    @cached_property
    def kept(self) -> tuple[TermEvidence, ...]:
        """The terms that were kept, the most certain first."""
        return tuple(term for term in self.terms if term.kept)

    @cached_property
    def doubtful(self) -> tuple[TermEvidence, ...]:
        """The candidates, kept or dropped, whose decision is not certain, the least certain first."""
        return tuple(sorted((term for term in self.terms if not term.certain), key=lambda term: term.margin))

    @cached_property
    def in_doubt(self) -> tuple[str, ...]:
        """The discovered links, stated ones aside, without a certain term: other links may be there instead."""
        return tuple(
            dict.fromkeys(term.link for term in self.kept if self.decision(term.link) is not Decision.CERTAIN)
        )

    @cached_property
    def inclusion(self) -> dict[str, float]:
        """The probability that each term tested is there, by name, among the terms on offer; NaN if it is not identifiable."""
        probabilities = self.average.probabilities
        return {term.name: probabilities[term.name] if term.identifiable else nan for term in self.terms}

    def force_band(self, link: str, d: ArrayLike, *, averaged: bool = True) -> tuple[Floats, Floats, Floats]:
        """Stiffness force of a link with its 95 % band, averaged over the models that survive, or of the selected one.

        Parameters
        ----------
        link : str
            Name of the link.
        d : array_like
            Elongations in m.
        averaged : bool, default True
            Average over the models. That band is wider where they differ; that of the selected model allows for each term
            that was dropped from the link as large as the record lets it be, however improbable.

        Returns
        -------
        force, lower, upper : array of the shape of `d`
            Force and ends of the band in N; NaN ends where no interval can be trusted.

        Raises
        ------
        StructureError
            If there is no such link.
        """
        estimate, elongations = self.estimate.link(link), np.asarray(d, dtype=float)
        if not averaged:
            return estimate.force_band(elongations)
        return self.average.force_band(estimate, elongations)

    def decision(self, link: str) -> Decision:
        """How firm it is that a link is there: certain if it was stated, or one of its terms is certain.

        Parameters
        ----------
        link : str
            Name of the link.

        Returns
        -------
        Decision
            `Decision.CERTAIN` or `Decision.DOUBTFUL`.

        Raises
        ------
        StructureError
            If there is no such link.
        """
        tested = {term.name: term.certain for term in self.kept}
        tested |= {name: law.certain for law in self.memory for name in law.coefficients}
        names = (f"{link}.{name}" for name in self.structure.link(link).coefficients)
        return Decision.CERTAIN if any(tested.get(name, True) for name in names) else Decision.DOUBTFUL

    def certainty(self, link: str) -> float:
        """By how much the criterion rises without the most certain term of a link.

        Parameters
        ----------
        link : str
            Name of the link.

        Returns
        -------
        float
            On the scale of -2 log likelihood (no unit); infinite if the link was stated.

        Raises
        ------
        StructureError
            If there is no such link.
        """
        margins = {term.name: term.margin for term in self.kept}
        margins |= {name: law.margin for law in self.memory for name in law.coefficients}
        return max(
            (margins.get(f"{link}.{name}", float("inf")) for name in self.structure.link(link).coefficients),
            default=float("inf"),
        )

    def __str__(self) -> str:
        return as_text(self)

    def to_dict(self) -> dict[str, Any]:
        """The result as plain data: that of the estimate, and the evidence.

        Returns
        -------
        dict
            The content of result.json: that of `Estimate.to_dict`, and "terms", "path", "runners_up", "memory",
            "untested" and "remarks".
        """
        return {
            **self.estimate.to_dict(),
            "seconds": self.seconds,
            "remarks": list(self.remarks),
            "links_in_doubt": list(self.in_doubt),
            **self._judgement(),
            "settled": Verdict.SEARCH_UNSETTLED not in self.verdicts,
            "seen": Verdict.DISPLACEMENTS_INTEGRATED not in self.verdicts,
            "exact": Verdict.TERMS_MAY_BE_MISSING not in self.verdicts,
            "terms": [{**_as_dict(term), "inclusion": self.inclusion[term.name]} for term in self.terms],
            "models": [
                {"terms": list(terms), "weight": float(weight)}
                for terms, weight in zip(self.average.models, self.average.weights, strict=True)
            ],
            "path": [
                {
                    "terms": point.terms,
                    "cost": point.cost,
                    "criterion": point.criterion,
                    "step": point.step,
                    "chosen": point.chosen,
                    "prediction": point.prediction,
                    "scatter": point.scatter,
                    "share": point.share,
                }
                for point in self.path
            ],
            "runners_up": [{"change": model.change, "margin": model.margin} for model in self.runners_up],
            "memory": [law.to_dict() for law in self.memory],
            "untested": list(self.untested),
        }


def _as_dict(term: TermEvidence) -> dict[str, Any]:
    return {
        "name": term.name,
        "between": list(term.between),
        "term": term.term,
        "kept": term.kept,
        "reliable": term.unambiguous,
        "certain": term.certain,
        "told": term.identifiable,
        "possible_share": term.possible_share,
        "decision": term.decision.value,
        "value": term.value,
        "standard_error": term.standard_error,
        "unit": term.unit,
        "z": term.z,
        "margin": term.margin,
    }
