"""What laws with the likeliest missing term say of an answer: that it stands, or what the model error hid."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from present import present
from problems import truth
from structures import NES, link, structure

import linkwise as lw
from linkwise.estimates.cause import Cause
from linkwise.likelihood.richer_laws import with_cause

MASSES = {"m1": 1.0, "m2": 0.01}
SINK = link("nes1", "m2-m1", NES, alpha=-100.0, beta=1e6, c=0.02)
STATED = structure(MASSES, link("spring1", "m1-ground", "k*d + c*v", k=3e4, c=1.0), SINK)
SPRING = link("cable", "m2-ground", "k*d", k=4.0)
DAMPER = link("oil", "m2-ground", "c*v", c=0.002)


@cache
def answer(cubic: float, speed: float, seed: int, *missing: lw.Link) -> lw.Estimate:
    """The answer of the stated laws, where the host's spring hardens by a few percent and `missing` links were not stated."""
    harder = link("spring1", "m1-ground", "k*d + c*v + g*d**3", k=3e4, c=1.0, g=cubic)
    whole = structure(MASSES, harder, SINK, *missing)
    record = lw.simulate(whole, release={"v:m1": speed}, duration=6.0, rate=1000.0).with_noise(
        30.0, seed=seed
    )
    return lw.identify(record, STATED.unknown("all"))


@pytest.mark.parametrize("seed", [61, 62])
def test_an_answer_stands_where_its_laws_lack_one_term(seed: int) -> None:
    fit = answer(2e7, 1.0, seed)
    assert fit.verdicts == (lw.Verdict.MODEL_ERROR_NEEDED,)
    assert fit.message.endswith(" With d**3 in spring1 only noise is left.")
    errors = (fit.values - truth(STATED, fit.given_structure)) / np.sqrt(fit.covariance.diagonal())
    assert np.abs(errors).max() < 2.0


@pytest.mark.parametrize(
    ("cubic", "speed", "missing", "moved"),
    [(2e7, 1.4, SPRING, "nes1.alpha"), (5e6, 1.0, DAMPER, "nes1.c")],
)
def test_a_link_that_the_model_error_hides_takes_trust_away(
    cubic: float, speed: float, missing: lw.Link, moved: str
) -> None:
    """A spring of 4 % of the sink's stiffness, or a damper of a tenth of its damping, to the ground."""
    fit = answer(cubic, speed, 63, missing)
    assert not fit.trusted
    assert [cause.where for cause in fit.diagnosis[:2]] == ["spring1", "m2-ground"]
    assert fit.message.startswith(
        f"With d**3 in spring1 and {fit.diagnosis[1].term} in a link m2-ground the laws leave"
    )
    true = present(STATED.coefficient(moved).value)
    assert abs(fit.coefficient(moved).value - true) > 0.02 * abs(true)


def test_a_term_is_added_beside_a_coefficient_of_its_name() -> None:
    named = structure({"m1": 1.0}, link("spring", "m1-ground", "added*d", added=2.0))
    richer = with_cause(named, Cause("term", "spring", 1.0, "N", 20.0, 0.1, term="d**3"))
    assert richer.link("spring").law.text == "added*d + added_*(d**3)"
    assert richer.coefficient("spring.added").value == 2.0
    assert [parameter.name for parameter in richer.parameters] == ["spring.added_"]


def test_a_link_is_added_beside_one_of_its_name() -> None:
    known = [link(name, f"{mass}-ground", "k*d", k=2.0) for name, mass in (("m2_m1", "m1"), ("spring", "m2"))]
    named = structure({"m1": 1.0, "m2": 1.0}, *known)
    richer = with_cause(named, Cause("link", "m2-m1", 1.0, "N", 20.0, 0.1, term="v"))
    assert richer.link("m2_m1_").between == ("m2", "m1")
    assert [parameter.name for parameter in richer.parameters] == ["m2_m1_.size"]
