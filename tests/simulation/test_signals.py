"""Simulated signals, hosts, and branches of laws with kinks where a piece of an input begins."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import said
from present import present, some
from scipy.interpolate import make_interp_spline
from structures import NES, bodies, host, link, structure

import linkwise as lw

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
