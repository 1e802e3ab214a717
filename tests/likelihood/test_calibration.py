"""Sensors with an unknown gain, and records of different noise fitted together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from present import present
from problems import chain_record
from structures import asked_oscillator, oscillator

import linkwise as lw
from linkwise.likelihood.fit import likelihood_fit
from linkwise.likelihood.shooting.loss import Gaussian, Huber, Loss, Student
from linkwise.likelihood.shooting.normal_equations import linearise
from linkwise.likelihood.shooting.residuals import evaluate
from linkwise.likelihood.shooting.segmentation import cut_segments
from linkwise.likelihood.shooting.segments import Iterate, Scales
from linkwise.likelihood.shooting.system import System


@pytest.fixture(scope="module")
def quiet() -> lw.Record:
    return chain_record(2, duration=3.0)


def scaled(record: lw.Record, name: str, gain: float) -> lw.Record:
    """The record with one channel multiplied."""
    values = record.values.copy()
    values[:, record.channels.index(name)] *= gain
    return replace(record, values=values)


def test_an_unknown_gain_is_found_with_the_laws(quiet: lw.Record) -> None:
    chain = lw.bnes_chain(2)
    record = scaled(quiet.with_noise(40.0, seed=1), "x:m1", 1.1)
    unknown = chain.unknown("nes")
    fit = lw.identify(record, unknown, gains=["x:m1"])
    assert fit.trusted
    for name in ("nes1.alpha", "nes1.beta", "nes1.c"):
        low, high = fit.coefficient(name).interval or (np.nan, np.nan)
        spare = 0.5 * (high - low)  # five deviations, for a seed that was not picked
        # 2.5 times 1.96 deviations
        assert low - 1.5 * spare < present(chain.coefficient(name).value) < high + 1.5 * spare
    assert any(line.startswith(("x:m1 shows 1.1", "x:m1 shows 1.09")) for line in fit.findings)
    assert fit.message == "The laws explain the record to within its noise."
    assert lw.identify(record, unknown).message != fit.message  # with the gain taken as 1 they do not


@pytest.mark.parametrize("loss", [Gaussian(), Huber()])
def test_the_column_of_a_gain_is_its_difference_quotient(quiet: lw.Record, loss: Gaussian | Huber) -> None:
    chain = lw.bnes_chain(2)
    unknown = chain.unknown("nes")
    system = System.of(unknown)
    record = quiet[:60].with_noise(20.0, seed=0)
    segments = cut_segments([record], unknown, system, samples=5, refine=1, offsets=["x:m2"], gains=["x:m2"])
    theta = np.array([chain.coefficient(p.name).value for p in unknown.parameters])
    states = quiet.simulated
    assert states is not None
    nodes = np.concatenate([states.displacement[:60:5].T, states.velocity[:60:5].T])
    scales = Scales(np.array([1e-3, 2e-3]), np.ones(4), np.append(np.abs(theta), [1e-3, 1.0]))

    def data(gain: float) -> float:
        point = Iterate(nodes, theta, np.array([1e-3]), np.array([gain]))
        return evaluate(segments, point, scales, loss).data

    misfit = evaluate(segments, Iterate(nodes, theta, np.array([1e-3]), np.array([1.2])), scales, loss)
    gradient = -2.0 * linearise(segments, misfit, scales, loss).data.corner_gradient[-1]
    quotient = (data(1.2 + 1e-5) - data(1.2 - 1e-5)) / 2e-5
    assert gradient == pytest.approx(quotient, rel=1e-4)  # tangents are kept in single precision


def test_each_record_has_its_own_noise(quiet: lw.Record) -> None:
    chain = lw.bnes_chain(2)
    unknown = chain.unknown("nes")
    loud, soft = quiet.with_noise(20.0, seed=2), quiet.with_noise(50.0, seed=3)
    theta = np.array([chain.coefficient(p.name).value for p in unknown.parameters])
    both = likelihood_fit([loud, soft], unknown, theta)
    alone = likelihood_fit([soft], unknown, theta)
    assert both.chi_square == pytest.approx(
        1.0, abs=0.05
    )  # of 12002 samples, and the estimate of their noise
    ratio = np.sqrt(np.diag(both.covariance) / np.diag(alone.covariance))
    assert np.all(ratio < 1.0)  # a loud record adds, it does not spoil ...
    assert np.all(ratio > 0.95)  # ... and it adds little: 30 dB are a factor of 1000 in weight


def test_a_gain_of_no_channel_is_refused(quiet: lw.Record) -> None:
    with pytest.raises(lw.IdentificationError, match="no offset or gain of x:m9 can be estimated"):
        lw.identify(quiet.with_noise(30.0, seed=0), lw.bnes_chain(2).unknown("nes"), gains=["x:m9"])


def test_the_order_of_the_records_does_not_matter() -> None:
    chain = lw.bnes_chain(2)
    unknown = chain.unknown("nes")
    weak_hit = chain_record(2, duration=1.0, speed=0.02).with_noise(30.0, seed=4)
    strong_hit = chain_record(2, duration=2.0).with_noise(30.0, seed=5)
    weak_first, strong_first = (
        lw.identify([weak_hit, strong_hit], unknown),
        lw.identify([strong_hit, weak_hit], unknown),
    )
    assert weak_first.trusted and strong_first.trusted
    np.testing.assert_allclose(
        weak_first.values, strong_first.values, rtol=1e-3
    )  # both within their errors of one optimum
    # extremes of motions that differ by a part of the noise, 3 % of their deviation
    assert weak_first.link("nes1").d_range == pytest.approx(strong_first.link("nes1").d_range, rel=1e-2)
    assert weak_first.findings == strong_first.findings == ()


@pytest.mark.parametrize("loss", [Huber(), Huber(0.7), Student()])
def test_a_robust_loss_on_clean_noise_is_trusted(quiet: lw.Record, loss: Loss) -> None:
    fit = lw.identify(quiet.with_noise(20.0, seed=6), lw.bnes_chain(2).unknown("nes"), loss=loss)
    assert fit.trusted
    assert fit.chi_square_per_sample == pytest.approx(
        1.0, abs=0.06
    )  # 6002 samples, and the estimate of their noise


def test_the_expected_cost_of_noise_is_that_of_many_draws() -> None:
    draws = np.random.default_rng(0).standard_normal(400_000)
    for loss in (Gaussian(), Huber(), Huber(0.7), Student(), Student(2.0)):
        costs = loss.costs(draws)
        assert loss.expected == pytest.approx(
            costs.mean(), abs=5.0 * costs.std() / np.sqrt(len(draws))
        )  # of the mean


def test_the_weak_form_refuses_an_absolute_displacement_beside_an_acceleration_of_the_base() -> None:
    isolated = oscillator("k*d + c*v", to="base", name="mount", k=900.0, c=1.0).unknown("all")
    time = np.arange(400) / 200.0
    record = lw.Record.from_arrays(time, {"x:m1": np.sin(20.0 * time), "a:base": np.cos(20.0 * time)})
    with pytest.raises(
        lw.IdentificationError,
        match=r"only up to drift: measure the motion relative to the base \(rel:x:m1\)",
    ):
        lw.identify(record, isolated, method="weak")


def test_a_law_that_is_not_finite_where_the_link_went_is_refused() -> None:
    rooted = asked_oscillator("k*d + b*sqrt(d)", 1.0, name="root")
    time = np.arange(800) / 200.0
    record = lw.Record.from_arrays(time, {"x:m1": np.sin(20.0 * time)}).with_noise(40.0, seed=0)
    for method in ("weak", "ml"):
        with pytest.raises(lw.IdentificationError, match=r"root\.b is not finite over the whole motion"):
            lw.identify(record, rooted, method=method)


def test_time_in_the_wrong_unit_is_refused_by_the_flow(quiet: lw.Record) -> None:
    slow = lw.Record(0.0, 1.0, quiet.channels, quiet.values)  # 1000 Hz taken for 1 Hz
    with pytest.raises(
        lw.IdentificationError, match=r"runs to infinity within a few samples: .*write time\[ms\]"
    ):
        lw.identify(slow.with_noise(40.0, seed=0), lw.bnes_chain(2).unknown("nes"))
