"""Channels of links, forces and states, in all that reads records: used, refused, or told not to be used."""

from dataclasses import replace

import pytest
from record_faults import changed
from structures import harvester, oscillator

import linkwise as lw

OSCILLATOR = oscillator("k*d + c*v", name="spring", k=400.0, c=0.5)


@pytest.fixture(scope="module")
def record() -> lw.Record:
    """A load cell in the spring shows three times its force, and 5 N more."""
    sensors = ("x:m1", "f:spring")
    clean = lw.simulate(OSCILLATOR, release={"v:m1": 1.0}, duration=3.0, rate=200.0, sensors=sensors)
    values = clean.values * [1.0, 3.0] + [0.0, 5.0]
    return replace(clean, values=values, simulated=None).with_noise(40.0, seed=1)


@pytest.mark.slow
def test_what_does_not_use_a_load_cell_says_so_and_shared_gains_are_told(record: lw.Record) -> None:
    unknown, said = OSCILLATOR.unknown("all"), 'f:spring were not used: method "ml" alone takes {} of links.'
    assert said.format("forces") in lw.identify(record, unknown, method="weak").findings
    assert said.format("forces and states") in lw.identify(record, unknown, method="sindy").findings
    assert not lw.identify(record, unknown).trusted
    assert any("f:spring were not used" in line for line in lw.discovery.check_discovery(record, {"m1": 1.0}))
    fit = lw.identify(record.select(["x:m1"]), unknown, calibration={"common": 0.01})
    assert any(line.startswith("common shows ") for line in fit.findings)


VOLTAGE = "state:piezo.V"


@pytest.fixture(scope="module")
def piezo() -> lw.Structure:
    values = {"k": 400.0, "c": 1.0, "theta": 0.02, "R": 1e5, "C": 1e-6}
    return harvester(1.0, "ground", "piezo", **values)


@pytest.fixture(scope="module")
def harvested(piezo: lw.Structure) -> lw.Record:
    forces = {"m1": "2*sin(20*t) + sin(33*t)"}
    sensors = ("x:m1", VOLTAGE, "f:piezo")
    clean = lw.simulate(piezo, duration=4.0, rate=250.0, forces=forces, sensors=sensors)
    return clean.with_noise(50.0, seed=3)


def test_the_weak_form_does_not_disown_the_state_it_uses(piezo: lw.Structure, harvested: lw.Record) -> None:
    """Without the voltage it would refuse the law; only the load cell is left out."""
    fit = lw.identify(harvested, piezo.unknown("piezo.c"), method="weak")
    remarks = [line for line in fit.findings if "not used" in line]
    assert remarks == ['f:piezo were not used: method "ml" alone takes forces of links.']
    assert fit.noise[VOLTAGE].unit == "V"


def test_errors_of_a_voltmeter_are_in_the_unit_of_the_law(piezo: lw.Structure, harvested: lw.Record) -> None:
    record = changed(harvested, **{VOLTAGE: lambda voltage: 1.05 * voltage + 0.4})
    fit = lw.identify(record, piezo.unknown("piezo.c"), offsets=[VOLTAGE], gains=[VOLTAGE])
    assert [(error.kind, error.unit) for error in fit.sensor_errors] == [("offset", "V"), ("gain", "1")]
    offset, gain = (error.description for error in fit.sensor_errors)
    assert " V throughout" in offset
    assert "of its value" in gain
    assert abs(fit.sensor_errors[0].value - 0.4) < 4.0 * fit.sensor_errors[0].standard_error
    (link,) = fit.to_dict()["links"]
    assert link["states"] == {"V": {"rate": "(-theta*v - V/R)/C", "unit": "V"}}


def test_validation_scores_a_load_cell(record: lw.Record) -> None:
    """Its force is not that of the spring; without it the record agrees."""
    validation = lw.validate(record, OSCILLATOR)
    assert not validation.channels["f:spring"].agrees
    assert not validation.trusted
    assert lw.validate(record.select(["x:m1"]), OSCILLATOR).trusted
