"""Ambient forces, which no channel shows, and noise of the channels of applied forces."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import scipy
from present import present, some
from shaken_chain import DAMPING, NOISE, RATE, STEADY, STIFFNESS, SUBSTEPS, chain, motion
from structures import oscillator, torsion_chain

import linkwise as lw
from linkwise.arrays import Floats
from linkwise.likelihood.random_forces import force_estimates, random_forces
from linkwise.verdict import Verdict

ERRORS = 5.0  # standard errors that an estimate may be off: 6e-7 of chance for each


@cache
def ambient(n: int, seconds: float, seed: int, cubic: float = 0.0) -> lw.Record:
    """Displacements in a white force of 1 N a sample on every mass."""
    rng, count = np.random.default_rng(seed), int(seconds * RATE)
    forces = np.sqrt(SUBSTEPS) * rng.standard_normal(((STEADY + count) * SUBSTEPS, n))
    x = motion(forces, cubic)[STEADY:, :n]
    channels = tuple(f"x:m{i}" for i in range(1, n + 1))
    return lw.Record(0.0, RATE, channels, x + NOISE * rng.standard_normal(x.shape))


@cache
def accelerations(seed: int, seconds: float = 10.0) -> lw.Record:
    """Accelerations of two masses in white forces of 1 N, constant in each sample, with noise of 0.01 m/s^2."""
    rng, count = np.random.default_rng(seed), int(seconds * RATE)
    forces = rng.standard_normal((STEADY + count, 2))
    states = motion(np.repeat(forces, SUBSTEPS, axis=0))
    incidence = np.eye(2) - np.eye(2, k=1)
    pulls = STIFFNESS * states[:, :2] @ incidence + DAMPING * states[:, 2:] @ incidence
    shown = (forces - pulls @ incidence.T)[STEADY:]
    noisy = shown + 0.01 * rng.standard_normal(shown.shape)
    return lw.Record(0.0, RATE, ("a:m1", "a:m2"), noisy)


@cache
def with_load_cell(seed: int) -> lw.Record:
    """Two masses, a force on the first of about 1 N that is held between its samples, whose channel has noise of 0.1 N."""
    rng, count = np.random.default_rng(seed), 2000
    applied = np.convolve(rng.standard_normal(count), np.ones(4) / 2.0, mode="same")
    forces = np.zeros((count * SUBSTEPS, 2))
    forces[:, 0] = np.repeat(applied, SUBSTEPS)
    x = motion(forces)[:, :2]
    columns = np.column_stack(
        [x + 1e-5 * rng.standard_normal(x.shape), applied + 0.1 * rng.standard_normal(count)]
    )
    return lw.Record(0.0, RATE, ("x:m1", "x:m2", "force:m1"), columns, interpolation={"force:m1": "held"})


def assert_true_within_errors(fit: lw.Estimate, true: lw.Structure) -> None:
    assert fit.trusted, fit.message
    for parameter in some(fit.parameters):
        estimate = fit.coefficient(parameter.name)
        error = estimate.value - present(true.coefficient(parameter.name).value)
        assert abs(error) < ERRORS * present(estimate.standard_error), parameter.name


def test_an_ambient_record_gives_stiffness_damping_and_the_forces() -> None:
    fit = lw.identify(ambient(2, 20.0, seed=1), chain(2).unknown("all"), ambient="all")
    assert_true_within_errors(fit, chain(2))
    assert [force.where for force in fit.random_forces] == ["m1", "m2"]
    for force in some(fit.random_forces):
        assert force.found
        # 2000 samples, of which the record determines more than 500: scatter below 1 / sqrt(1000), five times that
        assert force.deviation == pytest.approx(1.0, rel=0.16)
        assert force.spectral_density == pytest.approx(force.deviation * np.sqrt(2.0 / RATE), rel=1e-12)
        assert force.description in fit.findings
    assert [force["where"] for force in fit.to_dict()["random_forces"]] == ["m1", "m2"]
    # of 4000 samples, with the noise found: what is lost is that of the relaxed flow, and chi-square scatters by 0.02
    assert fit.chi_square_per_sample == pytest.approx(1.0, abs=0.05)


def test_accelerations_alone_in_ambient_forces_give_stiffness_and_damping() -> None:
    fit = lw.identify(accelerations(6), chain(2).unknown("all"), ambient="all")
    assert_true_within_errors(fit, chain(2))
    for force in some(
        fit.random_forces
    ):  # accelerations show nearly all 1000 of them: five times 1 / sqrt(2000)
        assert force.deviation == pytest.approx(1.0, rel=5.0 / np.sqrt(2000))


def test_without_the_forces_the_same_record_is_not_trusted() -> None:
    assert not lw.identify(ambient(2, 20.0, seed=1), chain(2).unknown("all")).trusted


def test_the_estimates_are_at_the_maximum_of_the_likelihood_by_a_kalman_filter() -> None:
    record = ambient(1, 20.0, seed=2)
    density = np.sqrt(2.0 / RATE)  # of 1 N a sample
    stated = lw.Record(record.start, record.rate, record.channels, record.values, noise={"x:m1": NOISE})
    fit = lw.identify(stated, chain(1).unknown("all"), ambient={"m1": density})
    assert_true_within_errors(fit, chain(1))
    y = record.channel("x:m1")
    errors = np.sqrt(fit.covariance.diagonal())

    def cost(moved: Floats) -> float:
        return _kalman_cost(y, *(fit.values + moved))

    for unit in np.diag(errors):
        slope = 0.5 * (cost(unit) - cost(-unit))
        curvature = cost(unit) + cost(-unit) - 2.0 * cost(0.0 * unit)
        # a twentieth is where the search is said to have settled; as much for the relaxation of the flow beside the force
        assert abs(slope / curvature) < 0.1
        assert curvature == pytest.approx(2.0, rel=0.2)  # standard errors to a tenth, of this one unknown


def _kalman_cost(y: Floats, stiffness: float, damping: float) -> float:
    """-2 log likelihood of displacements of one mass in a force that is constant in each sample, with a deviation of 1 N."""
    matrix = np.array([[0.0, 1.0, 0.0], [-stiffness, -damping, 1.0], [0.0, 0.0, 0.0]])
    step = scipy.linalg.expm(matrix / RATE)[:2]
    onward, pushed = step[:, :2], step[:, 2:]
    mean, spread, total = np.zeros(2), np.diag([1e-2, 1e1]), 0.0  # at first far wider than the motion
    for sample in y:
        power = spread[0, 0] + NOISE**2
        surprise = sample - mean[0]
        total += surprise**2 / power + np.log(power)
        gain = spread[:, 0] / power
        mean, spread = mean + gain * surprise, spread - np.outer(gain, spread[0])
        mean, spread = onward @ mean, onward @ spread @ onward.T + pushed @ pushed.T
    return float(total)


@pytest.mark.parametrize("stated", [0.1, None])
def test_noise_of_a_load_cell_is_counted_in(stated: float | None) -> None:
    unknown = chain(2, "k*d + c*v + k3*d**3").unknown("all")
    fit = lw.identify(with_load_cell(3), unknown, input_noise={"force:m1": stated})
    assert_true_within_errors(fit, chain(2, "k*d + c*v + k3*d**3"))
    [force] = fit.random_forces
    assert force.where == "force:m1"
    assert force.found is (stated is None)
    # of 2000 samples the record determines a hundred: scatter below 1 / sqrt(2 * 100), five times that
    assert force.deviation == pytest.approx(0.1, rel=0.35)


def test_a_missing_cubic_spring_is_told_beside_an_ambient_force() -> None:
    # half the force in the spring at the largest elongation of 7 mm
    record = ambient(1, 20.0, seed=4, cubic=2e7)
    fit = lw.identify(record, chain(1).unknown("all"), ambient=["m1"])
    assert fit.fit_verdicts == (Verdict.SYSTEMATIC_MISFIT,)
    assert fit.diagnosis[0].term in ("d**3", "d**5")
    whole = chain(1, "k*d + c*v + k3*d**3").unknown("all")
    estimate = lw.identify(record, whole, ambient=["m1"])
    assert estimate.trusted, estimate.message
    assert abs(estimate.coefficient("l1.k3").value - 2e7) < ERRORS * present(
        estimate.coefficient("l1.k3").standard_error
    )


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"ambient": ["m7"]}, "no ambient force can act on m7: the masses are m1, m2"),
        ({"ambient": {"m1": -1.0}}, "the ambient force on m1 must be a positive number in N/sqrt(Hz)"),
        ({"input_noise": ["force:m2"]}, "no noise of force:m2"),
        ({"input_noise": {"force:m1": 0.0}}, "the noise of force:m1 must be a positive number in N,"),
        ({"ambient": ["m1"], "input_noise": "all"}, "are the same to the mass: state one of them"),
        (
            {"ambient": ["m2"], "delays": ["x:m2"]},
            "random forces and a delay of x:m2 cannot be estimated together yet",
        ),
        ({"ambient": ["m2"], "admit": ["gain"]}, "random forces and errors of sensors to be admitted (gain)"),
        (
            {"ambient": ["m2"], "loss": lw.likelihood.Student()},
            "random forces and a robust loss cannot be estimated together",
        ),
    ],
)
def test_what_cannot_be_is_refused(options: dict[str, object], words: str) -> None:
    with pytest.raises(lw.IdentificationError) as error:
        lw.identify(with_load_cell(3), chain(2).unknown("all"), **options)  # type: ignore[arg-type]
    assert words in str(error.value)


def test_a_spring_that_is_left_out_is_told_beside_an_ambient_force() -> None:
    """A term may be larger than all of the force that the law has."""
    fit = lw.identify(ambient(1, 15.0, seed=5), chain(1, "c*v").unknown("all"), ambient="all")
    assert fit.fit_verdicts == (Verdict.SYSTEMATIC_MISFIT,)
    assert fit.diagnosis[0].term == "d"


def test_an_error_of_the_law_is_not_told_as_noise_of_the_load_cell() -> None:
    """Cogging that is as large as the applied force."""
    rng = np.random.default_rng(6)
    structure = oscillator("k*d + c*v + F*sin(d/s)", name="l1", k=STIFFNESS, c=DAMPING, F=1.0, s=1e-3)
    force = np.convolve(rng.standard_normal(1500), 0.5 * np.ones(4), "same")
    record = lw.simulate(
        structure, forces={"m1": lw.model.Sampled(0.0, RATE, force)}, duration=14.99, rate=RATE
    )
    noisy = record.with_noise(40.0, seed=6)
    fit = lw.identify(noisy, chain(1).unknown("all"), input_noise="all")
    assert not fit.trusted


def test_channels_of_links_are_refused() -> None:
    record = ambient(1, 4.0, seed=2)
    force = STIFFNESS * record.values[:, :1]
    both = lw.Record(0.0, RATE, ("x:m1", "f:l1"), np.hstack([record.values[:, :1], force]))
    with pytest.raises(lw.IdentificationError, match="random forces and f:l1 cannot be estimated together"):
        lw.identify(both, chain(1).unknown("all"), ambient="all")


def test_noise_of_an_input_that_no_record_has_is_refused() -> None:
    with pytest.raises(lw.IdentificationError, match="no noise of an input can be estimated"):
        lw.identify(ambient(1, 20.0, seed=2), chain(1).unknown("all"), input_noise=["force:m1"])
    with pytest.raises(lw.IdentificationError, match='ambient are for method "ml"'):
        lw.identify(ambient(1, 20.0, seed=2), chain(1).unknown("all"), method="weak", ambient="all")


def test_random_moments_are_told_in_newton_metres() -> None:
    subject = torsion_chain()
    record = lw.simulate(
        subject, release={"v:disc1": 6.0}, forces={"disc2": "sin(20*t)"}, duration=1.0, rate=500.0
    )
    forces = random_forces({"disc1": None}, {"force:disc2": 0.1}, record, subject)
    found = force_estimates(forces, np.array([2.0, 0.1]), record.rate)
    assert [force.unit for force in found] == ["N m", "N m"]
    assert "on disc1 of 0.126 N m/sqrt(Hz)" in found[0].description
    assert "Noise of force:disc2 of 0.1 N m, as stated" in found[1].description
    assert found[0].to_dict()["spectral_density_unit"] == "N m/sqrt(Hz)"
    with pytest.raises(lw.IdentificationError, match=r"N m/sqrt\(Hz\)"):
        random_forces({"disc1": -1.0}, {}, record, subject)
