"""Every link that a structure may have, with every candidate term, and the structures that a selection of them makes.

The options of a discovery: one frozen object, and the keywords that it is made of.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypedDict, final

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
from linkwise.likelihood.options import ADMIT, AMBIENT, CALIBRATION, CLOCKS, HARMONICS, INPUT_NOISE
from linkwise.likelihood.random_forces import Deviations
from linkwise.model.coefficient import Coefficient
from linkwise.model.host import Host
from linkwise.model.law import Law
from linkwise.model.link import BASE, GROUND, Link, Mass, refuse_memory
from linkwise.model.rotations import differ_in_unit, mass_in_si, rotations_of
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

    def turns(self, rotations: Collection[str]) -> bool:
        """Whether an end is among the `rotations`, so that forces are moments."""
        return not set(rotations).isdisjoint(self.between)


@dataclass(frozen=True)
class CandidateTerm:
    """A `term` that the link number `pair` may have; `name` is that of its coefficient, "m2-m1.k3".

    It has numbers in place of the parameters of the `offered` term.
    """

    name: str
    pair: int
    term: Term
    offered: Term

    @property
    def is_damper(self) -> bool:
        """Whether the term is linear damping, which weak equations can hardly judge."""
        return self.term.text == "v"


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
        return (
            *(point for host in self.hosts for point in host.points),
            *(mass.name for mass in self.masses),
        )

    @cached_property
    def rotations(self) -> tuple[str, ...]:
        """The points and masses that turn."""
        return rotations_of(self.hosts, self.masses)

    @cached_property
    def entries(self) -> tuple[CandidateTerm, ...]:
        """The candidates, pair by pair, in the order of `terms`."""
        return tuple(
            CandidateTerm(name, number, term.at(self.values_of(name, term)), term)
            for number, pair in enumerate(self.pairs)
            for term in _open_terms(pair, self.terms)
            if (name := f"{pair.name}.{term.coefficient}") not in self.inactive
        )

    def values_of(self, name: str, term: Term) -> Mapping[str, float]:
        """The values of the parameters of a candidate."""
        return self.values.get(name) or dict.fromkeys(term.parameters, 1.0)

    @cached_property
    def by_name(self) -> Mapping[str, CandidateTerm]:
        """The candidates by their names."""
        return {entry.name: entry for entry in self.entries}

    def on_links_of(self, names: Collection[str]) -> frozenset[str]:
        """The names of all candidates on the links that have at least one of the candidates in `names`."""
        linked = {self.by_name[name].pair for name in names if name in self.by_name}
        return frozenset(entry.name for entry in self.entries if entry.pair in linked)

    @property
    def always_tested(self) -> frozenset[str]:
        """The names of the candidates on the links that were asked for."""
        return frozenset(
            entry.name for entry in self.entries if self.pairs[entry.pair].name in self.asked_for
        )

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
        chosen_terms: dict[int, list[Term]] = {}
        for entry in self.entries:
            if entry.name in chosen:
                chosen_terms.setdefault(entry.pair, []).append(entry.term)
                if entry.name in self.free:
                    chosen_terms[entry.pair][-1] = entry.offered
        parameters = self._unknown_parameters
        links = [
            link
            for number, pair in enumerate(self.pairs)
            for link in _links(pair, chosen_terms.get(number, []), parameters.get(number, {}))
        ]
        linked = {end for link in links for end in link.between}
        free = [mass.name for mass in self.masses if mass.name not in linked]
        if free:
            raise IdentificationError(
                f"no link to {', '.join(free)} was found: none of its terms is above the noise. Excite the structure more "
                "strongly, record for longer or offer more terms; a link that is known to be there can be stated in a "
                "structure file"
            )
        return Structure(name, self.masses, tuple(links), self.hosts)

    @cached_property
    def _unknown_parameters(self) -> Mapping[int, Mapping[str, Coefficient]]:
        """The parameters of the `free` candidates of each pair that has some, which start from their values."""
        parameters: dict[int, dict[str, Coefficient]] = {}
        for entry in self.entries if self.free else ():
            if entry.name in self.free:
                parameters.setdefault(entry.pair, {}).update(
                    (name, Coefficient.unknown(value, lower=value / _FARTHEST, upper=value * _FARTHEST))
                    for name, value in self.values_of(entry.name, entry.offered).items()
                )
        return parameters

    def without_masses(self, masses: Collection[str]) -> Candidates:
        """The candidates without some masses; masses at the end of a stated link stay."""
        stated = {end for pair in self.pairs for link in pair.stated for end in link.between}
        removed = set(masses) - stated
        if not removed:
            return self
        return replace(
            self,
            masses=tuple(mass for mass in self.masses if mass.name not in removed),
            pairs=tuple(pair for pair in self.pairs if removed.isdisjoint(pair.between)),
        )

    def with_memory(self, pair: int, law: str) -> Candidates:
        """The candidates where the link of a pair, by number, has the states of a named law beside its terms."""
        given = self.pairs[pair]
        first = given.stated[:1]
        reserved = {name for term in self.terms for name in (term.coefficient, *term.parameters)}
        reserved |= {name for link in first for name in link.law.coefficients}
        link = link_with_memory(given.name, given.between, law, reserved)
        for stated in first:
            text = f"{stated.law.text} + {link.law.text}"
            coefficients = {**stated.coefficients, **link.coefficients}
            signals = dict(stated.law.signal_units)
            joined = Law.parse(text, link.states, signals=signals)
            link = Link(stated.name, stated.between, joined, coefficients, link.states)
        pairs = list(self.pairs)
        pairs[pair] = replace(given, stated=(link, *given.stated[1:]))
        return replace(self, pairs=tuple(pairs))

    @property
    def without_signals(self) -> Candidates:
        """The candidates whose terms are functions of the motion alone."""
        return replace(self, terms=tuple(term for term in self.terms if not term.law.signals))

    @cached_property
    def full_structure(self) -> Structure:
        """The structure of all candidates."""
        return self.structure(self.by_name.keys())


def all_candidates(
    masses: Sequence[Mass],
    terms: Sequence[Term],
    *,
    stated: Sequence[Link] = (),
    base: bool = False,
    ground: bool = True,
    hosts: Sequence[Host] = (),
) -> Candidates:
    """The candidates between every pair of `masses`, with `ground` every mass and the ground, with `base` and the base.

    Points of `hosts` are ends as masses are, where some mode moves them. Links of `stated` are known to be there with their
    laws; other terms may join them, except terms whose coefficient is a number there (0 excludes a term). A link whose law is
    0 is known not to be there. Raises StructureError for a stated link to something that is not a mass, and for a mass that
    is listed twice.
    """
    _require_single_names(masses)
    ends = (*_moving_points(hosts), *(mass.name for mass in masses))
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
    based = base or any(BASE in link.between for link in stated)
    supports = (*((BASE,) if based else ()), *((GROUND,) if ground else ()))
    link_names = {link.name for links in stated_links.values() for link in links}
    pairs, turning = [], rotations_of(hosts, masses)
    for number, end in enumerate(ends):
        for partner in (*supports, *ends[:number]):
            links = tuple(stated_links.get(frozenset((end, partner)), ()))
            if any(link.law.expression == Number(0.0) for link in links):
                continue
            if not links and (_move_alike(hosts, end, partner) or differ_in_unit((end, partner), turning)):
                continue
            if links:
                pairs.append(Pair(links[0].name, links[0].between, links))
            else:
                name = f"{end}-{partner}"
                while name in link_names:  # masses "a-b" and "c" beside "a" and "b-c"
                    name += "_"
                link_names.add(name)
                pairs.append(Pair(name, (end, partner)))
    return Candidates(tuple(masses), tuple(pairs), tuple(terms), hosts=tuple(hosts))


def _moving_points(hosts: Sequence[Host]) -> tuple[str, ...]:
    """The points that some mode moves."""
    return tuple(point for host in hosts for point in host.points if any(host.shape(point).values()))


def _move_alike(hosts: Sequence[Host], first: str, second: str) -> bool:
    """Whether two ends are points of a host that move alike in every mode, so that nothing stretches a link between them."""
    return any(
        {first, second} <= set(host.points) and host.shape(first) == host.shape(second) for host in hosts
    )


def _require_single_names(masses: Sequence[Mass]) -> None:
    """StructureError for a mass that is listed twice."""
    names = [mass.name for mass in masses]
    repeated = [name for name in names if names.count(name) > 1]
    if repeated:
        raise StructureError(
            f"the name is used {names.count(repeated[0])} times; each mass needs its own",
            f'mass "{repeated[0]}"',
        )


def _open_terms(pair: Pair, terms: Sequence[Term]) -> list[Term]:
    """The terms that the stated links of a pair do not have, with coefficient names that those do not use.

    A constant force acts on a mass from the ground or the base only.
    """
    coefficient_names = {name for link in pair.stated for name in link.law.coefficients}
    stated = {basis for link in pair.stated for basis in link.law.basis.values()}
    grounded = not {GROUND, BASE}.isdisjoint(pair.between)
    candidates = [
        term for term in terms if term.law.expression not in stated and (grounded or not term.is_constant)
    ]
    return [term.beside(coefficient_names) for term in candidates]


def _links(pair: Pair, terms: Sequence[Term], parameters: Mapping[str, Coefficient]) -> tuple[Link, ...]:
    """The links of a pair: the stated ones, with the chosen `terms` and their `parameters` added to the law of the first."""
    if not terms:
        return pair.stated
    ordered = sorted(terms, key=lambda term: not term.elastic)
    text = " + ".join(term.product for term in ordered)
    new = {term.coefficient: Coefficient.unknown() for term in ordered}
    new |= {name: parameters[name] for term in ordered for name in term.parameters}
    if not pair.stated:
        return (Link(pair.name, pair.between, Law.parse(text, signals=dict(ordered[0].signals)), new),)
    first, *others = pair.stated
    summands = (text, first.law.text) if first.states else (first.law.text, text)
    law = Law.parse(" + ".join(summands), first.states, signals=dict(ordered[0].signals))
    return Link(first.name, first.between, law, {**first.coefficients, **new}, first.states), *others


def candidates_for(
    records: Sequence[Record],
    masses: Mapping[str, float | str] | Structure | PartialStructure,
    terms: str | Sequence[str],
) -> Candidates:
    """All candidates between the masses of the records."""
    expect("discover(record, masses): masses", masses, Mapping, Structure, PartialStructure)
    if not records:
        raise IdentificationError("discovery needs at least one record, got none")
    check_distinct(records)
    check_stated_noise(records)
    hosts: tuple[Host, ...] = ()
    if isinstance(masses, Structure):
        given, stated, hosts = _parts(masses)
    elif isinstance(masses, PartialStructure):
        given, stated, hosts = masses.masses, masses.links, masses.hosts
    else:
        given = tuple(_mass(name, value) for name, value in masses.items())
        stated = ()
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
    signals = (
        {}
        if hosts
        else {
            channel.place: records[0].unit(channel).replace("?", "")
            for channel in records[0].channels
            if channel.kind == "signal"
        }
    )
    offered = parse_terms(with_signals(terms, signals), signals)
    parameters = [name for term in offered for name in term.parameters]
    if hosts and parameters:
        raise IdentificationError(
            f"beside a host the parameters of terms are not found yet: write a number in place of {parameters[0]}, as in "
            "friction(0.01)"
        )
    candidates = all_candidates(given, offered, stated=stated, base=bool(base), ground=grounded, hosts=hosts)
    return replace(candidates, memory=offered_memory(terms))


def _parts(structure: Structure) -> tuple[tuple[Mass, ...], tuple[Link, ...], tuple[Host, ...]]:
    """The masses and links of a structure that are no modes, and its hosts with the frequencies and damping of their modes."""
    masses = tuple(mass for mass in structure.masses if mass.name not in structure.modes)
    links = tuple(link for link in structure.links if link.name not in structure.modes)
    return masses, links, tuple(host.as_in(structure.link) for host in structure.hosts)


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


def _copied(stated: Deviations) -> Deviations:
    """What was stated of random forces, so that it stays as it is; what is neither is refused where it is used."""
    if isinstance(stated, Mapping):
        return dict(stated)
    return tuple(stated) if isinstance(stated, Sequence) and not isinstance(stated, str) else stated


class DiscoveryKeywords(TypedDict, total=False):
    """The fields of `DiscoveryOptions`."""

    terms: str | Sequence[str]
    offsets: str | Sequence[str]
    gains: str | Sequence[str]
    calibration: Mapping[str, float]
    delays: str | Sequence[str]
    clocks: Deviations
    harmonics: Mapping[str, float | Sequence[float]]
    admit: str | Sequence[str]
    ambient: Deviations
    input_noise: Deviations
    tested: str | Sequence[str]


@final
@dataclass(frozen=True, kw_only=True)
class DiscoveryOptions:
    """The options of `discover` and `check_discovery`.

    Those functions take the same as keywords; an object serves for several records.

    Parameters
    ----------
    terms : str or sequence of str
        The candidate terms of every link, functions of d, v and recorded signals, or families of them;
        "v, d, d**2, d**3" by default, and u, u*d and u*v for each signal u of the record.
    offsets, gains : sequence of str
        Channels with an unknown constant error or factor, which every fit of the search finds with the terms; of factors also
        those of applied forces.
    calibration : mapping of str to float
        Relative standard deviations to which the gains of sensors and of applied forces are known, by channel: 0.01, or 1 %;
        ``"all"`` and ``"common"`` as of `MaximumLikelihood`.
    delays : sequence of str
        Channels with an unknown delay, which every fit finds likewise.
    clocks : sequence of str or mapping of str to float or None
        Channels recorded by a device with a clock of its own, as of `MaximumLikelihood`, likewise.
    harmonics : mapping of str to float or sequence of float
        Frequencies in Hz of harmonic forces that no channel shows, by mass, as of `MaximumLikelihood`.
    admit : sequence of {"gain", "offset", "delay", "clock"}
        Errors of sensors that are taken into the model where they are significant: the search is repeated with those that its
        diagnosis names.
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
    offsets: str | Sequence[str] = ()
    gains: str | Sequence[str] = ()
    calibration: Mapping[str, float] = field(default_factory=dict, hash=False, metadata=CALIBRATION)
    delays: str | Sequence[str] = ()
    harmonics: Mapping[str, float | Sequence[float]] = field(
        default_factory=dict, hash=False, metadata=HARMONICS
    )
    clocks: Deviations = field(default=(), hash=False, metadata=CLOCKS)
    admit: str | Sequence[str] = field(default=(), metadata=ADMIT)
    ambient: Deviations = field(default=(), hash=False, metadata=AMBIENT)
    input_noise: Deviations = field(default=(), hash=False, metadata=INPUT_NOISE)
    tested: str | Sequence[str] = field(default=(), metadata={"typed": "LIST"})

    def __post_init__(self) -> None:
        terms = self.terms if isinstance(self.terms, str) else tuple(self.terms)
        object.__setattr__(self, "terms", terms)
        for name in ("offsets", "gains", "delays", "admit", "tested"):
            given = getattr(self, name) or ()
            expect(f"DiscoveryOptions: {name}", given, str, tuple, list)
            object.__setattr__(self, name, (given,) if isinstance(given, str) else tuple(given))
        for name in ("calibration", "harmonics"):
            object.__setattr__(self, name, dict(getattr(self, name) or {}))
        for name in ("ambient", "input_noise", "clocks"):
            object.__setattr__(self, name, _copied(getattr(self, name) or ()))
        parse_terms(terms, possible_signals(terms))  # raises what is wrong with them
