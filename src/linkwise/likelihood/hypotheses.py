"""Hypotheses of what a fit may lack: terms of its links, and links of its structure."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

from linkwise.estimates.causes import CAUSE_KINDS
from linkwise.expression import to_text
from linkwise.likelihood.memory_forces import MEMORY_FORCES, MEMORY_TERMS, MemoryForce
from linkwise.likelihood.score_test import CandidateForce
from linkwise.model.law import Law
from linkwise.model.link import BASE, GROUND, Link
from linkwise.model.rotations import differ_in_unit
from linkwise.model.structure import Structure
from linkwise.records.channel_units import unit_in

_TERMS = tuple(
    map(
        Law.parse,
        ("1", "d", "d**2", "d**3", "d**5", "v", "v*abs(v)", "v**3", "sign(v)", "v*d**2"),
    )
)
BETWEEN_MODES = "damping between modes"
"""The kind of a hypothesis of damping that a host lacks, whose place is the link that would hold it."""

_USUAL = ("d**3", "d**5", "v*abs(v)", "sign(v)", *MEMORY_TERMS)
_OF_MODES = tuple(map(Law.parse, ("d", "v")))  # a frequency or a damping that is off
_OF_LINKS = tuple(map(Law.parse, ("d", "v", "d**3")))
_LINKS = 40  # that are tested, in the structure's order
_PAIRS = 40  # without a link, up to which all of them are tested


@dataclass(frozen=True)
class Hypothesis:
    """One thing that may be wrong, with the words of a `Cause`; `in_units_of` states the `unit` of all but forces."""

    kind: str
    where: str
    term: str = ""
    source: str = ""
    unit: str = ""


def in_units_of(hypotheses: Iterable[Hypothesis], structure: Structure) -> tuple[Hypothesis, ...]:
    """Hypotheses with the unit of their size: that of their force, of their kind, or of the channel that they are in."""
    return tuple(
        replace(
            lacking, unit=lacking.unit or CAUSE_KINDS[lacking.kind].unit or unit_in(structure, lacking.where)
        )
        for lacking in hypotheses
    )


def missing_forces(
    structure: Structure, estimated: Collection[str] = ()
) -> tuple[list[Hypothesis], list[CandidateForce]]:
    """Terms that links may lack, and links that the structure may lack, with the force of each; as `missing_terms`."""
    hypotheses, forces = missing_terms(structure, estimated)
    of_links, added = _missing_links(structure)
    return hypotheses + of_links, forces + added


def usual_terms(
    structure: Structure, estimated: Collection[str] = ()
) -> tuple[list[Hypothesis], list[CandidateForce]]:
    """The few terms that links lack most often, with the force of each, for fits that leave no more than noise."""
    hypotheses, forces = missing_terms(structure, estimated)
    usual = which_usual(hypotheses, structure)
    return [hypotheses[number] for number in usual], [forces[number] for number in usual]


def which_usual(hypotheses: Sequence[Hypothesis], structure: Structure) -> list[int]:
    """The numbers of the `usual_terms` among hypotheses."""
    return [
        number
        for number, hypothesis in enumerate(hypotheses)
        if hypothesis.kind == "term" and hypothesis.term in _USUAL and hypothesis.where not in structure.modes
    ]


def which_between_modes(hypotheses: Sequence[Hypothesis]) -> list[int]:
    """The numbers of those of damping between modes of hosts."""
    return [number for number, hypothesis in enumerate(hypotheses) if hypothesis.kind == BETWEEN_MODES]


def missing_terms(
    structure: Structure, estimated: Collection[str] = ()
) -> tuple[list[Hypothesis], list[CandidateForce]]:
    """Terms that links may lack, with the force of each; modes of hosts come last.

    Terms whose coefficients are among those `estimated`, by name, are there: their scores are rounding.
    """
    names = [link.name for link in structure.links if _offered(link, structure)]
    tested = set(sorted(names, key=lambda name: name in structure.modes)[:_LINKS])
    pairs = [
        (_of_term(link.name, law, structure), CandidateForce(first, second, law))
        for link, (first, second) in zip(structure.links, structure.topology.ends.tolist(), strict=True)
        if link.name in tested
        for law in _lacking(link, structure, estimated)
    ]
    return [hypothesis for hypothesis, _ in pairs], [force for _, force in pairs]


def _lacking(link: Link, structure: Structure, estimated: Collection[str]) -> list[Law | MemoryForce]:
    """What a link may lack that is not among its terms with coefficients `estimated`."""
    present = linear_terms(link, estimated)
    return [law for law in _offered(link, structure) if law.text.replace(" ", "") not in present]


def _offered(link: Link, structure: Structure) -> tuple[Law | MemoryForce, ...]:
    """What a link may lack; one with states has its memory, a damper between modes nothing."""
    if link.name in structure.modes:
        return _OF_MODES if link.name in structure.mass_names else ()
    return _TERMS if link.states else (*_TERMS, *MEMORY_FORCES)


def linear_terms(link: Link, estimated: Collection[str] | None = None) -> set[str]:
    """The terms of the law of a link that have a coefficient each, as hypotheses write them; of those `estimated` only."""
    return {
        Law.parse(to_text(link.law.basis[name])).text.replace(" ", "")
        for name in link.law.linear
        if estimated is None or f"{link.name}.{name}" in estimated
    }


def _of_term(link: str, law: Law | MemoryForce, structure: Structure) -> Hypothesis:
    """A term that a link lacks; a force like d beside that of a mode is an error of its frequency."""
    kind = "frequency" if link in structure.modes and law.text == "d" else "term"
    unit = structure.link(link).law.force_unit if kind == "term" else "1"
    return Hypothesis(kind, link, law.text, unit=unit)


def _missing_links(structure: Structure) -> tuple[list[Hypothesis], list[CandidateForce]]:
    """Links between masses or points, and from one to the ground, that are not there; none where there are too many of them.

    Where links end at the base, so may those; at the ground as well only where a link does. None joins a rotation and what
    moves along a line: its force would have no unit.
    """
    linked = {frozenset(link.between) for link in structure.links}
    supports = [end for end in (GROUND, BASE) if any(end in pair for pair in linked)] or [GROUND]
    ends = [
        *((name, support) for name in structure.places for support in supports),
        *((second, first) for first, second in combinations(structure.places, 2)),
    ]
    rotations = structure.rotations
    free = [pair for pair in ends if frozenset(pair) not in linked and not differ_in_unit(pair, rotations)]
    if len(free) > _PAIRS:
        return [], []
    index = structure.topology.index
    pairs = [
        (
            Hypothesis("link", "-".join(pair), law.text, unit=unit_in(structure, f"force:{pair[0]}")),
            CandidateForce(index[pair[0]], index[pair[1]], law),
        )
        for pair in free
        for law in _OF_LINKS
    ]
    return [hypothesis for hypothesis, _ in pairs], [force for _, force in pairs]
