"""Discovery with hosts: links between points and masses, from fewer sensors than places."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache, partial

import numpy as np
import pytest
from present import some
from structures import (
    CANTILEVER,
    CANTILEVER_SHAPES,
    CANTILEVER_SINK,
    NES,
    bodies,
    host,
    link,
    named,
    structure,
)

import linkwise as lw
from linkwise.discovery.candidates import all_candidates
from linkwise.discovery.screen import screen_links
from linkwise.discovery.selection import Selection, TermSearch, select_structure
from linkwise.discovery.terms import parse_terms
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.starts.values import starting_values
from linkwise.progress import silent
from linkwise.verdict import Verdict

SINK = bodies({"sink": 0.03})
NEAR = {
    "near": tuple(1.002 * part for part in CANTILEVER_SHAPES["tip"])
}  # moves as the tip to within the noise


def beam(shapes: Mapping[str, tuple[float, ...]], *, second: float = 1.0) -> lw.Host:
    """A cantilever by three modes, of which the frequency of the second is off by a factor."""
    first, middle, last = CANTILEVER
    return host("beam", [first, middle * second, last], 0.01, shapes)


def with_sink(end: str, shapes: Mapping[str, tuple[float, ...]]) -> lw.Structure:
    """The beam with a bistable sink at one of its points."""
    sink = link("nes", f"sink-beam.{end}", NES, **CANTILEVER_SINK)
    return structure({"sink": 0.03}, sink, hosts=[beam(shapes)], name="beam")


@cache
def record(end: str, sensors: tuple[str, ...], seed: int = 4) -> lw.Record:
    """Two hammer hits on the beam, which has a bistable sink at one of its points."""
    return lw.simulate(
        with_sink(end, CANTILEVER_SHAPES | NEAR),
        forces={"beam.root": "80*exp(-((t - 0.05)/0.002)**2) + 60*exp(-((t - 0.375)/0.002)**2)"},
        release={"x:sink": 0.00707},
        duration=0.4,
        rate=1000.0,
        sensors=sensors,
    ).with_noise(25.0, seed=seed)


def discovered(end: str, sensors: tuple[str, ...], known: lw.Host, seed: int = 4) -> lw.Discovery:
    return lw.discover(
        record(end, sensors, seed), lw.model.PartialStructure(SINK, (), (known,)), terms="v, d, d**3"
    )


def test_a_sink_at_mid_span_is_found_at_mid_span() -> None:
    discovery = discovered("mid", ("a:beam.tip", "a:beam.mid", "a:sink"), beam(CANTILEVER_SHAPES))
    assert discovery.trusted
    assert [term.name for term in sorted(discovery.kept, key=lambda term: term.name)] == [
        "sink-beam.mid.c",
        "sink-beam.mid.k",
        "sink-beam.mid.k3",
    ]
    assert discovery.in_doubt == ()
    for name, true in (
        ("k", CANTILEVER_SINK["alpha"]),
        ("k3", CANTILEVER_SINK["beta"]),
        ("c", CANTILEVER_SINK["c"]),
    ):
        estimate = discovery.estimate.coefficient(f"sink-beam.mid.{name}")
        assert estimate.standard_error is not None
        assert (
            abs(estimate.value - true) < 4.0 * estimate.standard_error
        )  # one draw of three: beyond 4 once in 5000
    assert "1 host, 3 modes, 1 mass, 1 link with 3 terms" in str(discovery)
    assert any("beam.root" in remark for remark in discovery.remarks)  # has no sensor


def test_a_point_that_moves_alike_leaves_the_link_in_doubt() -> None:
    discovery = discovered("tip", ("a:beam.mid", "a:sink"), beam(CANTILEVER_SHAPES | NEAR))
    [link] = discovery.in_doubt
    assert link in ("sink-beam.tip", "sink-beam.near")
    [exchanged] = {"sink-beam.tip", "sink-beam.near"} - {link}
    assert any(f"hardly distinguishes the link {link} from {exchanged}" in text for text in discovery.remarks)


def test_links_that_a_wrong_frequency_asks_for_are_not_trusted() -> None:
    """Links stand in for it; where the search settles, the frequency is named."""
    sensors, wrong = ("a:beam.tip", "a:beam.mid", "a:sink"), beam(CANTILEVER_SHAPES, second=1.03)
    discoveries = [discovered("tip", sensors, wrong, seed) for seed in (4, 5, 6)]
    assert not any(discovery.trusted for discovery in discoveries)
    settled = [found for found in discoveries if Verdict.SEARCH_UNSETTLED not in found.verdicts]
    assert all(
        re.search(r"the frequency of beam.mode2 were [23](\.\d)? % less than stated", " ".join(found.remarks))
        for found in some(settled)
    )


def test_the_screen_finds_the_link_before_its_law_is_known() -> None:
    candidates = all_candidates(SINK, parse_terms("v, d"), hosts=(beam(CANTILEVER_SHAPES),))
    screened = screen_links(record("mid", ("a:beam.tip", "a:beam.mid", "a:sink")), candidates)
    assert screened == {"sink-beam.mid.c", "sink-beam.mid.k"}


def selected_beside(stated: str, first: set[str]) -> Selection:
    """The selection of a record of a sink at mid-span, with a link stated, from a `first` subset of the candidates."""
    sink = link("nes", f"sink-beam.{stated}", NES)
    candidates = all_candidates(
        SINK, parse_terms("v, d, d**3"), stated=(sink,), hosts=(beam(CANTILEVER_SHAPES),)
    )
    records = [record("mid", ("a:beam.tip", "a:beam.mid", "a:sink"))]
    start, every = partial(starting_values, records), frozenset(candidates.by_name)
    search = TermSearch(records, candidates, every, start, silent, LikelihoodOptions(), restarts=True)
    return select_structure(search, first)


def test_stated_links_that_explain_a_record_come_before_what_the_screen_says() -> None:
    selection = selected_beside("mid", {"beam.mid-beam.tip.k", "beam.mid-beam.tip.c"})
    assert (selection.chosen, selection.settled, selection.rounds) == (frozenset(), True, 1)
    assert selection.is_exact


def test_a_stated_link_at_the_wrong_point_leaves_the_search_to_the_screen() -> None:
    selection = selected_beside("tip", {"sink-beam.mid.k", "sink-beam.mid.k3", "sink-beam.mid.c"})
    assert {"sink-beam.mid.k", "sink-beam.mid.k3", "sink-beam.mid.c"} <= selection.chosen


def test_known_links_that_explain_a_record_leave_nothing_to_find() -> None:
    known = with_sink("mid", CANTILEVER_SHAPES)
    discovery = lw.discover(record("mid", ("a:beam.tip", "a:beam.mid", "a:sink")), known, terms="v, d, d**3")
    assert (discovery.trusted, tuple(discovery.kept)) == (True, ())
    assert "1 link" in str(discovery)


def test_candidates_join_points_that_can_move_apart() -> None:
    shapes = {"tip": (3.2, -3.2, 3.2), "twin": (3.2, -3.2, 3.2), "clamp": (0.0, 0.0, 0.0)}
    pairs = all_candidates(SINK, parse_terms("d"), hosts=(beam(shapes),)).pairs
    assert [pair.name for pair in pairs] == [
        "beam.tip-ground",
        "beam.twin-ground",
        "sink-ground",
        "sink-beam.tip",
        "sink-beam.twin",
    ]


def test_a_record_without_sensors_of_the_structure_is_refused() -> None:
    full = record("mid", ("a:beam.tip", "a:beam.mid", "a:sink"))
    values = np.random.default_rng(1).standard_normal((len(full), 2))
    elsewhere = lw.Record(0.0, full.rate, ("a:elsewhere", "force:beam.root"), values)
    with pytest.raises(lw.IdentificationError, match="no channel measures the motion of a mass or point"):
        lw.discovery.check_discovery(
            elsewhere, lw.model.PartialStructure(SINK, (), (beam(CANTILEVER_SHAPES),))
        )


def test_the_truth_of_a_host_is_compared_by_its_links() -> None:
    tip, mid = with_sink("tip", CANTILEVER_SHAPES), with_sink("mid", CANTILEVER_SHAPES)
    score = lw.discovery.term_score(tip, mid)
    assert score.missing_links == ("nes",)
    assert score.extra == ("nes.alpha", "nes.beta", "nes.c")
    assert lw.discovery.term_score(tip, tip).exact
    aligned = lw.discovery.align_truth(tip, mid)
    assert aligned.link("nes").values == dict.fromkeys(CANTILEVER_SINK, 0.0)
    assert aligned.link("beam.mode1").values["frequency"] == CANTILEVER[0]


def test_parameters_of_terms_are_refused_beside_a_host() -> None:
    with pytest.raises(
        lw.IdentificationError, match=r"write a number in place of v_f, as in friction\(0.01\)"
    ):
        lw.discovery.check_discovery(
            record("mid", ("a:beam.tip", "a:beam.mid", "a:sink")),
            lw.model.PartialStructure(SINK, (), (beam(CANTILEVER_SHAPES),)),
            terms="v, d, friction",
        )


def test_memory_is_found_in_a_joint_of_a_beam() -> None:
    """Offered by name; the link that the forces show has it, with its values and the evidence for it."""
    law = {"k": 8000.0, "c": 2.0, "F": 10.0, "x0": 3e-4, "s": 0.5}
    known = beam(CANTILEVER_SHAPES)
    true = structure(
        {"body": 0.5}, named("joint", "body-beam.tip", "bouc-wen", **law), hosts=[known], name="beam"
    )
    taps = "80*exp(-((t - 0.05)/0.002)**2) + 60*exp(-((t - 0.375)/0.002)**2)"
    sensors = ("a:beam.tip", "a:beam.mid", "a:beam.root", "a:body")
    record = lw.simulate(true, forces={"beam.root": taps}, duration=0.6, rate=1000.0, sensors=sensors)
    discovery = lw.discover(
        record.with_noise(40.0, seed=5),
        lw.model.PartialStructure(bodies({"body": 0.5}), (), (known,)),
        terms="linear, bouc-wen",
    )
    assert discovery.trusted
    [evidence] = discovery.memory
    assert (evidence.link, evidence.law, evidence.certain) == ("body-beam.tip", "bouc-wen", True)
    for name, value in law.items():
        estimate = discovery.estimate.coefficient(f"body-beam.tip.{name}")
        assert estimate.standard_error is not None
        assert abs(estimate.value - value) < 4.0 * estimate.standard_error  # one draw of five


DIRECTIONS = {
    "ax": (1.0, 0.3, 0.5, -0.2),
    "ay": (0.2, 1.1, -0.4, 0.6),
    "bx": (0.6, -0.5, -0.9, 0.7),
    "by": (-0.3, 0.8, 0.7, 1.0),
}
OBLIQUE = {"k": 300.0, "k3": 4e6, "c": 0.3}


def across(seed: int) -> tuple[lw.Structure, lw.Record]:
    """A frame by four modes, with a link between the motion of a in x and that of b in y, hit at each."""
    frame = host("frame", (5.0, 9.0, 16.0, 23.0), 0.01, DIRECTIONS)
    joint = link("joint", "frame.ax-frame.by", "k*d + k3*d**3 + c*v", **OBLIQUE)
    true = structure({}, joint, hosts=[frame], name="frame")
    hits = {"frame.ax": "20*exp(-((t-0.1)/0.01)**2)", "frame.by": "15*exp(-((t-1.3)/0.01)**2)"}
    return true, lw.simulate(true, forces=hits, duration=3.0, rate=500.0).with_noise(35.0, seed=seed)


def test_a_link_between_two_directions_is_a_row_and_is_found() -> None:
    true, record = across(5413011)
    row = true.incidence[:, [-1]].toarray()[:, 0]
    assert row == pytest.approx(np.subtract(DIRECTIONS["ax"], DIRECTIONS["by"]), rel=1e-15)
    fit = lw.identify(record, true.unknown("joint"))
    assert fit.trusted
    for coefficient in some(fit.link("joint").coefficients):
        value = OBLIQUE[coefficient.name.rpartition(".")[2]]
        assert abs(coefficient.value - value) < 4.0 * (coefficient.standard_error or 0.0)
    found = lw.discover(record, lw.model.PartialStructure((), (), true.hosts))
    assert found.trusted
    assert [(set(own.link.between), own.link.law.text) for own in found.estimate.links] == [
        ({"frame.ax", "frame.by"}, "k*d + k3*d**3 + c*v")
    ]


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
    (own,) = found.estimate.links
    assert set(own.link.between) == {"disc", "beam.r"}
    assert {term.term: term.unit for term in found.kept} == {
        "d": "N m/rad",
        "d**3": "N m/rad^3",
        "v": "N m s/rad",
    }
