"""The answer as an object: names, intervals, what follows from them, and what result.json says."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from present import present
from problems import chain_record
from structures import NES, link

import linkwise as lw
from linkwise.estimates.causes import NoiseEstimate
from linkwise.estimates.link_estimate import LinkEstimate

ALPHA, BETA, MOVING = -100.0, 1e6, 0.0099
DEVIATIONS = np.diag([0.5, 4000.0, 1e-3])
COVARIANCE = DEVIATIONS @ np.array([[1, 0.6, 0], [0.6, 1, 0], [0, 0, 1]]) @ DEVIATIONS


def sink(
    alpha: float = ALPHA, beta: float = BETA, covariance: np.ndarray | None = COVARIANCE
) -> LinkEstimate:
    nes = link("nes1", "m2-m1", NES, alpha=alpha, beta=beta, c=0.02)
    return LinkEstimate(nes, (), (-0.03, 0.03), (-5.0, 5.0), ("alpha", "beta", "c"), covariance, MOVING)


@pytest.fixture(scope="module")
def record() -> lw.Record:
    return chain_record(2, duration=3.0).with_noise(30.0, seed=1)


@pytest.fixture(scope="module")
def fit(record: lw.Record, chain: lw.Structure) -> lw.Estimate:
    return lw.identify(record, chain.unknown("nes", "mass:m2"), method="weak")


@pytest.fixture(scope="module")
def refused(record: lw.Record, chain: lw.Structure) -> lw.Estimate:
    stated = {name: sigma / 4 for name, sigma in present(record.simulated).noise.items()}
    return lw.identify(replace(record, noise=stated), chain.unknown("nes", "mass:m2"), method="weak")


def test_wells_barrier_and_frequency_in_closed_form() -> None:
    estimated_link = sink()
    assert [well.value for well in estimated_link.wells] == pytest.approx([-0.01, 0.01], rel=1e-12)
    assert present(estimated_link.barrier).value == pytest.approx(ALPHA**2 / (4 * BETA), rel=1e-12)
    expected = np.sqrt(-2 * ALPHA / MOVING) / (2 * np.pi)
    # closed form against eigenvalues, whose square roots halve the digits that slopes lose
    found = [quantity.value for quantity in estimated_link.frequencies]
    assert found == pytest.approx([expected, expected], rel=1e-9)
    single = sink(alpha=100.0)
    assert single.wells == () and single.barrier is None and single.frequencies == ()


def test_their_intervals_are_the_delta_method() -> None:
    """Against the gradients written out: well sqrt(-alpha/beta), barrier alpha^2/(4 beta), frequency from -2 alpha."""
    estimated_link = sink()
    root = 1.0 / (2 * np.pi * np.sqrt(MOVING))
    gradients = {
        "well": np.array([-0.01 / (2 * -ALPHA), -0.01 / (2 * BETA)]),
        "barrier": np.array([ALPHA / (2 * BETA), -(ALPHA**2) / (4 * BETA**2)]),
        "frequency": np.array([-root / np.sqrt(-2 * ALPHA), 0.0]),
    }
    for quantity in (estimated_link.wells[1], present(estimated_link.barrier), estimated_link.frequencies[0]):
        slope = gradients[quantity.name]
        half = 1.959964 * np.sqrt(slope @ COVARIANCE[:2, :2] @ slope)
        assert quantity.interval == pytest.approx((quantity.value - half, quantity.value + half), rel=1e-6)


def test_the_band_of_a_force_is_that_of_its_coefficients() -> None:
    d = np.array([0.0, 0.005, 0.02])
    force, lower, upper = sink().force_band(d)
    slope = np.stack([d, d**3])
    half = 1.959964 * np.sqrt(np.einsum("in,ij,jn->n", slope, COVARIANCE[:2, :2], slope))
    assert force == pytest.approx(ALPHA * d + BETA * d**3)
    # the quantile is written with seven digits
    assert upper - force == pytest.approx(half, rel=1e-6, abs=1e-15)
    assert force - lower == pytest.approx(half, rel=1e-6, abs=1e-15)


def test_the_structure_is_complete_and_wrong_names_list_others(fit: lw.Estimate, chain: lw.Structure) -> None:
    assert fit.structure.parameters == ()
    assert fit.structure.link("nes1").values["alpha"] == fit.coefficient("nes1.alpha").value
    assert fit.structure.mass("m2").mass.value == fit.coefficient("m2.mass").value
    assert [fit.coefficient(unknown).value for unknown in fit.parameters] == fit.values.tolist()
    assert fit.structure.link("spring1") == chain.link("spring1")
    message = r'unknown name "nes1\.gamma".*; choose from spring1\.k, .*m2\.mass'
    with pytest.raises(lw.StructureError, match=message):
        fit.coefficient("nes1.gamma")
    with pytest.raises(lw.StructureError, match=r'unknown name "nes7".*; choose from spring1, nes1'):
        fit.link("nes7")


def test_a_refused_answer_keeps_its_values_and_gives_no_interval(refused: lw.Estimate) -> None:
    result = refused.to_dict()
    assert not refused.trusted and result["status"] == "chi-square off"
    for coefficient in (*result["links"][1]["coefficients"].values(), result["masses"]["m2"]):
        assert coefficient["standard_error"] is None and coefficient["interval"] is None
        assert np.isfinite(coefficient["value"])
    assert result["links"][1]["barrier"]["interval"] is None


def test_the_range_is_what_was_visited(fit: lw.Estimate, record: lw.Record) -> None:
    """To the noise, which would stretch it: three of its deviations."""
    d = present(record.simulated).displacement[:, 1] - present(record.simulated).displacement[:, 0]
    noise = present(record.simulated).noise
    sigma = np.hypot(noise["x:m1"], noise["x:m2"])
    assert fit.link("nes1").d_range == pytest.approx((d.min(), d.max()), abs=3 * sigma)


def test_signal_to_noise_counts_the_motion_alone() -> None:
    samples = 2.0 * np.sin(np.arange(1000) * 0.1) + 0.0
    record = lw.Record(0.0, 1000.0, ("x:m1",), samples[:, None])
    power = np.mean(samples**2)
    noise = NoiseEstimate.of(record, "x:m1", 0.2)
    assert noise.snr_db == pytest.approx(10 * np.log10((power - 0.04) / 0.04))
    assert noise.unit == "m"
    assert NoiseEstimate.of(record, "x:m1", 0.0).snr_db == np.inf
    assert NoiseEstimate.of(record, "x:m1", 9.0).snr_db == -np.inf


def test_an_answer_is_pickled_whatever_noted_its_progress(record: lw.Record, chain: lw.Structure) -> None:
    reports: list[lw.estimates.ProgressReport] = []
    fit = lw.identify(record, chain.unknown("nes"), progress=lambda report: reports.append(report))
    copied = pickle.loads(pickle.dumps(fit))
    assert reports and np.array_equal(present(copied.motion).d, present(fit.motion).d)
