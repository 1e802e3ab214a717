"""Forces with memory along a motion, and intervals of laws that lack them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from present import present
from problems import truth
from random_force import random_force
from scipy.integrate import solve_ivp
from structures import oscillator

import linkwise as lw
from linkwise.likelihood.memory_forces import MEMORY_FORCES, MemoryForce, Relaxation, Slip

RATE, DURATION = 200.0, 20.0
LAW = "k*d + c*v + k3*d**3"
TRUE = oscillator(LAW, k=987.0, c=6.0, k3=4e5)
CHANCE = 3.3  # standard errors that a normal estimate is off once in 1000


def cut(values: np.ndarray, steps: int) -> np.ndarray:
    """(2 J + 1, 2, 1, K) in segments of so many steps, of (2, N) at ends and middles in turn."""
    count = (values.shape[1] - 1) // (2 * steps)
    pieces = [values[:, 2 * steps * k : 2 * steps * (k + 1) + 1] for k in range(count)]
    return np.stack(pieces, axis=-1).transpose(1, 0, 2)[:, :, None]


TIME = np.linspace(0.0, 6.0, 6001)
MOTION = np.stack(
    [np.sin(3.0 * TIME) + 0.4 * np.cos(7.0 * TIME), 3.0 * np.cos(3.0 * TIME) - 2.8 * np.sin(7.0 * TIME)]
)
DEVIATION, RATE_DEVIATION = MOTION.std(axis=1)


@pytest.mark.parametrize(
    ("force", "rate"),
    [
        (Slip(0.3), lambda v, z: (v - z * abs(v)) / (0.3 * DEVIATION)),
        (Relaxation(2.0), lambda v, z: v - z * RATE_DEVIATION / (2.0 * DEVIATION)),
    ],
    ids=["slip", "relaxation"],
)
def test_a_force_with_memory_follows_its_differential_equation(
    force: MemoryForce, rate: Callable[[float, float], float]
) -> None:
    motion = cut(MOTION, 5)
    links = np.ones(motion.shape[-1] - 1, dtype=bool)
    along = force.along(motion, np.full(len(links) + 1, 2e-3), links)
    exact = solve_ivp(
        lambda t, z: rate(float(np.interp(t, TIME, MOTION[1])), z),
        (0.0, 6.0),
        [0.0],
        t_eval=TIME,
        rtol=1e-8,
        max_step=2e-3,
    ).y
    wanted = cut(exact, 5)
    # ends of segments count twice in the deviation, by a thousandth; a reversal between two values turns by 1e-5 of it
    allowed = 2e-3 * np.max(np.abs(exact))
    assert np.max(np.abs(along - wanted[:, 0])) < allowed


@pytest.mark.parametrize("force", MEMORY_FORCES, ids=[force.text for force in MEMORY_FORCES])
def test_a_force_with_memory_starts_anew_in_each_record(force: MemoryForce) -> None:
    motion = cut(MOTION, 5)
    step, links = np.full(motion.shape[-1], 2e-3), np.ones(motion.shape[-1] - 1, dtype=bool)
    links[19] = False
    along = force.along(motion, step, links)
    assert along[0, 0, 20] == 0.0 and along[0, 0, 19] != 0.0
    assert not force.along(0.0 * motion, step, links).any()


def record(joint: lw.Link, seed: int) -> lw.Record:
    """An oscillator with a joint beside its spring, under a random force of 6 N from 1 to 12 Hz, at 40 dB."""
    structure = replace(TRUE, links=(*TRUE.links, joint))
    forces = {"m1": random_force(np.random.default_rng(seed), DURATION, RATE)}
    return lw.simulate(structure, forces=forces, duration=DURATION, rate=RATE).with_noise(40.0, seed=seed)


def joint(law: str, **values: float) -> lw.Link:
    numbers = {name: lw.Coefficient.number(value) for name, value in values.items()}
    return lw.model.named_law(law).link("joint", ("m1", "ground"), numbers)


@pytest.mark.parametrize("seed", [1, 2])
def test_intervals_hold_slip_that_the_law_lacks(seed: int) -> None:
    """The damper makes up for it, alike in all parts of a record: c was 16 or 18 standard errors off, and trusted."""
    unknown = TRUE.unknown("all")
    fit = lw.identify(record(joint("bouc-wen", k=0.0, c=0.0, F=0.13, x0=0.003, s=0.5), seed), unknown)
    assert fit.verdicts == (lw.Verdict.MODEL_ERROR_NEEDED,)
    assert "Most of what is left would be explained by a force like hysteresis in link" in fit.message
    assert "such as bouc-wen" in fit.message
    off, covariance = np.abs(fit.values - truth(TRUE, unknown)), np.asarray(fit.covariance)
    by_blocks = covariance - present(fit.for_dropped_terms)
    number = [parameter.name for parameter in fit.parameters].index("link.c")
    assert off[number] > 2.0 * CHANCE * np.sqrt(by_blocks[number, number])
    assert np.all(off < CHANCE * np.sqrt(covariance.diagonal()))


@pytest.mark.parametrize("seed", [1, 3])
def test_intervals_hold_a_relaxation_that_only_scores_show(seed: int) -> None:
    """A spring in series with a damper of 0.2 % of the force: the law explains the record; c was 23 standard errors off."""
    unknown = TRUE.unknown("all")
    fit = lw.identify(record(joint("maxwell", k=2.0, c=0.06), seed), unknown)
    assert fit.trusted
    off, covariance = np.abs(fit.values - truth(TRUE, unknown)), np.asarray(fit.covariance)
    by_blocks = covariance - present(fit.for_dropped_terms)
    number = [parameter.name for parameter in fit.parameters].index("link.c")
    assert off[number] > 2.0 * CHANCE * np.sqrt(by_blocks[number, number])
    assert np.all(off < CHANCE * np.sqrt(covariance.diagonal()))


def test_a_relaxation_is_named_in_place_of_a_gain() -> None:
    fit = lw.identify(record(joint("maxwell", k=13.0, c=0.4), 1), TRUE.unknown("all"))
    assert fit.diagnosis[0].term == "relaxation"
