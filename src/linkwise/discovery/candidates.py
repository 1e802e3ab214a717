"""Every link that could be, with every term that it could have, and the structures that a choice among them makes."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from linkwise.discovery.terms import Term
from linkwise.errors import IdentificationError, StructureError
from linkwise.expression import Number
from linkwise.model.coefficient import Coefficient
from linkwise.model.law import Law
from linkwise.model.link import BASE, GROUND, Link, Mass
from linkwise.model.structure import Structure


@dataclass(frozen=True)
class Pair:
    """Two ends, and the links between them that are `stated`: known to be there, with all their terms."""

    name: str
    between: tuple[str, str]
    stated: tuple[Link, ...] = ()


@dataclass(frozen=True)
class CandidateTerm:
    """A `term` that the link number `pair` may have; `name` is that of its coefficient, "m2-m1.k3"."""

    name: str
    pair: int
    term: Term

    @property
    def is_damper(self) -> bool:
        """Whether its force is proportional to v, which every link's is in part, and weak equations hardly see."""
        return self.term.text == "v"


@dataclass(frozen=True, eq=False)
class Candidates:
    """All `entries` to choose from among `masses`, between `pairs`, with `terms` each less the `inactive` ones, by name.

    What is stated stays.
    """

    masses: tuple[Mass, ...]
    pairs: tuple[Pair, ...]
    terms: tuple[Term, ...]
    inactive: frozenset[str] = frozenset()

    @cached_property
    def entries(self) -> tuple[CandidateTerm, ...]:
        """Those of one pair stand together, in the order of `terms`."""
        return tuple(
            CandidateTerm(name, number, term)
            for number, pair in enumerate(self.pairs)
            for term in _open_terms(pair, self.terms)
            if (name := f"{pair.name}.{term.coefficient}") not in self.inactive
        )

    @cached_property
    def by_name(self) -> Mapping[str, CandidateTerm]:
        """The entries by their names."""
        return {entry.name: entry for entry in self.entries}

    def sharing(self, names: Collection[str]) -> frozenset[str]:
        """The names of all entries of the links that some entries are of."""
        linked = {self.by_name[name].pair for name in names if name in self.by_name}
        return frozenset(entry.name for entry in self.entries if entry.pair in linked)

    def structure(self, chosen: Collection[str], name: str = "discovered structure") -> Structure:
        """What is stated and the `chosen` entries, by name, with unknown coefficients.

        Raises IdentificationError where a mass would hang in the air.
        """
        kept: dict[int, list[Term]] = {}
        for entry in self.entries:
            if entry.name in chosen:
                kept.setdefault(entry.pair, []).append(entry.term)
        links = [
            link for number, pair in enumerate(self.pairs) for link in _joined(pair, kept.get(number, []))
        ]
        held = {end for link in links for end in link.between}
        loose = [mass.name for mass in self.masses if mass.name not in held]
        if loose:
            raise IdentificationError(
                f"nothing in this record shows what holds {', '.join(loose)}: no term of any link to it stands above the "
                "noise. Hit it harder, record for longer or offer more terms; a mass that is known to be held so is stated in "
                "a structure file"
            )
        return Structure(name, self.masses, tuple(links))

    def without(self, masses: Collection[str]) -> Candidates:
        """The same without some masses, except those that a stated link ends at."""
        held = {end for pair in self.pairs for link in pair.stated for end in link.between}
        gone = set(masses) - held
        if not gone:
            return self
        return replace(
            self,
            masses=tuple(mass for mass in self.masses if mass.name not in gone),
            pairs=tuple(pair for pair in self.pairs if gone.isdisjoint(pair.between)),
        )

    @cached_property
    def everything(self) -> Structure:
        """All entries chosen."""
        return self.structure(self.by_name.keys())


def candidates(
    masses: Sequence[Mass], terms: Sequence[Term], *, stated: Sequence[Link] = (), base: bool = False
) -> Candidates:
    """Every pair of `masses` and every mass with the ground, and with the base where that moves.

    The links of `stated` are known to be there with their laws; other terms may join them, except those whose coefficient is
    a number there, 0 for a term that is known not to be. A link whose law is 0 is known not to be there. Raises StructureError
    for a stated link to something that is no mass, and for a mass that stands twice or is unknown.
    """
    _require_numbers(masses)
    names = {mass.name for mass in masses}
    known: dict[frozenset[str], list[Link]] = {}
    for link in stated:
        strange = [end for end in link.between if end not in names and end not in (GROUND, BASE)]
        if strange:
            raise StructureError(
                f'"{strange[0]}" is neither a mass nor "ground" nor "base"; the masses are {", ".join(sorted(names))}',
                f'link "{link.name}"',
            )
        known.setdefault(frozenset(link.between), []).append(link)
    held = (BASE, GROUND) if base or any(BASE in link.between for link in stated) else (GROUND,)
    taken = {link.name for links in known.values() for link in links}
    pairs = []
    for number, mass in enumerate(masses):
        for other in (*held, *(each.name for each in masses[:number])):
            links = tuple(known.get(frozenset((mass.name, other)), ()))
            if any(link.law.expression == Number(0.0) for link in links):
                continue
            if links:
                pairs.append(Pair(links[0].name, links[0].between, links))
            else:
                name = f"{mass.name}-{other}"
                while name in taken:  # masses "a-b" and "c" beside "a" and "b-c"
                    name += "_"
                taken.add(name)
                pairs.append(Pair(name, (mass.name, other)))
    return Candidates(tuple(masses), tuple(pairs), tuple(terms))


def _require_numbers(masses: Sequence[Mass]) -> None:
    """StructureError for a mass that stands twice, or whose number is not known."""
    names = [mass.name for mass in masses]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise StructureError(
            f"the name is used {names.count(twice[0])} times; each mass needs its own", f'mass "{twice[0]}"'
        )
    unknown = [mass.name for mass in masses if not mass.mass.known]
    if unknown:
        raise StructureError(
            "it is unknown, and links are discovered between masses that are known, in their ratios at least; weigh it, or "
            "identify it in a structure that you write down",
            f'mass "{unknown[0]}"',
        )


def _open_terms(pair: Pair, terms: Sequence[Term]) -> list[Term]:
    """The terms that the stated links of a pair do not have, under names that they do not use."""
    taken = {name for link in pair.stated for name in link.law.coefficients}
    there = {basis for link in pair.stated for basis in link.law.basis.values()}
    left = [term for term in terms if term.law.expression not in there]
    return [
        Term(term.text, f"{term.coefficient}_added") if term.coefficient in taken else term for term in left
    ]


def _joined(pair: Pair, terms: Sequence[Term]) -> tuple[Link, ...]:
    """The links of a pair: those stated, the first of them with the chosen `terms` beside its own."""
    if not terms:
        return pair.stated
    ordered = sorted(terms, key=lambda term: not term.elastic)
    text = " + ".join(term.written for term in ordered)
    new = {term.coefficient: Coefficient.unknown() for term in ordered}
    if not pair.stated:
        return (Link(pair.name, pair.between, Law.parse(text), new),)
    first, *others = pair.stated
    law = Law.parse(f"{first.law.text} + {text}")
    return Link(first.name, first.between, law, {**first.coefficients, **new}), *others
