"""Discovery of structures that are known: nothing missing, nothing false, and a plain word where a record cannot tell."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from judged import graph, masses, terms
from present import present, some
from problems import chain_discovery, chain_record, linear_chain
from random_structures import random_case
from scipy.signal import lfilter
from structures import link, row_of_masses, structure, with_links

import linkwise as lw
from linkwise.discovery import screen

DURATION, RATE = 3.0, 1000.0
SINE = "60*sin(150*t) + 40*sin(190*t)"


@pytest.fixture(scope="module")
def two() -> tuple[lw.Record, lw.Discovery]:
    """The two-mass chain at 20 dB, discovered."""
    return chain_record(2, duration=DURATION).with_noise(20.0, seed=1000), chain_discovery(2, 20.0, 1000)


@pytest.mark.parametrize(
    ("n", "decibel", "seed"),
    [
        *((n, 20.0, seed) for n in (2, 4, 6) for seed in (1000, 1001)),
        (10, 20.0, 1000),
        (2, 30.0, 1000), (4, 40.0, 1000), (6, 30.0, 1000),
    ],
)  # fmt: skip
def test_the_papers_chain_is_found_exactly(n: int, decibel: float, seed: int) -> None:
    chain = lw.bnes_chain(n)
    discovery = chain_discovery(n, decibel, seed)
    assert discovery.trusted
    assert terms(discovery.structure) == terms(chain)
    assert all(term.certain for term in some(discovery.kept))


def test_what_is_found_lies_in_its_intervals(two: tuple[lw.Record, lw.Discovery]) -> None:
    """Within four standard errors each (6e-5 of chance)."""
    _, discovery = two
    chain = lw.bnes_chain(2)
    true_names = {"m1-ground.k": "spring1.k", "m1-ground.c": "spring1.c", "m2-m1.k": "nes1.alpha", "m2-m1.k3": "nes1.beta",
            "m2-m1.c": "nes1.c"}  # fmt: skip
    for name, true in true_names.items():
        estimate = discovery.estimate.coefficient(name)
        error = abs(estimate.value - present(chain.coefficient(true).value))
        assert error < 4.0 * present(estimate.standard_error)


def trusted(record: lw.Record, structure: lw.Structure) -> lw.Structure | None:
    """What is discovered between the masses of `structure`, None where the answer is refused or not to be trusted."""
    try:
        discovery = lw.discover(record, masses(structure))
    except lw.IdentificationError:
        return None
    return discovery.structure if discovery.trusted else None


def test_what_is_found_in_much_noise_is_right_or_not_to_be_trusted() -> None:
    """At 5 dB the chain is found; at 0 dB it may be lost, and at -8 dB it is, but the answer knows."""
    chain = lw.bnes_chain(2)
    discovery = lw.discover(chain_record(2).with_noise(5.0, seed=1000), masses(chain))
    assert discovery.trusted and terms(discovery.structure) == terms(chain)
    assert (
        discovery.remarks[0] == "m2 hardly moved above the noise: weak terms of links there will be missed."
    )
    faint = trusted(chain_record(2).with_noise(0.0, seed=1000), chain)
    assert faint is None or terms(faint) == terms(chain)
    assert trusted(chain_record(2).with_noise(-8.0, seed=1000), chain) is None


def test_one_link_has_one_set_of_coefficients(two: tuple[lw.Record, lw.Discovery]) -> None:
    _, discovery = two
    links = [link for link in discovery.structure.links if set(link.between) == {"m1", "m2"}]
    assert len(links) == 1
    names = [term.name for term in discovery.terms]
    assert len(names) == len(set(names)) == 12
    assert not [name for name in names if name.startswith("m1-m2")]


def test_the_same_record_gives_the_same_answer_to_the_last_digit(two: tuple[lw.Record, lw.Discovery]) -> None:
    record, discovery = two
    again = lw.discover(record, masses(lw.bnes_chain(2)))
    assert again.estimate.values.tolist() == discovery.estimate.values.tolist()
    assert again.terms == discovery.terms
    assert again.path == discovery.path
    assert again.runners_up == discovery.runners_up
    another = chain_discovery(2, 20.0, 1001)
    assert another.estimate.values.tolist() != discovery.estimate.values.tolist()


def test_the_answer_is_the_input_of_what_comes_next(two: tuple[lw.Record, lw.Discovery]) -> None:
    """Written, read, simulated, and identified again with all its coefficients unknown: the same numbers."""
    record, discovery = two
    structure = lw.parse_structure(lw.model.format_structure(discovery.structure))
    assert terms(structure) == terms(discovery.structure)
    lw.simulate(structure, release={"v:m1": 1.0}, duration=0.1, rate=RATE)
    fit = lw.identify(record, structure.unknown("all"))
    for parameter in some(fit.parameters):
        ours, theirs = discovery.estimate.coefficient(parameter.name), fit.coefficient(parameter.name)
        # two searches that end within 0.02 of the least cost each
        assert abs(ours.value - theirs.value) < 2.0 * np.sqrt(0.02) * theirs.standard_error


@pytest.mark.parametrize("n", [2, 4])
@pytest.mark.parametrize("seed", [1000, 1001])
def test_a_linear_chain_has_no_nonlinear_term(n: int, seed: int) -> None:
    true = linear_chain(n).structure
    discovery = lw.discover(linear_chain(n).record(seed), masses(true))
    assert terms(discovery.structure) == terms(true)
    assert not {"d**2", "d**3"} & {term.term for term in discovery.kept}


def apart() -> lw.Structure:
    """Two two-mass chains that do not touch, the second on a stiffer spring."""
    chain = lw.bnes_chain(2)
    return structure(
        {"m1": 1.0, "m2": 0.01, "m3": 1.0, "m4": 0.01},
        *chain.links,
        link("other-spring1", "m3-ground", "k*d + c*v", k=40000.0, c=1.0),
        replace(chain.link("nes1"), name="other-nes1", between=("m4", "m3")),
    )


@pytest.mark.parametrize("seed", [1000, 1001])
def test_structures_that_do_not_touch_have_no_link_between_them(seed: int) -> None:
    true = apart()
    record = lw.simulate(true, release={"v:m1": 1.0, "v:m3": 0.8}, duration=DURATION, rate=RATE)
    discovery = lw.discover(record.with_noise(20.0, seed=seed), masses(true))
    assert graph(discovery.structure) == graph(true)
    assert terms(discovery.structure) == terms(true)


def test_where_they_do_touch_the_link_is_found() -> None:
    """A tenth of the weaker spring's stiffness between the two frames, and no damper with it."""
    true = apart()
    true = with_links(true, link("touch", "m3-m1", "k*d", k=3000.0))
    record = lw.simulate(true, release={"v:m1": 1.0, "v:m3": 0.8}, duration=DURATION, rate=RATE)
    discovery = lw.discover(record.with_noise(20.0, seed=1000), masses(true))
    assert terms(discovery.structure) == terms(true)


@pytest.mark.parametrize("n", [2, 4])
@pytest.mark.parametrize("stated", [False, True])
def test_noise_alone_has_no_structure_and_the_answer_says_so(n: int, stated: bool) -> None:
    clean = chain_record(n, duration=DURATION)
    values = 1e-3 * np.random.default_rng(1000).normal(size=clean.values.shape)
    noise: dict[str, float] = dict.fromkeys(clean.channels, 1e-3) if stated else {}
    record = replace(clean, values=values, noise=noise, simulated=None)
    with pytest.raises(
        lw.IdentificationError, match="no motion above the noise in any channel, so no structure can be found"
    ):
        lw.discover(record, masses(lw.bnes_chain(n)))
    faint = replace(record, values=values + clean.values)  # what moves is no noise
    hardly = "m1 hardly moved above the noise: weak terms of links there will be missed."
    assert lw.discovery.check_discovery(faint, masses(lw.bnes_chain(n))) == (
        (hardly,) if n == 2 else ()
    )  # the longer chain was hit harder


def test_a_displacement_whose_zero_is_off_is_not_trusted(two: tuple[lw.Record, lw.Discovery]) -> None:
    """Its links would bend about another place; the answer says where to look: at a constant force in that link."""
    record = two[0][:1000]
    shifted = record.values + np.array([0.0, 0.02])
    discovery = lw.discover(replace(record, values=shifted, simulated=None), masses(lw.bnes_chain(2)))
    assert terms(discovery.structure) != terms(lw.bnes_chain(2)) and not discovery.trusted
    assert (discovery.diagnosis[0].term, discovery.diagnosis[0].where) == ("1", "m2-m1")
    assert "or a sensor has an error" in discovery.estimate.message


def test_coloured_noise_gives_nothing_to_be_trusted() -> None:
    """A random walk in every channel is no noise that a sensor makes, and no motion of a structure either."""
    clean = chain_record(2, duration=DURATION)
    walk = 1e-4 * np.cumsum(np.random.default_rng(1000).normal(size=clean.values.shape), axis=0)
    assert trusted(replace(clean, values=walk, simulated=None), lw.bnes_chain(2)) is None
    assert chain_discovery(2, 20.0, 1000).trusted


@pytest.fixture(scope="module")
def four() -> lw.Record:
    return chain_record(4, duration=3.0).with_noise(20.0, seed=1000)


def test_a_stated_structure_is_kept_and_nothing_joins_it(four: lw.Record) -> None:
    stated = lw.bnes_chain(4).unknown("all")
    discovery = lw.discover(four, stated)
    assert [link.name for link in discovery.structure.links] == [link.name for link in stated.links]
    assert terms(discovery.structure) == terms(lw.bnes_chain(4))
    assert not discovery.kept and discovery.trusted


def test_what_a_stated_structure_lacks_joins_it(four: lw.Record) -> None:
    """The sinks are stated without their cubic springs, the second frame without its damper."""
    chain, unknown = lw.bnes_chain(4), lw.Coefficient.unknown()
    less = {"nes1": "alpha*d + c*v", "nes2": "alpha*d + c*v", "spring2": "k*d"}
    links = [
        replace(
            link,
            law=(law := lw.Law.parse(less[link.name])),
            coefficients=dict.fromkeys(law.coefficients, unknown),
        )
        if link.name in less
        else link
        for link in chain.unknown("all").links
    ]
    discovery = lw.discover(four, replace(chain, links=tuple(links)))
    assert terms(discovery.structure) == terms(chain)
    assert {term.name for term in discovery.kept} == {"nes1.k3", "nes2.k3", "spring2.c"}


def known_not_to_be(masses_: tuple[lw.Mass, ...], *pairs: tuple[str, str]) -> lw.Structure:
    none = (link("-".join(pair), "-".join(pair), "0") for pair in pairs)
    return structure({mass.name: mass.mass for mass in masses_}, *none)


def test_a_link_that_is_known_not_to_be_is_not_found(four: lw.Record) -> None:
    chain = lw.bnes_chain(4)
    pairs = [("m2", "ground"), ("m4", "m1"), ("m3", "ground")]
    discovery = lw.discover(four, known_not_to_be(chain.masses, *pairs))
    assert terms(discovery.structure) == terms(chain)
    assert len(discovery.terms) == (10 - 3) * 4
    assert not {frozenset(pair) for pair in pairs} & {frozenset(term.between) for term in discovery.terms}


def test_a_link_that_is_wrongly_known_not_to_be_is_not_replaced_in_good_faith(
    two: tuple[lw.Record, lw.Discovery],
) -> None:
    """Without the sink's link to its frame the record cannot be explained."""
    record, _ = two
    discovery = lw.discover(record[:1000], known_not_to_be(lw.bnes_chain(2).masses, ("m2", "m1")))
    assert frozenset({"m1", "m2"}) not in graph(discovery.structure)
    assert not discovery.trusted


def test_terms_that_are_not_there_cost_nothing(four: lw.Record) -> None:
    discovery = lw.discover(four, masses(lw.bnes_chain(4)), terms="quintic, friction(0.01)")
    assert terms(discovery.structure) == terms(lw.bnes_chain(4))


@pytest.mark.parametrize(
    ("end", "drives", "channel"),
    [("ground", {"forces": {"m1": SINE}}, "force:m1"), ("base", {"base": "0.01*sin(150*t) + 0.006*sin(190*t)"}, "x:base")],
)  # fmt: skip
def test_a_structure_that_is_driven_is_found_from_the_record_of_what_drives_it(
    end: str, drives: dict[str, Any], channel: str
) -> None:
    chain = lw.bnes_chain(4)
    frame, *others = chain.links
    chain = replace(chain, links=(replace(frame, between=("m1", end)), *others))
    record = lw.simulate(chain, duration=DURATION, rate=RATE, **drives).with_noise(30.0, seed=1000)
    assert channel in record.channels
    discovery = lw.discover(record, masses(chain))
    assert terms(discovery.structure) == terms(chain)


def test_two_records_of_one_structure_tell_together(four: lw.Record) -> None:
    chain = lw.bnes_chain(4)
    second = chain_record(4, duration=3.0, hit="m3", speed=2.0)
    records = [
        chain_record(4, duration=3.0).with_noise(20.0, seed=1000), second.with_noise(20.0, seed=1001),
    ]  # fmt: skip
    assert terms(lw.discover(records, masses(chain)).structure) == terms(chain)


@pytest.mark.parametrize("sensor", ["v", "a"])
def test_what_was_integrated_is_trusted_where_the_laws_leave_only_noise(sensor: str) -> None:
    """Neither velocity nor acceleration says where its mass is; the likelihood needs neither."""
    chain = lw.bnes_chain(2)
    record = chain_record(2, duration=DURATION, sensors=(sensor,)).with_noise(30.0, seed=1000)
    discovery = lw.discover(record, masses(chain))
    assert terms(discovery.structure) == terms(chain)
    assert discovery.trusted and lw.Verdict.DISPLACEMENTS_INTEGRATED not in discovery.verdicts
    assert all(term.certain for term in some(discovery.kept))


def test_what_was_integrated_is_not_trusted_where_the_laws_leave_more_than_noise() -> None:
    """The sink has two wells, and no cubic term is offered."""
    chain = lw.bnes_chain(2)
    record = chain_record(2, duration=1.0, sensors=("a",)).with_noise(30.0, seed=1000)
    discovery = lw.discover(record, masses(chain), terms=["d"])
    assert lw.Verdict.DISPLACEMENTS_INTEGRATED in discovery.verdicts and not discovery.trusted
    assert any(remark.startswith("Some displacements were integrated") for remark in discovery.remarks)
    assert not any(term.certain for term in some(discovery.terms))


def test_states_that_accelerations_put_on_a_wrong_branch_are_computed_again() -> None:
    """The first fit of this record leaves a part of the motion in the other well, and later ones start from its states."""
    chain = lw.bnes_chain(2)
    record = chain_record(2, duration=DURATION, sensors=("a",)).with_noise(30.0, seed=1002)
    assert terms(lw.discover(record, masses(chain)).structure) == terms(chain)


def test_a_mass_at_rest_is_left_out_and_the_rest_is_found() -> None:
    """The second of two chains is never hit; its sensors show noise."""
    true = apart()
    record = lw.simulate(true, release={"v:m1": 1.0}, duration=DURATION, rate=RATE)
    noise = np.sqrt(np.mean(record.values[:, 0] ** 2)) / 10.0
    values = record.values + noise * np.random.default_rng(1000).normal(size=record.values.shape)
    for measured in (values, np.where(np.arange(4) < 2, values, 0.0)):  # or nothing at all
        discovery = lw.discover(replace(record, values=measured, simulated=None), masses(true))
        assert terms(discovery.structure) == terms(lw.bnes_chain(2))
        assert discovery.structure.mass_names == ("m1", "m2")
        assert discovery.remarks[0].startswith("m3 and m4 did not move above the noise and are left out")


def test_links_that_are_known_need_not_hold_all_masses(tmp_path: Path, four: lw.Record) -> None:
    """A file that states one spring, and nothing of the rest."""
    text = lw.model.format_structure(lw.bnes_chain(4))
    whole = "".join(
        f"[[{part}" for part in text.split("[[")[1:] if not part.startswith("link") or '"spring1"' in part
    )
    (tmp_path / "known.toml").write_text(whole, encoding="utf-8")
    known = lw.model.read_partial_structure(tmp_path / "known.toml")
    assert [link.name for link in known.links] == ["spring1"]
    discovery = lw.discover(four, known)
    assert terms(discovery.structure) == terms(lw.bnes_chain(4))
    assert discovery.structure.coefficient("spring1.k").value == 30000.0  # stated as a number
    assert "spring1.k" not in [term.name for term in discovery.terms]
    assert discovery.certainty("spring1") == np.inf
    assert 0.0 < discovery.certainty("m2-m1") < np.inf
    strange = replace(known.links[0], name="far", between=("m1", "m9"))
    with pytest.raises(lw.StructureError, match='"m9" is not a mass; choose from "ground", "base" and'):
        lw.discover(four, replace(known, links=(strange,)))


@pytest.mark.parametrize("seed", [1000, 1001])
def test_random_structures_are_found(seed: int) -> None:
    case = random_case(seed)
    discovery = lw.discover(case.record.with_noise(30.0, seed=seed), masses(case.structure))
    assert graph(discovery.structure) == graph(case.structure)


def test_candidates_that_were_never_tested_are_counted(
    four: lw.Record, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beyond some masses each is screened by itself before; here beyond one."""
    monkeypatch.setattr(screen, "_TOGETHER", 1)
    reports: list[lw.estimates.ProgressReport] = []
    discovery = lw.discover(four, masses(lw.bnes_chain(4)), progress=reports.append)
    assert terms(discovery.structure) == terms(lw.bnes_chain(4))
    untested = 40 - len(discovery.terms)
    assert untested == len(discovery.untested) == len(discovery.to_dict()["untested"]) > 0
    assert {term.name for term in discovery.terms}.isdisjoint(discovery.untested)
    activities = [report.activity for report in reports]
    assert activities[1:9] == [
        f"screening the links of m{number}{again}" for again in ("", " again") for number in range(1, 5)
    ]
    assert activities[9].endswith(" candidates together")
    fractions = [report.fraction for report in reports]
    assert fractions == sorted(fractions)
    remark = (
        f"{untested} candidates that were significant in the equation of neither of their masses were dropped without "
        "a test by likelihood. The result folder lists them as untested; one or all of these links can be asked for."
    )
    assert remark in discovery.remarks


def test_links_that_are_asked_for_are_tested_whatever_the_screen_says(
    four: lw.Record, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By their ends in either order; the answer remains."""
    monkeypatch.setattr(screen, "_TOGETHER", 1)
    kilograms, found = masses(lw.bnes_chain(4)), terms(lw.bnes_chain(4))
    before = lw.discover(four, kilograms)
    dropped = sorted({name.rpartition(".")[0] for name in before.untested})[0]
    first, second = dropped.split("-")
    asked = lw.discover(four, kilograms, tested=f"{second}-{first}")
    gained = {name for name in before.untested if name.startswith(f"{dropped}.")}
    assert set(before.untested) - set(asked.untested) == gained
    assert gained <= {term.name for term in asked.terms}
    everything = lw.discover(four, kilograms, tested=["all"])
    assert not everything.untested and len(everything.terms) == 40
    assert terms(asked.structure) == terms(everything.structure) == found
    with pytest.raises(
        lw.StructureError, match='"m1-m9" is not a link that is looked for: give its two ends'
    ):
        lw.discover(four, kilograms, tested="m1-m9")


def test_progress_goes_one_way_and_names_its_stages(four: lw.Record) -> None:
    reports: list[lw.estimates.ProgressReport] = []
    lw.discover(four, masses(lw.bnes_chain(4)), progress=reports.append)
    progress = [(report.fraction, report.activity) for report in reports]
    assert [fraction for fraction, _ in progress] == sorted(fraction for fraction, _ in progress)
    assert progress[0] == (0.0, "screening 40 candidates")
    assert all(0.0 <= fraction < 1.0 for fraction, _ in some(progress))
    assert progress[-3][1].startswith("round 1: q ")
    assert [activity for _, activity in progress[-2:]] == [
        "round 1: testing 40 candidates",
        "judging the terms selected",
    ]


@pytest.mark.parametrize(
    ("masses_", "message"),
    [
        ({}, "discovery needs at least one mass, got none; give masses by name"),
        ({"m1": "10 mm", "m2": 1.0}, "mass \"m1\": '10 mm' is in mm: expected a number in kg"),
        ({"m1": 1.0, "m2": float("nan")}, 'mass "m2": nan is not finite'),
    ],
)
def test_masses_that_are_none_are_refused(four: lw.Record, masses_: dict[str, Any], message: str) -> None:
    with pytest.raises(lw.LinkwiseError, match=message):
        lw.discover(four, masses_)


def test_no_record_is_refused() -> None:
    with pytest.raises(lw.IdentificationError, match="discovery needs at least one record, got none"):
        lw.discover([], {"m1": 1.0})


def two_of_four_joined() -> lw.Structure:
    """Four masses, the last two of which are all but rigidly joined: which of them holds the spring to the others cannot be
    told."""
    values = {"m1-ground": (4e3, 0.4), "m2-m1": (2e3, 0.2), "m3-m2": (500.0, 0.1), "m4-m3": (4e5, 0.5)}
    links = {name: ("k*d + c*v", {"k": k, "c": c}) for name, (k, c) in values.items()}
    return row_of_masses([1.0, 0.5, 0.3, 0.1], **links)


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


def test_links_in_doubt_beside_coloured_noise_are_not_trusted() -> None:
    """What a wrong link leaves looks as such noise does: on a record with white noise alone a wrong set of links was excused
    by it, with a damping 6.6 standard errors off."""
    true = two_of_four_joined()
    clean = lw.simulate(true, release={"v:m1": 1.0}, duration=3.0, rate=RATE)
    rng = np.random.default_rng(1000)
    noise = rng.normal(size=clean.values.shape)
    noise[:, 0] = lfilter([np.sqrt(1.0 - 0.7**2)], [1.0, -0.7], noise[:, 0])  # AR(1) of unit power
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
