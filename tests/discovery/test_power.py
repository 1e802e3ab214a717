"""A term is told as absent only where the record would have shown one that matters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from judged import masses
from present import some
from structures import row_of_masses

import linkwise as lw
from linkwise.discovery.result import CERTAIN

DAMPING = 0.03  # N s/m of the link between both masses: 0.1 % of its force


@pytest.fixture(scope="module")
def structure() -> lw.Structure:
    law = "k*d + c*v"
    links = {"m1-ground": (law, {"k": 2000.0, "c": 1.0}), "m2-m1": (law, {"k": 3000.0, "c": DAMPING})}
    return row_of_masses([1.0, 0.5], **links)


@pytest.fixture(scope="module")
def clean(structure: lw.Structure) -> lw.Record:
    return lw.simulate(structure, release={"v:m1": 1.0, "v:m2": -1.0}, duration=2.0, rate=400.0)


def discovered(structure: lw.Structure, record: lw.Record) -> lw.Discovery:
    return lw.discover(record, masses(structure), terms="v, d, d**2, d**3")


def test_a_damper_that_the_record_cannot_show_is_not_told_as_absent(
    structure: lw.Structure, clean: lw.Record
) -> None:
    """At 5 dB the damper is within its standard error: the criterion prefers the model without it by more than CERTAIN."""
    discoveries = [discovered(structure, clean.with_noise(5.0, seed=seed)) for seed in range(4)]
    dropped = [
        term
        for discovery in discoveries
        for term in discovery.terms
        if discovery.trusted and term.name == "m2-m1.c" and not term.kept and term.margin > CERTAIN
    ]
    for term in some(dropped):
        assert term.may_matter and term.decision is lw.discovery.Decision.DOUBTFUL
        assert abs(DAMPING - term.value) < 5.0 * term.standard_error


def test_what_a_precise_record_does_not_show_is_absent(structure: lw.Structure, clean: lw.Record) -> None:
    discovery = discovered(structure, clean.with_noise(50.0, seed=1))
    dropped = [
        term for term in discovery.terms if not term.kept and term.between in {("m1", "ground"), ("m2", "m1")}
    ]
    for term in some(dropped):
        # of the force of the link: a damper below it is as good as absent
        assert 0.0 < term.possible_share < 0.001 and not term.may_matter
        assert term.certain == (term.unambiguous and term.margin > CERTAIN)
    assert any(term.certain for term in dropped)
    elsewhere = [term for term in discovery.terms if term.between == ("m2", "ground")]
    for term in some(elsewhere):
        assert term.possible_share == 0.0 and term.certain


def test_the_share_is_that_of_the_far_end_of_the_interval(structure: lw.Structure, clean: lw.Record) -> None:
    """Against the force along the motion that the identified structure makes."""
    discovery = discovered(structure, clean.with_noise(40.0, seed=2))
    motion = discovery.estimate.motion
    place = {frozenset(link.between): number for number, link in enumerate(discovery.structure.links)}
    dropped = [term for term in discovery.terms if not term.kept and frozenset(term.between) in place]
    for term in some(dropped):
        number = place[frozenset(term.between)]
        link, d, v = discovery.structure.links[number], motion.d[:, number], motion.v[:, number]
        size = [
            np.sqrt(np.mean(force**2))
            for force in (lw.Law.parse(term.term).force(d, v, {}), link.law.force(d, v, link.values))
        ]
        expected = (abs(term.value) + 1.96 * term.standard_error) * size[0] / size[1]
        assert term.possible_share == pytest.approx(expected, rel=0.01)  # ends of steps, against samples


def test_a_small_damper_matters_where_a_small_spring_does_not(
    structure: lw.Structure, clean: lw.Record
) -> None:
    discovery = discovered(structure, clean.with_noise(50.0, seed=1))
    spring = next(term for term in discovery.terms if term.name == "m2-m1.k3")
    damper = replace(spring, term="v")
    limits = {
        share: (replace(spring, possible_share=share), replace(damper, possible_share=share))
        for share in (5e-4, 5e-3, 5e-2)
    }
    assert [[term.may_matter for term in pair] for pair in limits.values()] == [
        [False, False],
        [False, True],
        [True, True],
    ]
