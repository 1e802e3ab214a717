"""Simulated links with memory against an independent integrator, their energy, and their channels."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from present import present
from rigs import BOUC_WEN, hysteretic
from scipy.integrate import solve_ivp
from structures import link, named, structure

import linkwise as lw
from linkwise.arrays import Floats
from linkwise.expression import Number, Program, substitute

END, RATE = 2.0, 100.0  # s, Hz: each law passes its kinks several times
VELOCITY = 0.5  # m/s at the start: dry friction has no solution at rest
DRIVE = "30*sin(7*t) + 12*sin(2.3*t)"
VALUES: dict[str, dict[str, float]] = {  # such that 30 N take each law through its nonlinear range
    "bouc-wen": {"k": 60.0, "c": 0.8, "F": 12.0, "x0": 0.05, "s": 0.7},
    "bouc-wen-baber-noori": {
        "k": 60.0, "c": 0.8, "F": 12.0, "x0": 0.05, "s": 0.7, "nu": 0.02, "eta": 0.01, "zs": 0.8, "p": 0.3, "q": 0.1,
        "psi": 0.3, "dpsi": 0.01, "lam": 0.4,
    },
    "backlash-slip": {"k": 60.0, "c": 0.8, "F": 12.0, "x0": 0.05, "g": 0.4},
    "band-brake": {"k": 60.0, "c": 0.8, "Fp": 12.0, "Fm": 14.0, "x0": 0.05, "g": 0.4, "b": 0.4, "w": 25.0, "h": 0.3},
    "lugre": {"s0": 300.0, "s1": 0.5, "s2": 1.0, "Fc": 10.0, "Fs": 14.0, "vs": 0.4},
    "iwan(3)": {"FS": 15.0, "KT": 300.0, "chi": -0.4, "beta": 0.7},
    "maxwell": {"k": 100.0, "c": 9.0},
    "fractional(3)": {"K": 5.0, "a": 0.4, "w": 0.3},
    "piezo": {"k": 60.0, "c": 0.8, "theta": 0.02, "C": 5e-5, "R": 4e3},
}  # fmt: skip
GROUND_SPRING = link("spring", "m1-ground", "k*d + c*v", k=40.0, c=0.5)


def beside_spring(name: str) -> lw.Structure:
    """1 kg on a spring of 40 N/m beside a link with a named law."""
    return structure({"m1": 1.0}, GROUND_SPRING, named("link", "m1-ground", name, **VALUES[name]), name=name)


def simulated(name: str) -> lw.Record:
    return lw.simulate(
        beside_spring(name), duration=END, rate=RATE, sensors=["x", "v", "state"], forces={"m1": DRIVE},
        release={"v:m1": VELOCITY},
    )  # fmt: skip


def reference(name: str) -> Floats:
    """Displacement, velocity and states (N, 2 + S) by SciPy's DOP853, whose steps shrink at the kinks of a law."""
    own = beside_spring(name).link("link")
    numbers = {key: Number(value) for key, value in own.values.items()}
    trees = [
        substitute(tree, numbers) for tree in (own.law.expression, *(r.expression for r in own.law.rates))
    ]
    program = Program(trees, ("d", "v", *own.law.states), wide=())  # of one state at a time

    def slope(t: float, y: Floats) -> list[float]:
        force, *rates = (float(value) for value in program(*y))
        driven = 30.0 * np.sin(7.0 * t) + 12.0 * np.sin(2.3 * t)
        return [y[1], driven - force - 40.0 * y[0] - 0.5 * y[1], *rates]

    grid = np.arange(round(END * RATE) + 1) / RATE
    start = np.array([0.0, VELOCITY, *(0.0 for _ in own.law.states)])
    run = solve_ivp(slope, (0.0, END), start, "DOP853", grid, rtol=1e-11, atol=1e-13, max_step=0.02)
    states: Floats = run.y.T
    return states


@pytest.mark.slow
@pytest.mark.parametrize("name", VALUES)
def test_named_laws_follow_an_independent_integrator(name: str) -> None:
    truth, states = present(simulated(name).simulated), reference(name)
    exact_states = np.column_stack([truth.displacement, truth.velocity, *truth.states.values()])
    largest = np.abs(states).max(axis=0)
    assert exact_states.shape == states.shape and np.all(largest > 0.0)
    assert np.all(np.abs(exact_states - states).max(axis=0) < 1e-8 * largest)
    # the balance of energy is an identity, to what quadratures of 1e-14 a step sum up to
    assert np.abs(truth.energy.residual).max() < 1e-9 * np.abs(truth.energy.work).max()


def test_work_on_a_hysteretic_link_is_the_area_of_its_loops() -> None:
    sampling: dict[str, Any] = {"duration": END, "rate": 2000.0, "sensors": ["x", "f:link"]}
    record = lw.simulate(beside_spring("bouc-wen"), forces={"m1": DRIVE}, **sampling)
    truth = present(record.simulated)
    force, x = record.channel("f:link"), record.channel("x:m1")
    area = np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(x))  # trapezoids of 0.5 ms: order 2
    assert truth.energy.work[-1, 1] == pytest.approx(area, rel=1e-5)


def test_channels_of_links_are_simulated_and_read_in_their_units(tmp_path: Path) -> None:
    sampling: dict[str, Any] = {"duration": 1.0, "rate": RATE, "sensors": ["x", "f", "state"]}
    record = lw.simulate(beside_spring("piezo"), forces={"m1": DRIVE}, **sampling)
    assert record.channels == ("x:m1", "f:spring", "f:link", "state:link.V", "force:m1")
    assert record.masses == ("m1",) and record.inputs == ("force:m1",)
    rows = (f"{k / 100},{k % 7},{k * k}" for k in range(40))
    (tmp_path / "run.csv").write_text("\n".join(["time,x:m1[mm],state:piezo.V[mV]", *rows]))
    read = lw.read_record(tmp_path / "run.csv")
    np.testing.assert_allclose(read.channel("state:piezo.V"), 1e-3 * np.arange(40) ** 2, rtol=1e-15)


def test_the_release_of_a_state_takes_the_place_of_its_initial_value() -> None:
    structure = beside_spring("maxwell")
    start = {"state:link.q": 2.0}
    released = lw.simulate(structure, duration=1.0, rate=RATE, sensors=["state:link.q"], release=start)
    assert released.channel("state:link.q")[0] == 2.0
    for release, message in (
        ({"state:link.w": 1.0}, "unknown state 'link.w'"),
        ({"f:link": 1.0}, "unknown release"),
    ):
        with pytest.raises(lw.SimulationError, match=message):
            lw.simulate(structure, duration=1.0, rate=RATE, release=release)
    for sensor, message in (("f:lnk", "unknown link 'lnk'"), ("state:link", "written state:LINK.NAME")):
        with pytest.raises(lw.SimulationError, match=message):
            lw.simulate(structure, duration=1.0, rate=RATE, sensors=[sensor])


@pytest.mark.parametrize("base", ["0", "0*t"])
def test_a_link_with_memory_on_a_base_at_rest_has_no_force(base: str) -> None:
    """Its kinks never move, so that there is nothing to detect."""
    rig = structure({}, named("damper", "base-ground", "bouc-wen", k=500.0, c=1.0, F=5.0, x0=5e-3, s=0.6))
    record = lw.simulate(rig, base=base, duration=0.1, rate=100.0, sensors=["f:damper"])
    np.testing.assert_array_equal(record.values, 0.0)


@pytest.mark.slow
@pytest.mark.parametrize(("power", "band_limited"), [(1, True), (3, False)])
def test_a_hysteretic_link_leaves_its_rest(power: int, band_limited: bool) -> None:
    """The base rests, but for what a spline swings before a bend; then hysteresis follows as by `solve_ivp`."""
    rate, rest = 200.0, 0.2
    time = np.arange(161) / rate
    moved = np.where(time < rest, 0.0, 0.01 * np.sin(6.0 * (time - rest)) ** power)
    base = lw.model.Sampled(0.0, rate, moved, band_limited=band_limited)
    record = lw.simulate(hysteretic(), base=base, duration=0.8, rate=rate)
    law = BOUC_WEN

    def rate_of_z(t: float, z: np.ndarray) -> np.ndarray:
        v, s = base.derivative(np.array([t]))[0], law["s"]
        return np.asarray((v - s * abs(v) * z - (1.0 - s) * v * np.abs(z)) / law["x0"])

    solved = solve_ivp(rate_of_z, (0.0, 0.8), [0.0], t_eval=time, max_step=0.1 / rate, rtol=1e-10, atol=1e-12)
    force = law["k"] * base.value(time) + law["c"] * base.derivative(time) + law["F"] * solved.y[0]
    # the base moves towards the ground: force on its first end, the base; the tolerance is that of dense output
    assert record.channel("f:damper") == pytest.approx(force, abs=1e-6 * law["F"])
