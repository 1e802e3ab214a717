"""Harmonic forces that were not recorded: named by their lines, found with the laws, taken into the model."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from record_faults import changed
from structures import link, oscillator, structure

import linkwise as lw
from linkwise.estimates.estimate import Estimate

pytestmark = pytest.mark.slow


RATE, DURATION = 200.0, 10.0
LAW = {"k": 1000.0, "c": 2.0, "k3": 2e5}
OSCILLATOR = oscillator("k*d + c*v + k3*d**3", name="spring", k=1000.0, c=2.0, k3=2e5)
PAIR = structure(
    {"m1": 1.0, "m2": 0.5},
    link("spring", "m1-ground", "k*d + c*v + k3*d**3", **LAW),
    link("top", "m2-m1", "k*d + c*v", k=700.0, c=1.0),
)


def machine(
    subject: lw.Structure,
    hz: float,
    *,
    on: str = "m1",
    size: float = 1.5,
    wind: float = 0.0,
    seed: int = 1,
    duration: float = DURATION,
) -> lw.Record:
    """Displacements at 40 dB under a machine on a mass, beside a ring-down or `wind` in N/sqrt(Hz); no force is recorded."""
    rng = np.random.default_rng(seed)
    fine = 4.0 * RATE
    time = np.arange(round(fine * duration) + 1) / fine
    acting = {
        name: wind * np.sqrt(0.5 * fine) * rng.normal(size=len(time))
        + (name == on) * size * np.cos(2.0 * np.pi * hz * time + 0.7)
        for name in subject.mass_names
    }
    forces = {name: lw.model.Sampled(0.0, fine, values, order=1) for name, values in acting.items()}
    release = {} if wind else {"x:m1": 0.03}
    clean = lw.simulate(subject, forces=forces, release=release, duration=duration, rate=RATE)
    names = tuple(name for name in clean.channels if name.startswith("x:"))
    values = np.stack([clean.channel(name) for name in names], axis=1)
    return lw.Record(0.0, RATE, names, values).with_noise(40.0, seed=seed)


def assert_right(fit: Estimate, subject: lw.Structure, line: tuple[str, float]) -> None:
    """Whether an answer is trusted, and its coefficients and the frequency on a mass are within 4.5 standard errors."""
    assert fit.trusted
    for parameter in subject.unknown("all").parameters:
        found = fit.coefficient(parameter.name)
        owner, _, key = str(parameter.name).rpartition(".")
        value = subject.link(owner).coefficients[key].value
        assert abs(found.value - (value or 0.0)) < 4.5 * (found.standard_error or 0.0)
    forces = [error for error in fit.sensor_errors if error.kind == "harmonic force"]
    assert [force.channel for force in forces] == [line[0]]
    assert abs(forces[0].value - line[1]) < 4.5 * forces[0].standard_error < 0.01


@pytest.mark.parametrize(
    ("subject", "mass", "hz", "options"),
    [
        (PAIR, "m2", 4.0, {}),
        (
            OSCILLATOR,
            "m1",
            5.1,
            {"size": 0.1, "duration": 5.0},
        ),  # near resonance, of which laws leave no line
        (OSCILLATOR, "m1", 6.0, {"wind": 0.2}),
    ],
)
def test_an_unseen_machine_is_named(
    subject: lw.Structure, mass: str, hz: float, options: dict[str, Any]
) -> None:
    record = machine(subject, hz, on=mass, **options)
    ambient = ["all"] if "wind" in options else []
    fit = lw.identify(record, subject.unknown("all"), ambient=ambient, as_stated=True)
    named = next(cause for cause in fit.diagnosis if cause.kind == "harmonic force")
    assert not fit.trusted and (named.where, named.unit) == (mass, "Hz")
    assert abs(named.size - hz) < 0.5 / DURATION
    assert named.description.endswith(f"that was not recorded; try --harmonic {mass}={named.size:.4g}Hz")


@pytest.mark.parametrize(
    ("subject", "mass", "hz", "options"),
    [(OSCILLATOR, "m1", 7.3, {}), (OSCILLATOR, "m1", 6.0, {"wind": 0.2})],
)
def test_a_harmonic_force_is_found(
    subject: lw.Structure, mass: str, hz: float, options: dict[str, Any]
) -> None:
    record = machine(subject, hz, on=mass, **options)
    fit = lw.identify(
        record, subject.unknown("all"), ambient=["all"] if options else [], harmonics={mass: hz + 0.03}
    )
    assert_right(fit, subject, (mass, hz))
    assert any(f"The harmonic force on {mass} at " in line and " N " in line for line in fit.findings)


def test_a_harmonic_moment_is_in_newton_metres() -> None:
    record = machine(OSCILLATOR, 7.3)
    turning = replace(record, units={"x:m1": "rad"})
    body = lw.rig({"m1": "1 kg m^2"}, {"spring": "m1 - ground: k*d + c*v + k3*d**3"})
    named = next(cause for cause in lw.identify(turning, body, as_stated=True).diagnosis if cause.source)
    assert named.kind == "harmonic force" and " N m) that was not" in named.description
    fit = lw.identify(turning, body, harmonics={"m1": 7.3})
    assert any("The harmonic force on m1 at " in line and " N m " in line for line in fit.findings)


@pytest.mark.parametrize(("subject", "hz"), [(OSCILLATOR, 12.3), (PAIR, 7.3)])
def test_a_hum_of_a_sensor_is_no_harmonic_force(subject: lw.Structure, hz: float) -> None:
    """Compared with the motion held, it explained less than a force did, beside which the motion follows."""
    quiet = machine(subject, hz, size=0.0)
    hum = 4e-4 * np.sin(2.0 * np.pi * hz * quiet.time + 0.3)
    shaken = changed(quiet, **{str(quiet.channels[-1]): lambda x: x + hum})
    fit = lw.identify(shaken, subject.unknown("all"), as_stated=True)
    assert not fit.trusted and "harmonic force" not in [cause.kind for cause in fit.diagnosis]


def test_a_harmonic_force_is_taken_into_the_model() -> None:
    fit = lw.identify(machine(PAIR, 4.0, on="m2", seed=2), PAIR.unknown("all"))
    assert_right(fit, PAIR, ("m2", 4.0))
    assert [(cause.kind, cause.where) for cause in fit.added] == [("harmonic force", "m2")]


@pytest.mark.usefixtures("memory_not_sought")
def test_discover_allows_for_a_harmonic_force() -> None:
    record = machine(OSCILLATOR, 7.3, seed=3, duration=5.0)
    found = lw.discover(record, {"m1": 1.0}, harmonics={"m1": 7.3})
    assert found.trusted and [one.law.text for one in found.structure.links] == ["k*d + k3*d**3 + c*v"]


def test_a_motion_that_goes_on_without_a_force_is_told() -> None:
    """A hardly damped ring-down goes on as under a force that was not recorded; one with 1 % of damping does not."""
    for damping, told in ((0.01, True), (0.6, False)):
        subject = oscillator("k*d + c*v", name="spring", k=1000.0, c=damping)
        record = lw.simulate(subject, release={"x:m1": 0.02}, duration=10.0, rate=100.0).with_noise(
            40.0, seed=5
        )
        fit = lw.identify(record, subject.unknown("all"))
        assert ("does not decay over 50 periods, though no force was recorded" in fit.message) is told


def with_absorber(
    mass: float,
    k: float,
    c: float,
    absorber: tuple[float, float, float],
    *,
    speed: float,
    snr_db: float,
    seed: int,
) -> Estimate:
    """The answer for a mass on the ground in a decay, where an absorber of mass, stiffness and damping is not in the laws."""
    spring = link("spring", "m1-ground", "k*d + c*v", k=k, c=c)
    leaf = link("leaf", "absorber-m1", "k*d + c*v", k=absorber[1], c=absorber[2])
    hidden = structure({"m1": mass, "absorber": absorber[0]}, spring, leaf)
    record = lw.simulate(hidden, release={"v:m1": speed}, duration=2.4, rate=500.0, sensors=["x:m1"])
    shown = replace(record.with_noise(snr_db, seed=seed), simulated=None)
    return lw.identify(shown, structure({"m1": mass}, spring).unknown("all"))


@pytest.mark.parametrize(("absorber", "seed"), [((0.03, 1500.0, 0.1), 500), ((0.02, 1000.0, 0.05), 501)])
def test_a_mode_that_fades_is_no_force_that_goes_on(absorber: tuple[float, float, float], seed: int) -> None:
    """What the laws lack in a decay was taken in as a hum, trusted, with k 900 errors off."""
    fit = with_absorber(0.8, 5000.0, 3.0, absorber, speed=0.6, snr_db=35.0, seed=seed)
    assert not fit.trusted and not fit.added


@pytest.mark.parametrize("snr_db", [25.0, 30.0])
def test_a_line_that_may_fade_as_a_mode_does_is_a_second_answer(snr_db: float) -> None:
    """An absorber with 0.1 % of damping sounded through the record: taken in as a line, trusted, with k 400 errors off.

    Of a single mass a force and a hum explain as much, of which rounding may choose either.
    """
    fit = with_absorber(0.57, 1120.0, 0.56, (0.017, 236.0, 0.0036), speed=0.5, snr_db=snr_db, seed=500)
    assert fit.grade is lw.verdict.Grade.APPROXIMATE and not fit.added and fit.alternative is not None
    [line] = fit.alternative.added
    assert fit.alternative.may_fade == (line.size,)
    option = {"harmonic force": "--harmonic m1", "hum": "--sensor x:m1:hum"}[line.kind]
    title, options, _ = fit.second_answer
    assert "or a mode that the laws lack" in title and "or add a mass) only noise is left" in title
    assert options == [f"{option}={line.size:.6g}Hz"]


@pytest.mark.parametrize("hz", [7.14, 6.88])
def test_what_a_wrong_law_leaves_at_a_tone_of_the_base_is_no_force(hz: float) -> None:
    """A mount that relaxes, stated without: near a harmonic force in all that the record shows, and values far off."""
    law, values = "k*d + k3*d**3 + c*v", {"k": 900.0, "k3": 2e6, "c": 2.0}
    mount = structure(
        {"m1": 1.0, "h": 1e-3},
        link("mount", "m1-base", law, **values),
        link("spring", "m1-h", "k*d", k=300.0),
        link("dashpot", "h-base", "c*v", c=8.0),
    )
    moved = f"0.003*sin({2.0 * np.pi * hz:.5f}*t)"
    clean = lw.simulate(mount, base=moved, duration=4.0, rate=400.0).select(["x:m1", "x:base"])
    rng = np.random.default_rng(1140128)
    noise = 0.02 * clean["x:m1"].std() * rng.normal(size=len(clean))
    record = changed(clean, x_m1=lambda samples: samples + noise)
    stated = structure({"m1": 1.0}, link("mount", "m1-base", law))
    fit = lw.identify(record, stated, starts={f"mount.{name}": value for name, value in values.items()})
    assert not fit.trusted
    assert fit.alternative is None or not fit.alternative.trusted
    assert "harmonic force" not in {cause.kind for cause in (*fit.added, *fit.diagnosis[:1])}
