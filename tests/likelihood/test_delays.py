"""Sensors that are late by parts of a sample or by several."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from present import present
from problems import chain_record

import linkwise as lw
from linkwise.likelihood.fit import likelihood_fit
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.shooting.flow import Trajectories
from linkwise.likelihood.shooting.late_sensors import late_motion
from linkwise.likelihood.shooting.loss import Gaussian
from linkwise.likelihood.shooting.normal_equations import linearise
from linkwise.likelihood.shooting.residuals import evaluate

CHAIN = lw.bnes_chain(2)
ASKED = CHAIN.unknown("all")
FINE = 10  # samples of the exact motion in one of the record
SENSORS = ("x:m1", "x:m2", "v:m1", "a:m2")


def late(name: str, tenths: int, seed: int, snr_db: float = 30.0) -> lw.Record:
    """Four channels, one of them late by `tenths` of a sample, from exact motion at ten times the rate."""
    fine = chain_record(2, duration=1.6, rate=1000.0 * FINE, sensors=SENSORS)
    start, count = 100, 1400
    columns = []
    for channel in SENSORS:
        first = start * FINE - (tenths if channel == name else 0)
        columns.append(fine.channel(channel)[first : first + count * FINE : FINE])
    record = lw.Record(0.0, 1000.0, SENSORS, np.stack(columns, axis=1))
    return record.with_noise(snr_db, seed=seed)


def told(fit: lw.Estimate, name: str) -> tuple[float, float]:
    """The delay in s that was found, and its standard error."""
    pattern = rf"{name} is late by (\S+) ms \(estimated with the other unknowns, standard error (\S+) ms\)\."
    [match] = [found for found in (re.match(pattern, line) for line in fit.findings) if found]
    return 1e-3 * float(match[1]), 1e-3 * float(match[2])


@pytest.mark.parametrize("name", SENSORS)
@pytest.mark.parametrize("tenths", [3, -7])
def test_a_delay_of_one_of_four_channels_is_found_with_the_laws(name: str, tenths: int) -> None:
    record = late(name, tenths, seed=31)
    fit = lw.identify(record, ASKED, delays=[name])
    delay, deviation = told(fit, name)
    assert fit.trusted
    assert delay == pytest.approx(1e-4 * tenths, abs=2e-5)  # a fiftieth of a sample
    # five deviations, 6e-7 of chance; here, below and for the laws
    assert delay == pytest.approx(1e-4 * tenths, abs=5.0 * deviation)
    for parameter in ASKED.parameters:
        found = fit.coefficient(parameter.name)
        error = found.value - present(CHAIN.coefficient(parameter.name).value)
        assert abs(error) < 5.0 * present(found.standard_error)


def test_a_delay_of_several_samples_is_found_after_whole_shifts() -> None:
    record = late("a:m2", 34, seed=32)
    fit = lw.identify(record, ASKED, delays=["a:m2"])
    delay, deviation = told(fit, "a:m2")
    assert fit.trusted and delay == pytest.approx(3.4e-3, abs=5.0 * deviation)


def test_a_delay_is_admitted_and_without_that_not_trusted() -> None:
    record = late("x:m2", 3, seed=33)
    alone = lw.identify(record, ASKED)
    assert not alone.trusted
    assert (alone.diagnosis[0].kind, alone.diagnosis[0].where) == ("delay", "x:m2")
    fit = lw.identify(record, ASKED, admit=["delay"])
    delay, deviation = told(fit, "x:m2")
    assert fit.trusted and delay == pytest.approx(3e-4, abs=5.0 * deviation)


def test_a_delay_of_no_sensor_is_refused() -> None:
    with pytest.raises(lw.IdentificationError, match="no delay of x:m9 can be estimated: the sensors"):
        lw.identify(late("x:m1", 0, seed=34), ASKED, delays=["x:m9"])


def test_errors_of_sensors_that_cannot_be_found_are_refused() -> None:
    record = late("a:m2", 30, seed=36)
    coarse = record.decimate(2)
    with pytest.raises(
        lw.IdentificationError, match=r"late by more than a sample, which records of different"
    ):
        lw.identify([record, coarse], ASKED, delays=["a:m2"])
    for errors in ({"delays": ["x:m1", "x:m1"]}, {"offsets": ["x:m1", "x:m1"]}):
        with pytest.raises(lw.IdentificationError, match="x:m1 is named twice"):
            lw.identify(record, ASKED, **errors)  # type: ignore[arg-type]  # of one of the keywords


def test_the_column_of_a_delay_is_its_difference_quotient() -> None:
    theta = np.array([present(CHAIN.coefficient(p.name).value) for p in ASKED.parameters])
    record = late("v:m1", 3, seed=35)[:300]
    options = LikelihoodOptions(delays=("v:m1", "x:m2"), gains=("v:m1",), model_error=False)
    fit = likelihood_fit([record], ASKED, theta, options=options)
    optimum = fit.optimum

    def data(delays: np.ndarray) -> float:
        point = replace(optimum.point, delays=delays)
        return evaluate(optimum.segments, point, optimum.scales, Gaussian()).data

    at = np.array([2e-4, -1e-4])
    misfit = evaluate(optimum.segments, replace(optimum.point, delays=at), optimum.scales, Gaussian())
    linear = linearise(optimum.segments, misfit, optimum.scales, Gaussian())
    gradient = -2.0 * linear.data.corner_gradient[-2:] / optimum.scales.theta[-2:]
    for number in range(2):
        shift = 1e-7 * np.eye(2)[number]
        quotient = (data(at + shift) - data(at - shift)) / 2e-7
        assert gradient[number] == pytest.approx(quotient, rel=1e-3)  # columns are kept in single precision


@pytest.mark.parametrize(("kind", "exact"), [(0, np.sin), (1, np.cos), (2, lambda t: -np.sin(t))])
def test_the_motion_between_samples_is_of_fifth_order(kind: int, exact: np.ufunc) -> None:
    """sin(t) on a grid of step h: displacement to h^6 inside, velocity to h^5, acceleration to h^4."""
    errors = []
    for step in (0.2, 0.1):
        time = step * np.arange(6)[:, None]
        states = np.stack([np.sin(time), step * np.cos(time)], axis=1)[:, :, None]
        empty = np.empty((0, 0))
        orbit = Trajectories(states, empty, -np.sin(time)[:, None], empty, empty, empty, empty)
        shown, _ = late_motion(orbit, np.array([step]), 1, mass=0, kind=kind, delay=0.5 * step)
        errors.append(np.abs(shown[1:, 0] - exact(time[1:-1, 0] - 0.5 * step)).max())
    assert errors[0] / errors[1] > 0.7 * 2.0 ** (6 - kind)
