"""What a discovery looks like: printed, drawn, and as a folder that is complete in itself."""

from __future__ import annotations

from dataclasses import replace

import pytest

import linkwise as lw


@pytest.fixture(scope="module")
def found(chain: lw.Structure) -> lw.Discovery:
    """The paper's two-mass chain, from three seconds at 30 dB."""
    record = lw.simulate(chain, release={"v:m1": 1.0}, duration=3.0, rate=1000.0).with_noise(30.0, seed=1001)
    return lw.discover(record, {mass.name: mass.mass.value or 0.0 for mass in chain.masses})


def in_doubt(found: lw.Discovery, name: str, **changes: object) -> lw.Discovery:
    """The same with one decision that is hardly one."""
    terms = tuple(replace(t, margin=1.5, **changes) if t.name == name else t for t in found.terms)
    return replace(found, terms=terms)


def test_verdict_comes_first_then_links_by_certainty(found: lw.Discovery) -> None:
    lines = str(found).splitlines()
    assert lines[0] == "2 masses, 2 links with 5 terms: can be trusted"
    first, second = lines.index("m1-ground, linear: k*d + c*v"), lines.index("m2-m1, bistable: k*d + k3*d**3 + c*v")
    assert found.certainty("m1-ground") > found.certainty("m2-m1") and first < second
    stiffness = found.estimate.coefficient("m1-ground.k")
    assert f"{stiffness.value:.1f}" in lines[first + 1] and lines[first + 1].endswith("N/m")


def test_one_doubt_is_marked_and_the_others_are_not(found: lw.Discovery) -> None:
    sure = replace(found, terms=tuple(term for term in found.terms if term.certain))
    assert "Every decision is beyond doubt." in str(sure) and "in doubt" not in str(sure)
    text = str(in_doubt(sure, "m2-m1.k3"))
    assert "In doubt: 1 of the terms found." in text and "N/m^3  in doubt" in text
    assert "(in doubt)" not in text  # the link itself stands by its other terms
    assert "(in doubt)" in str(in_doubt(in_doubt(sure, "m1-ground.k"), "m1-ground.c"))


def test_what_cannot_be_told_says_so(found: lw.Discovery) -> None:
    name = next(term.name for term in found.terms if not term.kept)
    text = str(in_doubt(found, name, told=False))
    assert "not told beside what was kept" in text


def test_a_search_that_did_not_settle_is_not_to_be_trusted(found: lw.Discovery) -> None:
    assert found.trusted
    lost = replace(found, settled=False, remarks=("m2 hardly moved.",))
    text = str(lost)
    assert not lost.trusted and text.splitlines()[0].endswith("NOT to be trusted")
    assert "The search did not settle: this is the best so far." in text and "! m2 hardly moved." in text


def test_price_is_what_stands_between_evidence_and_margin(found: lw.Discovery) -> None:
    """Within a link a term costs the same whether it is in or out; to begin a link costs more."""
    prices = {term.name: term.price for term in found.terms}
    assert prices["m2-m1.k2"] == pytest.approx(prices["m1-ground.k3"], rel=1e-8)  # same numerics
    assert prices["m2-m1.k3"] == pytest.approx(prices["m2-m1.k2"], abs=1e-8 * found.kept[0].z ** 2)
    assert prices["m2-ground.k"] > prices["m2-m1.k2"]


def test_stated_links_are_certain(chain: lw.Structure, found: lw.Discovery) -> None:
    stated = lw.Structure(chain.name, chain.masses, (chain.link("spring1"), chain.unknown("nes").link("nes1")))
    known = lw.discover(found.estimate.record, stated)
    assert known.certainty("spring1") == known.certainty("nes1") == float("inf")
    assert "stated" in str(known) and "given" in str(known)
