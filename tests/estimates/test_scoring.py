"""A structure that was found beside the true one: terms are compared by what they do, links by their ends."""

from dataclasses import replace

import numpy as np
import pytest
from structures import link, structure

import linkwise as lw


def built(*links: tuple[str, str, str, dict[str, float]], masses: str = "m1 m2") -> lw.Structure:
    """Masses of 1 kg and links given as name, ends, law and numbers."""
    joined = (link(name, ends, law, **numbers) for name, ends, law, numbers in links)
    return structure(dict.fromkeys(masses.split(), 1.0), *joined)


SPRING = ("m1-ground", "m1-ground", "k*d + c*v", {"k": 30000.0, "c": 1.0})
SINK = ("m2-m1", "m2-m1", "k*d + k3*d**3 + c*v", {"k": -100.0, "k3": 1e6, "c": 0.02})


def test_other_names_are_the_same_terms(chain: lw.Structure) -> None:
    score = lw.discovery.term_score(built(SPRING, SINK), chain)
    assert score.exact and score.right == tuple(
        f"{link[0]}.{name}" for link in (SPRING, SINK) for name in lw.Law.parse(link[2]).coefficients
    )


def test_missing_and_false_terms_are_named(chain: lw.Structure) -> None:
    lost = ("m2-m1", "m2-m1", "k*d + k2*d**2 + c*v", {"k": -100.0, "k2": 1.0, "c": 0.02})
    stray = ("m2-ground", "m2-ground", "k*d", {"k": 3.0})
    score = lw.discovery.term_score(built(SPRING, lost, stray), chain)
    assert not score.exact
    assert score.missing == ("nes1.beta",) and score.extra == ("m2-m1.k2", "m2-ground.k")
    assert score.missing_links == () and score.extra_links == ("m2-ground",)
    bare = lw.discovery.term_score(built(SPRING, ("m2-ground", "m2-ground", "k*d", {"k": 3.0})), chain)
    assert bare.missing_links == ("nes1",) and set(bare.missing) == {"nes1.alpha", "nes1.beta", "nes1.c"}


@pytest.mark.parametrize(
    "law", ["k*d + q*d**2 + g*max(d - 0.01, 0) + F*tanh(v/e)", "2000*d + q*d**2 + c*v*abs(v)"]
)
def test_ends_may_be_exchanged(law: str) -> None:
    """The force that the true link exerts on m2 is the same, whichever end its law is written for."""
    names = lw.Law.parse(law).coefficients
    true = built(SPRING, ("gap", "m1-m2", law, {name: 0.3 + k for k, name in enumerate(names)}))
    aligned = lw.discovery.align_truth(built(SPRING, SINK), true).link("m2-m1")
    d, v = np.random.default_rng(1).normal(size=(2, 50))
    np.testing.assert_allclose(aligned.force(d, v), -true.link("gap").force(-d, -v), rtol=1e-12, atol=1e-12)
    assert aligned.between == ("m2", "m1") and aligned.values["k3"] == 0.0


def test_a_factor_or_a_number_in_a_law_is_no_other_term() -> None:
    true = built(("spring", "m1-ground", "30000*d + c*v", {"c": 1.0}), SINK)
    discovered = built(("m1-ground", "m1-ground", "k*2*d + c*v", {"k": 15000.0, "c": 1.0}), SINK)
    assert lw.discovery.term_score(discovered, true).exact
    assert lw.discovery.align_truth(discovered, true).link("m1-ground").values == pytest.approx(
        {"k": 15000.0, "c": 1.0}, rel=1e-12
    )


def test_a_coefficient_of_zero_is_no_term() -> None:
    none = ("nes1", "m2-m1", "k*d + k2*d**2 + k3*d**3 + c*v", {"k": -100.0, "k2": 0.0, "k3": 1e6, "c": 0.02})
    first, second = built(SPRING, SINK), built(SPRING, none)
    assert lw.discovery.term_score(first, second).exact and lw.discovery.term_score(second, first).exact


def test_other_masses_cannot_be_compared(chain: lw.Structure) -> None:
    discovered = built(SPRING, ("x", "big-m1", "k*d", {"k": 1.0}), masses="m1 big")
    with pytest.raises(
        lw.StructureError, match="does not have the mass big, so the two cannot be compared; it has m1, m2"
    ):
        lw.discovery.term_score(discovered, chain)


def test_laws_with_memory_are_refused_by_name(chain: lw.Structure) -> None:
    given = {"sigma": 1e4, "Fc": 1.0, "c": 0.1}
    joint = lw.model.named_law("dahl").link("joint", ("m2", "m1"), given)
    with_memory = replace(chain, links=(chain.links[0], joint))
    message = (
        r'link "joint": the law has memory \(state q\), which is not supported in the comparison with a truth'
    )
    for pair in ((chain, with_memory), (with_memory, chain)):
        for compare in (lw.discovery.term_score, lw.discovery.align_truth):
            with pytest.raises(lw.StructureError, match=message):
                compare(*pair)
