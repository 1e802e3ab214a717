"""Simulated links with memory and with signals against an independent integrator, their energy, and their channels."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import said
from present import present, some
from rigs import BOUC_WEN, hysteretic
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline
from structures import NES, bodies, host, link, named, structure

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


VALVE = lw.rig(
    {"m1": 1.0},
    {"damper": "m1 - ground: k*d + (c0 + cu*u)*v"},
    {"damper.k": 400.0, "damper.c0": 0.5, "damper.cu": 2.0},
    signals={"u": "V"},
)
RUN: dict[str, Any] = {"release": {"x:m1": 0.1}, "duration": 1.0, "rate": 500.0}
SAMPLED = lw.model.Sampled(0.0, 500.0, np.sin(3.0 * np.arange(501) / 500.0))


def test_a_signal_drives_the_law_and_is_recorded() -> None:
    record = lw.simulate(VALVE, **RUN, signals={"u": "0.5 + 0.5*sin(3*t)"}, sensors=["x", "v", "a", "f"])
    assert record.inputs == ("signal:u",)
    assert record.unit("signal:u") == "V"
    x, v, a, f, u = record.values.T
    np.testing.assert_allclose(u, 0.5 + 0.5 * np.sin(3.0 * record.time), rtol=1e-12)
    np.testing.assert_allclose(f, 400.0 * x + (0.5 + 2.0 * u) * v, rtol=1e-12)
    np.testing.assert_allclose(a, -f, rtol=1e-12)
    assert record.simulated is not None
    energy = record.simulated.energy
    np.testing.assert_allclose(energy.residual, 0.0, atol=1e-12 * energy.supplied[0])


def test_a_constant_signal_is_a_coefficient() -> None:
    stated = lw.rig({"m1": 1.0}, {"damper": "m1 - ground: k*d + c*v"}, {"damper.k": 400.0, "damper.c": 3.5})
    driven = lw.simulate(VALVE, **RUN, signals={"u": 1.5})
    np.testing.assert_allclose(driven.channel("x:m1"), lw.simulate(stated, **RUN).channel("x:m1"), atol=1e-13)


def test_states_follow_a_signal() -> None:
    link = lw.Link(
        "coil",
        ("m1", "ground"),
        lw.Law.parse("k*d - Bl*i", {"i": "(u - R*i - Bl*v)/L"}, signals={"u": "V"}),
        {"k": 400.0, "Bl": 5.0, "R": 4.0, "L": 0.05},
    )
    speaker = lw.Structure("speaker", (lw.Mass("m1", 0.5),), (link,))
    record = lw.simulate(
        speaker, duration=1.0, rate=500.0, signals={"u": SAMPLED}, sensors=["v", "state:coil.i"]
    )
    v, i, u = record.values.T
    slope = make_interp_spline(record.time, i, 7).derivative()(record.time)[20:-20]
    rate = ((u - 4.0 * i - 5.0 * v) / 0.05)[20:-20]
    # of the spline's order
    np.testing.assert_allclose(slope, rate, atol=2.0 * (80.0 / 500.0) ** 7 * abs(slope).max())


def test_signals_that_are_missing_or_of_no_law_are_named() -> None:
    with pytest.raises(lw.SimulationError, match="a law names the signal u, whose course is not given"):
        lw.simulate(VALVE, **RUN)
    with pytest.raises(lw.SimulationError, match="unknown signal 'w' in an excitation; the signals are u"):
        lw.simulate(VALVE, **RUN, signals={"u": 1.0, "w": 1.0})
    with pytest.raises(lw.SimulationError, match="signal:u is sampled from 0 to 1 s"):
        lw.simulate(VALVE, duration=2.0, rate=500.0, signals={"u": SAMPLED})


def test_responses_take_no_signal() -> None:
    with pytest.raises(lw.StructureError, match=r"a signal \(u\), which is not supported in responses"):
        lw.respond(VALVE, hz=(1.0, 5.0), force={"m1": 1.0})


@pytest.mark.parametrize("suffix", ["csv", "h5", "mat"])
def test_commands_and_files_keep_signals(
    suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    lw.write_structure(VALVE, "valve.toml")
    line = "simulate valve.toml --duration 1 --rate 100 --release x:m1=0.1 --signal"
    said(f"{line} u=2*sin(3*t) -o run.{suffix}")
    record = lw.read_record(f"run.{suffix}")
    # MAT files have units of channels nowhere
    assert record.unit("signal:u") == ("?" if suffix == "mat" else "V")
    said(f"{line} u=run.{suffix} -o again.csv")
    np.testing.assert_allclose(lw.read_record("again.csv").values, record.values, atol=1e-5)


def test_a_signal_is_read_in_its_unit(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("time,laser,valve\n" + "".join(f"{0.01 * n},{n % 3},{n}\n" for n in range(40)))
    record = lw.read_record(
        path, channels={"x:m1[mm]": "laser", "signal:u[mV]": "valve"}, known_masses=["m1"]
    )
    assert record.unit("signal:u") == "V"
    np.testing.assert_allclose(record.channel("signal:u"), 1e-3 * np.arange(40), rtol=1e-12)
    with pytest.raises(lw.RecordError, match="'degC' is not a unit of signal of a law"):
        lw.read_record(path, channels={"x:m1": "laser", "signal:u[degC]": "valve"})


@cache
def two_masses() -> lw.Structure:
    """Two masses on springs, undamped, so that real modes take them apart."""
    springs = link("root", "a-ground", "k*d", k=3e4), link("between", "b-a", "k*d", k=2e4)
    return structure({"a": 1.0, "b": 0.5}, *springs)


def with_sink(subject: lw.Structure, end: str) -> lw.Structure:
    """A structure with a bistable sink at one of its places."""
    sink = link("nes", f"sink-{end}", NES, alpha=-100.0, beta=1e6, c=0.02)
    masses = (*subject.masses, *bodies({"sink": 0.01}))
    return replace(subject, masses=masses, links=(*subject.links, sink))


@cache
def as_host() -> lw.Structure:
    """The same two masses by their modes."""
    modes = lw.analysis.modes(two_masses())
    shapes = modes.shapes / np.sqrt(np.einsum("ir,i,ir->r", modes.shapes, [1.0, 0.5], modes.shapes))
    by_point = {"a": shapes[0].tolist(), "b": shapes[1].tolist()}
    return structure({}, hosts=[host("beam", modes.frequencies.tolist(), 0.0, by_point)])


def test_a_host_by_its_modes_moves_as_its_masses_do() -> None:
    """Displacements, accelerations and forces agree with those of the masses to the accuracy of two integrations."""
    masses, host = (
        lw.simulate(
            structure,
            forces={f"{prefix}a": "20*sin(60*t)"},
            impulses=[lw.model.Impulse(f"{prefix}b", 0.05)],
            sensors=["x", "a", "f:nes"],
            duration=0.5,
            rate=1000.0,
        )
        for structure, prefix in (
            (with_sink(two_masses(), "b"), ""),
            (with_sink(as_host(), "beam.b"), "beam."),
        )
    )
    assert host.channels[:3] == ("x:beam.a", "x:beam.b", "x:sink")
    for column, name in some(enumerate(masses.channels)):
        size = np.abs(masses.values[:, column]).max()
        # half a second of chaotic motion amplifies 1e-16 by less than 1e8
        assert np.abs(host.values[:, column] - masses.values[:, column]).max() < 1e-8 * size, name


def test_energy_of_a_host_balances_and_what_it_lacks_is_told() -> None:
    subject = with_sink(as_host(), "beam.b")
    record = lw.simulate(subject, forces={"beam.a": "20*sin(60*t)"}, duration=2.0, rate=500.0)
    energy = present(record.simulated).energy
    assert np.abs(energy.residual).max() < 1e-12 * np.abs(energy.supplied).max()
    with pytest.raises(lw.SimulationError, match=r"release these, such as x:beam\.mode1"):
        lw.simulate(subject, release={"x:beam.a": 0.1}, duration=1.0, rate=100.0)
    blow = [lw.model.Impulse("beam.c", 1.0)]
    with pytest.raises(lw.SimulationError, match=r"the masses and points are beam\.a, beam\.b, sink"):
        lw.simulate(subject, impulses=blow, duration=1.0, rate=100.0)
