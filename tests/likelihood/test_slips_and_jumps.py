"""Samples that a response lost or has twice, and motion that begins anew: told, allowed for, and taken in two parts."""

from dataclasses import replace

import numpy as np
import pytest
from random_signals import random_force
from record_faults import changed
from structures import HARDENING, oscillator
from within import errors

import linkwise as lw
from linkwise.likelihood.checks.slips import slips

TRUE = {"s.k": 4000.0, "s.k3": 5e7, "s.c": 1.3}
SPRING = oscillator(HARDENING, name="s", k=4000.0, k3=5e7, c=1.3)
AT, RATE = 370, 250.0


def shaken() -> lw.Record:
    """At 40 dB, by a force that acts throughout."""
    force = random_force(np.random.default_rng(31), 4.0, RATE, highest=30.0, rms=10.0)
    clean = lw.simulate(SPRING, duration=4.0, rate=RATE, forces={"m1": force}, sensors=("x",))
    return replace(clean.with_noise(40.0, seed=32), simulated=None)


def slipped(record: lw.Record, samples: int) -> lw.Record:
    """The record whose displacement lost so many samples, or has them twice."""
    return changed(record, x_m1=lambda x: np.append(x[:AT], np.roll(x, -samples)[AT:]))[:-4]


@pytest.mark.parametrize("samples", [1, 3, -2])
def test_the_force_tells_a_slip_of_the_only_response(samples: int) -> None:
    record = shaken()
    cause, mended = next(slips(slipped(record, samples), SPRING.unknown("all"), TRUE))
    assert (cause.where, cause.size) == ("x:m1", samples)
    shown, exact = mended.channel("x:m1")[AT + 60 : -8], record.channel("x:m1")[AT + 60 : -8 - 4]
    assert np.array_equal(shown[: len(exact)], exact)


def test_it_tells_none_where_it_no_longer_acts() -> None:
    """A hit that nobody recorded moves what follows as well."""
    record = shaken()
    unforced = changed(record, force_m1=lambda x: np.where(np.arange(len(x)) < AT - 40, x, 0.0))
    assert not list(slips(slipped(unforced, 3), SPRING.unknown("all"), TRUE))


@pytest.mark.slow
def test_it_is_put_back_in_its_place() -> None:
    fit = lw.identify(slipped(shaken(), -2), SPRING.unknown("all"))
    [slip] = fit.added
    assert (slip.kind, slip.where, slip.size) == ("slip", "x:m1", -2)
    assert fit.trusted and np.abs(errors(fit, SPRING)).max() < 4.0
    assert not fit.alerts  # of samples that are left out around it


@pytest.mark.parametrize("late", [True, False])
def test_samples_that_were_written_twice_are_left_out(late: bool) -> None:
    """Whether those behind them come late, or the buffer took the place of another one."""
    record = shaken()
    values = np.insert(record.values, 600, record.values[400:600], axis=0)
    if not late:
        values = np.delete(values, slice(800, 1000), axis=0)
    twice = replace(record, values=values)
    assert lw.identify(twice, SPRING.unknown("all"), as_stated=True).grade is lw.Grade.REFUSED
    fit = lw.identify(twice, SPRING.unknown("all"))
    assert [(slip.kind, slip.where, slip.size) for slip in fit.added] == [("slip", "x:m1", -200)]
    assert fit.trusted and np.abs(errors(fit, SPRING)).max() < 4.0
    assert [len(part) for part in (fit.record, *fit.more_records)] == [600, 401 if late else 201]


def test_many_samples_that_were_lost_are_in_neither_part() -> None:
    """The windows tell the moment to within as many."""
    record = shaken()
    lost = changed(record, x_m1=lambda x: np.concatenate([x[:AT], x[AT + 60 :], np.full(60, np.nan)]))
    _, mended = next(slips(lost, SPRING.unknown("all"), TRUE))
    shown = mended.channel("x:m1")
    there = np.isfinite(shown)
    assert np.array_equal(shown[there], record.channel("x:m1")[there]) and there.mean() > 0.7


LINEAR = oscillator("k*d + c*v", name="s", k=1030.0, c=0.33)
SLOW, PERIOD = 200.0, 2.0 * np.pi / np.sqrt(1030.0)
ANEW = 280


def decay(seed: int, snr_db: float = 25.0, *, repeated: int = 0) -> lw.Record:
    """A free decay, of which a hit that nobody recorded brings back the motion so many whole periods before."""
    clean = lw.simulate(LINEAR, release={"x:m1": 5e-3}, duration=4.5, rate=SLOW)
    shown, again = clean.channel("x:m1"), round(repeated * PERIOD * SLOW)
    anew = np.concatenate([shown[:ANEW], shown[ANEW - again : len(shown) - again]])
    return lw.Record.from_arrays(clean.time, {"x:m1": anew}).with_noise(snr_db, seed=seed)


@pytest.mark.parametrize("seed", [81, 82, 83])
def test_motion_that_begins_anew_by_whole_periods_is_an_event(seed: int) -> None:
    """The motion goes on as smoothly as before, and one damping for all of it would be ten standard errors off."""
    fit = lw.identify(decay(seed, repeated=2), LINEAR.unknown("all"))
    assert fit.trusted and np.abs(errors(fit, LINEAR)).max() < 3.5
    [event] = fit.added
    assert (event.kind, event.unit) == ("event", "s")
    assert event.size == pytest.approx(ANEW / SLOW, abs=2.0 * event.standard_error)
    assert "the parts before and behind it are taken as two records" in " ".join(str(fit).split())


def test_as_stated_such_a_record_is_not_trusted() -> None:
    fit = lw.identify(decay(84, repeated=2), LINEAR.unknown("all"), as_stated=True)
    assert not fit.trusted and fit.diagnosis[0].kind == "event"
    assert "identify the parts of the record before and behind it" in fit.message


@pytest.mark.parametrize("seed", [104, 205])
def test_a_hint_at_one_that_noise_hides_widens_the_intervals(seed: int) -> None:
    """The damping alone would be off by three of its standard errors."""
    fit = lw.identify(decay(seed, 20.0, repeated=1), LINEAR.unknown("all"))
    clean = lw.identify(decay(seed, 20.0), LINEAR.unknown("all"))
    assert fit.trusted and "The residuals hint at a force that was not recorded" in fit.message
    assert np.abs(errors(fit, LINEAR)).max() < 1.96
    wider = np.sqrt(fit.covariance.diagonal() / clean.covariance.diagonal())
    assert wider[-1] > 2.0


@pytest.mark.parametrize("seed", range(90, 94))
def test_a_decay_without_one_is_left_as_it_is(seed: int) -> None:
    fit = lw.identify(decay(seed), LINEAR.unknown("all"))
    assert fit.trusted and not fit.added and "event" not in fit.message


@pytest.mark.parametrize("seed", [300, 303, 304])
def test_intervals_about_an_event_that_a_gain_resembles_allow_for_that(seed: int) -> None:
    """From the middle on a channel shows 3 % more of a cubic decay: as an event alone, k would be three errors off."""
    spring = oscillator("k*d + c*v + k3*d**3", name="s", k=1030.0, c=0.6, k3=2e6)
    clean = lw.simulate(spring, release={"x:m1": 5e-3}, duration=6.0, rate=200.0)
    shown = clean.with_noise(35.0, seed=seed).channel("x:m1") * np.where(clean.time > 3.0, 1.03, 1.0)
    fit = lw.identify(lw.Record.from_arrays(clean.time, {"x:m1": shown}), spring.unknown("all"))
    assert fit.trusted and np.abs(errors(fit, spring)).max() < 1.96
    [event] = fit.added
    assert event.kind == "event" and "intervals allow for gains that are off by" in event.remark
    assert event.share == pytest.approx(0.03, abs=0.01)
