"""Identification on a moving base: what sensors relative to it, and its velocity or acceleration alone, determine."""

from dataclasses import replace
from functools import cache
from typing import Any, Literal

import numpy as np
import pytest
import scipy
from present import some
from problems import parsed, truth
from record_faults import changed
from structures import HARDENING, link, structure

import linkwise as lw

BASE = "0.004*sin(31*t) + 0.003*sin(47*t + 1) + 0.002*sin(71*t + 2) + 0.01*sin(9*t)"
SEED = 1
QUANTILE = 0.9999  # of chi-square with one degree of freedom a coefficient
SENSORS = {
    "relative displacements": ("rel:x", "a:base"),
    "a velocity of the base": ("rel:x", "v:base"),
    "accelerations alone": ("a", "a:base"),
    "one of each": ("rel:x:m1", "a:m2", "a:base"),
    "a displacement of the base": ("rel:x", "x:base"),
}


@cache
def two_storeys() -> lw.Structure:
    lower = link("lower", "m1-base", "k*d + c*v", k=2000.0, c=1.0)
    upper = link("upper", "m2-m1", HARDENING, k=1500.0, k3=4e6, c=0.5)
    return structure({"m1": 1.0, "m2": 0.5}, lower, upper)


@cache
def exact(*sensors: str, duration: float = 4.0) -> lw.Record:
    """Simulated in absolute coordinates, which none of the estimators uses here."""
    return lw.simulate(two_storeys(), duration=duration, rate=500.0, base=BASE, sensors=sensors)


@cache
def measured(*sensors: str, seed: int = SEED, duration: float = 4.0) -> lw.Record:
    """At 40 dB."""
    return exact(*sensors, duration=duration).with_noise(40.0, seed=seed)


def near(fit: lw.Estimate) -> bool:
    """Whether the squared error in standard errors is within the quantile of its chi-square distribution."""
    error = fit.values - truth(two_storeys(), fit.given_structure)
    distance = float(error @ np.linalg.solve(fit.covariance, error))
    return distance < float(scipy.stats.chi2.ppf(QUANTILE, len(fit.values)))


@pytest.mark.slow
@pytest.mark.parametrize("case", SENSORS)
def test_likelihood_finds_the_coefficients(case: str) -> None:
    record = measured(*SENSORS[case])
    fit = lw.identify(record, two_storeys().unknown("all"))
    assert fit.trusted and near(fit)
    assert set(fit.noise) == set(record.responses)


def with_masses(given: lw.Structure, **masses: lw.Coefficient) -> lw.Structure:
    return replace(given, masses=tuple(replace(m, mass=masses.get(m.name, m.mass)) for m in given.masses))


UNKNOWN_MASSES = {
    "unknown": {"m2": lw.Coefficient.unknown()},
    "far from its start": {"m2": lw.Coefficient.unknown(0.8)},
    "known to within": {"m1": lw.Coefficient.unknown(1.004, sigma=0.01), "m2": lw.Coefficient.unknown()},
}


@pytest.mark.parametrize(
    ("case", "sensors"),
    [
        ("unknown", ("a", "a:base")),
        ("far from its start", ("rel:x", "v:base")),
        ("known to within", ("rel:x", "a:base")),
    ],
    ids=str,
)
def test_an_acceleration_of_the_base_determines_masses(case: str, sensors: tuple[str, ...]) -> None:
    """The force of inertia is the unknown mass times what was recorded; another mass sets the scale."""
    fit = lw.identify(measured(*sensors), with_masses(two_storeys().unknown("all"), **UNKNOWN_MASSES[case]))
    assert fit.trusted and near(fit)
    [mass] = (mass for mass in fit.masses if mass.name == "m2.mass")
    assert mass.interval is not None
    assert mass.interval[1] - mass.interval[0] < 0.05  # of 0.5 kg: the record determines it


@pytest.mark.parametrize("method", ["ml", "weak"])
def test_nothing_sets_the_scale_where_all_masses_are_unknown(method: Literal["ml", "weak"]) -> None:
    """An acceleration of the base fixes ratios of masses and coefficients only."""
    unknown, free = two_storeys().unknown("all"), lw.Coefficient.unknown()
    with pytest.raises(lw.IdentificationError, match="nothing sets the scale of the forces"):
        lw.identify(measured("rel:x", "a:base"), with_masses(unknown, m1=free, m2=free), method=method)


@pytest.mark.parametrize("sensors", [("rel:x", "a:base"), ("x", "x:base")], ids=str)
def test_starts_do_not_set_the_scale_of_forces(sensors: tuple[str, ...]) -> None:
    """With a start for each unknown the search ended at them, with errors of rounding: "can be trusted"."""
    started = {"m1": 1.0, "m2": 0.5}
    masses = {name: lw.Coefficient.unknown(value) for name, value in started.items()}
    unknown = with_masses(two_storeys().unknown("all"), **masses)
    with pytest.raises(lw.IdentificationError, match="nothing sets the scale of the forces"):
        lw.identify(measured(*sensors), unknown)
    known = with_masses(two_storeys().unknown("all"), m1=masses["m1"], m2=lw.Coefficient.number(0.5))
    assert lw.identify(measured(*sensors), known).trusted


def test_a_mass_that_noise_makes_zero_at_first_starts_like_the_others() -> None:
    """The search began at 0 kg: "the mass must be positive", of a structure that states none."""
    noisy = exact("a", "a:base").with_noise(5.0, seed=601)
    unknown = with_masses(two_storeys().unknown("all"), m1=lw.Coefficient.unknown())
    fit = lw.identify(noisy, unknown)
    assert fit.trusted and fit.coefficient("m1.mass").value == pytest.approx(1.0, abs=0.1)


def test_a_base_at_rest_with_an_accelerometer_is_no_frame() -> None:
    """Its noise was taken for the acceleration of the coordinates: KeyError 0, or inertia counted twice."""
    forces, sensors = {"m2": "40*sin(35*t) + 25*sin(61*t)"}, ("x", "x:base")
    clean = lw.simulate(two_storeys(), duration=4.0, rate=500.0, base="0*t", forces=forces, sensors=sensors)
    at_rest = clean.with_noise(40.0, seed=SEED)
    noise = 0.01 * np.random.default_rng(SEED).standard_normal(len(at_rest))
    channels, values = parsed(*at_rest.channels, "a:base"), np.column_stack([at_rest.values, noise])
    record = replace(at_rest, channels=channels, values=values, simulated=None)
    unknown = with_masses(two_storeys().unknown("all"), m1=lw.Coefficient.unknown())
    with_base, without = (lw.identify(given, unknown, method="weak") for given in (record, at_rest))
    assert with_base.values == pytest.approx(without.values, rel=1e-9)  # the same equations
    unforced = record.select([name for name in record.channels if name != "force:m2"])
    lw.identify(replace(unforced, source="unforced"), unknown, method="weak")


@pytest.mark.slow
def test_gain_and_delay_of_the_base_are_told() -> None:
    """A gain of 2 %, a delay of half a sample: the first cause names it, its size to first order (5 %)."""
    record = measured("a", "a:base")
    motion = record.channel("a:base")
    signal = lw.model.Sampled(record.start, record.rate, motion, band_limited=True)
    late = signal.value(np.maximum(record.time - 1e-3, record.start))
    for kind, size, values in (("gain", 0.02, 1.02 * motion), ("delay", 1e-3, late)):
        fit = lw.identify(changed(record, a_base=values), two_storeys().unknown("all"), as_stated=True)
        assert not fit.trusted or near(fit)
        cause = fit.diagnosis[0]
        assert (cause.kind, cause.where) == (kind, "a:base")
        assert cause.size == pytest.approx(size, rel=0.05)


@pytest.mark.slow
def test_gain_of_an_absolute_accelerometer_is_found_with_the_rest() -> None:
    """It shows the base as well, which the relative coordinates do not hold; 4 standard deviations of the noise per sample."""
    record = measured("a", "a:base", duration=2.0)
    record = changed(record, a_m1=lambda a: 1.02 * a)
    estimate = lw.identify(record, two_storeys().unknown("all"), as_stated=True)
    assert not estimate.trusted
    assert (estimate.diagnosis[0].kind, estimate.diagnosis[0].where) == ("gain", "a:m1")
    fit = lw.identify(record, two_storeys().unknown("all"), gains=["a:m1"])
    assert fit.trusted and near(fit)
    [remark] = (remark for remark in fit.remarks if remark.startswith("a:m1"))
    assert float(remark.split()[2]) == pytest.approx(1.02, abs=4.0 * 0.01 / np.sqrt(len(record)))


@pytest.mark.parametrize(
    ("option", "told"),
    [
        ({"drifts": ["rel:x:m1"]}, "rel:x:m1 drifts over"),
        ({"hums": {"rel:x:m1": 50.0}}, "rel:x:m1 has a hum of"),
        ({"corners": ["rel:x:m1"]}, "rel:x:m1 is behind a high pass"),
    ],
    ids=["drift", "hum", "high pass"],
)
def test_what_is_added_to_a_relative_sensor_is_found_and_told(option: dict[str, Any], told: str) -> None:
    """Its channel was looked for by the name that the equations give it, which the record lacks."""
    fit = lw.identify(measured("rel:x", "a:base", duration=1.0), two_storeys().unknown("all"), **option)
    assert fit.trusted and near(fit)
    assert any(remark.startswith(told) for remark in fit.remarks)


def test_discovery_offers_the_base_in_place_of_the_ground() -> None:
    discovery = lw.discover(measured("rel:x", "a:base"), {"m1": 1.0, "m2": 0.5})
    assert discovery.trusted
    laws = {link.name: link.law.text for link in discovery.structure.links}
    assert laws == {"m1-base": "k*d + c*v", "m2-m1": "k*d + k3*d**3 + c*v"}


@pytest.mark.slow
def test_validation_predicts_what_the_sensors_show() -> None:
    sensors = ("a", "a:base")
    record = measured(*sensors, seed=2)
    validation = lw.validate(record, two_storeys())
    assert validation.trusted
    assert set(validation.channels) == set(record.responses)
    off = two_storeys().with_values({"lower.k": 2020.0})
    assert not lw.validate(record, off).trusted
    run = lw.analysis.free_run(two_storeys(), record)
    for name, error in some(run.rmse.items()):
        noise = float(np.std(record.channel(name) - exact(*sensors).channel(name)))
        # the state at the start, of four values from 100 samples, leaves 4/100 of the noise in power, 2 % in deviation;
        # two and a half times that has a chance of 4 % at this seed
        assert error == pytest.approx(noise, rel=0.05)
