"""Links and terms that a record leaves in doubt, and those that are absent or inactive: what it cannot show."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from present import present, some
from problems import chain_discovery
from random_signals import autoregressive
from record_faults import without
from structures import link, oscillator, row_of_masses, structure
from within import masses

import linkwise as lw
from linkwise.discovery.criterion import CERTAIN

RATE = 1000.0
ALPHA, BETA = -100.0, 1e6
WELL = (-ALPHA / BETA) ** 0.5


def two_of_four_joined() -> lw.Structure:
    """Four masses, the last two of which are all but rigidly joined: which of them holds the spring to the others cannot be
    told."""
    values = {"m1-ground": (4e3, 0.4), "m2-m1": (2e3, 0.2), "m3-m2": (500.0, 0.1), "m4-m3": (4e5, 0.5)}
    links = {name: ("k*d + c*v", {"k": k, "c": c}) for name, (k, c) in values.items()}
    return row_of_masses([1.0, 0.5, 0.3, 0.1], **links)


@pytest.mark.slow
def test_the_coefficients_of_a_link_in_doubt_have_no_intervals() -> None:
    true = two_of_four_joined()
    record = lw.simulate(true, release={"v:m1": 1.0}, duration=3.0, rate=RATE).with_noise(30.0, seed=1000)
    discovery = lw.discover(record, masses(true))
    assert discovery.trusted and "m1-ground" not in discovery.in_doubt and discovery.in_doubt
    for estimate in some(discovery.estimate.links):
        doubtful = estimate.link.name in discovery.in_doubt
        assert (estimate.covariance is None) == doubtful
        assert all(
            (coefficient.standard_error is None) == doubtful for coefficient in some(estimate.coefficients)
        )


@pytest.mark.slow
def test_links_in_doubt_beside_coloured_noise_are_not_trusted() -> None:
    """What a wrong link leaves looks as such noise does: on a record with white noise alone a wrong set of links was excused
    by it, with a damping 6.6 standard errors off."""
    true = two_of_four_joined()
    clean = lw.simulate(true, release={"v:m1": 1.0}, duration=2.0, rate=RATE)
    noise = autoregressive(np.random.default_rng(1000), clean.values.shape, 0.7)
    size = np.sqrt(np.mean(clean.values**2, axis=0)) * 10.0**-1.5  # 30 dB
    discovery = lw.discover(replace(clean, values=clean.values + size * noise), masses(true))
    assert "correlated from sample to sample in x:m1" in discovery.estimate.message
    assert discovery.estimate.trusted and not discovery.trusted
    assert discovery.verdicts[-1] is lw.Verdict.LINKS_IN_DOUBT
    assert not any(term.certain for term in some(discovery.terms))


def test_a_discovery_without_a_certain_link_is_not_trusted() -> None:
    """Two masses all but rigidly joined on a soft spring to the ground: on which of them it sits cannot be told."""
    law = "k*d + c*v"
    true = row_of_masses([0.5, 0.1], soft=(law, {"k": 1e3, "c": 0.2}), stiff=(law, {"k": 4e5, "c": 0.5}))
    record = lw.simulate(true, release={"v:m1": 1.0}, duration=3.0, rate=RATE).with_noise(30.0, seed=1000)
    discovery = lw.discover(record, masses(true))
    assert discovery.in_doubt and "m1 and m2 moved together" in discovery.remarks[0]
    assert set(discovery.in_doubt) == {link.name for link in discovery.structure.links}
    assert lw.Verdict.LINKS_IN_DOUBT in discovery.verdicts and not discovery.trusted
    assert not any(term.certain for term in some(discovery.terms))
    assert str(discovery).splitlines()[0].endswith(": NOT to be trusted") and "No link is certain" in str(
        discovery
    )
    firm = chain_discovery(2, 20.0, 1000)
    assert firm.in_doubt == () and str(firm).splitlines()[0].endswith(": can be trusted")


@pytest.mark.slow
def test_a_link_beside_another_of_its_mass_is_in_doubt_where_noise_hides_which() -> None:
    """The sink, by half a second at 8 dB: a cubic spring to the ground beside a spring to the primary explains it as well."""
    study = lw.study.read_study("reach")
    subject = study.subject("1 sink, 0.5 s, 687.5 Hz")
    record = subject.simulate(8).select(["x:m1", "x:m2"]).with_noise(8.0, seed=7008)
    discovery = lw.discover(record, {mass.name: mass.mass.value or 0.0 for mass in subject.structure.masses})
    assert {link.name for link in discovery.structure.links} == {"m1-ground", "m2-m1", "m2-ground"}
    assert discovery.trusted and "m2-ground" in discovery.in_doubt


def test_one_mode_decides_nothing_of_its_masses() -> None:
    """A light mass that follows a heavy one: as an oscillator of its own, in step with it, it explains the record as well."""
    pair = structure(
        {"m1": 0.3, "m2": 3.3},
        link("m1-ground", "m1-ground", "k*d + c*v", k=4e4, c=4.0),
        link("m2-m1", "m2-m1", "k*d + c*v", k=8e3, c=1.0),
        link("m2-ground", "m2-ground", "k*d + c*v", k=1.3e4, c=4.0),
    )
    clean = lw.simulate(pair, release={"x:m2": 0.05, "x:m1": 0.0084}, duration=2.0, rate=400.0)
    discovery = lw.discover(clean.with_noise(12.0, seed=49001), masses(pair))
    assert "m1 and m2 moved in proportion" in discovery.remarks[0]
    assert not [term.name for term in discovery.terms if term.certain]


def with_stiffness(alpha: float) -> lw.Structure:
    return oscillator("alpha*d + beta*d**3 + c*v", mass=0.01, alpha=alpha, beta=BETA, c=0.02)


def discovered(structure: lw.Structure, sensors: tuple[str, ...]) -> lw.Discovery:
    record = lw.simulate(structure, release={"x:m1": 1.35 * WELL}, duration=1.2, rate=500.0, sensors=sensors)
    return lw.discover(record.with_noise(40.0, seed=22), {"m1": 0.01})


def test_a_motion_in_one_well_does_not_tell_that_there_are_two() -> None:
    """About the well the force is -2 alpha d + 3 beta w d**2 + beta d**3, as far as accelerations tell."""
    discovery = discovered(with_stiffness(ALPHA), ("a",))
    (link,) = discovery.structure.links
    assert link.coefficients["k"].value == pytest.approx(-2.0 * ALPHA, rel=0.01)
    assert abs(float(link.coefficients["k2"].value or 0.0)) == pytest.approx(3.0 * BETA * WELL, rel=0.01)
    assert not any(term.certain for term in some(discovery.kept)) and not discovery.trusted
    assert discovery.in_doubt == ("m1-ground",)
    assert any(remark.startswith("The law of m1-ground is not odd") for remark in discovery.remarks)


@pytest.mark.slow
@pytest.mark.parametrize(("alpha", "sensors"), [(ALPHA, ("x", "a")), (-ALPHA, ("a",))])
def test_wells_told_by_displacements_and_odd_laws_are_certain(alpha: float, sensors: tuple[str, ...]) -> None:
    discovery = discovered(with_stiffness(alpha), sensors)
    assert {term.term for term in discovery.kept} == {"d", "d**3", "v"}
    assert discovery.trusted and all(term.certain for term in some(discovery.kept))
    assert not any("not odd" in remark for remark in discovery.remarks)


@pytest.mark.slow
def test_a_constant_force_beside_all_powers_starts_from_these() -> None:
    """It only shifts an elongation that accelerations do not tell: the equations of the start were singular."""
    true = oscillator("k*d + k3*d**3 + c*v", mass=1.0, k=4000.0, k3=4e7, c=1.5)
    drive = {"m1": "8*sin(2*pi*(2 + 1.5*t)*t)"}
    record = lw.simulate(true, forces=drive, duration=10.0, rate=200.0, sensors=("a",)).with_noise(
        40.0, seed=2
    )
    discovery = lw.discover(record, {"m1": 1.0}, terms="1, v, d, d**2, d**3, v*abs(v)")
    assert {term.term for term in discovery.kept} == {"v", "d", "d**3"} and discovery.trusted
    constant = next(term for term in discovery.terms if term.term == "1")
    assert not constant.kept and constant.margin > 10.0


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
