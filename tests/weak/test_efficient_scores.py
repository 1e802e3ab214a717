"""Friction too small for plain scores shows at the likeliest motion, or is named with what it would do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from problems import chain_record
from structures import oscillator

import linkwise as lw
from linkwise.weak.displacements import read_displacements
from linkwise.weak.efficient_scores import EfficientScores, efficient_scores
from linkwise.weak.equations import WeakEquations
from linkwise.weak.estimate import weak_search
from linkwise.weak.fit import WeakFit
from linkwise.weak.tested_terms import significant_score

LINEAR = oscillator("k*d + c*v", k=900.0, c=1.5)
LAW = "k*d + c*v + F*tanh(v/s)"
STEADY = {"m1": "2*sin(25*t)"}


def rubbing(friction: float) -> lw.Structure:
    return oscillator(LAW, k=900.0, c=1.5, F=friction, s=0.002)


def record(truth: lw.Structure, snr_db: float, seed: int, **drive: object) -> lw.Record:
    """Six seconds under a steady sine, from rest, or as `drive` says."""
    moved = drive or {"forces": STEADY}
    return lw.simulate(truth, duration=6.0, rate=1000.0, **moved).with_noise(snr_db, seed=seed)  # type: ignore[arg-type]


def scored(measured: lw.Record, asked: lw.Structure) -> tuple[WeakEquations, WeakFit, EfficientScores]:
    equations, fit, _ = weak_search(measured, asked, read_displacements(measured, asked))
    scores = efficient_scores(measured, asked, equations, fit)
    assert scores is not None
    return equations, fit, scores


def test_scores_of_exact_laws_are_normal() -> None:
    """Of chaotic records and of a nonlinear one under a sine, twelve each, at 20 to 40 dB."""
    hardening = oscillator("k*d + c*v + k3*d**3", k=900.0, c=1.5, k3=2e6)
    clean = lw.simulate(hardening, duration=6.0, rate=1000.0, forces={"m1": "sin(33*t)"})
    squares = []
    for seed in range(12):
        snr_db = (20.0, 30.0, 40.0)[seed % 3]
        for exact, truth in ((clean, hardening), (chain_record(2), lw.bnes_chain(2))):
            scores = scored(exact.with_noise(snr_db, seed=700 + seed), truth.unknown("all"))[2]
            assert scores.significant() is None
            squares.append(np.mean(scores.scores[np.abs(scores.scores) > 0.0] ** 2))
    # those of a record are hardly more than two independent ones: 48, with a deviation of sqrt(2/48) of the mean
    assert abs(np.mean(squares) - 1.0) < 3.0 * np.sqrt(2.0 / 48.0)


def test_small_friction_shows_that_plain_scores_miss() -> None:
    """The damping is some 30 of its standard errors off."""
    asked = LINEAR.unknown("all")
    measured = record(rubbing(0.02), 30.0, seed=811)
    equations, fit, scores = scored(measured, asked)
    off = (fit.values - [900.0, 1.5]) / np.sqrt(fit.covariance.diagonal())
    assert abs(off[1]) > 15.0
    assert significant_score(measured, asked, equations, fit.values, fit.excess) is None
    largest = scores.significant()
    assert largest is not None and largest.term in ("sign(v)", "v*abs(v)") and abs(largest.z) > 6.0
    answer = lw.identify(measured, asked, method="weak")
    assert answer.verdicts == (lw.Verdict.SYSTEMATIC_MISFIT,)
    assert answer.coefficient("link.c").interval is None


@pytest.mark.parametrize("truth", [LINEAR, rubbing(0.02)])
def test_damping_that_the_record_leaves_open_takes_trust_away(truth: lw.Structure) -> None:
    """At 15 dB a steady sine tells friction from damping no better than to a tenth of the damping; a decay does."""
    asked = LINEAR.unknown("all")
    fit = lw.identify(record(truth, 15.0, seed=821), asked, method="weak")
    assert fit.verdicts in ((lw.Verdict.HARDLY_DETERMINED,), (lw.Verdict.SYSTEMATIC_MISFIT,))
    if truth is LINEAR:
        assert "does not rule out a force like" in fit.message and "Record a free decay" in fit.message
        decay = record(truth, 15.0, seed=821, release={"v:m1": 1.0})
        assert lw.identify(decay, asked, method="weak").trusted


def test_terms_move_coefficients_as_far_as_told() -> None:
    """Friction of half its limit is not seen, and moves the damping by half of what is told, which is named."""
    asked = LINEAR.unknown("all")
    clean = lw.identify(record(LINEAR, 30.0, seed=831), asked, method="weak")
    assert clean.trusted
    told = next(term for term in clean.unseen_terms if term.term == "sign(v)")
    assert (told.link, told.coefficient) == ("link", "link.c") and told.standard_errors > 3.0
    assert any("do not rule out" in finding for finding in clean.findings)
    scores = scored(record(LINEAR, 30.0, seed=831), asked)[2]
    limit = float(scores.limits[scores.terms.index("sign(v)")])
    hidden = lw.identify(record(rubbing(0.5 * limit), 30.0, seed=831), asked, method="weak")
    change = hidden.values[1] - clean.values[1]
    assert abs(change / (0.5 * told.change) - 1.0) < 0.15  # to first order


def test_friction_in_the_law_is_not_missed() -> None:
    measured = record(rubbing(0.1), 40.0, seed=841)
    fit = lw.identify(measured, rubbing(0.1).unknown("link.k", "link.c", "link.F"), method="weak")
    assert fit.trusted, fit.message


def test_structures_that_are_not_tested_have_no_scores() -> None:
    """Too many masses, and records without noise, of which the error of sums is not white."""
    for masses in (8, 2):
        asked, exact = lw.bnes_chain(masses).unknown("all"), chain_record(masses)
        measured = exact if masses == 2 else exact.with_noise(30.0, seed=1)
        equations, fit, _ = weak_search(measured, asked, read_displacements(measured, asked))
        assert efficient_scores(measured, asked, equations, fit) is None


def test_a_stated_mass_that_is_wrong_is_named() -> None:
    """The lightest of six masses, a tenth too heavy, at 20 dB."""
    asked = lw.bnes_chain(6).unknown("all")
    masses = tuple(
        replace(mass, mass=lw.Coefficient.number(0.011)) if mass.name == "m6" else mass
        for mass in asked.masses
    )
    measured = chain_record(6).with_noise(20.0, seed=851)
    largest = scored(measured, replace(asked, masses=masses))[2].significant()
    assert largest is not None and largest.place == "m6"
    assert largest.description == "a force like acceleration of m6 on m6 alone"
    assert scored(measured, asked)[2].significant() is None
