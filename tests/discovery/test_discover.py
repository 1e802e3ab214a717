"""Discovery of structures that are known: nothing missing, nothing false, and a plain word where a record cannot tell."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from duffing_ring import SIZE, VALUES, ring
from present import some
from problems import chain_discovery, chain_record, linear_chain
from structures import link, row_of_masses, structure, with_links
from within import assert_discovered, graph, masses, terms

import linkwise as lw

pytestmark = pytest.mark.slow


DURATION, RATE = 3.0, 1000.0
Asked = tuple[lw.Structure, list[lw.Record]]


@pytest.fixture(scope="module")
def two() -> tuple[lw.Record, lw.Discovery]:
    """The two-mass chain at 20 dB, discovered."""
    return chain_record(2, duration=DURATION).with_noise(20.0, seed=1000), chain_discovery(2, 20.0, 1000)


@pytest.mark.parametrize(("n", "decibel"), [(2, 20.0), (4, 40.0), (6, 20.0)])
def test_the_papers_chain_is_found_exactly(n: int, decibel: float) -> None:
    chain = lw.bnes_chain(n)
    discovery = chain_discovery(n, decibel, 1000)
    assert_discovered(discovery, chain)
    assert all(term.certain for term in discovery.kept)


def trusted(record: lw.Record, structure: lw.Structure) -> lw.Structure | None:
    """What is discovered between the masses of `structure`, None where the answer is refused or not to be trusted."""
    try:
        discovery = lw.discover(record, masses(structure))
    except lw.IdentificationError:
        return None
    return discovery.structure if discovery.trusted else None


def test_what_is_found_in_much_noise_is_right_or_not_to_be_trusted() -> None:
    """At 5 dB the chain is found; at -8 dB it is lost, but the answer knows."""
    chain = lw.bnes_chain(2)
    record = chain_record(2)
    discovery = lw.discover(record.with_noise(5.0, seed=1000), masses(chain))
    assert discovery.trusted and terms(discovery.structure) == terms(chain)
    assert (
        discovery.remarks[0] == "m2 hardly moved above the noise: weak terms of links there will be missed."
    )
    assert trusted(record.with_noise(-8.0, seed=1000), chain) is None


def test_the_same_record_gives_the_same_answer_to_the_last_digit(two: tuple[lw.Record, lw.Discovery]) -> None:
    record, discovery = two
    again = lw.discover(record, masses(lw.bnes_chain(2)))
    assert again.estimate.values.tolist() == discovery.estimate.values.tolist()
    assert again.terms == discovery.terms
    assert repr(again.path) == repr(discovery.path)  # NaN where a share is not known
    assert again.runners_up == discovery.runners_up


def apart() -> lw.Structure:
    """Two two-mass chains that do not touch, the second on a stiffer spring."""
    chain = lw.bnes_chain(2)
    return structure(
        {"m1": 1.0, "m2": 0.01, "m3": 1.0, "m4": 0.01},
        *chain.links,
        link("other-spring1", "m3-ground", "k*d + c*v", k=40000.0, c=1.0),
        replace(chain.link("nes1"), name="other-nes1", between=("m4", "m3")),
    )


def moved(true: lw.Structure, snr_db: float, seed: int, duration: float = DURATION, **drives: Any) -> Asked:
    """A structure, and its record."""
    record = lw.simulate(true, **{"duration": duration, "rate": RATE, **drives})
    return true, [record.with_noise(snr_db, seed=seed)]


def apart_or(*links: lw.Link, seed: int) -> Asked:
    return moved(with_links(apart(), *links), 20.0, seed, release={"v:m1": 1.0, "v:m3": 0.8})


def driven(end: str, **drives: Any) -> Asked:
    """The chain of two, whose first spring ends at the ground or at a base."""
    chain = lw.bnes_chain(2)
    frame, *others = chain.links
    return moved(replace(chain, links=(replace(frame, between=("m1", end)), *others)), 30.0, 1000, **drives)


def twice() -> Asked:
    """The chain of two, hit at one mass and at the other."""
    hits = chain_record(2, duration=1.5), chain_record(2, duration=1.5, hit="m2", speed=2.0)
    return lw.bnes_chain(2), [hit.with_noise(20.0, seed=1000 + k) for k, hit in enumerate(hits)]


def coupled_ring(snr_db: float, seed: int, duration: float = 29.8) -> Asked:
    """Duffing oscillators at 2 Hz: few samples a period, where sums are no integrals of powers of them."""
    true = ring(*VALUES.reshape(3, SIZE))
    release = {f"x:{name}": 1.0 for name in true.mass_names}
    return moved(true, snr_db, seed, duration, rate=2.0, release=release)


CHAINS: dict[str, Callable[[], Asked]] = {
    "two structures that do not touch": lambda: apart_or(seed=1001),
    "a tenth of a spring between them": lambda: apart_or(link("touch", "m3-m1", "k*d", k=3000.0), seed=1000),
    "driven by the base": lambda: driven("base", base="0.01*sin(150*t) + 0.006*sin(190*t)"),
    "two records": twice,
    "sixty samples of a ring": lambda: coupled_ring(24.0, 5_003_010),
    "five samples a period": lambda: moved(
        lw.bnes_chain(2), 24.0, 5_003_011, 0.5, rate=137.5, release={"v:m1": 1.0}
    ),
    "four linear": lambda: (linear_chain(4).structure, [linear_chain(4).record(1000)]),
}


@pytest.mark.parametrize("name", CHAINS)
def test_the_structure_is_found_exactly(name: str) -> None:
    """And trusted from few samples, where sums over them as measured gave other terms."""
    true, records = CHAINS[name]()
    discovery = lw.discover(records, masses(true))
    assert terms(discovery.structure) == terms(true)
    assert discovery.trusted or "samples" not in name


def known_not_to_be(true: lw.Structure, *pairs: str) -> lw.Structure:
    return structure(dict(masses(true)), *(link(pair, pair, "0") for pair in pairs))  # type: ignore[arg-type]


@pytest.mark.parametrize("given", ["all links", "which are none", "further terms"])
def test_what_is_stated_or_offered_besides_changes_nothing(given: str, four: lw.Record) -> None:
    chain, none = lw.bnes_chain(4), ("m2-ground", "m4-m1", "m3-ground")
    stated = {"all links": chain.unknown("all"), "which are none": known_not_to_be(chain, *none)}.get(given)
    offer = "quintic, friction(0.01)" if given == "further terms" else "cubic"
    discovery = lw.discover(four, stated or masses(chain), terms=offer)
    assert terms(discovery.structure) == terms(chain)
    assert discovery.trusted or given != "all links"
    if given == "all links":
        assert not discovery.kept
        assert [link.name for link in discovery.structure.links] == [link.name for link in chain.links]
    if given == "which are none":
        assert len(discovery.terms) == (10 - 3) * 4
        asked = {frozenset(term.between) for term in discovery.terms}
        assert not asked & {frozenset(pair.split("-")) for pair in none}


@pytest.mark.usefixtures("memory_not_sought")
def test_a_displacement_whose_zero_is_off_is_not_trusted(two: tuple[lw.Record, lw.Discovery]) -> None:
    """Its links would bend about another place; the answer says where to look: at a constant force in that link."""
    record = two[0][:600]
    shifted = record.values + np.array([0.0, 0.02])
    discovery = lw.discover(replace(record, values=shifted, simulated=None), masses(lw.bnes_chain(2)))
    assert terms(discovery.structure) != terms(lw.bnes_chain(2)) and not discovery.trusted
    assert (discovery.diagnosis[0].term, discovery.diagnosis[0].where) == ("1", "m2-m1")
    assert "or a sensor has an error" in discovery.estimate.message


@pytest.mark.usefixtures("memory_not_sought")
def test_coloured_noise_gives_nothing_to_be_trusted() -> None:
    """A random walk in every channel is no noise that a sensor makes, and no motion of a structure either."""
    clean = chain_record(2, duration=1.5)
    walk = 1e-4 * np.cumsum(np.random.default_rng(1000).normal(size=clean.values.shape), axis=0)
    assert trusted(replace(clean, values=walk, simulated=None), lw.bnes_chain(2)) is None
    assert chain_discovery(2, 20.0, 1000).trusted


@pytest.fixture(scope="module")
def four() -> lw.Record:
    return chain_record(4, duration=3.0).with_noise(20.0, seed=1000)


def test_what_a_stated_structure_lacks_joins_it(two: tuple[lw.Record, lw.Discovery]) -> None:
    """The sink is stated without its cubic spring, the frame without its damper."""
    chain, unknown = lw.bnes_chain(2), lw.Coefficient.unknown()
    less = {"nes1": "alpha*d + c*v", "spring1": "k*d"}
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
    discovery = lw.discover(two[0], replace(chain, links=tuple(links)))
    assert terms(discovery.structure) == terms(chain)
    assert {term.name for term in discovery.kept} == {"nes1.k3", "spring1.c"}


@pytest.mark.usefixtures("memory_not_sought")
def test_a_link_wrongly_known_not_to_be_is_not_replaced_in_silence(
    two: tuple[lw.Record, lw.Discovery],
) -> None:
    """Without the sink's link to its frame the record cannot be explained."""
    record, _ = two
    discovery = lw.discover(record[:1000], known_not_to_be(lw.bnes_chain(2), "m2-m1"))
    assert frozenset({"m1", "m2"}) not in graph(discovery.structure)
    assert not discovery.trusted


@pytest.mark.parametrize(
    ("n", "sensor", "seed", "rounds"),
    [(2, "a", 1002, None), (4, "v", 2001, 2)],
    ids=["accelerations, a first fit in the other well", "velocities, a first tree from forces"],
)
def test_integrated_channels_are_trusted_with_noise(
    n: int, sensor: str, seed: int, rounds: int | None
) -> None:
    """Neither velocity nor acceleration says where its mass is; the likelihood needs neither."""
    chain = lw.bnes_chain(n)
    record = chain_record(n, duration=DURATION, sensors=(sensor,)).with_noise(30.0, seed=seed)
    discovery = lw.discover(record, masses(chain))
    assert terms(discovery.structure) == terms(chain)
    assert discovery.trusted and lw.Verdict.DISPLACEMENTS_INTEGRATED not in discovery.verdicts
    assert all(term.certain for term in some(discovery.kept))
    assert rounds in (None, discovery.rounds)


@pytest.mark.usefixtures("memory_not_sought")
def test_what_was_integrated_is_not_trusted_where_the_laws_leave_more_than_noise() -> None:
    """The sink has two wells, and no cubic term is offered."""
    chain = lw.bnes_chain(2)
    record = chain_record(2, duration=0.5, sensors=("a",)).with_noise(30.0, seed=1000)
    discovery = lw.discover(record, masses(chain), terms=["d"])
    assert lw.Verdict.DISPLACEMENTS_INTEGRATED in discovery.verdicts and not discovery.trusted
    assert any(remark.startswith("Some displacements were integrated") for remark in discovery.remarks)
    assert not any(term.certain for term in some(discovery.terms))


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


def test_of_many_masses_the_candidates_that_were_never_tested_are_counted() -> None:
    """Each mass is screened by itself before; links that are asked for are tested whatever the screen says."""
    law = "k*d + c*v"
    links = {f"l{k}": (law, {"k": 3000.0 - 90.0 * k, "c": 1.0}) for k in range(13)}
    true = row_of_masses([1.0 + 0.1 * k for k in range(13)], **links)
    release = {f"v:{name}": (-1.0) ** k for k, name in enumerate(true.mass_names) if k % 3}
    record = lw.simulate(true, release=release, duration=1.0, rate=200.0).with_noise(40.0, seed=1)
    reports: list[lw.estimates.ProgressReport] = []
    discovery = lw.discover(record, masses(true), terms="v, d", progress=reports.append)
    assert terms(discovery.structure) == terms(true)
    untested = 13 * 14 - len(discovery.terms)
    assert untested == len(discovery.untested) == len(discovery.to_dict()["untested"]) > 0
    assert {term.name for term in discovery.terms}.isdisjoint(discovery.untested)
    assert [
        remark for remark in discovery.remarks if remark.startswith(f"{untested} candidates that were sig")
    ]
    assert_one_way(reports, first="screening 182 candidates")
    assert reports[1].activity == "screening the links of m1"
    first, second = discovery.untested[0].partition(".")[0].split("-")
    asked = lw.discover(record, masses(true), terms="v, d", tested=f"{second}-{first}")
    gained = {name for name in discovery.untested if name.startswith(f"{first}-{second}.")}
    assert set(discovery.untested) - set(asked.untested) == gained
    assert gained <= {term.name for term in asked.terms} and terms(asked.structure) == terms(true)
    with pytest.raises(
        lw.StructureError, match='"m1-m99" is not a link that is looked for: give its two ends'
    ):
        lw.discover(record, masses(true), tested="m1-m99")


def assert_one_way(reports: list[lw.estimates.ProgressReport], first: str) -> None:
    """Fractions rise from zero, and the last stage is the judgement."""
    fractions = [report.fraction for report in reports]
    assert fractions == sorted(fractions) and fractions[0] == 0.0 and fractions[-1] < 1.0
    assert (reports[0].activity, reports[-1].activity) == (first, "judging the terms selected")


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
