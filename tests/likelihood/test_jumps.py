"""Motion that begins anew at one moment, which no block of a record shows: told, allowed for, and taken in two parts."""

import numpy as np
import pytest
from structures import oscillator
from within import errors

import linkwise as lw

SPRING = oscillator("k*d + c*v", name="s", k=1030.0, c=0.33)
RATE, PERIOD = 200.0, 2.0 * np.pi / np.sqrt(1030.0)
AT = 280


def decay(seed: int, snr_db: float = 25.0, *, repeated: int = 0) -> lw.Record:
    """A free decay, of which a hit that nobody recorded brings back the motion so many whole periods before."""
    clean = lw.simulate(SPRING, release={"x:m1": 5e-3}, duration=4.5, rate=RATE)
    shown, again = clean.channel("x:m1"), round(repeated * PERIOD * RATE)
    anew = np.concatenate([shown[:AT], shown[AT - again : len(shown) - again]])
    return lw.Record.from_arrays(clean.time, {"x:m1": anew}).with_noise(snr_db, seed=seed)


@pytest.mark.parametrize("seed", [81, 82, 83])
def test_motion_that_begins_anew_by_whole_periods_is_an_event(seed: int) -> None:
    """The motion goes on as smoothly as before, and one damping for all of it would be ten standard errors off."""
    fit = lw.identify(decay(seed, repeated=2), SPRING.unknown("all"))
    assert fit.trusted and np.abs(errors(fit, SPRING)).max() < 3.5
    [event] = fit.added
    assert (event.kind, event.unit) == ("event", "s")
    assert event.size == pytest.approx(AT / RATE, abs=2.0 * event.standard_error)
    assert "the parts before and behind it are taken as two records" in " ".join(str(fit).split())


def test_as_stated_such_a_record_is_not_trusted() -> None:
    fit = lw.identify(decay(84, repeated=2), SPRING.unknown("all"), as_stated=True)
    assert not fit.trusted and fit.diagnosis[0].kind == "event"
    assert "identify the parts of the record before and behind it" in fit.message


@pytest.mark.parametrize("seed", [104, 205])
def test_a_hint_at_one_that_noise_hides_widens_the_intervals(seed: int) -> None:
    """The damping alone would be off by three of its standard errors."""
    fit = lw.identify(decay(seed, 20.0, repeated=1), SPRING.unknown("all"))
    clean = lw.identify(decay(seed, 20.0), SPRING.unknown("all"))
    assert fit.trusted and "The residuals hint at a force that was not recorded" in fit.message
    assert np.abs(errors(fit, SPRING)).max() < 1.96
    wider = np.sqrt(fit.covariance.diagonal() / clean.covariance.diagonal())
    assert wider[-1] > 2.0


@pytest.mark.parametrize("seed", range(90, 94))
def test_a_decay_without_one_is_left_as_it_is(seed: int) -> None:
    fit = lw.identify(decay(seed), SPRING.unknown("all"))
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
