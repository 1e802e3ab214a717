"""Every link that a structure may have, with every candidate term, the structures of a selection of them, and the options.

A candidate is a term on a pair of ends, with a coefficient of its own. Links that were stated are part of every structure, and
terms that are selected on the same pair join the law of the first of them.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import final

import numpy as np

from linkwise.discovery.terms import (
    DEFAULT,
    Term,
    link_with_memory,
    offered_memory,
    parse_terms,
    possible_signals,
    with_signals,
)
from linkwise.errors import IdentificationError, LinkwiseError, StructureError, expect
from linkwise.expression import Number
from linkwise.likelihood.options import AskedFor, AskedKeywords
from linkwise.likelihood.tests.score_test import CandidateForce
from linkwise.model.coefficient import Coefficient, check_unique
from linkwise.model.host import Host, rotations_of
from linkwise.model.law import Law
from linkwise.model.link import BASE, GROUND, Link, Mass, differ_in_unit, mass_in_si, refuse_memory
from linkwise.model.structure import Structure
from linkwise.model.structure_file import PartialStructure
from linkwise.records.joining import check_distinct, check_stated_noise
from linkwise.records.record import Record

_FARTHEST = 100.0  # times a value of a parameter that was found among some


@dataclass(frozen=True)
class Pair:
    """Two ends, and the `stated` links between them, which the user knows to be there."""

    name: str
    between: tuple[str, str]
    stated: tuple[Link, ...] = ()


@dataclass(frozen=True)
class CandidateTerm:
    """A `term` that the link number `pair` may have; `name` is that of its coefficient, "m2-m1.k3".

    It has numbers, the `values`, in place of the parameters of the `offered` term; where it is `free`, these are unknowns of a
    structure.
    """

    name: str
    pair: int
    term: Term
    offered: Term
    values: Mapping[str, float] = field(default_factory=dict)
    free: bool = False

    @property
    def written(self) -> Term:
        """The term as a law of a structure has it."""
        return self.offered if self.free else self.term

    @property
    def unknowns(self) -> dict[str, Coefficient]:
        """Its coefficient, and its parameters where they are free, which start from their values."""
        parameters = self.values.items() if self.free else ()
        return {self.term.coefficient: Coefficient.unknown()} | {
            name: Coefficient.unknown(value, lower=value / _FARTHEST, upper=value * _FARTHEST)
            for name, value in parameters
        }


@dataclass(frozen=True, eq=False)
class Candidates:
    """All candidate terms between `masses` and points of `hosts`: every one of `terms` on every one of `pairs`.

    Laws with `memory` were offered by name. Stated links are part of every structure; `inactive` holds names of candidates
    that are left out. Terms with parameters have those of `values`, by name, and 1 in SI units before there are any; in
    structures those of `free` candidates are unknown. All terms of the pairs `asked_for`, by name, are to be tested.
    """

    masses: tuple[Mass, ...]
    pairs: tuple[Pair, ...]
    terms: tuple[Term, ...]
    inactive: frozenset[str] = frozenset()
    hosts: tuple[Host, ...] = ()
    values: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    free: frozenset[str] = frozenset()
    memory: tuple[str, ...] = ()
    asked_for: frozenset[str] = frozenset()

    @property
    def places(self) -> tuple[str, ...]:
        """The points of hosts, and the masses."""
        points = (point for host in self.hosts for point in host.points)
        return (*points, *(mass.name for mass in self.masses))

    @cached_property
    def entries(self) -> tuple[CandidateTerm, ...]:
        """The candidates, pair by pair, in the order of `terms`."""
        entries = []
        for number, pair in enumerate(self.pairs):
            for term in _open_terms(pair, self.terms):
                name = f"{pair.name}.{term.coefficient}"
                values = self.values.get(name) or dict.fromkeys(term.parameters, 1.0)
                if name not in self.inactive:
                    entry = CandidateTerm(name, number, term.at(values), term, values, name in self.free)
                    entries.append(entry)
        return tuple(entries)

    @cached_property
    def by_name(self) -> Mapping[str, CandidateTerm]:
        """The candidates by their names."""
        return {entry.name: entry for entry in self.entries}

    @property
    def stated_pairs(self) -> frozenset[int]:
        """The numbers of the pairs with stated links, which cost nothing."""
        return frozenset(number for number, pair in enumerate(self.pairs) if pair.stated)

    def on_links_of(self, names: Collection[str]) -> frozenset[str]:
        """The names of all candidates on the links that have at least one of the candidates in `names`."""
        return self.on_pairs({self.by_name[name].pair for name in names if name in self.by_name})

    def on_pairs(self, pairs: Collection[int]) -> frozenset[str]:
        """The names of all candidates on some pairs, by number."""
        return frozenset(entry.name for entry in self.entries if entry.pair in pairs)

    def rows(self, pair: int) -> list[int]:
        """The places of the ends of a pair, by number, among the masses, the base and the ground."""
        row = {name: number for number, name in enumerate((*(m.name for m in self.masses), BASE, GROUND))}
        return [row[end] for end in self.pairs[pair].between]

    def forces(self, entries: Iterable[CandidateTerm], structure: Structure) -> list[CandidateForce]:
        """The forces of some candidates per unit of their coefficients, in a structure."""
        index = structure.topology.index
        ends = [(entry.term.law, *self.pairs[entry.pair].between) for entry in entries]
        return [CandidateForce(index[first], index[second], law) for law, first, second in ends]

    def asking_for(self, links: Collection[str]) -> Candidates:
        """The candidates with all terms of `links` tested, by their names or ends in either order, of "all" of every link.

        Raises StructureError for another link.
        """
        names = {f"{a}-{b}": pair.name for pair in self.pairs for a, b in (pair.between, pair.between[::-1])}
        names |= {pair.name: pair.name for pair in self.pairs}
        strange = [link for link in links if link not in names and link != "all"]
        if strange:
            raise StructureError(
                f'"{strange[0]}" is not a link that is looked for: give its two ends, as in "{self.pairs[-1].name}", or "all"'
            )
        chosen = names.values() if "all" in links else (names[link] for link in links)
        return replace(self, asked_for=frozenset(chosen))

    def structure(self, chosen: Collection[str], name: str = "discovered structure") -> Structure:
        """The structure of the stated links and the `chosen` candidates, by name, with unknown coefficients.

        Raises IdentificationError if a mass has no link.
        """
        by_pair: dict[int, list[CandidateTerm]] = {number: [] for number in range(len(self.pairs))}
        for entry in self.entries:
            if entry.name in chosen:
                by_pair[entry.pair].append(entry)
        links = [link for number, added in by_pair.items() for link in _links(self.pairs[number], added)]
        linked = {end for link in links for end in link.between}
        free = [mass.name for mass in self.masses if mass.name not in linked]
        if free:
            raise IdentificationError(
                f"no link to {', '.join(free)} was found: none of its terms is above the noise. Excite the structure more "
                "strongly, record for longer or offer more terms; a link that is known to be there can be stated in a "
                "structure file"
            )
        return Structure(name, self.masses, tuple(links), self.hosts)

    def without_masses(self, masses: Collection[str]) -> Candidates:
        """The candidates without some masses; masses at the end of a stated link stay."""
        stated = {end for pair in self.pairs for link in pair.stated for end in link.between}
        removed = set(masses) - stated
        return replace(
            self,
            masses=tuple(mass for mass in self.masses if mass.name not in removed),
            pairs=tuple(pair for pair in self.pairs if removed.isdisjoint(pair.between)),
        )

    def with_memory(self, pair: int, law: str) -> Candidates:
        """The candidates where the link of a pair, by number, has the states of a named law beside its terms."""
        given = self.pairs[pair]
        reserved = {name for term in self.terms for name in (term.coefficient, *term.parameters)}
        reserved |= {name for link in given.stated[:1] for name in link.law.coefficients}
        return self.with_link(pair, link_with_memory(given.name, given.between, law, reserved))

    def with_link(self, pair: int, link: Link) -> Candidates:
        """The candidates where a link, its law added to that of the first stated one, is part of a pair, by number."""
        given = self.pairs[pair]
        for first in given.stated[:1]:
            link = _joined(first, link)
        changed = replace(given, stated=(link, *given.stated[1:]))
        return replace(self, pairs=(*self.pairs[:pair], changed, *self.pairs[pair + 1 :]))

    @cached_property
    def full_structure(self) -> Structure:
        """The structure of all candidates."""
        return self.structure(self.by_name.keys())


def candidates_for(
    records: Sequence[Record],
    masses: Mapping[str, float | str] | Structure | PartialStructure,
    terms: str | Sequence[str],
) -> Candidates:
    """All candidates between every pair of masses, every mass and the ground, and every mass and a recorded base.

    Points of hosts are ends as masses are, where some mode moves them. Links that are stated are known to be there with their
    laws; other terms may join them, except terms whose coefficient is a number there (0 excludes a term). A link whose law is
    0 is known not to be there. Raises StructureError for a stated link to something that is not a mass, and for a mass that
    is listed twice.
    """
    expect("discover(record, masses): masses", masses, Mapping, Structure, PartialStructure)
    if not records:
        raise IdentificationError("discovery needs at least one record, got none")
    check_distinct(records)
    check_stated_noise(records)
    if isinstance(masses, Structure):  # without its modes, which the hosts have
        given = tuple(mass for mass in masses.masses if mass.name not in masses.modes)
        stated = tuple(link for link in masses.links if link.name not in masses.modes)
        hosts = tuple(host.as_in(masses.link) for host in masses.hosts)
    elif isinstance(masses, PartialStructure):
        given, stated, hosts = masses.masses, masses.links, masses.hosts
    else:
        given, stated, hosts = tuple(_mass(name, value) for name, value in masses.items()), (), ()
    if not given and not hosts:
        raise IdentificationError(
            'discovery needs at least one mass, got none; give masses by name, as in {"m1": 1.0, "m2": "10 g"}'
        )
    refuse_memory(stated, "discovery")
    _require_no_priors(given, stated)
    if not hosts:  # whose modes have masses
        _require_scale(given, records)
    base = {name for record in records for name in record.channels if name.place == BASE}
    grounded = not base or f"x:{BASE}" in base  # else the motion is known relative to the base alone
    if hosts and base:
        raise IdentificationError("a moving base beside a host is not supported in discovery")
    shown = () if hosts else [channel for channel in records[0].channels if channel.kind == "signal"]
    signals = {channel.place: records[0].unit(channel).replace("?", "") for channel in shown}
    offered = parse_terms(with_signals(terms, signals), signals)
    parameters = [name for term in offered for name in term.parameters]
    if hosts and parameters:
        raise IdentificationError(
            f"beside a host the parameters of terms are not found yet: write a number in place of {parameters[0]}, as in "
            "friction(0.01)"
        )
    check_unique(tuple(mass.name for mass in given), "mass")
    based = base or any(BASE in link.between for link in stated)
    supports = (*((BASE,) if based else ()), *((GROUND,) if grounded else ()))
    pairs = _pairs(given, stated, hosts, supports)
    return Candidates(given, pairs, offered, hosts=hosts, memory=offered_memory(terms))


def _pairs(
    masses: Sequence[Mass], stated: Sequence[Link], hosts: Sequence[Host], supports: Sequence[str]
) -> tuple[Pair, ...]:
    """Every pair of ends that a link may have."""
    moving = [point for host in hosts for point in host.points if any(host.shape(point).values())]
    ends = (*moving, *(mass.name for mass in masses))
    names = {*ends, *(point for host in hosts for point in host.points)}
    stated_links: dict[frozenset[str], list[Link]] = {}
    for link in stated:
        strange = [end for end in link.between if end not in names and end not in (GROUND, BASE)]
        if strange:
            raise StructureError(
                f'"{strange[0]}" is not a {"mass or point" if hosts else "mass"}; choose from "ground", "base" and the '
                f"{'masses and points' if hosts else 'masses'} {', '.join(sorted(names))}",
                f'link "{link.name}"',
            )
        stated_links.setdefault(frozenset(link.between), []).append(link)
    link_names = {link.name for links in stated_links.values() for link in links}
    pairs, turning = [], rotations_of(hosts, masses)
    for number, end in enumerate(ends):
        for partner in (*supports, *ends[:number]):
            links = tuple(stated_links.get(frozenset((end, partner)), ()))
            if any(link.law.expression == Number(0.0) for link in links):
                continue
            if links:
                pairs.append(Pair(links[0].name, links[0].between, links))
            elif not (_move_alike(hosts, end, partner) or differ_in_unit((end, partner), turning)):
                name = f"{end}-{partner}"
                while name in link_names:  # masses "a-b" and "c" beside "a" and "b-c"
                    name += "_"
                link_names.add(name)
                pairs.append(Pair(name, (end, partner)))
    return tuple(pairs)


def _move_alike(hosts: Sequence[Host], first: str, second: str) -> bool:
    """Whether two ends are points of a host that move alike in every mode, so that nothing stretches a link between them."""
    common = (host for host in hosts if {first, second} <= set(host.points))
    return any(host.shape(first) == host.shape(second) for host in common)


def _open_terms(pair: Pair, terms: Sequence[Term]) -> list[Term]:
    """The terms that the stated links of a pair do not have, with coefficient names that those do not use.

    A constant force acts on a mass from the ground or the base only.
    """
    coefficient_names = {name for link in pair.stated for name in link.law.coefficients}
    stated = {basis for link in pair.stated for basis in link.law.basis.values()}
    grounded = not {GROUND, BASE}.isdisjoint(pair.between)
    possible = (term for term in terms if grounded or not term.is_constant)
    return [term.beside(coefficient_names) for term in possible if term.law.expression not in stated]


def _links(pair: Pair, entries: Sequence[CandidateTerm]) -> tuple[Link, ...]:
    """The links of a pair: the stated ones, with the chosen terms added to the law of the first."""
    if not entries:
        return pair.stated
    ordered = sorted(entries, key=lambda entry: not entry.term.elastic)
    text = " + ".join(entry.written.product for entry in ordered)
    law = Law.parse(text, signals=dict(ordered[0].written.signals))
    unknowns = [coefficient for entry in ordered for coefficient in entry.unknowns.items()]
    link = Link(pair.name, pair.between, law, dict(unknowns))
    return (_joined(pair.stated[0], link), *pair.stated[1:]) if pair.stated else (link,)


def _joined(first: Link, second: Link) -> Link:
    """A stated link with the law of another one added to its own; states come last."""
    states = {**first.states, **second.states}
    texts = (second.law.text, first.law.text) if first.states else (first.law.text, second.law.text)
    coefficients = {**first.coefficients, **second.coefficients}
    signals = {**dict(first.law.signal_units), **dict(second.law.signal_units)}
    law = Law.parse(" + ".join(texts), states, signals=signals)
    return Link(first.name, first.between, law, coefficients, states)


def _require_no_priors(masses: Sequence[Mass], links: Sequence[Link]) -> None:
    stated = {f"{mass.name}.mass": mass.mass for mass in masses}
    stated |= {f"{link.name}.{name}": value for link in links for name, value in link.coefficients.items()}
    known = [name for name, value in stated.items() if value.sigma < np.inf]
    if known:
        raise StructureError(
            f"discovery takes a value as known or as unknown, and {', '.join(known)} is stated with a sigma: write a number "
            'or "unknown" for the discovery, and identify the structure found with the sigma'
        )


def _require_scale(masses: Sequence[Mass], records: Sequence[Record]) -> None:
    """StructureError if all masses are unknown and no applied force sets the scale of the forces."""
    forced = any(record.forces for record in records)
    if not forced and not any(mass.mass.known for mass in masses):
        raise StructureError(
            "the mass is unknown, and neither an applied force nor another mass sets the scale of the forces; weigh one mass, "
            "or record the applied force",
            f'mass "{masses[0].name}"',
        )


def _mass(name: str, value: float | str) -> Mass:
    """A mass of a number in kg, or "unknown"; a text in kg m^2 is the moment of inertia of one that turns."""
    if value == "unknown":
        return Mass(name, Coefficient.unknown())
    try:
        number, unit = mass_in_si(value)
    except LinkwiseError as error:
        raise StructureError(str(error), f'mass "{name}"') from error
    return Mass(name, number, unit)


class DiscoveryKeywords(AskedKeywords, total=False):
    """The fields of `DiscoveryOptions`."""

    terms: str | Sequence[str]
    tested: str | Sequence[str]


@final
@dataclass(frozen=True, kw_only=True)
class DiscoveryOptions(AskedFor):
    """The options of `discover` and `check_discovery`.

    Those functions take the same as keywords; an object serves for several records.

    Parameters
    ----------
    terms : str or sequence of str
        The candidate terms of every link: functions of d, v and signals, or families; "v, d, d**2, d**3" by default,
        and u, u*d and u*v of each signal u.
    offsets, gains : sequence of str
        Channels with an unknown constant error or factor, which every fit of the search finds with the terms; of factors also
        those of applied forces.
    calibration : mapping of str to float
        Relative standard deviations to which the gains of sensors and of applied forces are known, by channel: 0.01, or 1 %;
        ``"all"`` and ``"common"`` as of `MaximumLikelihood`.
    delays : sequence of str
        Channels with an unknown delay, which every fit finds likewise.
    drifts : sequence of str or mapping of str to float or None
        Channels with a slow drift, as of `MaximumLikelihood`, likewise.
    hums : mapping of str to float or sequence of float
        Frequencies in Hz of hums, one or several, by channel, likewise.
    corners : sequence of str or mapping of str to float or None
        Channels behind a high pass of first order, with its corner in Hz, which is estimated where none is given.
    clocks : sequence of str or mapping of str to float or None
        Channels recorded by a device with a clock of its own, as of `MaximumLikelihood`, likewise.
    harmonics : mapping of str to float or sequence of float
        Frequencies in Hz of harmonic forces that no channel shows, by mass, as of `MaximumLikelihood`.
    admit : sequence of {"gain", "offset", "delay", "drift", "high pass", "clock", "crosstalk", ...}
        Errors of sensors that are taken into the model where they are significant: the search is repeated with those that its
        diagnosis names. By default two at most, and where they leave only noise.
    as_stated : bool
        Search once, and take no error of a sensor into the model by itself where what was stated leaves more than noise.
    ambient : sequence of str or mapping of str to float or None
        Masses on which a random force acts that no channel shows, as of `MaximumLikelihood`: every fit of the search counts
        them in.
    input_noise : sequence of str or mapping of str to float or None
        Inputs whose channel has noise, likewise.
    tested : str or sequence of str
        Links, by their ends as in "m3-m1", whose terms are all tested by likelihood; "all" for every link, which takes memory
        with the square of the candidates. By default, of more than 12 masses those are tested that are significant in the
        equation of one of their masses.

    Raises
    ------
    IdentificationError
        If the terms are not a list of candidates, as `parse_terms` raises it.
    LawError
        If a term is not a valid expression.

    Examples
    --------
    >>> import linkwise as lw
    >>> options = lw.discovery.DiscoveryOptions(terms="linear, d**3")
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=2.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> found = lw.discover(record, {"m1": 1.0, "m2": 0.01}, options)
    >>> [link.law.text for link in found.structure.links]
    ['k*d + c*v', 'k*d + k3*d**3 + c*v']
    """

    terms: str | Sequence[str] = field(default=DEFAULT, metadata={"typed": "LIST"})
    tested: str | Sequence[str] = field(default=(), metadata={"typed": "LIST"})

    def __post_init__(self) -> None:
        terms = self.terms if isinstance(self.terms, str) else tuple(self.terms)
        # copies, so that the options stay as they were stated; what is neither a list nor a table is refused where it is used
        own: dict[str, object] = {"terms": terms}
        for name in ("offsets", "gains", "delays", "admit", "tested"):
            given = getattr(self, name) or ()
            expect(f"DiscoveryOptions: {name}", given, str, tuple, list)
            own[name] = (given,) if isinstance(given, str) else tuple(given)
        for name in ("calibration", "harmonics", "hums"):
            own[name] = dict(getattr(self, name) or {})
        for name in ("ambient", "input_noise", "drifts", "corners", "clocks"):
            given = getattr(self, name) or ()
            given = dict(given) if isinstance(given, Mapping) else given
            own[name] = tuple(given) if isinstance(given, list) else given
        vars(self).update(own)
        parse_terms(terms, possible_signals(terms))  # raises what is wrong with them
