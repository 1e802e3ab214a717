"""Records whose channels were sampled at different rates: from what they say together to what is found from all of it."""

from dataclasses import replace

import numpy as np
import pytest
from judged import masses
from present import present
from problems import chain_record, parsed

import linkwise as lw
from linkwise.records.joining import common_samples, sampled_every
from linkwise.signals.noise import channel_noise


def two_rates(every: int, first: int = 0) -> lw.Record:
    """The paper's chain at 1000 Hz, its sink at a part of that rate; 30 dB."""
    record = chain_record(2).with_noise(30.0, seed=31)
    values = record.values.copy()
    missing = np.ones(len(record), dtype=bool)
    missing[first::every] = False
    values[missing, 1] = np.nan
    return replace(record, values=values)


@pytest.mark.parametrize("first", [0, 1])
def test_common_samples_are_those_of_the_slower_channel(first: int) -> None:
    record = two_rates(3, first)
    common = present(common_samples(record))
    assert common.rate == pytest.approx(record.rate / 3, rel=1e-12)
    assert common.start == pytest.approx(first / record.rate, rel=1e-12)
    np.testing.assert_array_equal(common.values, record.values[first::3])


def test_a_record_with_some_gaps_has_one_rate() -> None:
    record = two_rates(1)
    assert common_samples(record) is None
    values = record.values.copy()
    values[100:900, 0] = np.nan
    values[::7, 1] = np.nan
    assert common_samples(replace(record, values=values)) is None
    assert sampled_every(np.zeros(5, dtype=bool)) == 1
    thinned = np.zeros(3000, dtype=bool)  # samples of a channel at a lower rate may be missing
    thinned[1::3] = np.random.default_rng(3).random(1000) < 0.8
    assert sampled_every(thinned) == 3
    slow = np.full((len(record), 1), np.nan)  # a slow load cell does not thin the motion
    slow[::100] = 1.0
    channels = parsed(*record.channels, "f:nes1")
    assert common_samples(replace(record, channels=channels, values=np.hstack([record.values, slow]))) is None


@pytest.mark.parametrize("every", [2, 5])
def test_noise_of_a_slower_channel_is_that_of_its_samples(every: int) -> None:
    """It was taken for rounding, 1e-12 of the motion."""
    record = two_rates(every)
    slower, complete = channel_noise(record)["x:m2"], channel_noise(two_rates(1))["x:m2"]
    # 1.2 % of standard error at 6001 samples, five of them at a part of these
    assert slower == pytest.approx(complete, rel=5.0 * 0.012 * np.sqrt(every))


def near(fit: lw.Estimate) -> bool:
    """Whether the coefficients of the sink lie within four standard errors of those of the chain."""
    chain, found = lw.bnes_chain(2), [fit.coefficient(f"nes1.{name}") for name in ("alpha", "beta", "c")]
    errors = [each.value - present(chain.coefficient(each.name).value) for each in found]
    return all(
        abs(error) < 4.0 * present(each.standard_error) for error, each in zip(errors, found, strict=True)
    )


@pytest.mark.slow
@pytest.mark.parametrize("every", [2, 4])
def test_laws_are_found_from_all_samples_of_channels_at_two_rates(every: int) -> None:
    record, chain = two_rates(every), lw.bnes_chain(2)
    fit = lw.identify(record, chain.unknown("nes"))
    assert fit.trusted and fit.samples == 6001 + len(range(0, 6001, every)) and near(fit)
    fewer = lw.identify(present(common_samples(record)), chain.unknown("nes"))
    wider, narrower = (present(each.coefficient("nes1.alpha").standard_error) for each in (fewer, fit))
    assert narrower < wider
    with pytest.raises(lw.IdentificationError, match="keep the samples that all sensors have"):
        lw.identify(record, chain.unknown("nes"), method="weak")


def test_links_are_discovered_from_channels_at_two_rates_and_the_slower_is_told_once_with_its_rate() -> None:
    discovery = lw.discover(two_rates(2), masses(lw.bnes_chain(2)))
    assert discovery.trusted
    assert {link.name for link in discovery.structure.links} == {"m1-ground", "m2-m1"}
    (alert,) = lw.inspect(two_rates(4)).alerts
    assert (alert.kind, alert.channel) == ("dropped", "x:m2")
    assert "in one of 4 rows, so that its rate is 250 Hz" in alert.message


@pytest.mark.parametrize("missing", [0.6, 0.7])
def test_most_samples_may_be_missing_at_random(missing: float) -> None:
    """Most of those that are left follow in the same distance, which is no rate: they had no noise, and no answer trust."""
    record = two_rates(1)
    values = np.where(np.random.default_rng(4).random(record.values.shape) < missing, np.nan, record.values)
    fewer = replace(record, values=values)
    assert common_samples(fewer) is None
    noise, complete = channel_noise(fewer), channel_noise(record)
    # standard errors of 3 %, of cells that are fewer and wider; four of these
    assert all(noise[name] == pytest.approx(complete[name], rel=0.12) for name in complete)
    fit = lw.identify(fewer, lw.bnes_chain(2).unknown("nes"))
    assert fit.verdicts == (lw.Verdict.CONVERGED,) and near(fit)
