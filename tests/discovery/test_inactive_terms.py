"""Terms that never acted: a stop that was not reached is left out and named, one that was reached is found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from structures import link, structure

import linkwise as lw
from linkwise.discovery.candidates import candidates_for
from linkwise.discovery.screened_records import inactive_remark, inactive_terms
from linkwise.weak.displacements import read_displacements

TERMS = "v, d, contact(0.004), friction(0.01)"
MASSES = {"m1": 1.0, "m2": 0.3}
TRUTH = structure(
    {"m1": 1.0, "m2": 0.3},
    link("stop", "m1-ground", "k*d + c*v + kc*max(d - 0.004, 0)", k=3000.0, c=1.0, kc=2e4),
    link("slide", "m2-m1", "k*d + c*v + F*tanh(v/0.01)", k=1500.0, c=0.3, F=0.5),
)


def struck(velocity: float) -> lw.Record:
    """Three seconds after a hit on the first mass, at 30 dB."""
    record = lw.simulate(TRUTH, release={"v:m1": velocity}, duration=3.0, rate=1000.0)
    return record.with_noise(30.0, seed=1021)


@pytest.fixture(scope="module")
def hard() -> lw.Record:
    return struck(1.0)


@pytest.fixture(scope="module")
def soft() -> lw.Record:
    """Its masses stay within 3 mm."""
    return struck(0.1)


def inactive(*records: lw.Record) -> set[str]:
    pool = candidates_for(records, MASSES, TERMS)
    motions = [read_displacements(record, pool.full_structure) for record in records]
    return set(inactive_terms(motions, [record.rate for record in records], pool))


def test_a_stop_that_was_reached_is_found_with_friction_beside(hard: lw.Record) -> None:
    discovery = lw.discover(hard, MASSES, terms=TERMS)
    assert inactive(hard) == set() and discovery.trusted
    assert lw.discovery.term_score(discovery.structure, TRUTH).exact


def test_a_stop_on_the_other_side_is_found_as_well(hard: lw.Record) -> None:
    """Nobody chooses which end of a candidate comes first; in a mirror the stop closes where d is negative."""
    discovery = lw.discover(replace(hard, values=-hard.values, simulated=None), MASSES, terms=TERMS)
    assert discovery.trusted
    assert {term.name for term in discovery.kept if term.link == "m1-ground"} == {
        "m1-ground.k",
        "m1-ground.c",
        "m1-ground.kn",
    }
    assert "m1-ground.kc" in {term.name for term in discovery.terms}


def test_a_stop_that_was_not_reached_is_left_out_and_named(soft: lw.Record) -> None:
    stops = {f"{link}.{side}" for link in ("m1-ground", "m2-ground", "m2-m1") for side in ("kc", "kn")}
    assert inactive(soft) == stops
    discovery = lw.discover(soft, MASSES, terms=TERMS)
    assert lw.discovery.term_score(discovery.structure, TRUTH).missing == ("stop.kc",)
    assert lw.discovery.term_score(discovery.structure, TRUTH).extra == ()
    assert not stops & {term.name for term in discovery.terms}
    assert any(
        remark.startswith("m1-ground.kc, m1-ground.kn, m2-ground.kc, ") for remark in discovery.remarks
    )


def test_another_record_may_reach_it(hard: lw.Record, soft: lw.Record) -> None:
    assert inactive(soft, hard) == set()


def test_smooth_terms_and_gaps_are_not_taken_for_silence(hard: lw.Record) -> None:
    values = hard.values.copy()
    values[500:700, 0] = np.nan
    assert inactive(replace(hard, values=values)) == set()
    pool = candidates_for([hard], MASSES, "v, d**3, v*abs(v)")
    assert inactive_terms([read_displacements(hard, pool.full_structure)], [hard.rate], pool) == ()


def test_few_are_named_and_the_rest_counted() -> None:
    assert inactive_remark(()) == ()
    [sentence] = inactive_remark([f"m{k}-ground.kc" for k in range(9)])
    assert (
        sentence.startswith("m0-ground.kc, m1-ground.kc")
        and "m5-ground.kc and 3 more were never active" in sentence
    )
