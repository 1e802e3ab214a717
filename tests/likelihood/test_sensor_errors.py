"""Offsets, gains, drift and hum of sensors: found with the laws, admitted, and known beforehand to within."""

import re
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import scipy
from present import present
from problems import chain_record, truth
from record_faults import changed
from structures import asked_oscillator, oscillator
from within import assert_within, errors

import linkwise as lw
from linkwise.arrays import Floats
from linkwise.likelihood.estimate import _Search
from linkwise.likelihood.fit import likelihood_fit
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.terms import GainDrift, Nonlinearity, Term, _passed


@pytest.fixture(scope="module")
def quiet() -> lw.Record:
    return chain_record(2, duration=3.0)


def test_each_record_has_its_own_noise(quiet: lw.Record) -> None:
    chain = lw.bnes_chain(2)
    unknown = chain.unknown("nes")
    loud, soft = quiet.with_noise(20.0, seed=2), quiet.with_noise(50.0, seed=3)
    both, alone = (
        likelihood_fit(records, unknown, truth(chain, unknown)) for records in ([loud, soft], [soft])
    )
    # of 12002 samples, and the estimate of their noise
    assert both.chi_square == pytest.approx(1.0, abs=0.05)
    ratio = np.sqrt(np.diag(both.covariance) / np.diag(alone.covariance))
    assert np.all(ratio < 1.0)  # a loud record adds, it does not spoil ...
    assert np.all(ratio > 0.95)  # ... and it adds little: 30 dB are a factor of 1000 in weight


def test_a_law_that_is_not_finite_where_the_link_went_is_refused() -> None:
    rooted = asked_oscillator("k*d + b*sqrt(d)", 1.0, name="root")
    time = np.arange(800) / 200.0
    record = lw.Record.from_arrays(time, {"x:m1": np.sin(20.0 * time)}).with_noise(40.0, seed=0)
    for method in ("weak", "ml"):
        with pytest.raises(lw.IdentificationError, match=r"root\.b is not finite over the whole motion"):
            lw.identify(record, rooted, method=method)


def test_time_in_the_wrong_unit_is_refused_by_the_flow(quiet: lw.Record) -> None:
    slow = lw.Record(0.0, 1.0, quiet.channels, quiet.values)  # 1000 Hz taken for 1 Hz
    with pytest.raises(
        lw.IdentificationError, match=r"runs to infinity within a few samples: .*write time\[ms\]"
    ):
        lw.identify(slow.with_noise(40.0, seed=0), lw.bnes_chain(2).unknown("nes"))


CHAIN = lw.bnes_chain(2)
TRUTH = {p.name: present(CHAIN.coefficient(p.name).value) for p in CHAIN.unknown("all").parameters}


def known_within(structure: lw.Structure, start: float, sigma: float) -> lw.Structure:
    """The structure with a prior of its second mass."""
    first, second = structure.masses
    mass = replace(second, mass=lw.Coefficient.unknown(start, sigma=sigma))
    return replace(structure, masses=(first, mass))


def miscalibrated(record: lw.Record, deviation: float, seed: int) -> lw.Record:
    """The record with gains drawn about 1, one for each channel."""
    gains = 1.0 + deviation * np.random.default_rng(seed).standard_normal(record.values.shape[1])
    return replace(record, values=record.values * gains)


@pytest.fixture(scope="module")
def record() -> lw.Record:
    return chain_record(2, duration=3.0).with_noise(40.0, seed=1)


def test_a_mass_that_is_known_to_within_is_found_between_prior_and_record(record: lw.Record) -> None:
    """The product of two normal densities, of the prior and of the fit without it."""
    prior = lw.identify(record, known_within(CHAIN.unknown("all"), 0.010002, 1e-6)).coefficient("m2.mass")
    free = lw.identify(record, known_within(CHAIN.unknown("all"), 0.010002, 1.0)).coefficient("m2.mass")
    weights = np.array([1e-6, present(free.standard_error)]) ** -2.0
    joined = weights @ [0.010002, free.value] / weights.sum()
    # the likelihood is quadratic over its own errors to some per cent
    assert prior.value == pytest.approx(joined, abs=0.05 * weights.sum() ** -0.5)
    assert present(prior.standard_error) == pytest.approx(weights.sum() ** -0.5, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["ml", "weak"])
def test_a_value_that_the_record_contradicts_is_not_trusted(method: str, record: lw.Record) -> None:
    right = lw.identify(record, known_within(CHAIN.unknown("all"), 0.0101, 1e-4), method=method)  # type: ignore[arg-type]
    wrong = lw.identify(record, known_within(CHAIN.unknown("all"), 0.0120, 1e-4), method=method)  # type: ignore[arg-type]
    assert right.trusted and not wrong.trusted
    assert wrong.verdicts[0] is lw.Verdict.MEASUREMENT_ERROR and "m2.mass" in wrong.message


def test_sparse_regression_and_discovery_refuse_what_they_would_not_count(record: lw.Record) -> None:
    unknown = known_within(CHAIN.unknown("nes"), 0.0101, 1e-4)
    with pytest.raises(lw.IdentificationError, match=r"m2\.mass is stated with a sigma"):
        lw.identify(record, unknown, method="sindy")
    with pytest.raises(lw.StructureError, match=r"m2\.mass is stated with a sigma"):
        lw.discover(record, lw.model.PartialStructure(unknown.masses, ()))


def test_calibration_widens_only_what_a_gain_may_change(record: lw.Record) -> None:
    """All gains 1 % larger leave a linear law as it is and make a cubic coefficient 2 % smaller."""
    unknown = CHAIN.unknown("all")
    sharp = lw.identify(record, unknown)
    wide = lw.identify(record, unknown, calibration={"common": 0.01})
    ratio = {
        str(name): present(wide.coefficient(name).standard_error)
        / present(sharp.coefficient(name).standard_error)
        for name in TRUTH
    }
    assert ratio["nes1.beta"] > 10.0  # 2 % of it, 0.03 % without
    assert ratio["spring1.k"] == pytest.approx(1.0, abs=0.05)  # the same numerics, another optimum
    assert present(wide.coefficient("nes1.beta").standard_error) == pytest.approx(0.02 * 1e6, rel=0.1)


@pytest.mark.slow
def test_intervals_of_sensors_of_stated_calibration_cover_the_truth() -> None:
    """Five drawn sets of gains: the sum of squares stays below what five independent ones reach once in 10 000."""
    squares = []
    for seed in range(4100, 4105):
        record = miscalibrated(chain_record(2, duration=1.0).with_noise(40.0, seed=seed), 0.01, seed)
        fit = lw.identify(record, CHAIN.unknown("all"), calibration={"all": 0.01})
        assert fit.trusted
        squares.append(np.square(errors(fit, CHAIN)))
    chance = scipy.stats.chi2.ppf(1.0 - 1e-4, 5) / 5.0
    assert (np.mean(squares, axis=0) < chance).all()


@pytest.mark.slow
def test_a_test_is_planned_with_what_is_known_beforehand() -> None:
    plan = {"duration": 0.5, "rate": 1000.0, "noise": 40.0, "release": {"v:m1": 1.0}}
    wide, narrow = (
        lw.limit(known_within(CHAIN, 0.01, sigma), **plan).coefficient("m2.mass")  # type: ignore[arg-type]
        for sigma in (1.0, 1e-6)
    )
    information = np.array([present(wide.standard_error), 1e-6]) ** -2.0
    # same numerics, of a matrix whose scales are 1e6 apart
    assert present(narrow.standard_error) == pytest.approx(information.sum() ** -0.5, rel=1e-6)


UNKNOWN = CHAIN.unknown("nes")


def noisy() -> lw.Record:
    return chain_record(2, duration=2.0).with_noise(30.0, seed=1)


def stating(record: lw.Record, **known: float) -> lw.Record:
    return replace(record, uncertainty={"x:m2": lw.records.SensorUncertainty(**known)})


def sensor_error(fit: lw.Estimate, phrase: str) -> tuple[float, float]:
    """Value and standard error of what the findings tell of x:m2."""
    [match] = [
        hit
        for text in fit.findings
        if (hit := re.match(rf"x:m2 {phrase} (\S+) .*error (\S+?)( ms)?\)", text))
    ]
    return float(match[1]), float(match[2])


@pytest.mark.parametrize(
    ("kind", "phrase", "unit"), [("offset", "is off by", 1.0), ("delay", "is late by", 1e3)]
)
def test_a_prior_adds_its_precision(kind: str, phrase: str, unit: float) -> None:
    free = sensor_error(lw.identify(stating(noisy(), **{kind: np.inf}), UNKNOWN), phrase)[1] / unit
    value, error = sensor_error(lw.identify(stating(noisy(), **{kind: free}), UNKNOWN), phrase)
    # as precise as the record: half the variance; both are told to two digits
    assert error / unit == pytest.approx(free / np.sqrt(2.0), rel=0.08)
    # four standard errors: 6e-5 of chance each
    assert abs(value) < 4.0 * error


@pytest.mark.slow
def test_a_stated_gain_is_a_calibration() -> None:
    stated = lw.identify(stating(noisy(), gain=0.01), UNKNOWN)
    by_option = lw.identify(noisy(), UNKNOWN, calibration={"x:m2": 0.01})
    assert stated.coefficient("nes1.beta").standard_error == by_option.coefficient("nes1.beta").standard_error
    by_weak = lw.identify(stating(noisy(), gain=0.01), UNKNOWN, method="weak")
    assert any("errors of x:m2 is not counted: method" in finding for finding in by_weak.findings)
    # what is asked for goes before what the record states
    narrow = lw.identify(stating(noisy(), gain=0.2), UNKNOWN, calibration={"all": 0.05, "x:m2": 0.01})
    both = lw.identify(noisy(), UNKNOWN, calibration={"all": 0.05, "x:m2": 0.01})
    assert narrow.coefficient("nes1.beta").value == both.coefficient("nes1.beta").value


def late() -> lw.Record:
    """The second laser is three samples of 1 ms late."""
    return changed(noisy(), x_m2=lambda x: np.roll(x, 3))[3:]


@pytest.mark.slow
def test_a_prior_of_a_delay_is_of_the_whole_delay() -> None:
    value, error = sensor_error(lw.identify(stating(late(), delay=2e-3), UNKNOWN), "is late by")
    # the prior, 300 times as wide as the error, moves it by 1e-5 of 3 ms; the record says it to 0.0064 ms
    assert value == pytest.approx(3.0, abs=4.0 * error)


def test_an_offset_that_dwarfs_the_motion_leaves_the_search_where_it_would_end_without(
    quiet: lw.Record,
) -> None:
    decay = lw.simulate(
        lw.bnes_chain(2), release={"x:m1": 0.01}, duration=3.0, rate=quiet.rate, sensors=["x:m1", "x:m2"]
    )
    decay = decay.with_noise(40.0, seed=3)
    far = replace(decay, values=decay.values + 1.0, simulated=None)
    near, moved = (
        lw.identify(record, lw.bnes_chain(2).unknown("all"), offsets=["x:m1", "x:m2"])
        for record in (decay, far)
    )
    np.testing.assert_allclose(moved.values, near.values, rtol=1e-3)


@pytest.mark.slow
def test_an_offset_beyond_its_prior_takes_trust_away() -> None:
    off = replace(noisy(), values=noisy().values + np.array([0.0, 1e-3]), simulated=None)
    wrong = lw.identify(stating(off, offset=1e-4), UNKNOWN)
    assert not wrong.trusted and "offset of x:m2 0.000999 m above the value that is stated" in wrong.message
    assert lw.identify(stating(off, offset=1e-3), UNKNOWN).trusted


def test_records_that_state_different_errors_are_refused() -> None:
    second = chain_record(2, duration=2.0).with_noise(30.0, seed=2)
    with pytest.raises(
        lw.IdentificationError,
        match=r"state different errors of x:m2: its offset is known to 0\.0001 m, and its offset is known to 0\.001 m; state",
    ):
        lw.identify([stating(noisy(), offset=1e-4), stating(second, offset=1e-3)], UNKNOWN)


@pytest.mark.slow
def test_a_validation_allows_for_stated_errors() -> None:
    record = noisy()
    wrong = replace(record, values=record.values * [1.0, 1.03], simulated=None)
    assert not lw.validate(wrong, CHAIN).trusted
    assert lw.validate(stating(wrong, gain=0.03), CHAIN).trusted
    unknown = lw.validate(stating(record, offset=np.inf), CHAIN)
    assert "Errors taken as zero, though stated as unknown: offset of x:m2." in unknown.remarks


ASKED = CHAIN.unknown("all")


def disturbed(added: Floats, seed: int, start: float = 0.0) -> lw.Record:
    """A record at 30 dB whose sink has `added` (N,), in standard deviations of its noise, on top of its motion."""
    clean = chain_record(2, duration=2.0)
    record = clean.with_noise(30.0, seed=seed)
    sigma = float(np.std(clean.channel("x:m2"))) * 10.0**-1.5
    values = record.values + np.outer(sigma * added, [0.0, 1.0])
    return replace(record, start=start, values=values, simulated=None)


TIME = chain_record(2, duration=2.0).time
HUM = 3.0 * np.sin(2.0 * np.pi * 50.0 * TIME + 1.0)
DRIFT = 6.0 * np.sin(1.5 * TIME)


@pytest.mark.slow
def test_laws_are_found_with_what_is_added_to_a_sensor_beside_a_gain() -> None:
    """Four standard errors: chance exceeds them for one in 2300 of these seven coefficients."""
    record = disturbed(DRIFT + HUM, seed=21)
    assert not lw.identify(record, ASKED, as_stated=True).trusted
    fit = lw.identify(record, ASKED, drifts={"x:m2": 0.4}, hums={"x:m2": 50.0}, gains=["x:m2"])
    assert_within(fit, CHAIN)


def test_amplitude_and_range_are_told_with_standard_errors() -> None:
    """Within five of them; the drift within the error of a line of eight pieces, whose corners lie on the curve."""
    record = disturbed(DRIFT + HUM, seed=22)
    fit = lw.identify(record, ASKED, drifts=["x:m2"], hums={"x:m2": 50.0})
    sigma = float(np.std(chain_record(2, duration=2.0).channel("x:m2"))) * 10.0**-1.5
    [drift] = [line.split() for line in fit.findings if " drifts over " in line]
    [hum] = [line.split() for line in fit.findings if " has a hum of " in line]
    assert float(hum[5]) == pytest.approx(3.0 * sigma, abs=5.0 * float(hum[-1].rstrip(").")))
    assert float(drift[3]) == pytest.approx(np.ptp(DRIFT) * sigma, rel=0.05)


@cache
def coupled(corner: float = 0.3, before: int = 0) -> tuple[lw.Record, lw.Structure, float]:
    """An accelerometer behind a high pass on a mass at 2.5 Hz under a random force, from a sample on; with its structure."""
    rate, count = 100.0, 2001 + before
    rng = np.random.default_rng(3)
    frequency = np.fft.rfftfreq(8 * count, 1.0 / (8 * rate))
    spectrum = np.exp(2j * np.pi * rng.random(len(frequency))) * ((frequency > 0.5) & (frequency < 8.0))
    signal = np.fft.irfft(spectrum, 8 * count)
    spring = oscillator("k*d + c*v", name="l1", k=250.0, c=1.0)
    force = lw.model.Sampled(0.0, 8 * rate, 10.0 * signal / signal.std())
    clean = lw.simulate(spring, duration=(count - 1) / rate, rate=rate, forces={"m1": force}, sensors=("a",))
    passed = changed(clean, a_m1=lambda a: _passed(a, 1.0 / rate, corner))
    return passed.with_noise(40.0, seed=3)[before:], spring.unknown("all"), corner


@pytest.mark.slow
@pytest.mark.parametrize("keywords", [{}, {"corners": ["a:m1"]}, {"corners": {"a:m1": 0.3}}])
def test_a_high_pass_is_named_and_taken_into_the_model(keywords: dict[str, Any]) -> None:
    record, unknown, corner = coupled()
    fit = lw.identify(record, unknown, **keywords)
    assert fit.trusted, fit.message
    assert_within(fit, {"l1.k": 250.0, "l1.c": 1.0}, 4.5)
    if keywords.get("corners") != {"a:m1": corner}:
        [error] = fit.sensor_errors
        assert error.kind == "high pass" and abs(error.value - corner) < 4.5 * error.standard_error
        assert any("behind a high pass with its corner at 0.3" in line for line in fit.findings)
    assert [cause.kind for cause in fit.added] == ([] if keywords else ["high pass"])


@pytest.mark.slow
def test_a_high_pass_is_found_where_the_record_begins_in_motion() -> None:
    """The state of the high pass at the start decays with its corner."""
    record, unknown, corner = coupled(0.6, before=330)
    fit = lw.identify(record, unknown, corners=["a:m1"])
    assert fit.trusted, fit.message
    assert_within(fit, {"l1.k": 250.0, "l1.c": 1.0}, 4.5)
    assert abs(fit.sensor_errors[0].value - corner) < 4.5 * fit.sensor_errors[0].standard_error


def test_a_hum_of_a_sensor_on_the_base_is_told_by_its_own_name() -> None:
    known = oscillator("k*d + c*v", to="base", k=400.0, c=0.5)
    record = lw.simulate(
        known,
        duration=4.0,
        rate=100.0,
        base="0.01*sin(15*t) + 0.01*sin(27*t)",
        sensors=["rel:v:m1", "a:base"],
    ).with_noise(30.0, seed=1)
    humming = changed(record, rel_v_m1=lambda v: v + 0.05 * np.sin(2.0 * np.pi * 9.0 * record.time))
    fit = lw.identify(humming, known.unknown("all"), hums={"rel:v:m1": 9.0}, as_stated=True)
    assert any(remark.startswith("rel:v:m1 has a hum of 0.05") for remark in fit.remarks)


@pytest.mark.parametrize("error", [GainDrift("x:m1"), Nonlinearity("x:m1")])
def test_noise_of_a_channel_makes_no_error_that_follows_its_motion_larger(error: Term) -> None:
    """With the noise in what it follows from, its size grows as that then takes noise off as well: here by 11 of its errors.

    Tolerance: statistics, 4 standard errors, one in 16 000, of a fixed seed.
    """
    box = oscillator("k*d + c*v + k3*d**3", name="s", k=900.0, c=0.6, k3=4e5)
    clean = lw.simulate(box, duration=4.0, rate=200.0, release={"x:m1": 0.03})
    size, elapsed = 0.04, clean.time / clean.duration
    shape = elapsed if isinstance(error, GainDrift) else (clean.channel("x:m1") / 0.03) ** 2
    record = changed(clean, x_m1=lambda x: x / (1.0 - size * shape)).with_noise(25.0, seed=1200001)
    fit = _Search(box.unknown("all"), {})([record], LikelihoodOptions(errors=(error,)))
    found, deviation = fit.size_of(fit.terms[0])
    assert abs(found - size) < 4.0 * deviation


@pytest.mark.parametrize(("chi_square", "searches"), [(2e3, 3), (1e2, 1)])
def test_a_search_that_converged_far_from_the_noise_of_quiet_sensors_is_repeated_beside_more(
    monkeypatch: pytest.MonkeyPatch, chi_square: float, searches: int
) -> None:
    """First beside a hundredth of the motion, then beside the noise that was found, from the values that were."""
    box = oscillator("k*d + c*v", name="s", k=900.0, c=0.6)
    record = lw.simulate(box, duration=2.0, rate=200.0, release={"x:m1": 0.03}).with_noise(80.0, seed=1)
    search, options, asked = _Search(box.unknown("all"), {}), LikelihoodOptions(), []
    fit = replace(search([record], options), chi_square=chi_square)

    def answer(self: _Search, records: list[lw.Record], _: LikelihoodOptions) -> object:
        asked.append((records[0].noise, self.given))
        return fit

    monkeypatch.setattr(_Search, "_from_starts", answer)
    search([record], options)
    part = 0.01 * np.std(record.channel("x:m1"))
    beside = [({}, {}), ({"x:m1": pytest.approx(part)}, {}), (fit.noise, fit.by_name)]
    assert asked == beside[:searches]
