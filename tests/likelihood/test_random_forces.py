"""Ambient forces, which no channel shows: white, coloured, unsteady, correlated, and unstated."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import scipy
from present import some
from record_faults import changed
from shaken_chain import DAMPING, NOISE, RATE, STEADY, STIFFNESS, SUBSTEPS, chain, matrices, motion
from structures import oscillator
from within import assert_within

import linkwise as lw
from linkwise.arrays import Floats

pytestmark = pytest.mark.slow


ERRORS = 5.0  # standard errors that an estimate may be off: 6e-7 of chance for each


def white_forces(rng: np.random.Generator, seconds: float, n: int = 2) -> Floats:
    """Of 1 N a sample, constant in each part of it."""
    forces: Floats = np.sqrt(SUBSTEPS) * rng.standard_normal(((STEADY + int(seconds * RATE)) * SUBSTEPS, n))
    return forces


def shown(forces: Floats, rng: np.random.Generator, cubic: float = 0.0) -> lw.Record:
    """Displacements of as many masses, in forces from the time on where they are steady."""
    n = forces.shape[1]
    x = motion(forces, cubic)[STEADY:, :n]
    channels = tuple(f"x:m{i}" for i in range(1, n + 1))
    return lw.Record(0.0, RATE, channels, x + NOISE * rng.standard_normal(x.shape))


@cache
def ambient(deviations: tuple[float, ...], seconds: float, seed: int, cubic: float = 0.0) -> lw.Record:
    """Displacements in independent white forces of so many N a sample, which no channel shows."""
    rng = np.random.default_rng(seed)
    return shown(white_forces(rng, seconds, len(deviations)) * deviations, rng, cubic)


def test_an_ambient_record_gives_stiffness_damping_and_the_forces() -> None:
    record, asked = ambient((1.0, 1.0), 20.0, seed=1), chain(2).unknown("all")
    fit = lw.identify(record, asked, ambient="all")
    assert_within(fit, chain(2), ERRORS)
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


def kalman_cost(y: Floats, row: int, noise: float, onward: Floats, added: Floats) -> float:
    """-2 log likelihood of a state of one mass, by its transition over a sample and the covariance that a force adds."""
    mean, spread, total = np.zeros(2), np.diag([1e-2, 1e1]), 0.0  # at first far wider than the motion
    for sample in y:
        power = spread[row, row] + noise**2
        surprise = sample - mean[row]
        total += surprise**2 / power + np.log(power)
        gain = spread[:, row] / power
        mean, spread = mean + gain * surprise, spread - np.outer(gain, spread[row])
        mean, spread = onward @ mean, onward @ spread @ onward.T + added
    return float(total)


def of_held_force(stiffness: float, damping: float) -> tuple[Floats, Floats]:
    """A force that is constant in each sample, with a deviation of 1 N."""
    matrix = np.array([[0.0, 1.0, 0.0], [-stiffness, -damping, 1.0], [0.0, 0.0, 0.0]])
    step = scipy.linalg.expm(matrix / RATE)[:2]
    return step[:, :2], step[:, 2:] @ step[:, 2:].T


def of_white_force(stiffness: float, damping: float) -> tuple[Floats, Floats]:
    matrix = np.array([[0.0, 1.0], [-stiffness, -damping]])
    return _step_in_white_noise(matrix, np.diag([0.0, 1.0 / RATE]))


@pytest.mark.parametrize("channel", ["x:m1", "v:m1"])
def test_the_estimates_are_at_the_maximum_of_the_likelihood_by_a_kalman_filter(channel: str) -> None:
    held = channel == "x:m1"
    record = ambient((1.0,), 20.0, seed=2) if held else velocities((1.0,), 40.0, 5799003)
    y = record.channel(channel)
    noise = NOISE if held else 0.03 * float(np.sqrt(np.mean(y**2)))
    stated = replace(record, noise={channel: noise})
    fit = lw.identify(stated, chain(1).unknown("all"), ambient={"m1": DENSITY})
    assert_within(fit, chain(1), ERRORS)
    steps = of_held_force if held else of_white_force

    def cost(moved: Floats) -> float:
        return kalman_cost(y, 0 if held else 1, noise, *steps(*(fit.values + moved)))

    for unit in np.diag(np.sqrt(fit.covariance.diagonal())):
        slope = 0.5 * (cost(unit) - cost(-unit))
        curvature = cost(unit) + cost(-unit) - 2.0 * cost(0.0 * unit)
        # a twentieth is where the search is said to have settled; as much for the relaxation of the flow beside the force
        assert abs(slope / curvature) < 0.1
        if held:  # standard errors to a tenth, of this one unknown
            assert curvature == pytest.approx(2.0, rel=0.2)


def test_a_missing_spring_is_told_beside_an_ambient_force() -> None:
    """Half the force in the spring at the largest elongation of 7 mm."""
    record = ambient((1.0,), 20.0, seed=4, cubic=2e7)
    fit = lw.identify(record, chain(1).unknown("all"), ambient=["m1"])
    assert fit.fit_verdicts == (lw.Verdict.SYSTEMATIC_MISFIT,)
    assert fit.diagnosis[0].term in ("d**3", "d**5")
    whole = lw.identify(record, chain(1, "k*d + c*v + k3*d**3").unknown("all"), ambient=["m1"])
    assert_within(whole, {"l1.k3": 2e7}, ERRORS)


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


def low_pass(forces: Floats, corner: float) -> Floats:
    """Forces behind a filter of first order at a corner in Hz."""
    b, a = scipy.signal.butter(1, corner / (RATE * SUBSTEPS / 2.0))
    filtered: Floats = scipy.signal.lfilter(b, a, forces, axis=0)
    return filtered


@cache
def in_coloured_forces(corner: float, seconds: float, seed: int) -> lw.Record:
    rng = np.random.default_rng(seed)
    return shown(low_pass(white_forces(rng, seconds), corner), rng)


def test_forces_that_fall_off_are_named_in_the_band_of_the_motion_and_as_good_as_white_beyond() -> None:
    asked = chain(2).unknown("all")
    fit = lw.identify(in_coloured_forces(3.0, 14.0, seed=5700011), asked, ambient="all")
    assert not fit.trusted
    assert fit.verdicts[0] is lw.Verdict.MEASUREMENT_ERROR
    cause = fit.diagnosis[0]
    assert (cause.kind, cause.unit) == ("coloured force", "1")
    assert cause.where in ("m1", "m2")
    assert f"an ambient force on {cause.where} that is not white (its density is" in fit.message
    assert "intervals of exact laws say: record the forces, or the structure where" in fit.message
    beyond = lw.identify(in_coloured_forces(40.0, 14.0, seed=5700012), asked, ambient="all")
    assert beyond.trusted and beyond.diagnosis == ()
    assert "which is tested where the structure moves" in beyond.message
    short = lw.identify(in_coloured_forces(3.0, 1.5, seed=5700016), asked, ambient="all")  # for a spectrum
    assert not {"coloured force", "correlated forces"} & {cause.kind for cause in short.diagnosis}


def test_forces_that_depend_on_each_other_are_named() -> None:
    rng = np.random.default_rng(5700013)
    forces = white_forces(rng, 20.0)
    forces[:, 1] = -0.8 * forces[:, 0] + 0.6 * forces[:, 1]
    fit = lw.identify(shown(forces, rng), chain(2).unknown("all"), ambient="all")
    assert not fit.trusted
    cause = fit.diagnosis[0]
    assert (cause.kind, cause.where, cause.source) == ("correlated forces", "m1", "m2")
    # forces are told with the noise of sensors, which lowers a correlation, here by less than a quarter
    assert cause.size == pytest.approx(-0.8, abs=0.2)
    assert f"a correlation of {cause.size:.2g} between the ambient forces on m1 and m2" in fit.message


def test_a_level_that_changes_with_time_is_named_before_a_term_that_seems_to_be_missing() -> None:
    rng = np.random.default_rng(5799011)
    forces = white_forces(rng, 25.0)
    second = np.arange(len(forces)) / (RATE * SUBSTEPS)
    forces *= np.where(second % 10.0 < 2.0, 4.0, 1.0)[:, None]
    fit = lw.identify(shown(forces, rng), chain(2).unknown("all"), ambient="all")
    assert fit.verdicts[0] is lw.Verdict.MEASUREMENT_ERROR
    cause = fit.diagnosis[0]
    assert (cause.kind, cause.unit) == ("unsteady force", "1")
    assert f"an ambient force on {cause.where} whose level changes with time (its density is" in fit.message
    assert "times too narrow: use parts of the record" in fit.message


DENSITY = np.sqrt(2.0 / RATE)  # N/sqrt(Hz), one-sided, of 1 N a sample


def _step_in_white_noise(matrix: Floats, process: Floats) -> tuple[Floats, Floats]:
    """The transition over a sample, and the covariance of what noise adds, of a spectral density (Van Loan 1978)."""
    m = len(matrix)
    whole = scipy.linalg.expm(np.block([[-matrix, process], [np.zeros((m, m)), matrix.T]]) / RATE)
    transition = whole[m:, m:].T
    return transition, transition @ whole[:m, m:]


@cache
def velocities(deviations: tuple[float, ...], seconds: float, seed: int) -> lw.Record:
    """Velocities in white forces of so many N a sample, with noise of 3 % of them."""
    rng, n = np.random.default_rng(seed), len(deviations)
    matrix, forces = matrices(n)[0], np.eye(2 * n)[:, n:]
    transition, added = _step_in_white_noise(
        matrix, forces @ np.diag(np.array(deviations) ** 2 / RATE) @ forces.T
    )
    sizes, axes = np.linalg.eigh(added)
    steps = rng.standard_normal((STEADY + int(seconds * RATE), 2 * n))
    steps = steps * np.sqrt(np.maximum(sizes, 0.0)) @ axes.T
    state, shown = np.zeros(2 * n), np.empty((len(steps), n))
    for number, step in enumerate(steps):
        shown[number] = state[n:]
        state = transition @ state + step
    shown = shown[STEADY:]
    noise = 0.03 * np.sqrt(np.mean(shown**2, axis=0)) * rng.standard_normal(shown.shape)
    return lw.Record(0.0, RATE, tuple(f"v:m{i}" for i in range(1, n + 1)), shown + noise)


@cache
def accelerations(corner: float, seconds: float, seed: int) -> lw.Record:
    """Accelerations of two masses in white forces of 1 N a sample, up to a corner in Hz, with noise of 1 %."""
    rng, count = np.random.default_rng(seed), int(seconds * RATE)
    matrix, forces = matrices(2)[0], np.eye(4)[:, 2:]
    spectrum = np.fft.rfft(rng.standard_normal((count, 2)), axis=0)
    frequency = np.fft.rfftfreq(count, 1.0 / RATE)
    spectrum[frequency > corner] = 0.0
    turns = 2j * np.pi * frequency[:, None, None] * np.eye(4)
    states = np.linalg.solve(turns - matrix, (spectrum @ forces.T)[:, :, None])[:, :, 0]
    shown = np.fft.irfft((states @ matrix.T + spectrum @ forces.T)[:, 2:], count, axis=0)
    noise = 0.01 * np.sqrt(np.mean(shown**2, axis=0)) * rng.standard_normal(shown.shape)
    return lw.Record(0.0, RATE, ("a:m1", "a:m2"), shown + noise)


def test_accelerations_are_told_where_they_are_flat_up_to_half_the_rate_and_refused_behind_a_filter() -> None:
    fit = lw.identify(accelerations(50.0, 6.0, 5799004), chain(2).unknown("all"), ambient="all")
    assert_within(fit, chain(2))
    for force in some(fit.random_forces):
        # of nearly all 600 forces: four times 1 / sqrt(1200)
        assert force.spectral_density == pytest.approx(DENSITY, rel=0.115)
    fit = lw.identify(accelerations(40.0, 6.0, 5799005), chain(2).unknown("all"), ambient="all")
    assert fit.verdicts[0] is lw.Verdict.MEASUREMENT_ERROR, fit.message
    assert fit.diagnosis[0].kind == "coloured force"
    assert "below 50 Hz, as behind a filter against aliasing)" in fit.message
    assert "resample the accelerations at twice the frequency up to which the filter is flat" in fit.message


def test_an_ambient_force_on_a_mass_that_is_not_named_takes_trust_and_is_told() -> None:
    fit = lw.identify(ambient((1.0, 1.0), 15.0, 51), chain(2).unknown("all"), ambient=["m1"])
    assert fit.fit_verdicts == (lw.Verdict.MEASUREMENT_ERROR,)
    cause = fit.diagnosis[0]
    assert (cause.kind, cause.where, cause.unit) == ("ambient", "m2", "N/sqrt(Hz)") and cause.is_instrument
    assert cause.description in fit.message
    assert "allow for an ambient force on m2" in fit.message
    # one step of the score from a deviation of zero: to the first order
    assert cause.size == pytest.approx(DENSITY, rel=0.2)


def test_a_force_that_is_looked_for_and_does_not_act_is_zero_below_a_limit() -> None:
    """The search for its deviation, which would shrink for ever, ends."""
    fit = lw.identify(ambient((1.0, 0.0), 15.0, 61), chain(2).unknown("all"), ambient="all")
    assert fit.trusted, fit.message
    last = some([force for force in fit.random_forces[1:] if force.deviation == 0.0])[-1]
    assert (last.spectral_density, last.found) == (0.0, True)
    # forces of a tenth of that on m1 are told in such records
    assert last.upper_limit is not None and 0.0 < last.upper_limit < 0.1 * DENSITY
    assert f"No ambient force on {last.where} was found: it is below" in last.description
    assert last.description in fit.findings
    upper_limits = {force["where"]: force["upper_limit"] for force in fit.to_dict()["random_forces"]}
    assert upper_limits[last.where] == last.upper_limit
    assert fit.random_forces[0].upper_limit is None


def test_a_stated_ambient_force_may_be_too_small_and_not_right() -> None:
    record, unknown = ambient((1.0, 1.0), 15.0, 54), chain(2).unknown("all")
    small = lw.identify(record, unknown, ambient={"m1": DENSITY, "m2": 0.3 * DENSITY})
    assert not small.trusted
    [cause] = [cause for cause in small.diagnosis if cause.kind == "ambient"]
    assert cause.where == "m2"
    assert cause.size == pytest.approx(DENSITY, rel=0.2)
    assert cause.description.endswith("(0.0424 was stated)")
    assert lw.identify(record, unknown, ambient={"m1": DENSITY, "m2": DENSITY}).trusted


def test_a_force_that_may_be_chance_is_told_with_a_limit() -> None:
    """A force of 0.008 N/sqrt(Hz), about what the record shows of one beside its own noise; 4 s of a Duffing oscillator."""
    rate, density = 400.0, 0.008
    rng = np.random.default_rng(2403)
    time = np.arange(1601) / rate
    known = 20.0 * np.sin(40.0 * time) + 10.0 * np.sin(63.0 * time)
    ambient = density * np.sqrt(rate / 2.0) * rng.standard_normal(len(time))
    frame = oscillator("k*d + k3*d**3 + c*v", mass=1.0, name="s", k=2000.0, k3=2e5, c=1.0)
    applied = lw.model.Sampled(0.0, rate, known + ambient, band_limited=True)
    record = lw.simulate(frame, forces={"m1": applied}, duration=4.0, rate=rate).with_noise(30.0, seed=2403)
    fit = lw.identify(changed(record, force_m1=known), frame.unknown("all"), ambient="all")
    assert fit.trusted, fit.message
    [force] = fit.random_forces
    assert force.upper_limit is not None
    assert 0.0 < force.spectral_density < force.upper_limit
    assert density < force.upper_limit < 2.0 * density
    assert "it may be chance, and is below" in force.description
    assert force.description in fit.findings
