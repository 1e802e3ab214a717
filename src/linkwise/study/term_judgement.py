"""How a structure that a method of a study has come to, links and terms, compares with the true one."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from linkwise.discovery.scoring import align_truth, term_score
from linkwise.identification.force_error import nmse
from linkwise.model.host_support import refuse_hosts
from linkwise.model.law import Law
from linkwise.model.link import LENGTH, Link
from linkwise.model.memory_support import refuse_memory
from linkwise.model.rig_support import refuse_rig
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.study.subject import Subject

_NO_FORCE = Law.parse("0")


@dataclass(frozen=True)
class TermJudgement:
    """The parts of a `MethodResult` that come from a comparison with the truth."""

    links: Mapping[str, float]
    terms: Mapping[str, int]

    @classmethod
    def of(cls, structure: Structure, subject: Subject, clean: Record) -> TermJudgement:
        """Compare a structure, every coefficient a number, with the true one along its motion `clean`.

        The NMSE of a true link is that of the link between the same ends, 100 % and more where there is none.
        """
        truth = subject.true_structure
        score = term_score(structure, truth)
        aligned, links = align_truth(structure, truth), {}
        for name in subject.judged_links:
            true = truth.link(name)
            link = _between(structure, true.between)
            if link is None:
                links[name] = nmse(true, Link(name, true.between, _NO_FORCE, {}), clean)
            else:
                links[name] = nmse(aligned.link(link.name), link, clean)
        return cls(links, term_counts(score.right, score.missing, score.extra))


def term_counts(
    right: Collection[object], missing: Collection[object], extra: Collection[object]
) -> dict[str, int]:
    """The numbers of terms as a row has them."""
    return {"right": len(right), "missing": len(missing), "extra": len(extra)}


def masses_alone(subject: Subject, method: str) -> dict[str, float | str]:
    """The masses by name, in kg or, of what turns, with their unit: all that a `method` that looks for links is told.

    Raises IdentificationError for a structure of another kind than masses on links.
    """
    structure = subject.true_structure
    refuse_rig(structure, method)
    refuse_memory(structure.links, method, "maximum likelihood takes it")
    refuse_hosts(structure, method)
    values = zip(structure.masses, structure.mass_values.tolist(), strict=True)
    return {
        mass.name: value if mass.unit == LENGTH else f"{value!r} {mass.mass_unit}" for mass, value in values
    }


def _between(structure: Structure, ends: tuple[str, str]) -> Link | None:
    return next((link for link in structure.links if set(link.between) == set(ends)), None)
