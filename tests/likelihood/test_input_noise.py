"""Noise of the channels of inputs, of forces and of the base: counted in, or told where nobody stated it."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from random_signals import random_force
from record_faults import changed
from structures import link, oscillator, structure
from within import assert_within

import linkwise as lw

pytestmark = pytest.mark.slow


RATE, COUNT = 100.0, 801
STIFFNESS, DAMPING = 900.0, 1.0  # of a mass of 1 kg: 4.8 Hz, of which 8 s hold 38 periods


def mounted(end: str) -> lw.Structure:
    return oscillator("k*d + c*v", to=end, name="l1", k=STIFFNESS, c=DAMPING)


@cache
def driven(channel: str, noise: float, seed: int) -> lw.Record:
    """Displacements at 40 dB of a mass on a base, or under a force, in random motion whose channel has relative `noise`."""
    rng = np.random.default_rng(seed)
    frequency = np.fft.rfftfreq(COUNT, 1.0 / RATE)
    spectrum = np.exp(2j * np.pi * rng.random(len(frequency))) * ((frequency > 1.0) & (frequency < 12.0))
    signal = np.fft.irfft(spectrum, COUNT)
    moving = channel.endswith("base")
    given = lw.model.Sampled(0.0, RATE, (3e-3 if moving else 1.0) * signal / signal.std())
    length = (COUNT - 1) / RATE
    if moving:
        sensors = ("rel:x", channel)
        clean = lw.simulate(mounted("base"), duration=length, rate=RATE, base=given, sensors=sensors)
    else:
        clean = lw.simulate(mounted("ground"), duration=length, rate=RATE, forces={"m1": given})
    record = clean.with_noise(40.0, seed=seed)
    return changed(record, **{channel: lambda x: x + noise * x.std() * rng.standard_normal(COUNT)})


@pytest.mark.parametrize(
    ("channel", "end", "noise"), [("a:base", "base", 0.004), ("force:m1", "ground", 0.012)]
)
def test_noise_that_nobody_stated_takes_trust_and_is_named(channel: str, end: str, noise: float) -> None:
    record = driven(channel, noise, 21)
    fit = lw.identify(record, mounted(end).unknown("all"), as_stated=True)
    assert not fit.trusted
    [cause] = [cause for cause in fit.diagnosis if cause.kind == "input noise"]
    assert (cause.where, cause.is_instrument) == (channel, True)
    assert f"allow for noise of {channel}" in fit.message
    true = noise * record.channel(channel).std()
    # of the dozen residuals that tell it the coefficients have fitted some: to within a factor of three
    assert true / 3.0 < cause.size < 3.0 * true
    # a gain is what the cause takes off -2 log likelihood: that of a chi-square, which is above half the square of its excess
    assert cause.gain > 3.3**2
    assert lw.identify(record, mounted(end).unknown("all"), input_noise=[channel]).trusted


@pytest.mark.parametrize(("channel", "end"), [("a:base", "base"), ("force:m1", "ground")])
def test_clean_inputs_have_no_noise(channel: str, end: str) -> None:
    fit = lw.identify(driven(channel, 0.0, 2), mounted(end).unknown("all"))
    assert fit.trusted, fit.message
    assert "input noise" not in [cause.kind for cause in fit.diagnosis]


def test_intervals_hold_the_noise_that_a_channel_shows() -> None:
    record, unknown = driven("force:m1", 0.008, 34), mounted("ground").unknown("all")
    fit = lw.identify(record, unknown)
    assert fit.trusted
    assert "The intervals allow for noise of force:m1 of 0.008" in fit.message
    with pytest.raises(lw.IdentificationError, match="nor for noise of an input that the residuals hint at"):
        lw.likelihood.profile_interval(fit, "l1.c")
    stated = lw.identify(record, unknown, input_noise={"force:m1": 0.008})
    # to first order the same; friction, which noise looks like a little, is counted besides
    by_noise = np.asarray(fit.covariance) - (0.0 if fit.for_dropped_terms is None else fit.for_dropped_terms)
    ratios = np.sqrt(by_noise.diagonal() / stated.covariance.diagonal())
    assert np.all((ratios > 0.9) & (ratios < 1.2))


def test_what_noise_of_a_force_does_to_motion_between_wells_does_not_depend_on_a_relaxation(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Such motion is sensitive to its past: kicks that relaxed laws forget move coefficients by much of their errors."""
    rig = structure(
        {"m1": 1.4, "m2": 0.3},
        link("s1", "m1-ground", "k*d + k3*d**3 + c*v", k=2600.0, k3=1e7, c=1.0),
        link("s2", "m2-m1", "alpha*d + beta*d**3 + c*v", alpha=-850.0, beta=3.4e7, c=0.4),
    )
    given = random_force(np.random.default_rng(53), 8.0, 250.0, rms=5.0, highest=20.0)
    drive: dict[str, Any] = {"forces": {"m1": given}, "release": {"x:m2": 5e-3}}
    run = lw.simulate(rig, duration=8.0, rate=250.0, sensors=["a"], **drive).with_noise(35.0, seed=53)
    noisy = changed(run, force_m1=lambda x: x + 2e-3 * np.random.default_rng(1).standard_normal(len(x)))
    record = replace(noisy, noise={"force:m1": 2e-3})
    fit = lw.identify(record, rig.unknown("all"))
    assert fit.trusted and "allow for noise of force:m1 of 0.002" in fit.message
    monkeypatch.setattr("linkwise.likelihood.tests.variances._HELD", 1e-6)
    tighter = lw.identify(record, rig.unknown("all"))
    assert np.allclose(fit.covariance.diagonal(), tighter.covariance.diagonal(), rtol=0.01)


def test_a_model_error_of_a_driven_structure_may_be_noise_of_the_input() -> None:
    fit = lw.identify(driven("force:m1", 0.05, 6), mounted("ground").unknown("all"), as_stated=True)
    assert fit.fit_verdicts == (lw.Verdict.MODEL_ERROR_NEEDED,)
    assert "Noise of force:m1 has the same effect" in fit.message


DURATION = 6.0  # s
NOISE = 0.02  # of the base, relative
ERRORS = 5.0  # standard errors that an estimate may be off: 6e-7 of chance for each


def storeys(lower: str = "k*d + c*v") -> lw.Structure:
    """Two storeys, the upper of which a spring joins to the base as well."""
    values = {"k": 900.0, "c": 1.0, "k3": 4e5}
    own = {name: values[name] for name in lw.Law.parse(lower).coefficients}
    return structure(
        {"m1": 1.0, "m2": 0.5},
        link("lower", "m1-base", lower, **own),
        link("upper", "m2-m1", "k*d + c*v", k=900.0, c=1.0),
        link("stay", "m2-base", "k*d", k=900.0),
    )


@cache
def on_noisy_base(sensors: tuple[str, ...], lower: str, seed: int) -> lw.Record:
    """Responses with noise at 40 dB on a base in random motion from 1 to 12 Hz, whose channel has noise of `NOISE`."""
    rng, count = np.random.default_rng(seed), round(DURATION * RATE) + 1
    frequency = np.fft.rfftfreq(count, 1.0 / RATE)
    spectrum = np.exp(2j * np.pi * rng.random(len(frequency))) * ((frequency > 1.0) & (frequency < 12.0))
    motion = np.fft.irfft(spectrum, count)
    base = lw.model.Sampled(0.0, RATE, 3e-3 * motion / motion.std())
    clean = lw.simulate(storeys(lower), duration=DURATION, rate=RATE, base=base, sensors=sensors)
    record = clean.with_noise(40.0, seed=seed)
    return changed(record, **{sensors[-1]: lambda x: x + NOISE * x.std() * rng.standard_normal(count)})


@pytest.mark.parametrize(
    ("sensors", "lower", "seed"),
    [
        (("a", "a:base"), "k*d + c*v", 2),
        (("x", "x:base"), "k*d + c*v + k3*d**3", 3),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, tuple) else None,
)
def test_coefficients_and_the_noise_are_found(sensors: tuple[str, ...], lower: str, seed: int) -> None:
    record = on_noisy_base(sensors, lower, seed)
    fit = lw.identify(record, storeys(lower).unknown("all"), input_noise="all")
    assert_within(fit, storeys(lower), ERRORS)
    [noise] = fit.random_forces
    channel = sensors[-1]
    assert (noise.where, noise.ambient, noise.found) == (channel, False, True)
    assert noise.unit == noise.to_dict()["deviation_unit"] == ("m/s^2" if channel == "a:base" else "m")
    # of 600 samples the record determines more than 50: scatter below 1 / sqrt(100), five times that
    assert noise.deviation == pytest.approx(NOISE * record.channel(channel).std(), rel=0.5)
    assert noise.description in fit.findings


@pytest.mark.parametrize(("kind", "known"), [("v", "a:base"), ("x", "v:base")])
def test_absolute_sensors_need_no_displacement_of_the_base(kind: str, known: str) -> None:
    """What integration leaves open is a drift of each sensor, in each of the records."""
    lower = "k*d + c*v + k3*d**3"
    shaken = lw.simulate(
        storeys(lower), duration=DURATION, rate=RATE, sensors=(kind, known),
        base="0.004*sin(21*t) + 0.003*sin(33*t + 1) + 0.003*sin(47*t + 2)",
    ).with_noise(45.0, seed=6)  # fmt: skip
    noise = {name: sigma for name, sigma in shaken.noise.items() if not name.endswith("base")}
    record = replace(shaken, noise=noise)
    fit = lw.identify(record, storeys(lower).unknown("all"))
    assert_within(fit, storeys(lower), ERRORS)
    assert any(f"{kind}:m1 drifts over" in remark for remark in fit.remarks)
    assert not any(error.kind == "offset" for error in fit.sensor_errors)
    with pytest.raises(
        lw.IdentificationError, match=f"not supported beside {kind}:m1, which is not relative"
    ):
        lw.identify(record, storeys(lower).unknown("all"), ambient=["m1"])


def test_more_noise_than_a_measured_input_has_is_not_trusted() -> None:
    record = on_noisy_base(("rel:x", "a:base"), "k*d + c*v", 7)
    more = np.random.default_rng(7).standard_normal(len(record))
    noisy = changed(record, a_base=lambda x: x + 0.3 * x.std() * more)
    fit = lw.identify(noisy, storeys().unknown("all"), input_noise=["a:base"])
    assert fit.fit_verdicts == (lw.Verdict.UNEXPLAINED_FORCES,)
    assert "the noise found of a:base exceeds" in fit.message


def test_noise_that_stands_for_a_missing_term_is_not_trusted() -> None:
    """The base has no noise: beside what is found of it the damping would be 13 to 20 standard errors off."""
    true = oscillator("k*d + c*v + 0.3*v*abs(v)", to="base", name="l1", k=1600.0, c=0.8)
    rng, count = np.random.default_rng(61), 481
    frequency = np.fft.rfftfreq(count, 1.0 / 120.0)
    spectrum = np.exp(2j * np.pi * rng.random(len(frequency))) * ((frequency > 2.0) & (frequency < 12.0))
    motion = np.fft.irfft(spectrum / np.maximum(frequency, 2.0) ** 2, count)
    base = lw.model.Sampled(0.0, 120.0, 2e-3 * motion / motion.std())
    record = lw.simulate(true, duration=4.0, rate=120.0, base=base, sensors=("rel:x", "a:base"))
    record = replace(record.with_noise(40.0, seed=61), simulated=None)
    law = oscillator("k*d + c*v", to="base", name="l1", k=1600.0, c=0.8).unknown("all")
    fit = lw.identify(record, law, input_noise=["a:base"])
    assert fit.fit_verdicts == (lw.Verdict.SYSTEMATIC_MISFIT,), fit.message
    assert "only with the noise of a:base" in fit.message


@pytest.mark.parametrize(("channel", "end"), [("x:base", "base"), ("force:m1", "ground")])
def test_noise_that_a_channel_shows_is_added_where_laws_leave_more(channel: str, end: str) -> None:
    """Within 4.5 standard errors, which chance exceeds in one fit of 50 000, and named in what was added."""
    fit = lw.identify(driven(channel, 0.03, 40), mounted(end).unknown("all"))
    assert fit.trusted, fit.message
    [cause] = fit.added
    assert (cause.kind, cause.where) == ("input noise", channel)
    assert cause.size == pytest.approx(0.03 * driven(channel, 0.0, 40).channel(channel).std(), rel=0.2)
    assert_within(fit, {"l1.k": STIFFNESS, "l1.c": DAMPING}, 4.5)
    assert fit.to_dict()["added"][0]["cause"] == "input noise"
    assert fit.message.startswith(f"With noise of {channel} of ")
    assert "taken into the model, the laws " in fit.message
    assert lw.identify(driven(channel, 0.03, 40), mounted(end).unknown("all"), as_stated=True).added == ()


def test_a_hit_with_noise_in_its_load_cell_gives_the_laws() -> None:
    time = np.arange(COUNT) / RATE
    phase = (time - 0.5) / 0.15
    hit = np.where((phase > 0.0) & (phase < 1.0), 40.0 * np.sin(np.pi * phase) ** 2, 0.0)
    clean = lw.simulate(
        mounted("ground"), duration=time[-1], rate=RATE, forces={"m1": lw.model.Sampled(0.0, RATE, hit)}
    )
    record = clean.with_noise(40.0, seed=5)
    noisy = changed(record, force_m1=hit + 0.05 * np.random.default_rng(5).standard_normal(COUNT))
    fit = lw.identify(noisy, mounted("ground").unknown("all"))
    assert fit.trusted, fit.message
    assert any("force window" in note for note in fit.notes)
    assert_within(fit, {"l1.k": STIFFNESS, "l1.c": DAMPING}, 4.5)


def test_a_wrong_mass_is_no_gain_of_a_noisy_force() -> None:
    """Beside noise of the force its gain would explain a mass that is stated 20 % low, and the stiffness follow it."""
    record = driven("force:m1", 0.02, 1)
    light = replace(mounted("ground"), masses=(lw.Mass("m1", lw.Coefficient.number(0.8)),))
    assert not lw.identify(record, light.unknown("all")).trusted


@pytest.mark.parametrize("factor", [1.0, 1.1])
@pytest.mark.parametrize("seed", [3, 8])
def test_a_mass_is_tested_with_what_noise_of_a_force_makes_of_the_likelihood(
    seed: int, factor: float
) -> None:
    """A light mass behind it was told to be off by 3 to 15 %, as its score lacked the slope of the log determinant."""
    chain = lw.bnes_chain(2)
    force = random_force(np.random.default_rng(seed), 4.0, 1000.0, highest=60.0, rms=140.0)
    record = lw.simulate(chain, forces={"m1": force}, duration=4.0, rate=1000.0).with_noise(34.0, seed=seed)
    noisy = changed(record, force_m1=lambda x: x + 1.4 * np.random.default_rng(seed).normal(size=len(x)))
    stated = replace(chain, masses=(chain.masses[0], lw.Mass("m2", factor * 0.01)))
    fit = lw.identify(noisy, stated.unknown("all"), input_noise={"force:m1": 1.4}, as_stated=True)
    assert fit.trusted == (factor == 1.0), fit.message
    assert [cause.kind for cause in fit.diagnosis[:1]] == ["mass"] * (factor > 1.0)


@pytest.mark.parametrize("seed", [1, 2])
def test_intervals_beside_noise_of_an_input_hold_what_it_hides(seed: int) -> None:
    """Friction of 2 % of the force is not significant beside noise of 3 %, and moves the damping by a dozen of its errors."""
    rubbing = oscillator("k*d + c*v + F*tanh(v/0.01)", name="l1", k=STIFFNESS, c=DAMPING, F=0.02)
    force = lw.model.Sampled(0.0, RATE, driven("force:m1", 0.0, seed).channel("force:m1"))
    clean = lw.simulate(rubbing, duration=(COUNT - 1) / RATE, rate=RATE, forces={"m1": force})
    record = clean.with_noise(40.0, seed=seed)
    more = 0.03 * np.random.default_rng(seed).standard_normal(COUNT)
    noisy = changed(record, force_m1=lambda x: x + x.std() * more)
    fit = lw.identify(noisy, mounted("ground").unknown("all"))
    if fit.trusted:
        assert_within(fit, {"l1.k": STIFFNESS, "l1.c": DAMPING}, 4.5)
