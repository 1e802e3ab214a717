"""Motions of single modes against simulations and their own equation."""

import numpy as np
from structures import host, structure

import linkwise as lw
from linkwise.modal.oscillators import SampledForce, free_motion, free_motion_derivatives


def test_motion_of_a_mode_is_that_of_a_simulation() -> None:
    subject = structure({}, hosts=[host("one", [21.0], 0.02, {"p": [1.5]})])
    pulse, sensors = {"one.p": "8*exp(-((t - 0.05)/0.002)**2)"}, ["x:one.p", "v:one.p", "a:one.p"]
    record = lw.simulate(subject, forces=pulse, duration=0.5, rate=2000.0, sensors=sensors)
    motion = SampledForce(record.channel("force:one.p"), record.step).motion(21.0, 0.02)
    for kind, row in zip("xva", motion, strict=True):
        shown = record.channel(f"{kind}:one.p")
        assert np.abs(1.5**2 * row - shown).max() < 1e-5 * np.abs(shown).max()  # a spline of the fifth order


def test_free_motions_satisfy_the_equation_of_the_mode() -> None:
    x, v, a = free_motion(5.0, 0.1, 0.001, 400).transpose(1, 0, 2)
    w = 2.0 * np.pi * 5.0
    residual = a + 0.2 * w * v + w**2 * x
    assert np.abs(residual).max() < 1e-12 * np.abs(a).max()


def test_derivatives_by_frequency_and_damping_are_those_of_differences() -> None:
    force = SampledForce(np.random.default_rng(1).standard_normal(400), 0.002)
    step = 1e-5
    for motion, derivatives in (
        (force.motion, force.derivatives(21.0, 0.02)),
        (lambda f, z: free_motion(f, z, 0.002, 400), free_motion_derivatives(21.0, 0.02, 0.002, 400)),
    ):
        for number, (df, dz) in enumerate(((step, 0.0), (0.0, step))):
            ahead, behind = (motion(21.0 * np.exp(s * df), 0.02 * np.exp(s * dz)) for s in (1.0, -1.0))
            expected = (ahead - behind) / (2.0 * step)
            # central differences: of the second order in a step of 1e-5 of 100 radians
            assert np.abs(derivatives[number] - expected).max() < 1e-5 * np.abs(expected).max()
