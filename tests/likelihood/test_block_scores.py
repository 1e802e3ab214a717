"""Standard errors by blocks: of the size of what white noise would give where it is white, and wider where a law is wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy
from problems import chain_record
from structures import asked_oscillator

import linkwise as lw
from linkwise.likelihood.block_scores import BLOCKS, block_scatter, block_scores
from linkwise.likelihood.fit import LikelihoodFit, Optimum, likelihood_fit
from linkwise.likelihood.longer_optimum import in_longer_segments
from linkwise.likelihood.shooting.residuals import Misfit
from linkwise.likelihood.starts.values import starting_values


def fitted(record: lw.Record, structure: lw.Structure) -> LikelihoodFit:
    theta, spread = starting_values([record], structure, None)
    return likelihood_fit([record], structure, theta, spread=spread)


@pytest.fixture(scope="module")
def chain_fit() -> LikelihoodFit:
    record = chain_record(2).with_noise(30.0, seed=77)
    return fitted(record, lw.bnes_chain(2).unknown("all"))


def test_blocks_add_up_to_the_whole(chain_fit: LikelihoodFit) -> None:
    optimum = chain_fit.optimum
    scores = block_scores(
        optimum.segments, chain_fit.misfit, optimum.scales, optimum.loss, optimum.q, blocks=24
    )
    assert scores is not None
    whole = np.linalg.inv(scores.information.sum(axis=0)) * np.outer(
        optimum.scales.theta, optimum.scales.theta
    )
    # sums of single-precision products in another order
    assert np.allclose(whole, chain_fit.covariance, rtol=1e-2, atol=1e-2 * np.abs(chain_fit.covariance).max())
    step = np.linalg.solve(scores.information.sum(axis=0), scores.scores.sum(axis=0))
    deviations = np.sqrt(whole.diagonal()) / optimum.scales.theta
    assert np.all(np.abs(step) < 0.1 * deviations)  # the optimum: no step is left
    merged = scores.merged(6)
    assert np.allclose(merged.scores.sum(axis=0), scores.scores.sum(axis=0))
    assert len(merged.information) == 6


def test_longer_segments_scatter_as_short_ones(chain_fit: LikelihoodFit) -> None:
    """They end with the same blocks but for the last sample, which is a longer segment; other blocks scatter otherwise."""
    free = np.ones(len(chain_fit.optimum.scales.theta), dtype=bool)

    def deviations(optimum: Optimum, misfit: Misfit, blocks: int = BLOCKS[0]) -> np.ndarray:
        scores = block_scores(
            optimum.segments, misfit, optimum.scales, optimum.loss, optimum.q, blocks=blocks
        )
        assert scores is not None
        return scores.deviations(free)

    longer, misfit = in_longer_segments(chain_fit)
    assert longer.segments.count == 301 < chain_fit.optimum.segments.count
    short = deviations(chain_fit.optimum, chain_fit.misfit)
    np.testing.assert_allclose(deviations(longer, misfit), short, rtol=0.02)
    others = deviations(longer, misfit, BLOCKS[0] - 1)
    assert np.max(np.abs(others / short - 1.0)) > 0.05


def test_white_noise_hardly_widens(chain_fit: LikelihoodFit) -> None:
    optimum = chain_fit.optimum
    scatter = block_scatter(
        optimum.segments,
        chain_fit.misfit,
        optimum.scales,
        optimum.loss,
        q=optimum.q,
        noise=optimum.noise,
        free=np.ones(len(optimum.scales.theta), dtype=bool),
    )
    assert scatter is not None
    ratios = scatter.ratios
    # t over normal quantile is 1.15 for ten blocks, and the deviation of ten draws exceeds 1.6 times the true one in 0.2 %
    assert np.all(ratios >= 1.0) and np.all(ratios < 1.15 * 1.7)


def test_too_few_segments_have_no_blocks(chain_fit: LikelihoodFit) -> None:
    record = chain_record(2).with_noise(30.0, seed=77)[:400]
    short = fitted(record, lw.bnes_chain(2).unknown("nes"))
    optimum = short.optimum
    assert (
        block_scatter(
            optimum.segments,
            short.misfit,
            optimum.scales,
            optimum.loss,
            q=optimum.q,
            noise=1.0,
            free=short.free,
        )
        is None
    )


def test_pieces_of_a_servo_axis_scatter_as_the_whole_says(shared_data: Path) -> None:
    """EMPS: five pieces scattered 4 to 15 times the stated errors while the law's error was taken for white noise.

    Three of them here; all five are those of benchmarks/bench_inexact_laws.py.
    """
    data = scipy.io.loadmat(shared_data / "emps.mat")
    force = data["vir"].ravel() * float(data["gtau"].item())
    record = lw.Record.from_arrays(data["t"].ravel(), {"x:m1": data["qm"].ravel(), "force:m1": force})
    axis = asked_oscillator("fv*v + fc*sign(v) + off", name="friction")
    whole = lw.identify(record, axis)
    assert whole.trusted and whole.verdicts == (lw.Verdict.MODEL_ERROR_NEEDED,)
    published = {"friction.fv": 203.5, "friction.fc": 20.39, "friction.off": -3.165, "m1.mass": 95.109}
    for name, value in published.items():  # Janot, Gautier, Brunot 2019
        low, high = whole.coefficient(name).interval or (np.nan, np.nan)
        assert low < value < high
    length = len(record) // 5
    pieces = [lw.identify(record[k * length : (k + 1) * length], axis) for k in (0, 3, 4)]
    scatter = np.std([piece.values for piece in pieces], axis=0, ddof=1)
    errors = np.sqrt(whole.covariance.diagonal())
    # three normal numbers scatter beyond 1.7 deviations in 6 % of cases, as five do beyond 1.5: chi-square of 2 and 4
    assert np.all(scatter < 1.7 * np.sqrt(5.0) * errors)
    stated = np.sqrt(np.mean([piece.covariance.diagonal() for piece in pieces], axis=0))
    assert np.all(scatter < 1.7 * stated)
