"""Modes of a test: motions of one against simulations, derivatives against differences, and how many are found."""

import numpy as np
import pytest
from record_faults import changed
from structures import CANTILEVER, host, structure
from tapped_beam import DAMPING, shaken, tapped

import linkwise as lw
from linkwise.arrays import Floats
from linkwise.modal.measurement import MeasuredRun, ModalMeasurement
from linkwise.modal.oscillators import ComplexModes, SampledForce
from linkwise.modal.output_error import _OutputError
from linkwise.modal.pursuit import Projection, PursuedModes, pursued_modes
from linkwise.progress import silent

FREQUENCIES, RATIOS = np.array([3.0, 3.2, 11.0]), np.array([0.02, 0.03, 0.01])
PAIRS, BETWEEN = ((0, 1), (1, 2)), np.array([0.3, -0.5])


def complex_modes(parameters: Floats) -> ComplexModes:
    """From frequency and ratio of each coordinate in turn, then damping between pairs."""
    own = parameters[:6].reshape(3, 2)
    return ComplexModes(own[:, 0], own[:, 1], PAIRS, parameters[6:])


def stated() -> Floats:
    return np.concatenate([np.stack([FREQUENCIES, RATIOS], axis=1).ravel(), BETWEEN])


def residues(found: ComplexModes) -> Floats:
    """(n, n, n) products of vectors, which have no sign."""
    return np.asarray(np.einsum("kr,ks->krs", found.vectors, found.vectors))


def test_they_give_the_receptances_of_the_matrices() -> None:
    found = complex_modes(stated())
    for frequency in (0.5, 3.1, 7.0):
        s = 2j * np.pi * frequency
        stiffness = np.diag((2.0 * np.pi * FREQUENCIES) ** 2)
        exact = np.linalg.inv(stiffness + s * found.damping + s**2 * np.eye(3))
        summed = sum(
            each / (s - pole) + each.conj() / (s - pole.conjugate())
            for each, pole in zip(residues(found), found.poles, strict=True)
        )
        np.testing.assert_allclose(summed, exact, rtol=1e-10)  # rounding


def test_a_mode_that_does_not_vibrate_is_refused() -> None:
    with pytest.raises(np.linalg.LinAlgError, match="does not vibrate"):
        _ = ComplexModes(FREQUENCIES, np.array([0.02, 1.5, 0.01]), (), np.empty(0)).poles


def test_motion_of_a_mode_is_that_of_a_simulation() -> None:
    subject = structure({}, hosts=[host("one", [21.0], 0.02, {"p": [1.5]})])
    pulse, sensors = {"one.p": "8*exp(-((t - 0.05)/0.002)**2)"}, ["x:one.p", "v:one.p", "a:one.p"]
    record = lw.simulate(subject, forces=pulse, duration=0.5, rate=2000.0, sensors=sensors)
    force = SampledForce(record.channel("force:one.p"), record.step)
    run = MeasuredRun(np.zeros((1, len(record))), np.ones(1), (force,), record.step)
    for kind, row in zip("xva", run.motions(21.0, 0.02)[0], strict=True):
        shown = record.channel(f"{kind}:one.p")
        assert np.abs(1.5**2 * row - shown).max() < 1e-5 * np.abs(shown).max()  # a spline of the fifth order


def test_free_motions_satisfy_the_equation_of_the_mode() -> None:
    run = MeasuredRun(np.zeros((1, 400)), np.ones(1), (), 0.001)
    x, v, a = run.motions(5.0, 0.1).transpose(1, 0, 2)
    w = 2.0 * np.pi * 5.0
    residual = a + 0.2 * w * v + w**2 * x
    assert np.abs(residual).max() < 1e-12 * np.abs(a).max()


@pytest.mark.parametrize("pairs", [(), ((0, 1),)])
def test_the_derivatives_of_the_response_are_those_of_differences(pairs: tuple[tuple[int, int], ...]) -> None:
    measured = ModalMeasurement.of([tapped(release=0.02)], None)
    problem = _OutputError(measured, 2, pairs)
    rng = np.random.default_rng(2)
    residues, free = rng.standard_normal((2, 2, 1)), np.zeros((1, 2, 2), dtype=complex)
    start = PursuedModes(np.array([3.4, 20.0]), np.array([0.02, 0.01]), residues, free)
    theta = problem.start(start) + 0.1
    for channel, (rows, numbers) in enumerate(problem._jacobian(theta, 0)):
        for row, number in zip(rows, numbers, strict=True):
            step = np.zeros(len(theta))
            step[number] = 1e-5 * max(abs(theta[number]), 0.1)
            ahead, behind = (problem.response(theta + sign * step, 0)[channel] for sign in (1.0, -1.0))
            expected = (ahead - behind) / (2.0 * step[number])
            # central differences over steps of 1e-5; measured 2e-9
            assert np.abs(row - expected).max() < 1e-5 * max(np.abs(expected).max(), 1e-9)


def pursued(record: lw.Record) -> np.ndarray:
    return pursued_modes(ModalMeasurement.of([record]), None, silent).frequencies


def test_modes_of_a_linear_structure_are_found() -> None:
    # within a tenth of the half-power bandwidth
    assert pursued(tapped().with_noise(40.0, seed=11)) == pytest.approx(CANTILEVER, rel=0.2 * DAMPING)


@pytest.mark.slow
def test_no_modes_are_added_for_what_is_not_linear() -> None:
    """A cubic spring leaves 20 times the noise, which narrow modes beside the true ones would fit little by little."""
    frequencies = pursued(shaken(11, cubic=2e3).with_noise(60.0, seed=11))
    assert frequencies[1:] == pytest.approx(CANTILEVER[1:], rel=0.2 * DAMPING)  # the spring moves the first
    assert len(frequencies) == len(CANTILEVER)


@pytest.mark.slow
def test_no_modes_are_added_for_what_is_strong_in_a_band_alone() -> None:
    """As what a joint leaves at its resonance: narrow modes would each fit a few of its lines."""
    record, rng = shaken(12), np.random.default_rng(12)
    lines = np.fft.rfftfreq(len(record), record.step)
    spectrum = rng.standard_normal((2, len(lines), 2)) @ [1.0, 1.0j]
    noise = np.fft.irfft(np.where((lines > 9.0) & (lines < 13.0), spectrum, 0.0), len(record)).T
    shown = record.values[:, :2]
    noisy = shown + 0.3 * noise / noise.std(axis=0) * shown.std(axis=0)
    names = map(str, record.channels[:2])
    left = changed(record, **dict(zip(names, noisy.T, strict=True))).with_noise(60.0, seed=12)
    frequencies = pursued(left)
    assert len(frequencies) == len(CANTILEVER)
    assert frequencies == pytest.approx(CANTILEVER, rel=DAMPING)  # within the half-power bandwidth


def test_derivatives_of_what_is_left_are_those_of_differences() -> None:
    record = tapped().with_noise(30.0, seed=12)
    values = record.values.copy()
    values[100:130, 0] = np.nan
    measured = ModalMeasurement.of([lw.Record(record.start, record.rate, record.channels, values)])
    logs = np.log([[3.6, 0.012], [22.0, 0.009]])
    levels = np.array([0.3, 0.2])
    linear = Projection(measured, logs).equations(levels)
    step = 1e-5
    for number in range(4):
        change = np.zeros(4)
        change[number] = step
        moved = (logs + sign * change.reshape(2, 2) for sign in (1.0, -1.0))
        ahead, behind = (Projection(measured, each).cost(levels) for each in moved)
        # half the slope downwards; central differences of the second order
        expected = -(ahead - behind) / (4.0 * step)
        assert linear.slope[number] == pytest.approx(expected, rel=1e-5, abs=1e-6 * linear.cost)
