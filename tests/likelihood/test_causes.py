"""What would explain what a fit leaves: errors put into a record are named, with their size, and clean records show none."""

import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import scipy
from present import present
from problems import chain_record
from random_signals import random_force
from record_faults import changed
from structures import (
    host,
    link,
    named,
    oscillator,
    row_of_masses,
    structure,
    torsion_chain,
    with_links,
)
from within import assert_within

import linkwise as lw
from linkwise.likelihood.checks.recording import beyond_statement, recording_errors
from linkwise.likelihood.tests.score_test import missing_links, missing_terms

SNR, SEED = 30.0, 41

# standard errors between size and truth; and of the size, for faults that are not small
LOST, FOUND = (5.0, 0.2)


CHAIN = lw.bnes_chain(2)


def faulty(change: Callable[[np.ndarray, lw.Record], np.ndarray]) -> lw.Record:
    """The record of the two-mass chain with one channel changed before noise is added."""
    clean = chain_record(2, duration=3.0)
    return changed(clean, x_m2=change(clean.channel("x:m2"), clean)).with_noise(SNR, seed=SEED)


FAULTS: dict[str, tuple[Callable[[np.ndarray, lw.Record], np.ndarray], float]] = {
    "gain": (lambda x, record: 1.01 * x, 0.01),
    "gain drift": (lambda x, record: x * (1.0 + 0.03 * record.time / record.time[-1]), 0.03),
    "drift": (lambda x, record: x + 1e-3 * record.time / record.time[-1], 1e-3),
    "crosstalk": (lambda x, record: x + 0.05 * record.channel("x:m1"), 0.05),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", FAULTS)
def test_an_error_of_a_sensor_is_named_with_its_size(kind: str) -> None:
    change, size = FAULTS[kind]
    fit = lw.identify(faulty(change), CHAIN.unknown("all"), as_stated=True)
    assert not fit.trusted and fit.verdicts[0] is lw.Verdict.MEASUREMENT_ERROR
    named = [cause for cause in fit.diagnosis if cause.kind == kind and cause.where == "x:m2"]
    # where two sensors move together, the other one's is as good
    assert named and fit.diagnosis.index(named[0]) < 2
    assert named[0].size == pytest.approx(size, abs=LOST * named[0].standard_error + FOUND * size)
    assert "clipped" not in [cause.kind for cause in fit.diagnosis]
    assert f"{fit.diagnosis[0].description}" in fit.message
    entry = fit.to_dict()["diagnosis"][0]
    # five deviations squared, which no noise gains; measured 105 and more
    assert {"cause", "where", "size", "unit", "gain", "message"} <= set(entry) and entry["gain"] > 25.0


def test_a_gain_of_all_channels_that_drifts_is_named() -> None:
    """A decay that seems 10 % slower, of which no channel alone would tell; a damping would be eight errors off."""
    law, values = "k*d + c*v + k3*d**3", {"k": 900.0, "c": 0.8, "k3": 3e6}
    chain = row_of_masses([1.0, 0.5], outer=(law, values), inner=(law, values))
    clean = lw.simulate(chain, release={"x:m1": 0.01, "x:m2": -0.005}, duration=5.0, rate=200.0)
    drifting = clean.values * (1.0 + 0.1 * clean.time[:, np.newaxis] / clean.duration)
    record = replace(clean, values=drifting, simulated=None).with_noise(40.0, seed=SEED)
    fit = lw.identify(record, chain.unknown("all"), as_stated=True)
    named = [cause for cause in fit.diagnosis if (cause.kind, cause.where) == ("gain drift", "all channels")]
    assert not fit.trusted and named
    assert named[0].size == pytest.approx(0.1, abs=LOST * named[0].standard_error)


def test_a_filter_of_all_sensors_is_named() -> None:
    """A low pass of first order before white noise: residuals are white, and the cubic coefficient would be wrong."""
    clean = chain_record(2, duration=3.0)
    pole = 0.4
    values = scipy.signal.lfilter([1.0 - pole], [1.0, -pole], clean.values, axis=0)
    noisy = replace(clean, values=values, simulated=None).with_noise(20.0, seed=43)
    fit = lw.identify(noisy, CHAIN.unknown("all"), as_stated=True)
    assert fit.verdicts[0] is lw.Verdict.MEASUREMENT_ERROR
    cause = fit.diagnosis[0]
    assert cause.kind == "filter" and cause.is_instrument
    assert cause.description.startswith("a filter of all channels, as a low pass of first order at ")
    # log gain is -pole / 2 / (1 - pole)^2 (w dt)^2 at low frequencies; the motion goes up to where the fourth power counts
    size = pole / 2.0 / (1.0 - pole) ** 2 * clean.step**2
    assert cause.size == pytest.approx(size, rel=FOUND, abs=LOST * cause.standard_error)


@pytest.mark.slow
def test_missing_friction_is_no_filter() -> None:
    """To first order, sensors that raise what is near 5 Hz explain as much; no sensor and no amplifier does that."""
    leg = link("leg", "table-ground", "k*d + c*v", k=4000.0, c=1.0)
    slider = link("slider", "block-table", "k*d + F*tanh(v/0.01)", k=500.0, F=0.4)
    true = structure({"table": 2.0, "block": 0.3}, leg, slider)
    record = lw.simulate(true, release={"v:table": 0.5}, duration=4.0, rate=500.0).with_noise(30.0, seed=50)
    fit = lw.identify(record, with_links(true, link("slider", "block-table", "k*d + c*v")), as_stated=True)
    assert fit.verdicts[0] is lw.Verdict.SYSTEMATIC_MISFIT
    assert fit.diagnosis[0].kind == "term" and "filter" not in [cause.kind for cause in fit.diagnosis]


def torsional(change: Callable[[np.ndarray], np.ndarray]) -> lw.Record:
    """The record of the torsion chain with one channel changed before noise is added; it does not tell its units."""
    clean = lw.simulate(torsion_chain(), release={"v:disc1": 6.0}, duration=3.0, rate=500.0)
    values = changed(clean, x_disc2=change(clean.channel("x:disc2"))).values
    return lw.Record(0.0, 500.0, clean.channels, values).with_noise(40.0, seed=5413002)


@pytest.mark.slow
def test_errors_and_missing_terms_of_rotations_are_told_in_rad_and_newton_metres() -> None:
    asked = torsion_chain().unknown("sink")
    off = lw.identify(torsional(lambda x: x + 0.003), asked, as_stated=True)
    first = off.diagnosis[0]
    assert (first.kind, first.where, first.unit) == ("offset", "x:disc2", "rad")
    assert re.fullmatch(r"an offset of 0\.00\d+ rad in x:disc2", first.description)
    assert {cause.unit for cause in off.diagnosis if cause.kind in ("term", "drift")} == {"N m", "rad"}
    lacking = torsion_chain(sink="alpha*d + c*v", alpha=-4.0, c=0.008).unknown("sink")
    first = lw.identify(torsional(lambda x: x), lacking, as_stated=True).diagnosis[0]
    assert (first.kind, first.term, first.where, first.unit) == ("term", "d**3", "sink", "N m")
    assert first.description.endswith(" N m") or " N m (" in first.description
    degrees = lw.identify(torsional(np.degrees), asked, as_stated=True)
    assert "another unit of x:disc2, values 57.2958 times too large, as deg taken for rad" in degrees.message
    assert not degrees.trusted
    stated = lw.records.SensorUncertainty(offset=1e-4)
    record = replace(torsional(lambda x: x + 0.01), uncertainty={"x:disc2": stated})
    [prior] = [
        cause for cause in lw.identify(record, asked, as_stated=True).diagnosis if cause.kind == "prior"
    ]
    assert (prior.where, prior.unit) == ("offset of x:disc2", "rad")


def test_no_missing_link_joins_a_rotation_and_a_translation() -> None:
    carrier = host("beam", (5.0, 31.4), 0.01, {"tip": (1.7, -1.7), "r": (2.3, -8.0)}, rotations=["r"])
    spring = link("spring", "m1-beam.tip", "k*d", k=5.0)
    disc = link("shaft", "disc-ground", "k*d", k=5.0)
    mixed = structure({"m1": 1.0, "disc": 0.02}, spring, disc, hosts=[carrier], rotations=["disc"])
    hypotheses = [hypothesis for hypothesis, _ in missing_terms(mixed) + missing_links(mixed)]
    links = {lacking.where: lacking.unit for lacking in hypotheses if lacking.kind == "link"}
    assert links == {
        "beam.tip-ground": "N", "beam.r-ground": "N m", "m1-ground": "N", "disc-beam.r": "N m",
    }  # fmt: skip
    assert {lacking.unit for lacking in hypotheses if lacking.where == "shaft"} == {"N m"}


PUSH = "20*sin(150*t) + 15*sin(190*t)"
Change = Callable[[lw.Record], lw.Record]


def ac_coupled(record: lw.Record) -> lw.Record:
    high_pass = scipy.signal.butter(1, 0.5, "high", fs=record.rate, output="sos")
    return changed(record, x_m2=scipy.signal.sosfilt(high_pass, record.channel("x:m2")))


def pushed() -> lw.Record:
    return lw.simulate(CHAIN, forces={"m1": PUSH}, duration=2.0, rate=1000.0)


def freely() -> lw.Record:
    return chain_record(2, duration=3.0)


def times(name: str, factor: float) -> Change:
    return lambda record: changed(record, **{name: factor * record.channel(name.replace("_", ":"))})


def exchanged(record: lw.Record) -> lw.Record:
    return changed(record, x_m1=record.channel("x:m2"), x_m2=record.channel("x:m1"))


ERRORS: dict[str, tuple[Callable[[], lw.Record], Change, tuple[str, str, str]]] = {
    "sign of a force": (pushed, times("force_m1", -1.0), ("sign", "force:m1", "change the sign of force:m1")),
    "mm for m": (freely, times("x_m2", 1e3), ("unit", "x:m2", "multiply x:m2 by 0.001")),
    "swapped": (freely, exchanged, ("swapped", "x:m1", "exchange x:m1 and x:m2")),
    "AC coupled": (partial(chain_record, 2), ac_coupled, ("high pass", "x:m2", "DC")),
}


@pytest.mark.slow
@pytest.mark.parametrize("error", ERRORS)
def test_an_error_of_a_whole_channel_is_the_first_cause(error: str) -> None:
    make, change, (kind, where, advice) = ERRORS[error]
    record = change(make().with_noise(20.0, seed=71))
    fit = lw.identify(record, CHAIN.unknown("all"), method="ml", as_stated=True)
    first = fit.diagnosis[0]
    assert (first.kind, first.where) == (kind, where) and first.is_instrument
    assert not fit.trusted and fit.coefficient("nes1.alpha").interval is None
    assert first.description in fit.message and advice in fit.message
    assert fit.to_dict()["diagnosis"][0]["cause"] == kind


def test_a_driven_record_without_one_has_none() -> None:
    fit = lw.identify(pushed().with_noise(40.0, seed=72), CHAIN.unknown("all"))
    assert fit.trusted and fit.diagnosis == () and "shows by itself" not in fit.message


WRONG = {
    "missing friction": with_links(CHAIN, named("rough", "m2-m1", "bouc-wen", k=0, c=0, F=0.3, x0=0.005, s=0.5)),
    "slow relaxation": with_links(CHAIN, named("slow", "m1-ground", "zener", k=0.0, k1=1000.0, c1=1000.0)),
    "missing link": with_links(CHAIN, link("extra", "m2-ground", "k*d", k=20.0)),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("wrong", WRONG)
def test_a_law_that_is_wrong_is_not_taken_for_one(wrong: str) -> None:
    clean = lw.simulate(WRONG[wrong], release={"v:m1": 1.0}, duration=3.0, rate=1000.0)
    record = replace(clean.with_noise(40.0, seed=73), simulated=None)
    assert recording_errors([record], CHAIN.unknown("all")) == ()


@pytest.mark.slow
def test_what_the_equations_cannot_tell_apart_is_told_together() -> None:
    """Of one mass on a spring that is odd, the wrong sign of the force is that of the displacement."""
    spring = oscillator("k*d + c*v + k3*d**3", k=900.0, k3=2e5, c=1.5)
    push = {"m1": "15*sin(25*t) + 10*sin(33*t)"}
    record = lw.simulate(spring, forces=push, duration=6.0, rate=500.0).with_noise(30.0, seed=1)
    wrong = changed(record, force_m1=-record.channel("force:m1"))
    fit = lw.identify(wrong, spring.unknown("all"), method="ml", as_stated=True)
    assert [(cause.kind, cause.where) for cause in fit.diagnosis[:2]] == [
        ("sign", "force:m1"),
        ("sign", "x:m1"),
    ]
    assert "the wrong sign of x:m1 would do the same" in fit.message


def test_accelerations_alone_tell_a_unit_that_is_off() -> None:
    """They were given intervals, 2e7 standard errors off, as the weak form takes no accelerations."""
    spring = oscillator("k*d + c*v + k3*d**3", k=900.0, k3=2e5, c=1.5)
    force = {"m1": random_force(np.random.default_rng(1), 6.0, 250.0)}
    clean = lw.simulate(spring, forces=force, duration=6.0, rate=250.0, sensors=("a",))
    record = replace(clean.with_noise(30.0, seed=1), simulated=None)
    assert recording_errors([record], spring.unknown("all")) == ()
    wrong = changed(record, a_m1=1e3 * record.channel("a:m1"))
    errors = recording_errors([wrong], spring.unknown("all"))
    assert [(cause.kind, cause.where) for cause in errors] == [("unit", "force:m1"), ("unit", "a:m1")]


@pytest.mark.slow
@pytest.mark.usefixtures("memory_not_sought")
def test_a_search_is_told_of_one_by_all_terms_that_were_offered() -> None:
    """The terms that are found in a wrong record are not those that explain the right one."""
    law = "k*d + c*v"
    row = row_of_masses([1.0, 0.1], low=(law, {"k": 2000.0, "c": 0.5}), high=(law, {"k": 150.0, "c": 0.05}))
    clean = lw.simulate(row, release={"v:m1": 1.0}, duration=2.0, rate=250.0)
    record = replace(clean.with_noise(40.0, seed=75), simulated=None)
    wrong = changed(record, x_m2=1e3 * record.channel("x:m2"))
    found = lw.discover(wrong, {"m1": 1.0, "m2": 0.1}, terms="linear")
    assert (found.diagnosis[0].kind, found.diagnosis[0].where) == ("unit", "x:m2") and not found.trusted


GONE, AT = 15, 900


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "words"), [("lost", "jumps between two samples at"), ("repeated", "repeat")]
)
def test_lost_and_repeated_samples_come_before_gains(fault: str, words: str) -> None:
    """The diagnosis stays as it is."""
    record = replace(chain_record(2, duration=3.0).with_noise(40.0, seed=5_001_302), simulated=None)
    values = record.values.copy()
    if fault == "lost":
        values = np.delete(values, slice(AT, AT + GONE), axis=0)
    else:
        values = np.insert(values, [AT] * GONE, values[AT], axis=0)
    faulty = lw.Record(record.start, record.rate, record.channels, values)
    fit = lw.identify(faulty, CHAIN.unknown("nes"), as_stated=True)
    assert not fit.trusted and fit.diagnosis
    assert fit.message.startswith("The record shows by itself") and words in fit.message


def test_a_hit_that_was_not_recorded_is_told_with_its_moment() -> None:
    """The part after it is explained."""
    spring = oscillator("k*d + k3*d**3 + c*v", name="s", k=4e3, k3=1e7, c=3.0)
    force = lw.model.Sampled(0.0, 1000.0, np.where(abs(np.arange(2001) - 604) < 4, 300.0, 0.0))
    released = {"x:m1": 2e-3}
    clean = lw.simulate(
        spring, duration=2.0, rate=1000.0, release=released, forces={"m1": force}, sensors=("x",)
    )
    record = clean.select(["x:m1"]).with_noise(40.0, seed=5_001_303)
    fit = lw.identify(record, spring.unknown("all"), as_stated=True)
    assert not fit.trusted and fit.diagnosis[0].kind == "event"
    assert "Identify the record from 0.61" in fit.message
    assert_within(
        lw.identify(record.between(0.61, 2.0), spring.unknown("all")), {"s.k": 4e3, "s.k3": 1e7, "s.c": 3.0}
    )


def record_with_stated(factors: dict[str, float]) -> lw.Record:
    """At 20 dB, with noise stated as that times these factors."""
    clean = chain_record(2, duration=2.0)
    record = clean.with_noise(20.0, seed=5_001_301)
    true = {name: float(np.std(record.channel(name) - clean.channel(name))) for name in factors}
    noise = {name: factor * true[name] for name, factor in factors.items()}
    return replace(record, noise=noise, simulated=None)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stated", "calibration"),
    [({"x:m1": 0.1, "x:m2": 1.0}, {}), ({"x:m1": 0.1, "x:m2": 0.1}, {"all": 0.01})],
    ids=["one channel", "both, beside priors"],
)
def test_noise_stated_small(stated: dict[str, float], calibration: dict[str, float]) -> None:
    """With how far it is exceeded, by which channels, and what it is; also where a search beside priors does not converge."""
    fit = lw.identify(
        record_with_stated(stated), CHAIN.unknown("nes"), calibration=calibration, as_stated=True
    )
    assert not fit.trusted
    searched = {lw.Verdict.NOT_CONVERGED} if calibration else set()
    assert fit.fit_verdicts[0] in {lw.Verdict.NOISE_MISMATCH, *searched}
    assert "it is stated too small" in fit.message and "leave it out" in fit.message
    for name, factor in stated.items():
        assert (f"times in {name}, " in fit.message) == (factor < 1.0)
    assert "10 times in x:m1" in fit.message or "9.9 times in x:m1" in fit.message


@pytest.mark.slow
def test_noise_stated_as_next_to_nothing_is_told_by_the_scatter_of_samples() -> None:
    """Nothing converges with it, and what is left is no noise: the samples themselves tell, before any law."""
    fit = lw.identify(record_with_stated({"x:m1": 1e-4, "x:m2": 1.0}), CHAIN.unknown("all"), as_stated=True)
    assert fit.fit_verdicts == (lw.Verdict.NOT_CONVERGED,)
    assert "neighbouring samples scatter by far more" in fit.message
    assert "times in x:m1" in fit.message and "times in x:m2" not in fit.message


def test_a_force_that_scatters_and_noise_of_nothing_are_no_statement_too_small() -> None:
    """A shaker's random force changes from sample to sample by its own size."""
    rng = np.random.default_rng(5_001_302)
    channels = {"x:m1": np.sin(np.arange(2000) / 50.0), "force:m1": rng.normal(size=2000)}
    record = lw.Record.from_arrays(np.arange(2000) / 1000.0, channels)
    noise = {"force:m1": 1e-4, "x:m1": 0.0}
    assert not beyond_statement([replace(record, noise=noise)])
    shaken = replace(record, values=record.values + 0.01 * rng.normal(size=(2000, 1)), noise={"x:m1": 1e-6})
    assert "times in x:m1" in beyond_statement([shaken])


def clipped(share: float, snr_db: float, seed: int) -> lw.Record:
    """The record with the displacement of the sink clipped at a share of its peak, after noise was added."""
    record = chain_record(2).with_noise(snr_db, seed=seed)
    x = record.channel("x:m2")
    return changed(record, x_m2=np.clip(x, -share * np.abs(x).max(), share * np.abs(x).max()))


def test_clipped_samples_are_the_first_cause() -> None:
    record = clipped(0.8, 20.0, seed=81)
    fit = lw.identify(record, CHAIN.unknown("all"), method="ml", as_stated=True)
    first = fit.diagnosis[0]
    assert (first.kind, first.where) == ("clipped", "x:m2") and not fit.trusted
    assert "goes on beyond the range of x:m2" in fit.message and "mark_missing" in fit.message
    at_ends = np.abs(record.channel("x:m2")) == np.abs(record.channel("x:m2")).max()
    assert first.size == at_ends.sum()


def test_as_bounds_they_tell_more_than_as_missing() -> None:
    """Large motions tell the stiffening; chance is beyond 4.5 standard errors once in 30 000."""
    record = lw.inspection.mark_missing(clipped(0.5, 20.0, seed=83))
    bounds, missing = (
        lw.identify(each, CHAIN.unknown("nes"), method="ml") for each in (record, replace(record, clipped={}))
    )
    assert bounds.trusted and bounds.diagnosis == ()
    narrow, wide = (present(fit.coefficient("nes1.beta").standard_error) for fit in (bounds, missing))
    assert narrow < wide
    assert_within(bounds, {"nes1.beta": 1e6}, 4.5)


def test_a_robust_loss_takes_them_as_missing_and_says_so() -> None:
    record = lw.inspection.mark_missing(clipped(0.8, 30.0, seed=84).between(0.0, 2.0))
    robust, missing = (
        lw.identify(each, CHAIN.unknown("nes"), loss=lw.likelihood.Student())
        for each in (record, replace(record, clipped={}))
    )
    np.testing.assert_array_equal(robust.values, missing.values)
    assert any("taken as missing, not as bounds" in remark for remark in robust.remarks)
    assert not any("as bounds" in remark for remark in missing.remarks)


@pytest.mark.slow
def test_a_late_channel_keeps_them_as_it_is_shifted() -> None:
    record = lw.inspection.mark_missing(clipped(0.6, 30.0, seed=85).between(0.0, 2.0))
    late = {"x:m1": 4}
    behind = changed(record, x_m1=lambda x: np.append(x[:4], x[:-4]))
    fit = lw.identify(behind, CHAIN.unknown("nes"), delays=tuple(late))
    assert fit.trusted
    assert not any("as bounds" in remark for remark in fit.remarks)
