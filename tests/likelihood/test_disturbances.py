"""Drift and hum of sensors, found with the laws."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from present import present
from problems import chain_record
from structures import torsion_chain

import linkwise as lw
from linkwise.arrays import Floats
from linkwise.likelihood.fit import likelihood_fit
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.shooting.loss import Gaussian
from linkwise.likelihood.shooting.normal_equations import linearise
from linkwise.likelihood.shooting.residuals import evaluate

CHAIN = lw.bnes_chain(2)
ASKED = CHAIN.unknown("all")


def disturbed(added: Floats, seed: int, start: float = 0.0) -> lw.Record:
    """A record at 30 dB whose sink has `added` (N,), in standard deviations of its noise, on top of its motion."""
    clean = chain_record(2, duration=2.0)
    record = clean.with_noise(30.0, seed=seed)
    sigma = float(np.std(clean.channel("x:m2"))) * 10.0**-1.5
    values = record.values + np.outer(sigma * added, [0.0, 1.0])
    return replace(record, start=start, values=values, simulated=None)


TIME = chain_record(2, duration=2.0).time
HUM = 3.0 * np.sin(2.0 * np.pi * 50.0 * TIME + 1.0)
DRIFT = 6.0 * np.sin(1.5 * TIME)


def farthest(fit: lw.Estimate) -> float:
    """The largest error of a coefficient in standard errors."""
    return max(
        abs(estimate.value - present(CHAIN.coefficient(estimate.name).value))
        / present(estimate.standard_error)
        for estimate in (fit.coefficient(parameter.name) for parameter in ASKED.parameters)
    )


@pytest.mark.parametrize(
    ("added", "options"),
    [
        (HUM, {"hums": {"x:m2": 50.0}}),
        (DRIFT, {"drifts": ["x:m2"]}),
        (DRIFT + HUM, {"drifts": {"x:m2": 0.4}, "hums": {"x:m2": 50.0}, "gains": ["x:m2"]}),
    ],
    ids=["hum", "drift", "both beside a gain"],
)
def test_laws_are_found_with_what_is_added_to_a_sensor(added: Floats, options: LikelihoodOptions) -> None:
    """Four standard errors: chance exceeds them for one in 2300 of these seven coefficients."""
    record = disturbed(added, seed=21)
    assert not lw.identify(record, ASKED).trusted
    fit = lw.identify(record, ASKED, **options)  # type: ignore[arg-type]
    assert fit.trusted
    assert farthest(fit) < 4.0


def test_amplitude_and_range_are_told_with_standard_errors() -> None:
    """Within five of them; the drift within the error of a line of eight pieces, whose corners lie on the curve."""
    record = disturbed(DRIFT + HUM, seed=22)
    fit = lw.identify(record, ASKED, drifts=["x:m2"], hums={"x:m2": 50.0})
    sigma = float(np.std(chain_record(2, duration=2.0).channel("x:m2"))) * 10.0**-1.5
    [drift] = [line.split() for line in fit.findings if " drifts over " in line]
    [hum] = [line.split() for line in fit.findings if " has a hum of " in line]
    assert float(hum[5]) == pytest.approx(3.0 * sigma, abs=5.0 * float(hum[-1].rstrip(").")))
    assert float(drift[3]) == pytest.approx(np.ptp(DRIFT) * sigma, rel=0.05)


def test_a_channel_may_have_several_hums_and_be_named_alone() -> None:
    record = disturbed(HUM + DRIFT + 2.0 * np.sin(2.0 * np.pi * 150.0 * TIME), seed=27)
    fit = lw.identify(record, ASKED, drifts="x:m2", hums={"x:m2": [50.0, 150.0]})
    assert fit.trusted
    assert sum("has a hum of" in line for line in fit.findings) == 2


def test_every_record_has_sizes_of_its_own() -> None:
    records = [disturbed(DRIFT, seed=23), disturbed(-2.0 * HUM, seed=24, start=7.0)]
    fit = lw.identify(records, ASKED, drifts=["x:m2"], hums={"x:m2": 50.0})
    assert fit.trusted
    # four standard errors: 6e-5 of chance each
    assert farthest(fit) < 4.0
    assert sum("x:m2 drifts over" in line for line in fit.findings) == 2


def test_columns_are_the_derivatives_of_the_residuals() -> None:
    """By central differences, exact for a cost that is quadratic in the sizes; columns are in single precision."""
    theta = np.array([present(CHAIN.coefficient(parameter.name).value) for parameter in ASKED.parameters])
    options = LikelihoodOptions(drifts={"x:m2": None}, hums={"x:m1": [50.0]}, gains=["x:m2"], steps=3)
    fit = likelihood_fit([disturbed(DRIFT, seed=25)], ASKED, theta, options=options)
    segments, point, scales = fit.segments, fit.optimum.point, fit.optimum.scales
    point = replace(point, offsets=point.offsets + 3.0 * scales.theta[len(theta) :][: len(point.offsets)])
    gradient = (
        -2.0
        * linearise(
            segments, evaluate(segments, point, scales, Gaussian()), scales, Gaussian()
        ).data.corner_gradient
    )
    assert len(point.offsets) == 8 + 2
    for number in range(len(point.offsets)):
        unit = scales.theta[len(theta) + number]
        costs = []
        for side in (0.5, -0.5):
            offsets = point.offsets.copy()
            offsets[number] += side * unit
            costs.append(evaluate(segments, replace(point, offsets=offsets), scales, Gaussian()).data)
        assert costs[0] - costs[1] == pytest.approx(float(gradient[len(theta) + number]), rel=1e-4)


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"drifts": ["x:m3"]}, "no drift or hum of x:m3 can be estimated; did you mean"),
        ({"drifts": {"x:m2": 1e-3}}, "the pieces of the drift of x:m2 must be 0.0312 s long at least, got 0.001 s"),
        ({"drifts": {"x:m2": -1.0}}, "the pieces of the drift of x:m2 must have a positive length in s, got -1.0"),
        ({"hums": ["x:m2"]}, "hums takes frequencies in Hz by channel, as in"),
        ({"hums": {"x:m2": "50"}}, "hums takes frequencies in Hz by channel, as in"),
        ({"hums": {"x:m2": 600.0}}, "a frequency between 0 and half the rate, 500 Hz, got 600 Hz"),
        ({"drifts": ["x:m2"], "ambient": ["m1"]}, "random forces and drift or hum of x:m2 cannot be estimated together"),
    ],
)  # fmt: skip
def test_what_cannot_be_found_is_refused(options: LikelihoodOptions, reason: str) -> None:
    with pytest.raises(lw.IdentificationError, match=reason):
        lw.identify(disturbed(HUM, seed=26), ASKED, **options)  # type: ignore[arg-type]


def test_disturbances_of_rotations_are_told_in_rad() -> None:
    record = lw.simulate(torsion_chain(), release={"v:disc1": 6.0}, duration=2.0, rate=500.0)
    record = record.with_noise(40.0, seed=5413021)
    fit = lw.identify(
        record, torsion_chain().unknown("sink"), drifts={"x:disc2": 1.0}, hums={"x:disc1": 50.0}
    )
    told = [remark for remark in fit.remarks if "drifts over" in remark or "50 Hz" in remark]
    assert len(told) == 2 and all(" rad " in remark for remark in told), fit.remarks
