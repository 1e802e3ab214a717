"""Records that say too little: discovery ends with an answer or a reason, never with the failure of a matrix."""

import numpy as np
import pytest
from judged import masses
from problems import chain_record
from random_structures import draw_structure

import linkwise as lw


def attempt(record: lw.Record, kilograms: dict[str, float | str]) -> None:
    """An answer, or an error with a reason; any warning is an error of the test."""
    try:
        discovery = lw.discover(record, kilograms)
    except lw.IdentificationError as error:
        assert "m" in str(error)
        return
    assert str(discovery) and discovery.path and discovery.terms


@pytest.mark.slow
def test_the_chain_at_a_rate_that_is_too_low() -> None:
    """100 Hz and 20 dB: four samples for a period of the sink."""
    record = chain_record(2, duration=3.0, rate=100.0)
    attempt(record.with_noise(20.0, seed=1), {"m1": 1.0, "m2": 0.01})


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_random_records_of_any_rate_and_noise(seed: int) -> None:
    """5 to 50 samples for a period of the fastest link, 10 to 40 dB; the benchmark has more of them."""
    rng = np.random.default_rng(seed)
    subject, release = draw_structure(rng, (2, 4))
    rate = 60.0 * float(10.0 ** rng.uniform(0.7, 1.7))
    record = lw.simulate(subject, release=release, duration=min(0.7, 600 / rate), rate=rate)
    attempt(record.with_noise(float(rng.uniform(10.0, 40.0)), seed=seed), masses(subject))
