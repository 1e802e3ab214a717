"""Clocks of devices: ratios found beside delays, named, taken into the model, and taken out where they are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from random_signals import random_force
from structures import link, oscillator, structure

import linkwise as lw
from linkwise.estimates.estimate import Estimate
from linkwise.likelihood.delays import with_delays
from linkwise.likelihood.fit import likelihood_fit
from linkwise.likelihood.options import AskedFor, LikelihoodOptions, errors_to_find
from linkwise.likelihood.terms import Term
from linkwise.likelihood.tests import diagnosis
from linkwise.records.channel import interpolated

RATE, DURATION, LATE = 250.0, 8.0, 0.5e-3
OSCILLATOR = oscillator("k*d + c*v + k3*d**3", name="spring", k=1000.0, c=2.0, k3=2e5)
PPM = 300.0


def two_loggers(seed: int, *, noise_of_force: float = 0.0) -> lw.Record:
    """A force by one logger, and a displacement by another one whose clock runs fast and which started late."""
    rng, samples = np.random.default_rng(seed), round(RATE * DURATION) + 1
    frequency = np.fft.rfftfreq(samples, 1.0 / RATE)
    spectrum = np.where((frequency > 1.0) & (frequency < 12.0), rng.normal(size=(2, len(frequency))), 0.0)
    force = np.fft.irfft(spectrum[0] + 1j * spectrum[1], samples)
    acting = lw.model.Sampled(0.0, RATE, 8.0 * force / force.std(), band_limited=True)
    clean = lw.simulate(OSCILLATOR, forces={"m1": acting}, duration=DURATION, rate=RATE)
    shown = interpolated(0.0, RATE, clean.channel("x:m1"))
    time = clean.time - LATE - 1e-6 * PPM * (clean.time - 0.5 * DURATION)
    x = shown.value(np.clip(time, 0.0, DURATION))
    columns = {"x:m1": x + 0.01 * x.std() * rng.normal(size=samples), "force:m1": clean.channel("force:m1")}
    columns["force:m1"] = columns["force:m1"] + noise_of_force * rng.normal(size=samples)
    return lw.Record(0.0, RATE, tuple(columns), np.stack(list(columns.values()), axis=1))[8:-8]


def assert_right(fit: Estimate, channel: str, ppm: float) -> None:
    """Whether an answer is trusted, and right within 4.5 of its standard errors, as is the clock of a channel."""
    assert fit.trusted
    for name, value in (("spring.k", 1000.0), ("spring.k3", 2e5), ("spring.c", 2.0)):
        assert abs(fit.coefficient(name).value - value) < 4.5 * (fit.coefficient(name).standard_error or 0.0)
    found = next(error for error in fit.sensor_errors if error.kind == "clock")
    assert found.channel == channel and found.unit == "ppm"
    assert abs(found.value - ppm) < 4.5 * found.standard_error < 0.5 * abs(ppm)


@pytest.mark.slow
def test_an_acceleration_by_a_late_clock_beside_noise_of_a_force_is_explained() -> None:
    """A part of a sample that was not taken out looked like another clock, a gain and a late force."""
    rig = structure(
        {"m1": 1.0, "m2": 0.3},
        link("s1", "m1-ground", "k*d + k3*d**3 + c*v", k=1500.0, k3=5e6, c=1.0),
        link("s2", "m2-m1", "alpha*d + beta*d**3 + c*v", alpha=-850.0, beta=3.4e7, c=0.4),
    )
    force = random_force(np.random.default_rng(83), DURATION, RATE, rms=4.0, highest=20.0)
    drive: dict[str, Any] = {"forces": {"m1": force}, "release": {"x:m2": 5e-3}, "sensors": ["a"]}
    fine = lw.simulate(rig, duration=DURATION, rate=8.0 * RATE, **drive)
    record = lw.simulate(rig, duration=DURATION, rate=RATE, **drive)
    late = record.time - 1.3e-3 - 1e-6 * PPM * (record.time - 0.5 * DURATION)
    shown = interpolated(0.0, fine.rate, fine.channel("a:m2")).value(np.clip(late, 0.0, DURATION))
    rng, columns = np.random.default_rng(84), record.values.copy()
    columns[:, record.channels.index("a:m2")] = shown
    for column, name in zip(columns.T, record.channels, strict=True):
        column += (1e-3 if name.is_force else 0.02 * column.std()) * rng.standard_normal(len(column))
    measured = replace(record, values=columns, simulated=None)[8:-8]
    fit = lw.identify(
        measured, rig.unknown("all"), clocks=["a:m2"], input_noise={"force:m1": 1e-3}, as_stated=True
    )
    assert fit.trusted, fit.message
    found = next(error for error in fit.sensor_errors if error.kind == "clock")
    assert abs(found.value - PPM) < 4.5 * found.standard_error


@pytest.mark.parametrize(
    ("options", "channel", "ppm"),
    [
        ({"clocks": ["x:m1"]}, "x:m1", PPM),
        pytest.param({"clocks": "force:m1"}, "force:m1", -PPM, marks=pytest.mark.slow),
        pytest.param({"clocks": ["x:m1"], "input_noise": {"force:m1": 0.08}}, "x:m1", PPM, marks=pytest.mark.slow),
    ],
)  # fmt: skip
def test_the_ratio_of_clocks_is_found(options: dict[str, Any], channel: str, ppm: float) -> None:
    record = two_loggers(81, noise_of_force=0.08 if "input_noise" in options else 0.0)
    fit = lw.identify(record, OSCILLATOR.unknown("all"), as_stated=True, **options)
    assert_right(fit, channel, ppm)
    assert any("has a clock that runs " in line for line in fit.findings)


@pytest.mark.slow
def test_a_clock_is_named_before_the_delay_that_it_looks_like() -> None:
    fit = lw.identify(two_loggers(82), OSCILLATOR.unknown("all"), as_stated=True)
    first = fit.diagnosis[0]
    assert not fit.trusted and first.kind == "clock" and first.unit == "ppm"
    assert first.where in ("x:m1", "force:m1") and abs(first.size) == pytest.approx(PPM, rel=0.25)
    assert "a clock of " in first.description and " ppm " in first.description


@pytest.mark.parametrize(("noise", "holds_the_delay"), [(1.0, True), (10.0, False)])
def test_a_clock_counts_what_its_delay_gains_where_it_gains_more_than_by_chance(
    noise: float, holds_the_delay: bool
) -> None:
    """By the noise that is left: beside laws that leave 3 times as much, chance named a clock in place of a late force."""
    record, unknown = two_loggers(82), OSCILLATOR.unknown("all")
    fit = likelihood_fit([record], unknown, np.array([1000.0, 2.0, 2e5]))
    tested = diagnosis.tested_causes(fit, unknown.with_values(fit.by_name), record.channels, terms=False)
    noisy = replace(tested, longer=replace(tested.longer, noise=noise))
    gains = {
        one.kind: gain
        for one, gain in zip(tested.hypotheses, noisy.tests.gains, strict=True)
        if one.where == "x:m1"
    }
    assert (
        9.0 < gains["delay"] < 900.0 and 9.0 < gains["clock"] < 900.0
    )  # three standard errors, of either noise
    assert (gains["clock"] > 2.0 * gains["delay"]) == holds_the_delay


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, {"admit": "clock"}])
def test_a_clock_is_taken_into_the_model(options: dict[str, Any]) -> None:
    fit = lw.identify(two_loggers(83), OSCILLATOR.unknown("all"), **options)
    named = next(error.channel for error in fit.sensor_errors if error.kind == "clock")
    assert_right(fit, named, PPM if named == "x:m1" else -PPM)
    assert [cause.kind for cause in fit.added] == ([] if options else ["clock"])


@pytest.mark.slow
def test_a_known_clock_is_taken_out() -> None:
    record = two_loggers(84)
    fit = lw.identify(record, OSCILLATOR.unknown("all"), clocks={"x:m1": PPM}, as_stated=True)
    assert fit.trusted and "clock" not in [error.kind for error in fit.sensor_errors]
    right = lw.records.without_delays(record, {"x:m1": LATE}, clocks={"x:m1": PPM})
    assert "300 ppm in the clock of x:m1" in right.notes[-1]
    assert lw.identify(right, OSCILLATOR.unknown("all"), as_stated=True).trusted


@dataclass
class Searched:
    """A search of laws that are wrong: each fit finds the same delay in samples and ratio in ppm, whatever was taken out."""

    late: float
    ppm: float = 0.0
    fits: int = 0
    interrupted = False

    def __call__(self, records: Sequence[lw.Record], options: LikelihoodOptions) -> Searched:
        self.fits += 1
        self.delays = {"x:m1": self.late / RATE}
        return self

    def size_of(self, term: Term) -> tuple[float, float]:
        return self.ppm, 1.0


@pytest.mark.parametrize(
    ("found", "message"),
    [
        (Searched(0.1, ppm=400.0), "the clock of x:m1 does not settle"),
        (Searched(2.0), "the delay of x:m1 does not settle"),
    ],
)
def test_what_fits_do_not_agree_on_is_refused(found: Searched, message: str) -> None:
    record = two_loggers(86)
    options = LikelihoodOptions(errors_to_find([record], AskedFor(clocks=["x:m1"])))
    search: Any = found
    with pytest.raises(lw.IdentificationError, match=message):
        with_delays(search, [record], options)
    assert found.fits > 1
