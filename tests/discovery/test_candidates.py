"""All links that could be: who stands in the list, what is stated stays, and what is known not to be does not come back."""

from __future__ import annotations

import pytest
from present import some
from structures import bodies, host, link, torsion_chain

import linkwise as lw
from linkwise.discovery.candidates import Candidates, all_candidates, candidates_for
from linkwise.discovery.terms import parse_terms

TERMS = parse_terms("v, d, d**3")
STATED = (
    link("frame", "a-ground", "k*d + c*v", k=3.0),
    link("none", "b-a", "0"),
    link("sink", "c-b", "c*v**3 + k9*d", k9=0.0),
    link("second", "b-c", "q*d**3"),
)


def masses(*names: str) -> tuple[lw.Mass, ...]:
    return bodies(dict.fromkeys(names, 1.0))


def stated(*links: lw.Link) -> Candidates:
    return all_candidates(masses("a", "b", "c"), TERMS, stated=links or STATED)


def test_every_pair_and_every_mass_with_the_ground() -> None:
    candidates = all_candidates(masses("a", "b", "c"), TERMS)
    assert [pair.between for pair in candidates.pairs] == [
        ("a", "ground"), ("b", "ground"), ("b", "a"), ("c", "ground"), ("c", "a"), ("c", "b"),
    ]  # fmt: skip
    assert len(candidates.entries) == 18
    assert [entry.name for entry in candidates.entries[:4]] == [
        "a-ground.c",
        "a-ground.k",
        "a-ground.k3",
        "b-ground.c",
    ]


@pytest.mark.parametrize("n", [2, 5, 10])
def test_a_base_that_moves_is_one_more_end(n: int) -> None:
    names = [f"m{i}" for i in range(n)]
    at_rest, moved = (all_candidates(masses(*names), TERMS, base=base) for base in (False, True))
    assert len(at_rest.pairs) == n * (n + 1) // 2
    assert set(moved.pairs) - set(at_rest.pairs) == {
        pair for pair in moved.pairs if pair.between[1] == "base"
    }
    assert len(moved.pairs) == len(at_rest.pairs) + n


def test_dampers_are_told_from_springs() -> None:
    candidates = all_candidates(masses("a"), parse_terms("v, d, v*abs(v)"))
    assert [entry.is_damper for entry in candidates.entries] == [True, False, False]


def test_the_chosen_make_a_structure_with_unknown_coefficients_springs_first() -> None:
    candidates = all_candidates(masses("a", "b"), TERMS).structure(["b-a.c", "a-ground.k", "b-a.k3"])
    assert [(link.name, link.between, link.law.text) for link in candidates.links] == [
        ("a-ground", ("a", "ground"), "k*d"),
        ("b-a", ("b", "a"), "k3*d**3 + c*v"),
    ]
    assert [parameter.name for parameter in candidates.parameters] == ["a-ground.k", "b-a.k3", "b-a.c"]


def test_the_terms_of_a_link_are_told_from_one_of_them() -> None:
    candidates = stated()
    assert candidates.on_links_of(["frame.k3", "c-a.c"]) == {"frame.k3", "c-a.c", "c-a.k", "c-a.k3"}
    assert candidates.on_links_of(["frame.k"]) == frozenset()  # stated, and no candidate


def test_a_link_has_one_set_of_coefficients_that_both_ends_feel() -> None:
    candidates = all_candidates(masses("a", "b"), TERMS)
    assert not {entry.name for entry in candidates.entries} & {"a-b.k", "a-b.c", "a-b.k3"}
    place = [link.name for link in candidates.full_structure.links].index("b-a")
    assert candidates.full_structure.incidence.toarray()[:, place].tolist() == [-1.0, 1.0]


def test_a_mass_in_the_air_is_refused_with_what_to_do() -> None:
    with pytest.raises(
        lw.IdentificationError,
        match=r"no link to b, c was found: none .* above the noise\. Excite .* offer more terms;",
    ):
        all_candidates(masses("a", "b", "c"), TERMS).structure(["a-ground.k"])


def test_what_is_stated_stays_and_the_rest_may_join_it() -> None:
    candidates = stated()
    assert [entry.name for entry in candidates.entries if entry.name.startswith("frame")] == ["frame.k3"]
    stated_only = candidates.structure([])
    assert [link.law.text for link in stated_only.links] == ["k*d + c*v", "c*v**3 + k9*d", "q*d**3"]
    assert [parameter.name for parameter in stated_only.parameters] == ["frame.c", "sink.c", "second.q"]
    joined = candidates.structure(["frame.k3"])
    assert joined.links[0].law.text == "k*d + c*v + k3*d**3"
    assert joined.coefficient("frame.k").known and not joined.coefficient("frame.k3").known


def test_a_link_without_a_law_is_known_not_to_be() -> None:
    candidates = stated()
    assert not any(set(pair.between) == {"a", "b"} for pair in some(candidates.pairs))
    assert "none" not in [link.name for link in candidates.full_structure.links]


def test_a_coefficient_of_zero_is_a_term_known_not_to_be() -> None:
    """k9*d in the sink is the term d under another name; its damper takes a name that the sink does not use."""
    assert [entry.name for entry in stated().entries if entry.name.startswith("sink")] == ["sink.c_added"]
    assert stated().structure(["sink.c_added"]).links[1].law.text == "c*v**3 + k9*d + c_added*v"


def test_two_stated_links_of_one_pair_are_one_pair() -> None:
    pairs = [pair for pair in stated().pairs if set(pair.between) == {"b", "c"}]
    assert [[link.name for link in pair.stated] for pair in pairs] == [["sink", "second"]]


@pytest.mark.parametrize(
    "candidates",
    [
        stated(
            link("c-b", "a-ground", "k*d", k=1.0),
            link("b", "b-ground", "k*d", k=1.0),
            link("c", "c-ground", "k*d", k=1.0),
        ),
        all_candidates(masses("c", "b-c", "a-b", "a"), TERMS),  # "a-b" with "c", and "a" with "b-c"
    ],
    ids=["a stated link", "hyphens"],
)
def test_names_do_not_clash(candidates: Candidates) -> None:
    assert len(candidates.by_name) == len(candidates.entries)
    assert len(candidates.full_structure.links) == len(candidates.pairs)


def test_no_candidate_joins_a_rotation_and_a_translation() -> None:
    """Beside a base neither: it moves in m."""
    carrier = host("beam", (5.0, 31.4), 0.01, {"tip": (1.7, -1.7), "r": (2.3, -8.0)}, rotations=["r"])
    discs = bodies({"disc": 0.02, "m": 1.0}, ["disc"])
    candidates = all_candidates(discs, TERMS, hosts=[carrier], base=True)
    assert {frozenset(pair.between) for pair in candidates.pairs} == {
        frozenset(ends)
        for ends in (
            ("beam.tip", "base"), ("beam.tip", "ground"), ("beam.r", "ground"), ("disc", "ground"), ("disc", "beam.r"),
            ("m", "base"), ("m", "ground"), ("m", "beam.tip"),
        )
    }  # fmt: skip
    assert [pair.name for pair in candidates.pairs if pair.turns(candidates.rotations)] == [
        "beam.r-ground", "disc-ground", "disc-beam.r",
    ]  # fmt: skip
    assert candidates.full_structure.link("disc-beam.r").law.units["k3"] == "N m/rad^3"


def test_a_mass_given_in_kg_m2_turns() -> None:
    record = lw.simulate(torsion_chain(), release={"v:disc1": 6.0}, duration=0.1, rate=500.0)
    given = candidates_for([record], {"disc1": "1 kg m^2", "disc2": "100 kg cm^2"}, "v, d")
    assert [(mass.mass.value, mass.unit) for mass in given.masses] == [(1.0, "rad"), (0.01, "rad")]
    with pytest.raises(lw.StructureError, match="'1 m' is in m: expected a number in kg"):
        candidates_for([record], {"disc1": "1 m"}, "v, d")
    with pytest.raises(lw.RecordError, match=r"disc1 moves along a line, so it is in m: .* unit = \"rad\""):
        lw.discover(record, {"disc1": 1.0, "disc2": 0.01})
