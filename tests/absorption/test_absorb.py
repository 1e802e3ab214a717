"""Absorption: closed forms of linear structures, energy to the last joule, crossings between samples, options, refusals."""

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from present import present
from problems import chain_record
from structures import bodies, link, structure, torsion_chain, with_links

import linkwise as lw
from linkwise.absorption.absorb import AbsorptionKeywords, without_sinks
from linkwise.absorption.sinks import find_sinks
from linkwise.simulation.simulate import ExcitationKeywords

RELEASE = {"v:m1": 1.0}


def built(text: str, *masses: float, **values: float) -> lw.Structure:
    """`"a: m1-ground: law; b: m2-m1: law"` with masses m1, m2, ... in kg and coefficients by name."""
    links = []
    for part in text.split("; "):
        name, ends, law = (entry.strip() for entry in part.split(":"))
        own = {key: values[key] for key in lw.Law.parse(law).coefficients}
        links.append(link(name, ends, law, **own))
    return structure({f"m{i}": mass for i, mass in enumerate(masses, start=1)}, *links)


@pytest.fixture(scope="module")
def paper() -> lw.Absorption:
    """The paper's Fig. 3: the chain of two with its sink and with it removed."""
    return lw.absorb(lw.bnes_chain(2), duration=6.0, release=RELEASE)


def test_the_primary_without_its_sink_is_the_damped_oscillator(paper: lw.Absorption) -> None:
    """x = exp(-s t) sin(w t) / w: peak, rate, RMS, share of the damper and settling time in closed form."""
    s, w = 0.5, np.sqrt(30000.0 - 0.25)
    mass = paper.masses[0].without
    turn = np.arctan(w / s) / w
    # cubic at 27 Hz, 1 kHz
    assert mass.peak == pytest.approx(np.exp(-s * turn) * np.sin(w * turn) / w, rel=1e-5)
    assert mass.decay_rate == pytest.approx(s, rel=1e-6)
    time = np.linspace(0.0, 6.0, 600001)
    square = np.mean((np.exp(-s * time) * np.sin(w * time) / w)[:-1] ** 2)
    assert mass.rms == pytest.approx(np.sqrt(square), rel=1e-5)
    assert mass.settled is None  # exp(-0.5 * 6) is 4.98 %, within the last 5 % of the run
    looser = lw.absorb(lw.bnes_chain(2), duration=6.0, release=RELEASE, settle=0.2).masses[0].without
    # it leaves its band once in a half period
    assert looser.settled == pytest.approx(np.log(5.0) / s, abs=np.pi / w)
    stored = np.exp(-2.0 * s * 6.0)
    assert paper.without.share("spring1") == pytest.approx(1.0 - stored, abs=2.0 * s / w * stored)


def test_the_sink_takes_its_share_and_every_joule_is_somewhere(paper: lw.Absorption) -> None:
    for side in (paper.with_sinks, paper.without):
        total = side.dissipated.sum(axis=1) / side.total + side.remaining
        np.testing.assert_allclose(total, 1.0, atol=1e-12)  # free decay: all energy is put in at the start
        assert np.all(side.stored > -1e-12 * side.total)  # seen from the lowest wells nothing is negative
    assert paper.with_sinks.total == pytest.approx(0.5 + 0.0025, rel=1e-12)  # the sink starts on its barrier
    # the sink takes more than the damper of its host: 56 %
    assert paper.sinks_share == paper.sinks[0].share > 0.5
    assert paper.trusted


def test_crossings_are_those_of_the_paper(paper: lw.Absorption) -> None:
    """METHODS section 1: it crosses wells until 2.38 s and settles at +0.0099 m."""
    (sink,) = paper.sinks
    assert sink.last == pytest.approx(2.38, abs=5e-3) and sink.before_horizon == len(sink.crossings)
    assert paper.with_sinks.x[-1, 1] == pytest.approx(0.0099, abs=5e-5)
    assert len(sink.crossings) % 2 == 1  # it leaves the top downwards without passing it, and ends up
    record = chain_record(2, rate=20000.0)
    d = record.channel("x:m2") - record.channel("x:m1")
    after = np.flatnonzero(np.diff(np.sign(d[1:]))) + 1
    secant = record.time[after] - d[after] * record.step / (d[after + 1] - d[after])
    assert len(secant) == len(sink.crossings)
    np.testing.assert_allclose(secant, sink.crossings, atol=1e-7)  # secant over 50 us: (a h^2 / 8 v)


def test_crossings_that_samples_miss_are_found() -> None:
    """Sampled 20 times a second, most of the sink's passages lie between two samples on the same side."""
    coarse = lw.absorb(lw.bnes_chain(2), duration=6.0, rate=20.0, release=RELEASE)
    fine = lw.absorb(lw.bnes_chain(2), duration=6.0, rate=1000.0, release=RELEASE)
    np.testing.assert_allclose(coarse.sinks[0].crossings, fine.sinks[0].crossings, atol=1e-8)  # same numerics
    d = coarse.with_sinks.x[1:, 1] - coarse.with_sinks.x[1:, 0]
    assert np.sum(np.diff(np.sign(d)) != 0) < len(fine.sinks[0].crossings)


def test_locked_keeps_momentum_and_adds_the_mass() -> None:
    """The paper's chain with its sink held: 1.01 kg at 1/1.01 m/s, the same linear oscillator."""
    absorption = lw.absorb(lw.bnes_chain(2), duration=1.0, release=RELEASE, without="locked")
    w = np.sqrt(30000.0 / 1.01 - (0.5 / 1.01) ** 2)
    turn = np.arctan(w / (0.5 / 1.01)) / w
    peak = np.exp(-0.5 / 1.01 * turn) * np.sin(w * turn) / w / 1.01
    # the peak between samples, by a parabola through three of them
    assert absorption.masses[0].without.peak == pytest.approx(peak, rel=1e-5)
    assert absorption.without.total == pytest.approx(0.5 / 1.01, rel=1e-12)


def test_a_locked_link_keeps_the_elongation_it_starts_from() -> None:
    """What else hangs on the sink's mass sees it ahead of its host by that much, with its law as it was."""
    three = built(
        "a: m1-ground: k*d + c*v; s: m2-m1: p*d + q*d**3; b: m3-m2: k3*d**3", 1.0, 0.1, 0.5,
        k=100.0, c=1.0, p=-10.0, q=1e4, k3=500.0,
    )  # fmt: skip
    sinks = find_sinks(three, ("s",))
    excitation = lw.model.Excitation(
        release={"x:m1": 0.01, "x:m2": 0.04, "v:m2": 2.0},
        impulses=(lw.model.Impulse("m2", 0.5, 0.1),),
        forces={"m2": "sin(t)", "m1": "2"},
    )
    left, remaining = without_sinks(three, sinks, excitation, "locked")
    assert left.mass_names == ("m1", "m3") and left.mass_values.tolist() == [
        1.1,
        0.5,
    ]
    assert left.link("b").between == ("m3", "m1")
    d = np.linspace(-0.1, 0.1, 5)
    np.testing.assert_allclose(
        left.link("b").force(d), three.link("b").force(d - 0.03), rtol=1e-12, atol=1e-15
    )
    assert remaining.release == {"x:m1": 0.01, "v:m1": pytest.approx(0.2 / 1.1)}
    assert remaining.impulses[0].mass == "m1"
    force = remaining.forces["m1"]
    assert float(force.value(0.3)) == pytest.approx(2.0 + np.sin(0.3), rel=1e-12)


def test_which_mass_a_sink_carries() -> None:
    text = "a: m1-ground: k*d; s: m1-m2: p*d + q*d**3; b: m3-m1: k*d"
    plain = built(text, 0.1, 5.0, 1.0, k=1.0, p=-1.0, q=1.0)
    (leaf,) = find_sinks(plain)
    assert (leaf.mass, leaf.host) == ("m2", "m1")  # nothing else hangs on it, heavy as it is
    (lighter,) = find_sinks(plain, ("b",))
    assert (lighter.mass, lighter.host) == ("m3", "m1")
    grounded = built("a: m1-ground: p*d + q*d**3; b: m2-m1: k*d", 1.0, 1.0, p=-1.0, q=1.0, k=1.0)
    (sink,) = find_sinks(grounded)
    assert sink.mass is None and sink.host == "ground"


def test_a_linear_absorber_may_be_named_and_harvested_from() -> None:
    """The harvester is a damper in parallel: its share to that of the link's own damper is as their dampings."""
    tuned = built(
        "a: m1-ground: k*d + c*v; tmd: m2-m1: k2*d + c2*v", 1.0, 0.05, k=900.0, c=0.3, k2=40.0, c2=0.06
    )
    absorption = lw.absorb(tuned, sinks=("tmd",), duration=30.0, release=RELEASE, harvesters={"tmd": 0.02})
    (harvest,) = absorption.harvests
    assert harvest.share == pytest.approx(absorption.sinks[0].share * 0.02 / 0.06, rel=1e-9)
    assert harvest.average_power == pytest.approx(harvest.energy / 30.0, rel=1e-12)
    assert absorption.sinks_share == pytest.approx(absorption.sinks[0].share + harvest.share, rel=1e-12)
    with_sinks, without = absorption.settled
    # a damper tuned to the mass: 5.9 s against 20.0 s, and 60 % less motion
    assert with_sinks is not None and without is not None and with_sinks < 0.5 * without
    assert present(absorption.masses[0].rms_reduction) > 0.3 and not len(absorption.sinks[0].crossings)


@pytest.mark.slow
def test_forces_kinks_and_impulses_are_no_obstacle() -> None:
    """A one-sided stop on the sink: energy still closes, a blow counts as put in."""
    stop = built(
        "a: m1-ground: k*d + c*v; s: m2-m1: p*d + q*d**3 + c2*v; stop: m2-m1: kk*max(d - g, 0)", 1.0, 0.01,
        k=900.0, c=0.3, p=-100.0, q=1e6, c2=0.02, kk=1e4, g=0.012,
    )  # fmt: skip
    absorption = lw.absorb(stop, duration=1.0, impulses=(lw.model.Impulse("m1", 0.2, 0.1),))
    assert absorption.trusted and absorption.with_sinks.total == pytest.approx(0.5 * 0.04 + 0.0025, rel=1e-9)
    assert absorption.absorbing == ("s", "stop")
    side = lw.absorb(CHAIN, duration=1.0, rate=1000.0, forces={"m1": "20*sin(170*t)"}).with_sinks
    # identity; measured 2e-15
    known = side.dissipated.sum(axis=1) + side.stored
    np.testing.assert_allclose(known, side.supplied, atol=1e-12 * side.supplied.max())
    assert side.supplied[0] == pytest.approx(0.0025, rel=1e-12) and side.total > 1.0


LINEAR = built("a: m1-ground: k*d; b: m2-m1: k*d", 1.0, 1.0, k=100.0)
GROUNDED = built("s: m2-ground: p*d + q*d**3; b: m1-m2: k*d", 1.0, 0.1, k=100.0, p=-1.0, q=1.0)
NOTHING_LEFT = built("s: m2-ground: p*d + q*d**3; b: m1-m2: p*d + q*d**3", 1.0, 0.1, p=-1.0, q=1.0)
LONE = built("s: m1-ground: p*d + q*d**3", 1.0, p=-1.0, q=1.0)
CHAIN = lw.bnes_chain(2)
STRUCTURE, SIMULATION = lw.StructureError, lw.SimulationError


@pytest.mark.parametrize(
    ("structure", "changes", "error", "message"),
    [
        (CHAIN, {"sinks": ("spring1", "nes1")}, STRUCTURE, r"left with the sinks removed: no link has it as an end"),
        (CHAIN, {"release": {"v:m1": 0.0}}, SIMULATION, r"nothing sets the structure in motion"),
        (CHAIN, {"release": {}, "forces": {"m1": "0"}}, SIMULATION, r"removed nothing moves, so there is nothing"),
        (CHAIN, {"without": "frozen"}, STRUCTURE, r"way to take out sinks, 'frozen'; choose from 'removed', 'locked'"),
        (CHAIN, {"duration": 1e5}, SIMULATION, r"takes 5\.\de\+07 samples; give a lower rate"),
        (CHAIN, {"harvesters": {"nes1": -1.0}}, STRUCTURE, r'"nes1": the damping of a harvester must be positive, got -1.0'),
        (torsion_chain(), {"harvesters": {"sink": -1.0}, "release": {"v:disc1": 6.0}}, STRUCTURE, r", got -1\.0 N m s/rad"),
        (CHAIN, {"harvesters": {"nes3": 1.0}}, STRUCTURE, r'unknown link "nes3"'),
        (CHAIN, {"release": {"v:m7": 1.0}}, SIMULATION, r"unknown mass 'm7' in a release"),
        (CHAIN.unknown("nes"), {}, STRUCTURE, "coefficient alpha is unknown and has no start value"),
        (LINEAR, {}, STRUCTURE, r"no link of test has more than one stable well.*name the sinks among the links a, b"),
        (GROUNDED, {"without": "locked"}, STRUCTURE, 'link "s": the sink is linked to the ground: locked'),
        (NOTHING_LEFT, {"sinks": ("b", "s")}, STRUCTURE, "no valid structure is left with the sinks removed: no link has it"),
        (LONE, {}, STRUCTURE, r"every mass \(m1\) would belong to a sink.*name fewer sinks"),
    ],
)  # fmt: skip
def test_refusals(
    structure: lw.Structure, changes: dict[str, Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        lw.absorb(structure, **{"duration": 1.0, "release": RELEASE, **changes})


def test_the_text_says_what_matters_and_what_is_not_known(paper: lw.Absorption) -> None:
    text = str(paper)
    assert "With its sinks the RMS of the primary masses is 31.7 % smaller over 6 s." in text
    assert "109" in text and "2.379 s" in text
    assert paper.to_dict()["sinks"]["nes1"]["crossings"] == 109
    side = paper.with_sinks
    bad = replace(paper, with_sinks=replace(side, supplied=side.supplied - 2e-6 * side.total))
    assert paper.trusted and not bad.trusted
    assert "The energy balance with sinks has an error of 2e-06 of the energy supplied" in bad.findings[0]
    sink = CHAIN.link("nes1")
    start = {**sink.coefficients, "alpha": lw.Coefficient.unknown(-100.0)}
    guessed = lw.absorb(with_links(CHAIN, replace(sink, coefficients=start)), duration=0.5, release=RELEASE)
    assert "nes1.alpha is unknown: this result is for the start values." in guessed.findings


@pytest.mark.slow
def test_metres_and_radians_are_not_added() -> None:
    """Of two primaries in different units the reduction is that of parts of what each does without sinks."""
    chain = torsion_chain()
    frame = link("frame", "m1-ground", "k*d + c*v", k=900.0, c=0.5)
    mixed = lw.absorb(
        replace(chain, masses=(*chain.masses, *bodies({"m1": 1.0})), links=(*chain.links, frame)),
        duration=4.0,
        release={"v:disc1": 6.0, "v:m1": 0.01},
    )
    parts = [mass.with_sinks.rms / mass.without.rms for mass in mixed.masses]
    assert {mass.name for mass in mixed.masses} == {"disc1", "m1"}
    assert mixed.rms_reduction == pytest.approx(1.0 - np.sqrt(np.mean(np.square(parts))), rel=1e-12)
    assert [mixed.unit(name) for name in ("disc1", "m1")] == ["rad", "m"]
    swept = lw.absorption.absorption_map(
        mixed.with_sinks.structure,
        {"disc2.mass": [0.01]},
        duration=4.0,
        release={"v:disc1": 6.0, "v:m1": 0.01},
    )
    assert swept.axes[0].unit == "kg m^2"
    assert swept["rms_reduction"][0] == pytest.approx(present(mixed.rms_reduction), rel=1e-9)


def test_a_sink_that_starts_on_its_hilltop_is_a_finding_with_the_release_of_a_well() -> None:
    top = lw.absorb(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=0.2, rate=1000.0)
    assert top.findings[-1].startswith("nes1 starts on the top of its barrier between two wells")
    assert top.findings[-1].endswith("add the release x:m2=0.01.")
    well = lw.absorb(lw.bnes_chain(2), release={"v:m1": 1.0, "x:m2": 0.01}, duration=0.2, rate=1000.0)
    assert "barrier" not in " ".join(well.findings)


def test_every_field_has_its_keyword() -> None:
    names = {field.name for field in fields(lw.absorption.AbsorptionOptions)} - {"excitation"}
    assert names == set(AbsorptionKeywords.__annotations__) - set(ExcitationKeywords.__annotations__)


def test_both_at_once_and_unknown_keywords_are_refused() -> None:
    options = lw.absorption.AbsorptionOptions.of(duration=0.5, release=RELEASE)
    with pytest.raises(TypeError, match="got options and also duration; give one of the two"):
        lw.absorb(lw.bnes_chain(2), options, duration=1.0)
    with pytest.raises(TypeError, match="setle"):
        lw.absorption.AbsorptionOptions.of(duration=0.5, setle=0.1)  # type: ignore[call-arg]  # the point of the test


def test_without_a_duration_three_decay_times_are_simulated() -> None:
    """Of the first mass alone: 2 m/c = 2 s each."""
    assert lw.absorb(lw.bnes_chain(2), release=RELEASE).time[-1] == 6.0
    undamped = lw.bnes_chain(2).with_values({"spring1.c": 0.0})
    frequency = np.sqrt(3e4) / (2.0 * np.pi)
    assert lw.absorb(undamped, release=RELEASE).time[-1] == pytest.approx(300.0 / frequency, rel=0.05)
