"""What of a study is the paper's: chains run as the paper ran them, and which method plays which part."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from linkwise.model.chains import bnes_chain
from linkwise.paper.published import DURATION, MASSES, RATE, start
from linkwise.study.definition import Study
from linkwise.study.subject import Subject


@dataclass(frozen=True)
class PaperStudy:
    """`masses` counts those of each structure of a study that is a chain of the paper, by its name, fewest first.

    The paper's numbers may stand beside these alone. `classical` are the methods with a library of all monomials, `informed`
    those with the links' own columns, `weak` and `likelihood` linkwise's estimators; each by name in the study's order.
    """

    masses: Mapping[str, int]
    classical: tuple[str, ...]
    informed: tuple[str, ...]
    weak: tuple[str, ...]
    likelihood: tuple[str, ...]

    @classmethod
    def of(cls, study: Study) -> PaperStudy:
        """What `study` has of it: a chain counts with the masses, links, release, length and rate of the paper."""
        masses = {subject.name: subject.structure.size for subject in study.subjects if _is_paper(subject)}

        def named(kind: str) -> tuple[str, ...]:
            return tuple(method.name for method in study.methods if method.document()["kind"] == kind)

        return cls(
            dict(sorted(masses.items(), key=lambda item: item[1])),
            named("monomial"),
            named("physics-informed"),
            named("weak"),
            named("ml"),
        )

    def named(self, masses: int) -> str | None:
        """The name of the chain of so many masses, None where the study has none."""
        return next((name for name, count in self.masses.items() if count == masses), None)


def _is_paper(subject: Subject) -> bool:
    count = subject.structure.size
    if count not in MASSES:
        return False
    chain = bnes_chain(count)
    return (
        (subject.structure.masses, subject.structure.links) == (chain.masses, chain.links)
        and dict(subject.release) == start(count)
        and (subject.duration, subject.rate) == (DURATION, RATE)
        and not (subject.impulses or subject.forces or subject.base)
    )
