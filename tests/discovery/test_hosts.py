"""Discovery with hosts: links between points and masses, from fewer sensors than places."""

import re
from collections.abc import Mapping
from functools import cache

import numpy as np
import pytest
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
from within import assert_within, of

import linkwise as lw

pytestmark = pytest.mark.slow


SINK = bodies({"sink": 0.03})
THREE = ("a:beam.tip", "a:beam.mid", "a:sink")
# moves as the tip to within the noise
NEAR = {"near": tuple(1.002 * part for part in CANTILEVER_SHAPES["tip"])}


def beam(shapes: Mapping[str, tuple[float, ...]], *, second: float = 1.0) -> lw.Host:
    """A cantilever by three modes, of which the frequency of the second is off by a factor."""
    first, middle, last = CANTILEVER
    return host("beam", [first, middle * second, last], 0.01, shapes)


def with_sink(end: str, shapes: Mapping[str, tuple[float, ...]]) -> lw.Structure:
    """The beam with a bistable sink at one of its points."""
    sink = link("nes", f"sink-beam.{end}", NES, **CANTILEVER_SINK)
    return structure({"sink": 0.03}, sink, hosts=[beam(shapes)], name="beam")


@cache
def record(end: str, sensors: tuple[str, ...]) -> lw.Record:
    """Two hammer hits on the beam, which has a bistable sink at one of its points."""
    return lw.simulate(
        with_sink(end, CANTILEVER_SHAPES | NEAR),
        forces={"beam.root": "80*exp(-((t - 0.05)/0.002)**2) + 60*exp(-((t - 0.375)/0.002)**2)"},
        release={"x:sink": 0.00707},
        duration=0.4,
        rate=1000.0,
        sensors=sensors,
    ).with_noise(25.0, seed=4)


def discovered(end: str, sensors: tuple[str, ...], known: lw.Host) -> lw.Discovery:
    return lw.discover(
        record(end, sensors), lw.model.PartialStructure(SINK, (), (known,)), terms="v, d, d**3"
    )


def test_a_sink_at_mid_span_is_found_at_mid_span() -> None:
    discovery = discovered("mid", THREE, beam(CANTILEVER_SHAPES))
    assert {term.name for term in discovery.kept} == {f"sink-beam.mid.{name}" for name in ("c", "k", "k3")}
    assert discovery.in_doubt == ()
    true = {"k": CANTILEVER_SINK["alpha"], "k3": CANTILEVER_SINK["beta"], "c": CANTILEVER_SINK["c"]}
    assert_within(discovery.estimate, of("sink-beam.mid", true))
    assert discovery.trusted and "1 host, 3 modes, 1 mass, 1 link with 3 terms" in str(discovery)
    assert any("beam.root" in remark for remark in discovery.remarks)  # has no sensor


def test_a_point_that_moves_alike_leaves_the_link_in_doubt() -> None:
    discovery = discovered("tip", ("a:beam.mid", "a:sink"), beam(CANTILEVER_SHAPES | NEAR))
    [link] = discovery.in_doubt
    assert link in ("sink-beam.tip", "sink-beam.near")
    [exchanged] = {"sink-beam.tip", "sink-beam.near"} - {link}
    assert any(f"hardly distinguishes the link {link} from {exchanged}" in text for text in discovery.remarks)


@pytest.mark.usefixtures("memory_not_sought")
def test_links_that_a_wrong_frequency_asks_for_are_not_trusted() -> None:
    """Links stand in for it, and the frequency is named."""
    found = discovered("tip", THREE, beam(CANTILEVER_SHAPES, second=1.03))
    assert not found.trusted and lw.Verdict.SEARCH_UNSETTLED not in found.verdicts
    assert re.search(
        r"the frequency of beam.mode2 were [23](\.\d)? % less than stated", " ".join(found.remarks)
    )


def test_known_links_that_explain_a_record_leave_nothing_to_find() -> None:
    known = with_sink("mid", CANTILEVER_SHAPES)
    discovery = lw.discover(record("mid", THREE), known, terms="v, d, d**3")
    assert (discovery.trusted, tuple(discovery.kept)) == (True, ())
    assert "1 link" in str(discovery)


def test_a_stated_link_at_the_wrong_point_leaves_the_search_to_the_screen() -> None:
    nes = link("nes", "sink-beam.tip", NES)
    known = lw.model.PartialStructure(SINK, (nes,), (beam(CANTILEVER_SHAPES),))
    discovery = lw.discover(record("mid", THREE), known, terms="v, d, d**3")
    assert {f"sink-beam.mid.{name}" for name in ("c", "k", "k3")} <= {term.name for term in discovery.kept}


def test_what_cannot_be_found_beside_a_host_is_refused() -> None:
    full, known = record("mid", THREE), lw.model.PartialStructure(SINK, (), (beam(CANTILEVER_SHAPES),))
    values = np.random.default_rng(1).standard_normal((len(full), 2))
    elsewhere = lw.Record(0.0, full.rate, ("a:elsewhere", "force:beam.root"), values)
    with pytest.raises(lw.IdentificationError, match="no channel measures the motion of a mass or point"):
        lw.discovery.check_discovery(elsewhere, known)
    with pytest.raises(
        lw.IdentificationError, match=r"write a number in place of v_f, as in friction\(0.01\)"
    ):
        lw.discovery.check_discovery(full, known, terms="v, d, friction")


def test_the_truth_of_a_host_is_compared_by_its_links() -> None:
    tip, mid = with_sink("tip", CANTILEVER_SHAPES), with_sink("mid", CANTILEVER_SHAPES)
    score = lw.discovery.term_score(tip, mid)
    assert score.missing_links == ("nes",)
    assert score.extra == ("nes.alpha", "nes.beta", "nes.c")
    assert lw.discovery.term_score(tip, tip).exact
    aligned = lw.discovery.align_truth(tip, mid)
    assert aligned.link("nes").values == dict.fromkeys(CANTILEVER_SINK, 0.0)
    assert aligned.link("beam.mode1").values["frequency"] == CANTILEVER[0]


def test_memory_is_found_in_a_joint_of_a_beam() -> None:
    """Offered by name; the link that the forces show has it, with its values and the evidence for it."""
    law = {"k": 8000.0, "c": 2.0, "F": 10.0, "x0": 3e-4, "s": 0.5}
    known = host("beam", [8.0, 35.0], 0.01, {"tip": (1.2, -1.1)})
    true = structure(
        {"body": 0.5}, named("joint", "body-beam.tip", "bouc-wen", **law), hosts=[known], name="beam"
    )
    taps = "80*exp(-((t - 0.05)/0.002)**2) + 60*exp(-((t - 0.225)/0.002)**2)"
    sensors = ("x:beam.tip", "x:body")
    record = lw.simulate(true, forces={"beam.tip": taps}, duration=0.4, rate=1000.0, sensors=sensors)
    discovery = lw.discover(
        record.with_noise(40.0, seed=5),
        lw.model.PartialStructure(bodies({"body": 0.5}), (), (known,)),
        terms="linear, bouc-wen",
    )
    [evidence] = discovery.memory
    assert (evidence.link, evidence.law, evidence.certain) == ("body-beam.tip", "bouc-wen", True)
    assert_within(discovery.estimate, of("body-beam.tip", law))


DIRECTIONS = {
    "ax": (1.0, 0.3, 0.5, -0.2),
    "ay": (0.2, 1.1, -0.4, 0.6),
    "bx": (0.6, -0.5, -0.9, 0.7),
    "by": (-0.3, 0.8, 0.7, 1.0),
}
OBLIQUE = {"k": 300.0, "k3": 4e6, "c": 0.3}


def test_a_link_between_two_directions_is_a_row_and_is_found() -> None:
    """A frame by four modes, with a link between the motion of a in x and that of b in y, hit at each."""
    frame = host("frame", (5.0, 9.0, 16.0, 23.0), 0.01, DIRECTIONS)
    joint = link("joint", "frame.ax-frame.by", "k*d + k3*d**3 + c*v", **OBLIQUE)
    true = structure({}, joint, hosts=[frame], name="frame")
    row = true.incidence[:, [-1]].toarray()[:, 0]
    assert row == pytest.approx(np.subtract(DIRECTIONS["ax"], DIRECTIONS["by"]), rel=1e-15)
    hits = {"frame.ax": "20*exp(-((t-0.1)/0.01)**2)", "frame.by": "15*exp(-((t-0.8)/0.01)**2)"}
    record = lw.simulate(true, forces=hits, duration=1.6, rate=400.0).with_noise(35.0, seed=5413011)
    assert_within(lw.identify(record, true.unknown("joint")), of("joint", OBLIQUE))
    found = lw.discover(record, lw.model.PartialStructure((), (), true.hosts))
    assert found.trusted
    assert [(set(own.link.between), own.link.law.text) for own in found.estimate.links] == [
        ({"frame.ax", "frame.by"}, "k*d + k3*d**3 + c*v")
    ]
