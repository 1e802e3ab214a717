"""Laws that lack a term too small for chi-square: intervals hold it by the scatter of blocks and the scores of usual terms."""

from __future__ import annotations

import numpy as np
import pytest
from present import present
from problems import truth
from random_force import random_force
from structures import oscillator

import linkwise as lw
from linkwise.likelihood.block_scores import BlockScores

RATE, DURATION = 200.0, 20.0
LAW = "k*d + c*v + k3*d**3"
TRUE = oscillator(LAW, k=987.0, c=6.0, k3=4e5)
CHANCE = 3.3  # standard errors that a normal estimate is off once in 1000


def record(structure: lw.Structure, seed: int) -> lw.Record:
    """The structure under a random force of 6 N root mean square from 1 to 12 Hz, at 40 dB."""
    forces = {"m1": random_force(np.random.default_rng(seed), DURATION, RATE)}
    return lw.simulate(structure, forces=forces, duration=DURATION, rate=RATE).with_noise(40.0, seed=seed)


@pytest.mark.parametrize("seed", [19, 20])
def test_a_small_term_that_only_its_score_shows_is_held_and_told(seed: int) -> None:
    """It was refused: chi-square is within chance of one, and yet k3 is several standard errors off."""
    unknown = TRUE.unknown("all")
    fit = lw.identify(record(oscillator(f"{LAW} + q*d**5", k=987.0, c=6.0, k3=4e5, q=6e6), seed), unknown)
    assert fit.verdicts == (lw.Verdict.MODEL_ERROR_NEEDED,)
    assert 0.0 < fit.model_error < 0.01
    assert "Most of what is left would be explained by a force like d**5 in link" in fit.message
    off, covariance = np.abs(fit.values - truth(TRUE, unknown)), np.asarray(fit.covariance)
    by_blocks = covariance - present(fit.for_dropped_terms)
    number = [parameter.name for parameter in fit.parameters].index("link.k3")
    assert off[number] > CHANCE * np.sqrt(by_blocks[number, number])
    assert np.all(off < CHANCE * np.sqrt(covariance.diagonal()))


def of_noise(rng: np.random.Generator, blocks: int, unknowns: int) -> BlockScores:
    """Scores of white noise at the optimum, with information that differs from block to block as an amplitude does."""
    rows = rng.normal(size=(blocks, 40, unknowns)) * rng.uniform(0.5, 2.0, (blocks, 1, 1))
    noise = rng.normal(size=(blocks, 40))
    flat = rows.reshape(-1, unknowns)
    noise -= (flat @ np.linalg.lstsq(flat, noise.ravel(), rcond=None)[0]).reshape(noise.shape)
    return BlockScores(np.einsum("brp,br->bp", rows, noise), np.einsum("brp,brq->bpq", rows, rows))


def test_chances_of_noise_are_uniform() -> None:
    rng = np.random.default_rng(5)
    chances = np.concatenate([of_noise(rng, 20, 3).chances(np.ones(3, dtype=bool), 1.0) for _ in range(400)])
    for level in (0.02, 0.1, 0.5):
        # 1200 chances, in threes that are hardly dependent: four binomial deviations, and a fifth of the level for the
        # approximation by a multiple of chi-square
        allowed = 4.0 * np.sqrt(level * (1.0 - level) / len(chances)) + 0.2 * level
        assert abs(np.mean(chances < level) - level) < allowed


def test_scores_that_scatter_twice_as_far_have_hardly_a_chance() -> None:
    scores = of_noise(np.random.default_rng(6), 20, 3)
    free = np.array([True, True, False])
    chances = scores.chances(free, 0.5)  # the noise is twice what it is taken for
    assert np.all(chances[:2] < 1e-3) and chances[2] == 1.0
