"""Samples that the only response lost or has twice, beside the force that was recorded with it."""

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
