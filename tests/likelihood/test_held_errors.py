"""Small errors of sensors beside a model error: intervals hold them, and larger ones take trust away."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from present import present, some
from problems import truth
from random_force import random_force
from structures import oscillator

import linkwise as lw

RATE, DURATION = 200.0, 40.0
LAW = "k*d + c*v + k3*d**3"
TRUE = oscillator(LAW, k=987.0, c=2.0, k3=4e5)
DRAG = oscillator(f"{LAW} + q*v*abs(v)", k=987.0, c=2.0, k3=4e5, q=1.0)
PLAY = oscillator(f"{LAW} + q*(max(d - 0.02, 0) + min(d + 0.02, 0))", k=987.0, c=2.0, k3=4e5, q=100.0)
CHANCE = 3.3  # standard errors that a normal estimate is off once in 1000
SEED = 31

Change = Callable[[lw.Record], np.ndarray]


def late(seconds: float) -> Change:
    """The displacement shown late."""

    def shown(record: lw.Record) -> np.ndarray:
        signal = lw.model.Sampled(0.0, record.rate, record.channel("x:m1"), band_limited=True)
        return signal.value(np.clip(record.time - seconds, 0.0, record.time[-1]))

    return shown


def drifting(size: float) -> Change:
    """The displacement with a drift of `size` in m root mean square."""
    return lambda record: record.channel("x:m1") + size * np.sqrt(3.0) * np.linspace(-1.0, 1.0, len(record))


@cache
def shaken(structure: lw.Structure) -> lw.Record:
    """The motion of an oscillator under a random force from 1 to 12 Hz."""
    forces = {"m1": random_force(np.random.default_rng(SEED), DURATION, RATE)}
    return lw.simulate(structure, forces=forces, duration=DURATION, rate=RATE)


def recorded(change: Change, structure: lw.Structure = PLAY) -> lw.Record:
    """The oscillator with a stop that its law lacks, 0.3 % of its force, or another `structure`, at 50 dB."""
    clean = shaken(structure)
    values = clean.values.copy()
    values[:, clean.channels.index("x:m1")] = change(clean)
    return replace(clean, values=values, simulated=None).with_noise(50.0, seed=SEED)


@pytest.mark.parametrize(("change", "kind"), [(drifting(3e-4), "drift"), (late(3e-4), "delay")])
def test_an_error_that_intervals_hold_leaves_trust(change: Change, kind: str) -> None:
    """It explains most of what is left, so that the answer was refused; no coefficient moves by three standard errors."""
    unknown = TRUE.unknown("all")
    fit = lw.identify(recorded(change), unknown)
    assert fit.trusted and fit.verdicts == (lw.Verdict.MODEL_ERROR_NEEDED,)
    assert fit.diagnosis[0].is_instrument and fit.diagnosis[0].kind.endswith(kind)
    assert "the intervals allow for that" in fit.message
    off, covariance = np.abs(fit.values - truth(TRUE, unknown)), np.asarray(fit.covariance)
    assert np.all(off < CHANCE * np.sqrt(covariance.diagonal()))
    for cause in some(cause for cause in fit.diagnosis if cause.is_instrument):
        number = [parameter.name for parameter in fit.parameters].index(cause.shifted)
        before = np.sqrt((covariance - present(fit.for_dropped_terms))[number, number])
        assert cause.shift <= 3.0 and before < np.sqrt(covariance[number, number])


@pytest.mark.parametrize("change", [late(2e-3), lambda record: 1.02 * record.channel("x:m1")])
def test_an_error_that_moves_a_coefficient_beyond_its_interval_takes_trust(change: Change) -> None:
    unknown = TRUE.unknown("all")
    fit = lw.identify(recorded(change), unknown)
    off = np.abs(fit.values - truth(TRUE, unknown)) / np.sqrt(np.asarray(fit.covariance).diagonal())
    assert np.max(off) > CHANCE
    assert not fit.trusted and fit.diagnosis[0].is_instrument


def test_an_error_beside_a_likelier_term_takes_trust_where_intervals_do_not_hold_it() -> None:
    """Of a law that lacks drag, and a gain of 2 %: drag explains more, and k3 was 15 standard errors off and trusted."""
    unknown = TRUE.unknown("all")
    fit = lw.identify(recorded(lambda record: 1.02 * record.channel("x:m1"), DRAG), unknown)
    assert fit.diagnosis[0].kind == "term" and fit.model_error > 0.0
    assert fit.verdicts == (lw.Verdict.MEASUREMENT_ERROR,)
    assert "beside the terms that would explain more it would change" in fit.message


def test_an_error_that_intervals_hold_beside_a_likelier_term_leaves_trust() -> None:
    unknown = TRUE.unknown("all")
    fit = lw.identify(recorded(late(3e-4), DRAG), unknown)
    assert fit.verdicts == (lw.Verdict.MODEL_ERROR_NEEDED,) and fit.diagnosis[0].kind == "term"
    assert some(cause for cause in fit.diagnosis if cause.kind.endswith("delay"))
    off, covariance = np.abs(fit.values - truth(TRUE, unknown)), np.asarray(fit.covariance)
    assert np.all(off < CHANCE * np.sqrt(covariance.diagonal()))
