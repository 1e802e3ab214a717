"""Forms that were not offered: terms that stand in for one are in doubt, those that are there are not."""

import numpy as np
import pytest
from present import present
from random_signals import random_force
from structures import oscillator

import linkwise as lw

RATE, DURATION = 200.0, 10.0
OFFERED = "d, d**3, v, v**3"


def record(law: str, seed: int, *, c: float, k3: float, q: float) -> lw.Record:
    """A mass of 1 kg under a random force of 6 N root mean square from 1 to 12 Hz, at 20 dB."""
    true = oscillator(law, k=987.0, k3=k3, c=c, q=q)
    forces = {"m1": random_force(np.random.default_rng(seed), DURATION, RATE)}
    return lw.simulate(true, forces=forces, duration=DURATION, rate=RATE).with_noise(20.0, seed=seed)


def test_terms_that_stand_in_for_a_form_that_was_not_offered_are_in_doubt() -> None:
    """They were certain, and trusted: other terms on offer explain the record far worse."""
    given = record("k*d + k3*d**3 + c*v + q*d*abs(d)", 32, c=2.0, k3=0.0, q=400.0)
    discovery = lw.discover(given, {"m1": 1.0}, terms=OFFERED)
    assert discovery.estimate.trusted  # by its residuals alone
    assert not discovery.trusted and lw.Verdict.TERMS_MAY_BE_MISSING in discovery.verdicts
    assert not [term for term in discovery.kept if term.certain]
    (remark,) = (remark for remark in discovery.remarks if "offer it" in remark)
    assert "a force like d*abs(d) in m1-ground, which was not offered, m1-ground.k3 would not be" in remark


@pytest.mark.slow
def test_beside_a_model_error_terms_that_stand_in_for_another_form_are_in_doubt() -> None:
    """Damping that falls with the rate gives no energy: springs are told with intervals, damping as what it may be."""
    given = record("k*d + k3*d**3 + c*v + q*tanh(v/0.3)", 33, c=0.0, k3=4e5, q=1.0)
    discovery = lw.discover(given, {"m1": 1.0}, terms=OFFERED)
    assert lw.Verdict.MODEL_ERROR_NEEDED in discovery.verdicts
    assert {term.term for term in discovery.kept if term.certain} == {"d", "d**3"}
    assert {term.term for term in discovery.kept} == {"d", "d**3", "v", "v**3"}
    assert [
        remark for remark in discovery.remarks if "a force like tanh(v" in remark and "offer it" in remark
    ]
    for name, true in (("k", 987.0), ("k3", 4e5)):
        low, high = discovery.estimate.coefficient(f"m1-ground.{name}").interval or (np.nan, np.nan)
        assert low < true < high


def test_terms_that_are_there_stay_certain_beside_other_forms() -> None:
    given = record("k*d + k3*d**3 + c*v + q*v**3", 6, c=2.0, k3=4e5, q=4.0)
    discovery = lw.discover(given, {"m1": 1.0}, terms=OFFERED)
    assert discovery.trusted and not [remark for remark in discovery.remarks if "offer it" in remark]
    assert {term.term for term in discovery.kept if term.certain} == {"d", "d**3", "v", "v**3"}


def test_a_term_whose_interval_holds_zero_for_a_hint_of_another_one_is_not_certain() -> None:
    """Residuals hint at v*abs(v), which was not offered, with which v**3 would hardly be there; its margin alone is large."""
    given = record("k*d + k3*d**3 + c*v + q*v*abs(v)", 4202, c=6.0, k3=4e5, q=-2.0)
    discovery = lw.discover(given, {"m1": 1.0}, terms=OFFERED)
    assert "The residuals hint at" in discovery.estimate.message
    low, high = present(discovery.estimate.coefficient("m1-ground.c3").interval)
    assert low < 0.0 < high
    assert {term.term for term in discovery.kept if term.certain} == {"d", "d**3", "v"}


def test_damping_that_falls_with_the_motion_and_stays_damping_is_no_stand_in() -> None:
    """It was refused for the sign of its term alone, though the law takes energy throughout the motion."""
    term, q = "v*d**2", -4e3
    given = record(f"k*d + k3*d**3 + c*v + q*{term}", 43, c=6.0, k3=4e5, q=q)
    discovery = lw.discover(given, {"m1": 1.0}, terms=f"d, d**3, v, {term}")
    assert discovery.trusted
    assert {term.term for term in discovery.kept if term.certain} == {"d", "d**3", "v", term}
    fallen = next(kept for kept in discovery.kept if kept.term == term)
    assert (
        fallen.value < 0.0 and abs(fallen.value - q) < 4.0 * fallen.standard_error
    )  # 1e-4 of normal errors are larger


@pytest.mark.parametrize(("k3", "q", "certain"), [(0.0, 150.0, {"d", "v"}), (4e4, 0.0, {"d", "v", "d**3"})])
def test_a_term_of_which_another_form_is_as_good_is_in_doubt(k3: float, q: float, certain: set[str]) -> None:
    """A stiffness that grows with the elongation was told as cubic, beyond doubt; one that is cubic stays so."""
    given = record("k*d + k3*d**3 + c*v + q*d*abs(d)", 42, c=2.0, k3=k3, q=q)
    discovery = lw.discover(given, {"m1": 1.0}, terms=OFFERED)
    assert discovery.trusted and {term.term for term in discovery.kept} == {"d", "v", "d**3"}
    assert {term.term for term in discovery.kept if term.certain} == certain
    told = [remark for remark in discovery.remarks if "explains the record as well as m1-ground.k3" in remark]
    assert len(told) == ("d**3" not in certain)
