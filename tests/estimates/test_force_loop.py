"""Loops of force over elongation and rate, and the energy that a cycle dissipates."""

import numpy as np
import pytest
from problems import chain_record
from rigs import BOUC_WEN, hysteretic, measured, rig, run
from structures import hysteretic_oscillator

import linkwise as lw
from linkwise.estimates.curves import force_loop, has_loop
from linkwise.plot.links import loop_figure


@pytest.fixture(scope="module")
def damped() -> lw.Estimate:
    structure = rig("k*d + c*v", {"k": 2000.0, "c": 50.0})
    record = lw.simulate(structure, duration=10.0, rate=200.0, base="0.01*sin(5*t)")
    return lw.identify(measured(record, 1), structure.unknown("damper"))


def test_a_viscous_damper_dissipates_pi_c_omega_squared_amplitude_a_cycle(damped: lw.Estimate) -> None:
    loop = force_loop(damped, "damper")
    assert loop.cycles == 6  # of 10 s at 5 rad/s, from the first rise through 0 that was seen from below
    c = damped.coefficient("damper.c").value
    assert loop.energy == pytest.approx(np.pi * c * 5.0 * 0.01**2, rel=0.01)  # cycles end at samples, of 251
    assert "energy dissipated a cycle" in loop.energy_text


def test_a_record_without_a_cycle_gives_the_work_of_all_of_it() -> None:
    structure = rig("k*d + c*v", {"k": 2000.0, "c": 50.0})
    record = lw.simulate(structure, duration=1.0, rate=200.0, base="0.01*t")
    fit = lw.identify(measured(record, 1), structure.unknown("damper"))
    loop = force_loop(fit, "damper")
    assert loop.cycles == 0 and "over the record" in loop.energy_text
    work = np.array([0.5 * 0.01**2, 0.01**2])  # J by k and c, of 10 mm in a second
    # four standard errors of what k and c make of it, 6e-5 of chance, and the last of 200 samples
    error = np.sqrt(work @ fit.covariance @ work)
    assert loop.energy == pytest.approx(work @ [2000.0, 50.0], abs=4.0 * error, rel=2.0 / 200)


@pytest.mark.slow
def test_the_loop_of_a_link_with_memory_has_its_states() -> None:
    exact = run(hysteretic(), duration=4.0)
    fit = lw.identify(measured(exact, 1), hysteretic().unknown("damper"))
    loop = force_loop(fit, "damper")
    assert loop.measured is not None
    error = loop.identified - exact.channel("f:damper")
    assert np.sqrt(np.mean(error**2)) < 0.5  # of forces of 90 N; the noise is 1 N


@pytest.mark.slow
def test_a_link_with_memory_between_masses_has_a_loop_with_its_states() -> None:
    structure = hysteretic_oscillator(**BOUC_WEN)
    forces = {"m1": "150*sin(40*t) + 60*sin(97*t)"}
    exact = lw.simulate(structure, duration=1.0, rate=500.0, sensors=["x", "f"], forces=forces)
    record = exact.select(["x:m1", "force:m1"]).with_noise(50.0, seed=1)
    fit = lw.identify(record, structure.unknown("joint.F"))
    loop = force_loop(fit, "joint")
    assert loop.measured is None and has_loop(fit, "joint")
    force = exact.channel("f:joint")
    # noise of 0.3 % moves the orbit
    assert np.sqrt(np.mean((loop.identified - force) ** 2)) < 0.05 * np.std(force)
    record = chain_record(2, duration=1.0, rate=500.0).with_noise(40.0, seed=1)
    fit = lw.identify(record, lw.bnes_chain(2).unknown("nes"), method="weak")
    assert not has_loop(fit, "nes1")


def test_the_figure_draws_what_was_measured_and_identified(damped: lw.Estimate) -> None:
    panels = loop_figure(damped, "damper").axes
    assert [panel.get_xlabel() for panel in panels] == ["elongation d, mm", "rate v, mm/s"]
    for panel in panels:
        assert [line.get_label() for line in panel.get_lines()] == ["measured", "identified"]
    with pytest.raises(lw.StructureError, match='a loop is drawn over "d" or "v", got "a"'):
        lw.plot.loop(damped, "damper", over="a")
