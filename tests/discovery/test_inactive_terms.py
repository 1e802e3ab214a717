"""Terms that never acted: a stop that was not reached is left out and named, one that was reached is found."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from structures import link, structure

import linkwise as lw

TERMS = "v, d, contact(0.004), friction(0.01)"
MASSES = {"m1": 1.0, "m2": 0.3}
TRUTH = structure(
    MASSES,
    link("stop", "m1-ground", "k*d + c*v + kc*max(d - 0.004, 0)", k=3000.0, c=1.0, kc=2e4),
    link("slide", "m2-m1", "k*d + c*v + F*tanh(v/0.01)", k=1500.0, c=0.3, F=0.5),
)


@cache
def struck(velocity: float) -> lw.Record:
    """Two seconds after a hit on the first mass, at 30 dB; of 0.1 m/s its masses stay within 3 mm."""
    record = lw.simulate(TRUTH, release={"v:m1": velocity}, duration=2.0, rate=1000.0)
    return record.with_noise(30.0, seed=1021)


def with_gap() -> lw.Record:
    record = struck(1.0)
    values = record.values.copy()
    values[500:700, 0] = np.nan
    return replace(record, values=values)


def mirrored() -> lw.Record:
    """Nobody chooses which end of a candidate comes first; in a mirror the stop closes where d is negative."""
    return replace(struck(1.0), values=-struck(1.0).values, simulated=None)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("records", "stop"),
    [([mirrored()], "kn"), ([with_gap()], "kc"), ([struck(0.1), struck(1.0)], "kc")],
    ids=["on the other side", "gaps are no silence", "reached in another record"],
)
def test_a_stop_that_was_reached_is_found_with_friction_beside(records: list[lw.Record], stop: str) -> None:
    discovery = lw.discover(records, MASSES, terms=TERMS)
    assert discovery.trusted
    kept = {term.name for term in discovery.kept}
    assert kept == {f"m1-ground.{name}" for name in ("k", "c", stop)} | {
        f"m2-m1.{name}" for name in ("k", "c", "F")
    }
    assert {"m1-ground.kc", "m1-ground.kn"} <= {term.name for term in discovery.terms}
    assert not [remark for remark in discovery.remarks if "never active" in remark]


def test_a_stop_that_was_not_reached_is_left_out_and_named() -> None:
    stops = {f"{link}.{side}" for link in ("m1-ground", "m2-ground", "m2-m1") for side in ("kc", "kn")}
    discovery = lw.discover(struck(0.1), MASSES, terms=TERMS)
    score = lw.discovery.term_score(discovery.structure, TRUTH)
    assert (score.missing, score.extra) == (("stop.kc",), ())
    assert not stops & {term.name for term in discovery.terms}
    [remark] = [remark for remark in discovery.remarks if "were never active" in remark]
    assert all(stop in remark for stop in stops)
