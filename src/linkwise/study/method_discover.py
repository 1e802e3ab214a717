"""Discovery as a method of a study: links and terms from the masses alone, judged by whether they are the true ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Literal, final

from linkwise.discovery.discover import discover
from linkwise.discovery.options import DiscoveryOptions
from linkwise.discovery.terms import DEFAULT
from linkwise.records.record import Record
from linkwise.study.method import MethodResult, MethodTable, StudyMethod
from linkwise.study.subject import Subject
from linkwise.study.term_judgement import TermJudgement, masses_alone
from linkwise.verdict import status_of


@final
@dataclass(frozen=True)
class DiscoveryMethod(StudyMethod):
    """`discover` with candidate `terms` on every link (METHODS section 9).

    It is told the masses and nothing of links; what is `unknown` of a structure does not matter. Coefficients of its rows are
    those of the discovered structure, by its own names. Raises IdentificationError for terms that are no candidates.
    """

    looks_for_terms: ClassVar[bool] = True

    name: str
    terms: str = DEFAULT

    def __post_init__(self) -> None:
        DiscoveryOptions(terms=self.terms)

    def evaluate(self, subject: Subject, clean: Record, snr_db: float, seed: int) -> MethodResult:
        masses = masses_alone(subject, 'methods of the kind "discover"')
        record = subject.measured(clean).with_noise(snr_db, seed=seed)
        discovery = discover(record, masses, terms=self.terms)
        judgement = TermJudgement.of(discovery.structure, subject, clean)
        return MethodResult(
            status=status_of(discovery.verdicts),
            seconds=discovery.seconds,
            links=judgement.links,
            coefficients={
                f"{link.name}.{name}": float(value)
                for link in discovery.structure.links
                for name, value in link.values.items()
            },
            reason=next((verdict.value for verdict in discovery.verdicts if verdict.forbids), ""),
            terms=judgement.terms,
        )

    def document(self) -> dict[str, Any]:
        return {"name": self.name, "kind": "discover", "terms": self.terms}


class DiscoveryTable(MethodTable):
    """Its table in a study file."""

    kind: Literal["discover"]
    name: str = ""
    terms: str = DEFAULT

    def build(self) -> StudyMethod:
        return DiscoveryMethod(self.name or self.kind, self.terms)
