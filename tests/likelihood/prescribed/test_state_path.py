"""States along a motion that is known: against the integrator of simulations, and their derivatives by differences."""

from __future__ import annotations

import numpy as np
import pytest
from rigs import BOUC_WEN, MOTION, hysteretic, rig

import linkwise as lw
from linkwise.likelihood.prescribed.motion import PrescribedMotion
from linkwise.likelihood.prescribed.state_path import LinkPath
from linkwise.signals.smooth import smoothing_spline

T = 2.0
TWO = lw.Law.parse("k*d + F*z + q", {"z": "(v - s*abs(v)*z - (1 - s)*v*abs(z))/x0", "q": "k1*(v - q/c1)"})
VALUES = {**BOUC_WEN, "k1": 3000.0, "c1": 200.0}


def motion(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    signal = 0.01 * np.sin(5 * time) * np.sin(0.7 * time) + 0.003 * np.sin(17 * time)
    rate = (
        0.05 * np.cos(5 * time) * np.sin(0.7 * time)
        + 0.007 * np.sin(5 * time) * np.cos(0.7 * time)
        + 0.051 * np.cos(17 * time)
    )
    return signal, rate


def path(law: lw.Law, steps: int, *, initial: tuple[float, ...], **change: float) -> LinkPath:
    time = np.linspace(0.0, T, steps + 1)
    return LinkPath.of(law, {**VALUES, **change}, *motion(time), T / steps, np.array(initial))


def test_states_converge_to_those_of_a_simulation_with_the_square_of_the_step() -> None:
    record = lw.simulate(hysteretic(), duration=T, rate=100.0, sensors=["state"], base=MOTION)
    assert record.simulated is not None
    exact = record.simulated.states["damper.z"]
    errors = []
    for substeps in (4, 8, 16):
        link_path = path(hysteretic().link("damper").law, 200 * substeps, initial=(0.0,))
        assert link_path.converged
        errors.append(np.abs(link_path.states[::substeps, 0] - exact).max())
    order = np.log2(errors[0] / errors[-1]) / 2.0
    assert order == pytest.approx(2.0, abs=0.3)  # kinks of abs lie anywhere between nodes
    assert errors[-1] < 1e-3  # of 1: a step of 0.6 ms at 50 mm/s is 3 % of x0, and its square 1e-3


@pytest.mark.parametrize("law", [TWO, hysteretic().link("damper").law], ids=["two states", "one"])
def test_derivatives_by_unknowns_are_those_of_differences(law: lw.Law) -> None:
    start = (0.1, 2.0)[: len(law.states)]
    at = path(law, 400, initial=start)
    slopes = at.tangents(law.coefficients).by_unknowns()
    for column, name in enumerate(law.coefficients):
        step = 1e-6 * VALUES[name]
        above, below = (path(law, 400, initial=start, **{name: VALUES[name] + s}) for s in (step, -step))
        by_difference = (above.force() - below.force()) / (2.0 * step)
        size = np.abs(by_difference).max()
        np.testing.assert_allclose(slopes[:, column], by_difference, atol=1e-5 * size)  # of the differences
    for state in range(len(law.states)):
        moved = [np.array(start), np.array(start)]
        moved[0][state] += 1e-6
        moved[1][state] -= 1e-6
        above, below = (path(law, 400, initial=tuple(values)) for values in moved)
        by_difference = (above.force() - below.force()) / 2e-6
        column = len(law.coefficients) + state
        np.testing.assert_allclose(slopes[:, column], by_difference, atol=1e-4)


def test_the_transposed_equations_agree_with_the_direct_ones() -> None:
    rng = np.random.default_rng(3)
    tangents = path(TWO, 400, initial=(0.1, 2.0)).tangents(TWO.coefficients)
    weights, changes = rng.standard_normal((401, 3)), rng.standard_normal((2, 401, 2))
    forward = weights.T @ tangents.by_motion(*changes)
    by_d, by_v = tangents.to_motion(weights)
    np.testing.assert_allclose(by_d.T @ changes[0] + by_v.T @ changes[1], forward, rtol=1e-9)


def test_noise_of_samples_reaches_the_motion_as_the_spline_passes_it() -> None:
    rng = np.random.default_rng(5)
    samples = np.sin(np.arange(120) / 7.0) + 0.01 * rng.standard_normal(120)
    spline = smoothing_spline(samples, 50.0)
    moved = PrescribedMotion.of(spline, 3, 1.0)
    weights = rng.standard_normal((2, len(moved.d), 2))
    noise = moved.noise_of(*weights)
    step = np.zeros(120)
    step[40] = 1.0
    changed = PrescribedMotion.of(
        smoothing_spline(samples + step, 50.0, smoothing=float(spline.smoothing[0])), 3, 1.0
    )
    change = weights[0].T @ (changed.d - moved.d) + weights[1].T @ (changed.v - moved.v)
    np.testing.assert_allclose(noise[40], change, rtol=1e-7)


def test_nodes_between_samples_lie_on_the_spline() -> None:
    time = np.arange(300) / 50.0
    moved = PrescribedMotion.of(smoothing_spline(np.sin(3.0 * time), 50.0), 4, 0.0)
    nodes = np.arange(len(moved.d)) * moved.step
    inside = slice(40, -40)  # ends of the spline are less accurate
    np.testing.assert_allclose(moved.d[inside], np.sin(3.0 * nodes)[inside], atol=1e-6)
    np.testing.assert_allclose(moved.v[inside], 3.0 * np.cos(3.0 * nodes)[inside], atol=1e-4)


def test_a_state_that_runs_away_is_told() -> None:
    law = lw.Law.parse("k*d + F*z", {"z": "v/x0 + z*z*abs(v)/x0"})
    link = rig("k*d", {"k": 1.0}).link("damper")
    assert link.law.states == ()
    assert not path(law, 200, initial=(50.0,)).converged
