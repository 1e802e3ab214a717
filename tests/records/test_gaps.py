"""Records with gaps: clipped samples, channels of two rates, resampling, and inputs that must be complete."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from present import present
from problems import PROBLEMS, chain_record, parsed
from record_faults import without
from rigs import hysteretic, measured, run
from structures import beam_of_one_mode, link, oscillator

import linkwise as lw
from linkwise.arrays import Floats
from linkwise.records.record import common_samples
from linkwise.records.sample_checks import require_complete
from linkwise.records.timeline import resample_evenly
from linkwise.signals.noise import channel_noise


def marked() -> lw.Record:
    """A record of 1 s clipped at six tenths of its peaks."""
    record = chain_record(2).with_noise(30.0, seed=71).between(0.0, 1.0)
    peak = 0.6 * np.max(np.abs(record.values), axis=0)
    clipped = replace(record, values=np.clip(record.values, -peak, peak), simulated=None)
    return lw.inspection.mark_missing(clipped)


def readings(record: lw.Record, name: str) -> np.ndarray:
    return present(record.clipped[name].of(record.channel(name))).readings


def test_joined_records_have_those_of_both_parts() -> None:
    whole = marked()
    joined = lw.records.continued(whole[:400], whole[430:])
    expected = readings(whole, "x:m2")
    expected[400:430] = np.nan
    np.testing.assert_array_equal(readings(joined, "x:m2"), expected)
    joined = lw.records.continued(replace(whole[:400], clipped={}), whole[400:])
    assert np.isnan(readings(joined, "x:m2")[:400]).all()
    assert np.isfinite(readings(joined, "x:m2")[400:]).any()
    joined = lw.records.beside(whole.select(["x:m1"]), whole.select(["x:m2"])[:700])
    for name in ("x:m1", "x:m2"):
        np.testing.assert_array_equal(readings(joined, name), readings(whole, name)[:700])


@pytest.mark.parametrize(
    ("samples", "readings", "sides", "message"),
    [
        ([np.nan, 1.0], [2.0], [1.0], "arrays of one length"),
        ([np.nan, 1.0], [2.0, np.nan], [3.0, 0.0], "-1, 0 or 1, got 3 at sample 0"),
        ([2.0, 1.0], [2.0, np.nan], [1.0, 0.0], "sample 0 is there beside its reading"),
    ],
)
def test_wrong_samples(samples: list[float], readings: list[float], sides: list[float], message: str) -> None:
    with pytest.raises(lw.RecordError, match=message):
        lw.records.ClippedSamples(np.array(samples), np.array(readings), np.array(sides))


def test_clipped_samples_of_what_is_no_response_are_refused() -> None:
    record = marked()
    with pytest.raises(
        lw.RecordError,
        match=r"x:m7: is not in the record, and something is stated of it \(clipped samples\); the channels are x:m1, x:m2",
    ):
        replace(record, clipped={"x:m7": record.clipped["x:m2"]})
    forced = replace(record, channels=parsed("x:m1", "force:m2"), clipped={}, noise={})
    with pytest.raises(lw.RecordError, match="force:m2 is an input"):
        replace(forced, clipped={"force:m2": record.clipped["x:m2"]})


def two_rates(every: int, first: int = 0) -> lw.Record:
    """The paper's chain at 1000 Hz, its sink at a part of that rate; 30 dB."""
    record = chain_record(2).with_noise(30.0, seed=31)
    missing = np.ones(len(record), dtype=bool)
    missing[first::every] = False
    return without(record, **{str(record.channels[1]): missing})


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


RATE = 200.0
X, SINE, BASE = map(lw.records.Channel.parse, ("x:m1", "force:m1", "a:base"))


def noisy(times: Floats, seed: int) -> Floats:
    return np.sin(12.0 * times) + 0.01 * np.random.default_rng(seed).standard_normal(len(times))


def test_samples_whose_times_lie_on_the_grid_stay_as_they_are_and_none_is_invented() -> None:
    rng = np.random.default_rng(1)
    times = np.arange(2001) / RATE
    there = rng.random(2001) > 0.4
    there[[0, -1]] = True
    samples = noisy(times, 2)
    for given in (times[there], times):  # rows that the file lacks, and empty cells
        column = samples[there] if len(given) < 2001 else np.where(there, samples, np.nan)
        start, columns, note = resample_evenly(given, {X: column}, RATE)
        assert start == 0.0
        assert np.array_equal(columns[X], np.where(there, samples, np.nan), equal_nan=True)
        assert note.endswith("lie on an even grid of 200 Hz: no response was interpolated.")


def test_short_gaps_of_an_input_are_interpolated_beside_responses_that_are_not() -> None:
    times = np.arange(1001) / RATE
    smooth = np.sin(12.0 * times)
    smooth[[300, 500, 501]] = np.nan
    _, columns, note = resample_evenly(times, {X: smooth, SINE: smooth, BASE: smooth}, RATE)
    assert np.isnan(columns[X]).sum() == 3
    for name in (SINE, BASE):
        assert np.max(np.abs(columns[name] - np.sin(12.0 * times))) < 1e-7
    assert note.endswith("Short gaps of force:m1, a:base were, by quintic splines.")


@pytest.mark.parametrize("missing", [0.0, 0.4])
def test_where_a_spline_would_amplify_noise_samples_are_missing(missing: float) -> None:
    """Through samples at random times, some nearly at once, a spline had errors of a hundred times their noise."""
    rng = np.random.default_rng(3)
    times = np.sort(rng.uniform(0.0, 10.0, 2001))
    column = np.where(rng.random(2001) < missing, np.nan, noisy(times, 4))
    start, columns, _ = resample_evenly(times, {X: column}, RATE * 1.01)
    grid = start + np.arange(len(columns[X])) / (RATE * 1.01)
    errors = columns[X] - np.sin(12.0 * grid)
    assert np.sum(~np.isnan(errors)) > 300
    assert np.nanmax(np.abs(errors)) < 5.0 * 3.0 * 0.01


@pytest.mark.parametrize("uneven", [0.0, 1e-3])
def test_infinite_and_few_samples_are_refused_on_and_off_the_grid(uneven: float) -> None:
    times = np.arange(64) / RATE + uneven * np.sin(np.arange(64))
    rate = RATE * (1.1 if uneven else 1.0)
    with pytest.raises(lw.RecordError, match="infinite values"):
        resample_evenly(times, {X: np.full(64, np.inf)}, rate)
    with pytest.raises(lw.RecordError, match="0 samples are too few"):
        resample_evenly(times, {X: np.full(64, np.nan)}, rate)


FORCE = {"m1": "30*sin(50*t) + 40*sin(31*t + 1)"}
SPRING = link("spring", "beam.tip-ground", "k*d", k=500.0)


def _beam(*links: lw.Link) -> lw.Record:
    beam, force = beam_of_one_mode(*links, damping=0.01), {"beam.tip": "sin(130*t)"}
    return lw.simulate(beam, forces=force, duration=0.5, rate=400.0, sensors=["a:beam.tip"])


def _driven() -> tuple[lw.Record, lw.Structure]:
    structure = oscillator("k*d + c*v", k=900.0, c=1.0)
    return lw.simulate(structure, forces=FORCE, duration=1.0, rate=400.0), structure.unknown("all")


def _carried() -> tuple[lw.Record, lw.Structure]:
    structure = oscillator("k*d + c*v", to="base", k=900.0, c=1.0)
    sensors = ["rel:x:m1", "a:base"]
    record = lw.simulate(structure, base="0.01*sin(31*t)", duration=1.0, rate=400.0, sensors=sensors)
    return record, structure.unknown("all")


def _on_rig() -> tuple[lw.Record, lw.Structure]:
    return measured(run(hysteretic()), 1), hysteretic().unknown("damper")


def _on_host() -> tuple[lw.Record, lw.Structure]:
    return _beam(SPRING), beam_of_one_mode(SPRING, damping=0.01).unknown("all")


@pytest.mark.slow
@pytest.mark.parametrize("case", [_driven, _carried, _on_rig, _on_host])
def test_every_method_refuses_a_gap_in_an_input(case: Callable[[], tuple[lw.Record, lw.Structure]]) -> None:
    record, structure = case()
    lacking = without(record, **{record.inputs[0]: [20, 60]})
    with pytest.raises(lw.IdentificationError) as error:
        lw.identify(lacking, structure, method="ml")
    first, end = (f"{row / record.rate:.9g}" for row in (20, len(record) - 1))
    after = f"{61 / record.rate:.9g}"
    assert str(error.value) == (
        f"channel {record.inputs[0]}: 2 of {len(record)} samples are missing, the first at {first} s, and inputs must be "
        f"complete; cut the record to a piece without gaps (the longest is from {after} to {end} s: record.between({after}, "
        f"{end})), or interpolate "
        "across gaps that are short against the changes of this input"
    )
    assert error.value.arguments == ("earliest", "latest")


@pytest.mark.parametrize(
    ("missing", "longest"), [([0, 3], (4, 9)), ([9, 2], (3, 8)), ([6], (0, 5)), (range(1, 10), (0, 0))]
)
def test_the_longest_piece_without_a_gap_is_named(missing: list[int], longest: tuple[int, int]) -> None:
    record = PROBLEMS["two masses, 20 dB"].clean[100:110]
    lacking = without(record, x_m1=missing)
    with pytest.raises(lw.IdentificationError) as error:
        require_complete("x:m1", lacking.channel("x:m1"), lacking.start, lacking.rate)
    named = str(error.value).partition("record.between(")[2].partition(")")[0]
    piece = lacking.between(*map(float, named.split(", ")))
    assert (piece.values == record.values[longest[0] : longest[1] + 1]).all()
    whole = record.channel("x:m1")
    require_complete("x:m1", whole, record.start, record.rate)
    message = r"channel x:m1: every sample is missing.*leave the channel out"
    with pytest.raises(lw.IdentificationError, match=message):
        require_complete("x:m1", np.full(10, np.nan), record.start, record.rate)
