"""Weak equations on motions that are known exactly, and the records that cannot have them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from present import present
from problems import chain_record
from structures import oscillator

import linkwise as lw
from linkwise.weak.displacements import read_displacements
from linkwise.weak.equations import WeakEquations, weak_equations, weak_residual
from linkwise.weak.window import Window

RATE, SAMPLES = 1000.0, 1200


def equations(record: lw.Record, structure: lw.Structure, window: Window | None = None) -> WeakEquations:
    return weak_equations(record, structure, read_displacements(record, structure), window=window)


def two_tones(time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A motion with its first two derivatives."""
    x = 0.01 * np.sin(40 * time) + 0.006 * np.cos(77 * time)
    v = 0.4 * np.cos(40 * time) - 0.462 * np.sin(77 * time)
    a = -16 * np.sin(40 * time) - 35.574 * np.cos(77 * time)
    return x, v, a


@pytest.mark.parametrize(
    ("law", "values"),
    [
        ("k*d + c*v", {"k": 900.0, "c": 3.0}),
        (
            "k*d + k2*d**2 + k3*d**3 + c3*v*d**2 + f0",
            {"k": 900.0, "k2": 4e3, "k3": 2e6, "c3": 5e3, "f0": -0.7},
        ),
        ("k*sin(d/a)", {"k": 9.0, "a": 0.02}),
        ("k*d + c*v*abs(v)", {"k": 900.0, "c": 2.0}),
        ("F*tanh(v/s)", {"F": 2.0, "s": 0.3}),
    ],
)
def test_the_force_that_makes_a_motion_leaves_nothing(law: str, values: dict[str, Any]) -> None:
    """w = 2 x'' + f(x, x') on a motion of two tones: the weak equation is an identity, to the alias of phi (1e-6 of the
    forces); where v is not integrated by parts to the smoothing of v (1e-5).
    """
    structure = oscillator(law, mass=2.0, name="spring", **values)
    time = np.arange(SAMPLES) / RATE
    x, v, a = two_tones(time)
    force = 2.0 * a + structure.links[0].force(x, v)
    record = lw.Record(0.0, RATE, ("x:m1", "force:m1"), np.stack([x, force], axis=1))
    system = equations(record, structure, Window.of_deviation(3.0, 1.0 / RATE))
    left = weak_residual(system, np.zeros(0))[:, 0]
    exact = "abs" not in law and "tanh" not in law
    assert np.nanmax(np.abs(left)) < (1e-6 if exact else 1e-5) * np.abs(force).max()
    wrong = replace(record, values=record.values * [1.0, 1.01])
    left = weak_residual(equations(wrong, structure, Window.of_deviation(3.0, 1.0 / RATE)), np.zeros(0))
    assert np.nanmax(np.abs(left)) > 5e-3 * np.abs(force).max()  # half of the 1 % that the force is wrong by


def test_the_motion_of_the_base_counts() -> None:
    """x = u + d with d known: m x'' + k d = 0 asks for the u'' that gives it."""
    time = np.arange(SAMPLES) / RATE
    x, _, a = two_tones(time)
    structure = oscillator("k*d", mass=2.0, to="base", name="spring", k=800.0)
    base = x + 2.0 * a / 800.0
    record = lw.Record(0.0, RATE, ("x:m1", "x:base"), np.stack([x, base], axis=1))
    system = equations(record, structure)
    assert np.abs(weak_residual(system, np.zeros(0))).max() < 1e-6 * 2.0 * np.abs(a).max()
    # straight lines between samples are off by (77 1e-3)^2/8 = 7e-4
    assert system.d[0] == pytest.approx(np.interp(system.time, time, x - base), abs=2e-3 * np.ptp(x - base))


def test_windows_see_elongations_and_rates() -> None:
    """d at the centres to the fourth order of the window, v to the second."""
    time = np.arange(SAMPLES) / RATE
    x, v, _ = two_tones(time)
    record = lw.Record(0.0, RATE, ("x:m1",), x[:, None])
    system = equations(
        record, oscillator("k*d", mass=2.0, name="spring", k=1.0), Window.of_deviation(3.0, 1.0 / RATE)
    )
    centres = np.rint(system.time * RATE).astype(int)
    assert system.d[0] == pytest.approx(x[centres], abs=(77 * 3e-3) ** 4 * np.abs(x).max())
    assert system.v[0] == pytest.approx(v[centres], abs=(77 * 3e-3) ** 2 * np.abs(v).max())
    assert np.isnan(system.acceleration).sum() == 0


def test_windows_that_miss_a_sample_are_left_out() -> None:
    chain = lw.bnes_chain(2)
    whole = chain_record(2, duration=1.0).with_noise(40.0, seed=1)
    values = whole.values.copy()
    values[500:520, 1] = np.nan
    broken = replace(whole, values=values, noise=present(whole.simulated).noise)
    window = Window.of_deviation(2.5, 1.0 / RATE)
    [complete], [with_gaps] = (
        equations(subject, chain, window).patches
        for subject in (replace(whole, noise=present(whole.simulated).noise), broken)
    )
    starts = window.stride * np.arange(window.rows(len(whole)))
    touched = (starts < 520) & (starts + window.length > 500)
    assert (with_gaps.valid == np.where(touched, 0.0, 1.0)).all() and complete.valid.all()
    assert not with_gaps.rows[:, touched].any()
    assert with_gaps.rows[:, ~touched] == pytest.approx(complete.rows[:, ~touched], rel=1e-12)


def test_where_a_rate_is_not_known_nothing_is_asked() -> None:
    """A law curved in v takes it from a window around each sample: none around the ends and around gaps."""
    time = np.arange(SAMPLES) / RATE
    structure = oscillator("c*v*abs(v)", mass=2.0, name="spring", c=2.0)
    x, v, a = two_tones(time)
    values = np.stack([x, 2.0 * a + 2.0 * v * np.abs(v)], axis=1)
    values[600, 0] = np.nan
    window = Window.of_deviation(3.0, 1.0 / RATE)
    [patch] = equations(lw.Record(0.0, RATE, ("x:m1", "force:m1"), values), structure, window).patches
    first = window.stride * np.arange(window.rows(SAMPLES))
    last = first + window.length - 1
    reach = window.half
    is_complete = (first >= reach) & (last < SAMPLES - reach) & ((last < 600 - reach) | (first > 600 + reach))
    assert (patch.valid == is_complete).all()


def test_a_mass_is_asked_where_its_neighbours_were_seen() -> None:
    """Of the 6-chain m1 - m3 - m5 with sinks m2, m4, m6: without x:m4 neither m3 nor m4 can be asked."""
    chain = lw.bnes_chain(6)
    record = chain_record(6, duration=1.0)
    system = equations(record.select([f"x:m{i}" for i in (1, 2, 3, 5, 6)]), chain)
    assert sorted(mass for patch in system.patches for mass in patch.masses.tolist()) == [0, 1, 4, 5]


def test_a_record_that_is_too_short_says_how_long_it_must_be() -> None:
    record = chain_record(2, duration=0.033, rate=RATE)
    with pytest.raises(
        lw.IdentificationError, match=r"too short: its 34 samples give \d windows of \d+ samples, and 8"
    ):
        equations(record, lw.bnes_chain(2))


def test_a_record_that_is_too_broken_says_so() -> None:
    record = chain_record(2, duration=1.0, rate=RATE)
    values = record.values.copy()
    values[::10, 0] = np.nan
    with pytest.raises(
        lw.IdentificationError, match="too many samples are missing: no mass has 8 complete windows"
    ):
        equations(replace(record, values=values), lw.bnes_chain(2), Window.of_deviation(3.0, 1e-3))
    values[:] = np.nan
    with pytest.raises(lw.IdentificationError, match="too many samples are missing"):
        equations(replace(record, values=values), lw.bnes_chain(2))


def test_single_missing_samples_everywhere_leave_a_band() -> None:
    """No stretch of 256 samples is whole, yet the window is chosen as for the whole record."""
    chain = lw.bnes_chain(2)
    record = chain_record(2, duration=3.0).with_noise(30.0, seed=1)
    values = record.values.copy()
    values[100::150] = np.nan
    whole, broken = (
        read_displacements(subject, chain) for subject in (record, replace(record, values=values))
    )
    # seeds 2000 to 2009: 0 to 3.3 % of the band, which moves by bins of a spectrum, and 0.1 to 7.9 % of the variance
    assert broken.bandwidth == pytest.approx(whole.bandwidth, rel=0.07)
    assert broken.source_variance == pytest.approx(whole.source_variance, rel=0.12)


def test_a_record_without_displacements_says_what_it_holds() -> None:
    record = chain_record(2, duration=1.0, rate=RATE, sensors=("a",))
    with pytest.raises(lw.IdentificationError, match=r"needs displacements, and the record has a:m1, a:m2"):
        read_displacements(record, lw.bnes_chain(2))


def test_equations_of_some_masses_are_those_of_all() -> None:
    record = chain_record(4).with_noise(30.0, seed=1000)
    structure, motion = lw.bnes_chain(4).unknown("all"), read_displacements(record, lw.bnes_chain(4))
    (every,) = weak_equations(record, structure, motion).patches
    (one,) = weak_equations(record, structure, motion, only=(2,)).patches
    assert one.layout.masses.tolist() == [2]
    values = np.arange(1.0, 1.0 + len(structure.parameters))
    np.testing.assert_allclose(one.residual(values)[0], every.residual(values)[2], rtol=1e-12, atol=1e-12)
