"""Terms that are absent or inactive: what the record cannot show, and what it shows not to be."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from present import present, some
from record_faults import without
from structures import link, row_of_masses, structure
from within import masses

import linkwise as lw
from linkwise.discovery.criterion import CERTAIN

DAMPING = 0.03  # N s/m of the link between both masses: 0.1 % of its force
LAW = "k*d + c*v"
ROW = row_of_masses(
    [1.0, 0.5], **{"m1-ground": (LAW, {"k": 2000.0, "c": 1.0}), "m2-m1": (LAW, {"k": 3000.0, "c": DAMPING})}
)


@pytest.fixture(scope="module")
def clean() -> lw.Record:
    return lw.simulate(ROW, release={"v:m1": 1.0, "v:m2": -1.0}, duration=2.0, rate=400.0)


@pytest.fixture(scope="module")
def precise(clean: lw.Record) -> lw.Discovery:
    return lw.discover(clean.with_noise(50.0, seed=1), masses(ROW))


@pytest.mark.slow
def test_a_damper_that_the_record_cannot_show_is_not_told_as_absent(clean: lw.Record) -> None:
    """At 5 dB the damper is within its standard error: the criterion prefers the model without it by more than CERTAIN."""
    discoveries = [lw.discover(clean.with_noise(5.0, seed=seed), masses(ROW)) for seed in range(4)]
    dropped = [
        term
        for discovery in discoveries
        for term in discovery.terms
        if discovery.trusted and term.name == "m2-m1.c" and not term.kept and term.margin > CERTAIN
    ]
    for term in some(dropped):
        assert term.may_matter and term.decision is lw.discovery.Decision.DOUBTFUL
        assert abs(DAMPING - term.value) < 5.0 * term.standard_error


def test_what_a_precise_record_does_not_show_is_absent(precise: lw.Discovery) -> None:
    """The share of a term is that of the far end of its interval, of the force along the motion that was identified."""
    motion = precise.estimate.motion
    place = {frozenset(link.between): number for number, link in enumerate(precise.structure.links)}
    dropped = [term for term in precise.terms if not term.kept and frozenset(term.between) in place]
    for term in some(dropped):
        # of the force of the link: a damper below it is as good as absent
        assert 0.0 < term.possible_share < 0.001 and not term.may_matter
        assert term.certain == (term.unambiguous and term.margin > CERTAIN)
        number = place[frozenset(term.between)]
        link, d, v = precise.structure.links[number], motion.d[:, number], motion.v[:, number]
        forces = (lw.Law.parse(term.term).force(d, v, {}), link.law.force(d, v, link.values))
        own, whole = (np.sqrt(np.mean(force**2)) for force in forces)
        expected = (abs(term.value) + 1.96 * term.standard_error) * own / whole
        assert term.possible_share == pytest.approx(expected, rel=0.01)  # ends of steps, against samples
    assert any(term.certain for term in dropped)
    for term in some(term for term in precise.terms if term.between == ("m2", "ground")):
        assert term.possible_share == 0.0 and term.certain


@pytest.mark.parametrize(
    ("share", "spring", "damper"), [(5e-4, False, False), (5e-3, False, True), (5e-2, True, True)]
)
def test_a_small_damper_matters(share: float, spring: bool, damper: bool, precise: lw.Discovery) -> None:
    term = replace(next(term for term in precise.terms if term.name == "m2-m1.k3"), possible_share=share)
    assert (term.may_matter, replace(term, term="v").may_matter) == (spring, damper)


@pytest.mark.slow
def test_a_damper_that_the_noise_hides_is_in_the_intervals_of_the_others() -> None:
    """Three dampers of two masses in two modes: most often one is dropped, and the others take its part."""
    true = structure(
        {"m1": 1.0, "m2": 0.5},
        link("m1-ground", "m1-ground", LAW, k=4e3, c=0.4),
        link("m2-m1", "m2-m1", "k*d + k3*d**3 + c*v", k=4e3, k3=1e6, c=0.3),
        link("m2-ground", "m2-ground", LAW, k=2e3, c=0.05),
    )
    exact = lw.simulate(true, release={"v:m1": 0.5}, duration=3.0, rate=400.0)
    far, far_alone = [], []
    for seed in range(100, 103):
        discovery = lw.discover(exact.with_noise(25.0, seed=seed), masses(true))
        assert discovery.trusted
        for term in some(discovery.kept):
            error = discovery.estimate.coefficient(term.name).standard_error
            # of one fit in two ways, the model of the selection and the covariance of the optimum
            assert error is not None and error == pytest.approx(term.standard_error, rel=0.01)
            distance = abs(term.value - present(true.coefficient(term.name).value))
            far.append(distance / error)
            far_alone.append(distance * abs(term.z / term.value))
    assert max(far_alone) > 8.0  # ten in five of six seeds, where the damper was dropped
    assert max(far) < 4.0  # 1e-4 of normal errors are larger; some fifteen are looked at
    assert "mostly by" in " ".join(discovery.remarks)


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
    return without(record, **{str(record.channels[0]): slice(500, 700)})


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
