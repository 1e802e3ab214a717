"""The path of laws: terms come in the order of what they explain."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from present import present, some
from structures import oscillator

import linkwise as lw
from linkwise import equivalent
from linkwise.identification.law_path import law_of, law_path

pytestmark = pytest.mark.filterwarnings("ignore:linkwise.law_path:DeprecationWarning")

DUFFING = oscillator("k*d + k3*d**3 + c*v + c2*v*abs(v)", name="beam", k=900.0, k3=4e6, c=0.3, c2=4.0)


@pytest.fixture(scope="module")
def decay() -> tuple[lw.Record, lw.Structure]:
    record = lw.simulate(DUFFING, release={"x:m1": 0.02}, duration=4.0, rate=200.0).with_noise(50.0, seed=1)
    return record, DUFFING


def test_the_true_terms_come_first_and_leave_the_noise(decay: tuple[lw.Record, lw.Structure]) -> None:
    record, structure = decay
    path = law_path(record, structure, "beam", candidates=("d**2", "d**3", "v*abs(v)", "v*d"), most=4)
    assert [step.terms[2:] for step in path] == [(), ("d**3",), ("d**3", "v*abs(v)")] + [
        path[-1].terms[2:]
    ] * (len(path) - 3)
    assert path[2].left == pytest.approx(10.0 ** (-50.0 / 20.0), rel=0.1)  # what the noise alone would leave
    # in noise: 800 samples scatter by 1/sqrt(2 800) = 0.025, four of them; measured 0.994
    assert path[2].residual == pytest.approx(1.0, abs=0.1)
    assert path[0].bic > path[1].bic > path[2].bic


def test_it_warns_that_discover_replaces_it(decay: tuple[lw.Record, lw.Structure]) -> None:
    record, structure = decay
    with pytest.warns(
        DeprecationWarning, match=r"linkwise\.law_path is deprecated .*; use linkwise\.discover"
    ) as caught:
        path = law_path(record, structure, "beam", start=("d", "v", "d**3", "v*abs(v)"), most=4)
    assert caught[0].filename == __file__
    discovery = lw.discover(record, {"m1": 1.0}, terms="v, d, d**2, d**3, v*abs(v), v*d")
    assert {term.term for term in discovery.kept} == set(path[0].terms) and discovery.trusted


def test_laws_that_are_taken_for_exact_have_no_model_error(decay: tuple[lw.Record, lw.Structure]) -> None:
    """By default one is found, which explains what the laws leave."""
    record, _ = decay
    unknown = oscillator("k*d + k3*d**3 + c*v", name="beam").unknown("all")
    loose, exact = lw.identify(record, unknown), lw.identify(record, unknown, exact=True)
    assert loose.model_error > 0.0 and present(loose.chi_square_per_sample) < 2.0
    assert exact.model_error == 0.0 and present(exact.chi_square_per_sample) > 2.0
    assert exact.fit_verdicts == (lw.Verdict.NOISE_MISMATCH,)


def test_a_needless_term_does_not_pay(decay: tuple[lw.Record, lw.Structure]) -> None:
    record, structure = decay
    path = law_path(
        record, structure, "beam", candidates=("v*d",), start=("d", "v", "d**3", "v*abs(v)"), most=5
    )
    assert (
        path[1].bic > path[0].bic - 4.0
    )  # chi-square of one coefficient beyond 4 + log(N) has a chance of 1e-3


def test_a_constant_force_is_a_term() -> None:
    law, coefficients = law_of(("d", "1"))
    assert law.text == "p1*d + p2"
    assert not any(coefficient.known for coefficient in some(coefficients.values()))


def test_a_start_that_cannot_be_fitted_is_said(decay: tuple[lw.Record, lw.Structure]) -> None:
    record, structure = decay
    with pytest.raises(
        lw.IdentificationError, match='link "beam": the law with the terms d, d does not converge'
    ):
        law_path(record, structure, "beam", start=("d", "d"))


def test_magnet_beam_in_eight_coefficients(shared_data: Path) -> None:
    record = lw.read_record(shared_data / "magnet_beam_decay.csv")
    path = law_path(
        record,
        DUFFING,
        "beam",
        start=("d", "v", "d**3", "d**4"),  # the first that come, from a path of all six candidates
        candidates=("d**2", "d**5", "v*abs(d)", "v*d**2"),
    )
    assert len(path[-1].terms) == 8
    assert path[-1].left < 0.05  # the free run of all 3 s
    fit = lw.identify(record, path[-1].structure)
    # eight terms are asked to leave less than 1 % of the forces
    assert fit.verdicts == (lw.Verdict.MODEL_ERROR_NEEDED,) and fit.model_error < 0.01 and fit.diagnosis
    shorter = [lw.identify(record, step.structure) for step in path[:-1:2]]
    # laws of the same beam: their stiffnesses had excluded each other by up to nine errors
    for shorter_fit in some(shorter):
        assert not shorter_fit.trusted
        difference = abs(shorter_fit.values[0] - fit.values[0])
        # three deviations of the difference
        assert difference < 3.0 * np.sqrt(shorter_fit.covariance[0, 0] + fit.covariance[0, 0])
    small, middle, large = equivalent(fit.links[0], [2e-5, 1e-4, 2e-4], 42.0).damping
    assert (
        small < middle > large
    )  # damping grows from small to middle amplitudes and falls again at large ones
