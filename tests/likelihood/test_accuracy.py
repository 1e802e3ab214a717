"""The figures that maximum likelihood must reach, on seeds that nothing was tuned on (1000 and up).

The table of all masses and twenty seeds, and the statistics of 250 records, are those of benchmarks/bench_likelihood.py.
"""

from __future__ import annotations

import numpy as np
import paper_fits
import pytest
from paper_fits import FIRST, LARGEST_NMSE, Runs, identified
from present import present, some
from problems import chain_record

import linkwise as lw

MANY = 110  # records of the statistics below: that all 95 % intervals of a coefficient cover has a chance of 0.4 %
CHANCE = 0.005  # of a share being too small, and of its being too large: of five coefficients 5 % together
SHORT = 1.0  # s, a sixth of the paper's record: intervals cover and errors reach the bound at any duration


@pytest.mark.parametrize(("n", "seeds"), [(2, 8), (4, 3), (6, 3), (8, 1), (10, 4)])
def test_at_20_db_every_sink_is_found_to_a_few_millionths(n: int, seeds: int) -> None:
    paper_fits.check_sinks_at_20_db(identified(n, 20.0, seeds))


@pytest.mark.parametrize(("n", "seeds"), [(2, 4), (10, 1)])
def test_at_40_db_a_hundred_times_better(n: int, seeds: int) -> None:
    assert np.median(identified(n, 40.0, seeds).nmse) <= LARGEST_NMSE[40.0]


@pytest.mark.parametrize(("n", "seeds"), [(2, 6), (4, 3)])
def test_velocities_alone_are_enough(n: int, seeds: int) -> None:
    paper_fits.check_velocities(identified(n, 30.0, seeds, "v", duration=SHORT))


@pytest.fixture(scope="module")
def many() -> Runs:
    return identified(2, 20.0, MANY, duration=SHORT)


def test_standard_errors_are_what_the_errors_are(many: Runs) -> None:
    paper_fits.check_standard_errors(many)


def test_intervals_cover_as_often_as_they_say(many: Runs) -> None:
    paper_fits.check_intervals(many, CHANCE)


def test_the_force_band_covers_at_every_elongation(many: Runs) -> None:
    paper_fits.check_force_band(many, CHANCE)


def test_errors_are_as_small_as_information_allows(many: Runs) -> None:
    paper_fits.check_bound(many, SHORT)


def test_a_wrong_noise_model_is_caught_each_time() -> None:
    unknown = lw.bnes_chain(2).unknown("all")
    for seed in range(FIRST, FIRST + 5):
        record = chain_record(2, duration=SHORT).with_noise(20.0, seed=seed)
        half = {name: 0.5 * sigma for name, sigma in present(record.simulated).noise.items()}
        fit = lw.identify(lw.Record(0.0, 1000.0, record.channels, record.values, half), unknown)
        assert fit.status == "chi-square off"
        assert all(
            coefficient.interval is None for link in some(fit.links) for coefficient in link.coefficients
        )
