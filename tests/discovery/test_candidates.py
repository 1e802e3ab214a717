"""All links that could be: every pair is asked, what is stated stays, and what is known not to be does not come back."""

from collections.abc import Iterable

import numpy as np
import pytest
from structures import bodies, host, link, structure, torsion_chain

import linkwise as lw

pytestmark = pytest.mark.slow


MASSES = {"a": 1.0, "b": 0.5, "c": 0.3}
HIT = {"v:a": 1.0, "v:c": -1.0}


def frame(*links: lw.Link) -> lw.Structure:
    """Three masses in a row, and what else links them."""
    return structure(
        MASSES,
        link("frame", "a-ground", "k*d + c*v", k=3e3, c=1.0),
        link("upper", "b-a", "k*d + c*v", k=2e3, c=0.6),
        link("sink", "c-b", "c*v**3 + k*d", k=900.0, c=2.0),
        *links,
    )


def recorded(true: lw.Structure) -> lw.Record:
    return lw.simulate(true, release=HIT, duration=2.0, rate=400.0).with_noise(40.0, seed=1)


def names(evidence: Iterable[lw.discovery.TermEvidence], start: str = "") -> list[str]:
    return sorted(term.name for term in evidence if term.name.startswith(start))


def test_every_pair_and_every_mass_with_the_ground_is_asked() -> None:
    """What is chosen is a structure, springs first, of links whose coefficients both ends feel."""
    found = lw.discover(recorded(frame()), MASSES, terms="v, d, d**3, v**3")
    pairs = ("a-ground", "b-ground", "b-a", "c-ground", "c-a", "c-b")
    assert names(found.terms) == sorted(f"{pair}.{name}" for pair in pairs for name in ("c", "k", "k3", "c3"))
    assert [(link.name, link.law.text) for link in found.structure.links] == [
        ("a-ground", "k*d + c*v"),
        ("b-a", "k*d + c*v"),
        ("c-b", "k*d + c3*v**3"),
    ]
    assert found.trusted


def test_what_is_stated_stays_and_the_rest_may_join_it() -> None:
    """A link without a law is known not to be, and a coefficient of zero is a term known not to be."""
    stated = lw.model.PartialStructure(
        bodies(MASSES),
        (
            link("frame", "a-ground", "k*d", k=3e3),
            link("none", "c-a", "0"),
            link("sink", "c-b", "c*v**3 + k9*d", k9=900.0),
            link("b", "b-ground", "k*d", k=0.0),
            link("c-b", "b-c", "q*d**3", q=0.0),  # the name of a candidate
        ),
    )
    found = lw.discover(recorded(frame()), stated, terms="v, d, d**3")
    assert names(found.terms, "frame") == ["frame.c", "frame.k3"]
    assert names(found.terms, "sink") == ["sink.c_added"]  # its law has another c, and k9 is the spring
    assert not [term for term in found.terms if set(term.between) == {"a", "c"}]
    assert not [term for term in found.terms if term.name == "b.k"]
    assert len({term.name for term in found.terms}) == len(found.terms)
    assert found.trusted and names(found.kept) == ["b-a.c", "b-a.k", "frame.c"]
    assert found.structure.link("frame").law.text == "k*d + c*v"
    assert found.structure.coefficient("frame.k").value == 3e3


def test_names_of_masses_with_hyphens_do_not_clash() -> None:
    """ "a-b" with "c", and "a" with "b-c"."""
    masses = {"c": 1.0, "b-c": 0.5, "a-b": 0.4, "a": 0.3}
    springs = [
        link(f"s{number}", ends, "k*d + c*v", k=k, c=0.5)
        for number, (ends, k) in enumerate([("c-ground", 4e3), ("a-ground", 900.0)])
    ]
    law = lw.Law.parse("k*d + c*v")
    values = {"k": lw.Coefficient.number(2e3), "c": lw.Coefficient.number(0.3)}
    joined = [lw.Link("first", ("a-b", "c"), law, values), lw.Link("second", ("b-c", "a"), law, values)]
    true = structure(masses, *springs, *joined)
    record = lw.simulate(true, release={"v:c": 1.0, "v:b-c": -1.0}, duration=2.0, rate=400.0)
    found = lw.discover(record.with_noise(40.0, seed=2), masses, terms="v, d")
    assert len({term.name for term in found.terms}) == len(found.terms) == 20
    assert lw.discovery.term_score(found.structure, true).exact


def test_a_mass_in_the_air_is_refused_with_what_to_do() -> None:
    time = np.arange(1500) / 500.0
    x = np.column_stack([0.01 * np.cos(30.0 * time), 0.02 * time])
    record = lw.Record(0.0, 500.0, ("x:a", "x:b"), x).with_noise(40.0, seed=3)
    with pytest.raises(
        lw.IdentificationError,
        match=r"no link to b was found: none .* above the noise\. Excite .* offer more terms;",
    ):
        lw.discover(record, {"a": 1.0, "b": 1.0}, terms="v, d")


def test_a_mass_given_in_kg_m2_turns_and_is_joined_to_rotations_alone() -> None:
    record = lw.simulate(torsion_chain(), release={"v:disc1": 6.0}, duration=0.5, rate=1000.0)
    noisy = record.with_noise(40.0, seed=4)
    found = lw.discover(noisy, {"disc1": "1 kg m^2", "disc2": "100 kg cm^2"}, terms="v, d, d**3")
    assert found.trusted and lw.discovery.term_score(found.structure, torsion_chain()).exact
    assert [(mass.mass.value, mass.unit) for mass in found.structure.masses] == [(1.0, "rad"), (0.01, "rad")]
    with pytest.raises(lw.StructureError, match="'1 m' is in m: expected a number in kg"):
        lw.discover(noisy, {"disc1": "1 m"})
    with pytest.raises(lw.RecordError, match=r"disc1 moves along a line, so it is in m: .* unit = \"rad\""):
        lw.discover(noisy, {"disc1": 1.0, "disc2": 0.01})


def test_a_torsion_spring_between_rotations_is_found_beside_translations() -> None:
    """Only rotations are offered to rotations, and units are those of moments."""
    shapes = {"tip": (1.7, -1.7), "r": (2.3, -8.0)}
    carrier = host("beam", (5.0, 31.4), 0.01, shapes, rotations=["r"])
    shaft = link("shaft", "disc-beam.r", "k*d + k3*d**3 + c*v", k=2.0, k3=40.0, c=0.01)
    true = structure({"disc": 0.002}, shaft, hosts=[carrier], name="beam", rotations=["disc"])
    hits = {"beam.tip": "3*exp(-((t-0.1)/0.01)**2) - 2.4*exp(-((t-1.1)/0.01)**2)"}
    record = lw.simulate(true, forces=hits, duration=2.0, rate=300.0).with_noise(40.0, seed=5413012)
    found = lw.discover(record, lw.model.PartialStructure(bodies({"disc": 0.002}, ["disc"]), (), (carrier,)))
    assert found.trusted
    assert {frozenset(term.between) for term in found.kept} == {frozenset({"disc", "beam.r"})}
    asked = {frozenset(term.between) for term in found.terms}
    assert not asked & {frozenset({"disc", "beam.tip"}), frozenset({"beam.tip", "beam.r"})}
    assert {term.term: term.unit for term in found.kept} == {
        "d": "N m/rad",
        "d**3": "N m/rad^3",
        "v": "N m s/rad",
    }
