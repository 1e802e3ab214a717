"""Errors of sensors that are found with the structure: calibrations, offsets, gains and delays."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import scipy
from problems import chain_record
from record_faults import changed
from structures import oscillator
from within import assert_discovered

import linkwise as lw

MASSES = {"m1": 1.0, "m2": 0.01}
WIDTH = 0.01  # relative deviation of a calibration
LATE = 2  # samples


def record(seed: int = 1) -> lw.Record:
    return chain_record(2, duration=0.8).with_noise(40.0, seed=seed)


def test_a_calibration_widens_what_rests_on_it() -> None:
    """beta has the dimension N/m^3: scaled by a gain g of x:m2 it changes by -2 g, so its error is 2 % at least."""
    calibrated = lw.discover(record(), MASSES, calibration={"all": WIDTH})
    assert_discovered(calibrated, lw.bnes_chain(2))
    beta = calibrated.estimate.coefficient("m2-m1.k3")
    assert beta.standard_error == pytest.approx(np.sqrt(2.0) * WIDTH * beta.value, rel=0.1)
    without = lw.discover(record(), MASSES).estimate.coefficient("m2-m1.k3")
    assert float(without.standard_error or 0.0) < 0.1 * float(beta.standard_error or 0.0)


@pytest.mark.slow
def test_an_error_is_found_with_the_structure_admitted_or_not() -> None:
    faulty = changed(record(), x_m2=lambda x: 1.1 * x)
    by_itself, admitted = lw.discover(faulty, MASSES), lw.discover(faulty, MASSES, admit=["gain"])
    for discovery in (by_itself, admitted):
        assert_discovered(discovery, lw.bnes_chain(2))
        assert any("estimated with the other unknowns" in finding for finding in discovery.estimate.findings)
    (gain,) = by_itself.estimate.added
    assert (gain.kind, gain.where, admitted.estimate.added) == ("gain", "x:m2", ())
    assert gain.size == pytest.approx(0.1, abs=4.0 * gain.standard_error)
    stated = lw.discover(faulty, MASSES, as_stated=True)
    assert stated.grade is not lw.Grade.EXPLAINED and not stated.estimate.added
    assert stated.diagnosis[0].kind == "gain"


@pytest.mark.slow
def test_no_error_stands_for_a_term_that_is_not_offered_or_for_masses() -> None:
    masses = {"m1": 1.0, "m2": 0.3}
    truth = lw.rig(
        masses,
        {"leaf": "m1 - ground: k*d + c*v", "joint": "m2 - m1: k*d + k5*d**5 + c*v"},
        {"leaf.k": 900.0, "leaf.c": 1.5, "joint.k": 400.0, "joint.k5": 3e8, "joint.c": 0.5},
    )
    shaken = lw.simulate(truth, forces={"m1": "8*sin(2*pi*(2 + 0.8*t)*t)"}, duration=4.0, rate=200.0)
    discovery = lw.discover(shaken.with_noise(45.0, seed=1), masses, terms="v, d, d**3")
    assert not discovery.trusted and not discovery.estimate.added
    heavier = {
        name: 1.05 * mass for name, mass in masses.items()
    }  # which a gain of the force explains as well
    discovery = lw.discover(shaken.with_noise(45.0, seed=1), heavier, terms="v, d, d**3, d**5")
    assert not discovery.trusted and not discovery.estimate.added


@pytest.mark.slow
def test_of_two_gains_that_explain_the_record_alike_none_is_taken() -> None:
    """One of 2 % in either channel of a free decay: the criterion differs by 2."""
    discovery = lw.discover(changed(record(), x_m2=lambda x: 1.02 * x), MASSES, admit="gain")
    assert not discovery.trusted
    assert {cause.where for cause in discovery.diagnosis[:2]} == {"x:m1", "x:m2"}


@pytest.mark.slow
def test_a_delay_that_is_named_is_found() -> None:
    x = record().channel("x:m2")
    late = changed(record(), x_m2=np.concatenate([np.full(LATE, x[0]), x[:-LATE]]))
    faulty = late.between(0.01, 0.8)  # without the samples that the shift has repeated
    discovery = lw.discover(faulty, MASSES, delays=["x:m2"])
    assert_discovered(discovery, lw.bnes_chain(2))
    (sentence,) = (
        finding for finding in discovery.estimate.findings if finding.startswith("x:m2 is late by")
    )
    assert float(sentence.split()[4]) == pytest.approx(LATE, abs=0.02)  # ms, as many as samples


HIGH_PASS = scipy.signal.butter(1, 0.3, "high", fs=1000.0)  # Hz


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shown", "options"),
    [
        (lambda x, t: scipy.signal.lfilter(*HIGH_PASS, x), {"corners": ["x:m1"]}),
        (lambda x, t: x + 2e-4 * np.sin(100.0 * np.pi * t), {"hums": {"x:m1": 50.0}}),
        (lambda x, t: x + 5e-4 * np.sin(0.7 * t), {"drifts": ["x:m1"]}),
    ],
)
def test_what_a_sensor_makes_of_a_motion_is_found(shown: Any, options: dict[str, Any]) -> None:
    """Without that false springs stand in for it."""
    clean = chain_record(2, duration=2.0)
    x1 = shown(clean.channel("x:m1"), clean.time)
    faulty = replace(clean, values=np.column_stack([x1, clean.channel("x:m2")]), simulated=None)
    found = lw.discover(faulty.with_noise(40.0, seed=5), MASSES, **options)
    assert_discovered(found, lw.bnes_chain(2))
    assert all(abs(error.value - 0.3) < 3.0 * error.standard_error for error in found.estimate.sensor_errors)


@pytest.mark.parametrize(("sigma", "refused"), [(0.05, False), (0.2, True)])
def test_a_calibration_that_alone_tells_the_scale_must_be_narrow(sigma: float, refused: bool) -> None:
    """A test of a term is linear, in which the scale could shrink all of them to nothing."""
    plain = oscillator("k*d + c*v", k=900.0, c=1.5)
    forced = lw.simulate(plain, forces={"m1": "3*sin(23*t) + 2*sin(37*t + 1)"}, duration=4.0, rate=200.0)
    noisy = forced.with_noise(40.0, seed=3)
    options = lw.discovery.DiscoveryOptions(terms="linear, d**3", calibration={"force:m1": sigma})
    if refused:
        with pytest.raises(lw.IdentificationError, match=r"as loose as that of force:m1 .* up to 10 %"):
            lw.discover(noisy, {"m1": "unknown"}, options)
    else:
        assert lw.discover(noisy, {"m1": "unknown"}, options).trusted
    with pytest.raises(lw.IdentificationError, match="no calibration of x:m3"):
        lw.discover(noisy, {"m1": 1.0}, calibration={"x:m3": WIDTH})
