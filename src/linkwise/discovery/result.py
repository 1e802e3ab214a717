"""What was discovered: a structure like any other, and the evidence for every term kept and every candidate dropped."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from linkwise.estimates.estimate import Estimate
from linkwise.model.structure import Structure
from linkwise.text import as_text
from linkwise.verdict import Decision, Verdict, is_trusted

CERTAIN = 10.0  # on the criterion: the odds are exp(5) to 1 and better, "very strong" (Kass and Raftery 1995)


@dataclass(frozen=True)
class TermEvidence:
    """A candidate: the `term` ("d**3") of `link`, with the coefficient `name` ("m2-m1.k3"), `kept` or dropped.

    `value` and `standard_error` in `unit` are what was found, or what would be if it were added. `z` is their ratio. `margin`
    is by how much the criterion rises if the decision is turned round: more than `CERTAIN` is very strong. `identifiable` is
    False where the record cannot tell it beside the terms that were kept, `unambiguous` where the fit is not to be trusted,
    where an exchange of this term for or with another costs less than `CERTAIN`, or where an end of its link moved so much
    like another mass that the link may be the other's.
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

    @property
    def decision(self) -> Decision:
        """How firm it is by this record that the term is kept or dropped."""
        if not self.identifiable:
            return Decision.NOT_IDENTIFIABLE
        return Decision.CERTAIN if self.unambiguous and self.margin > CERTAIN else Decision.DOUBTFUL

    @property
    def certain(self) -> bool:
        """Whether the decision is beyond doubt by this record."""
        return self.decision is Decision.CERTAIN

    @property
    def penalty(self) -> float:
        """What the term costs beside its misfit: it belongs into the answer where z**2 is more."""
        return self.z**2 - self.margin if self.kept else self.z**2 + self.margin


@dataclass(frozen=True)
class PathPoint:
    """A point of the path: so many `terms`, their -2 log likelihood (`cost`) above that of the largest model on the path, and
    the `criterion`, cost plus price, above that of the chosen point.

    `step` is what it has beyond, "+ m2-m1.k3", or lacks beside, "- m2-m1.c", the point that is one nearer to the `chosen` one.
    Costs are those of the parabola at the chosen point, exact there and rough far from it.
    """

    terms: int
    cost: float
    criterion: float
    step: str
    chosen: bool


@dataclass(frozen=True)
class RunnerUp:
    """The best model that differs by one step, in words, and how much worse its criterion is."""

    change: str
    margin: float


@dataclass(frozen=True, eq=False)
class Discovery:
    """The answer of `discover`.

    `estimate` holds the discovered structure with all intervals, as `identify` gives them. `terms` lists every candidate that
    was tested by likelihood, the most certain of those kept first, with values as they were when the decision was made (a
    model error then changes those of `estimate`); `path` the cost against the number of terms; `runners_up` the next best
    models, best first. `remarks` say what this record cannot tell. `verdicts` are those of the estimate and of the search.
    """

    estimate: Estimate
    terms: tuple[TermEvidence, ...]
    path: tuple[PathPoint, ...]
    runners_up: tuple[RunnerUp, ...]
    remarks: tuple[str, ...]
    verdicts: tuple[Verdict, ...]
    rounds: int
    seconds: float

    @property
    def structure(self) -> Structure:
        """The discovered structure, every coefficient a number."""
        return self.estimate.structure

    @property
    def trusted(self) -> bool:
        """Whether no verdict forbids trust."""
        return is_trusted(self.verdicts)

    @cached_property
    def kept(self) -> tuple[TermEvidence, ...]:
        """The terms of the answer, the most certain first."""
        return tuple(term for term in self.terms if term.kept)

    @cached_property
    def doubtful(self) -> tuple[TermEvidence, ...]:
        """The candidates, kept or dropped, whose decision is not beyond doubt, the most doubtful first."""
        return tuple(sorted((term for term in self.terms if not term.certain), key=lambda term: term.margin))

    @cached_property
    def in_doubt(self) -> tuple[str, ...]:
        """The links that were found and not stated, and of which no term is certain: they may be other links' in truth."""
        return tuple(
            dict.fromkeys(term.link for term in self.kept if self.decision(term.link) is not Decision.CERTAIN)
        )

    def decision(self, link: str) -> Decision:
        """How firm it is that `link` is there: certain where it was stated, or where one of its terms is."""
        tested = {term.name: term.certain for term in self.kept}
        names = (f"{link}.{name}" for name in self.structure.link(link).coefficients)
        return Decision.CERTAIN if any(tested.get(name, True) for name in names) else Decision.DOUBTFUL

    def certainty(self, link: str) -> float:
        """By how much the criterion rises without the most certain term of a link; infinite for stated ones."""
        margins = {term.name: term.margin for term in self.kept}
        return max(
            (margins.get(f"{link}.{name}", float("inf")) for name in self.structure.link(link).coefficients),
            default=float("inf"),
        )

    def __str__(self) -> str:
        return as_text(self)

    def to_dict(self) -> dict[str, Any]:
        """What result.json holds: that of the estimate, and the evidence."""
        return {
            **self.estimate.to_dict(),
            "seconds": self.seconds,
            "remarks": list(self.remarks),
            "links_in_doubt": list(self.in_doubt),
            "verdicts": [verdict.name for verdict in self.verdicts],
            "trusted": self.trusted,
            "settled": Verdict.SEARCH_UNSETTLED not in self.verdicts,
            "seen": Verdict.DISPLACEMENTS_INTEGRATED not in self.verdicts,
            "exact": Verdict.TERMS_MAY_BE_MISSING not in self.verdicts,
            "terms": [_as_dict(term) for term in self.terms],
            "path": [
                {
                    "terms": c.terms,
                    "cost": c.cost,
                    "criterion": c.criterion,
                    "step": c.step,
                    "chosen": c.chosen,
                }
                for c in self.path
            ],
            "runners_up": [{"change": each.change, "margin": each.margin} for each in self.runners_up],
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
        "decision": term.decision.value,
        "value": term.value,
        "standard_error": term.standard_error,
        "unit": term.unit,
        "z": term.z,
        "margin": term.margin,
    }
