"""The error of an identified force, by Eq. (8) of the paper."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from present import present
from record_faults import without
from structures import THREE_TONES, duffing, hysteretic_oscillator, link, named, oscillator, with_links

import linkwise as lw


@pytest.fixture(scope="module")
def forced() -> lw.Record:
    return lw.simulate(duffing(), forces=THREE_TONES, duration=4.0, rate=500.0)


def test_nmse_in_closed_form() -> None:
    """Forces k d and (1 + e) k d over d: mean(e^2 d^2)/var(d)."""
    true, off = oscillator("k*d", k=10.0).links[0], oscillator("k*d", k=10.5).links[0]
    d = 0.3 + np.sin(np.linspace(0.0, 20.0, 500))
    record = lw.Record(0.0, 100.0, ("x:m1",), d[:, None])
    assert lw.nmse(true, off, record) == pytest.approx(100 * 0.05**2 * np.mean(d**2) / np.var(d), rel=1e-12)
    assert lw.nmse(true, true, record) == 0.0


def test_nmse_takes_true_elongations_and_forces_at_rest(forced: lw.Record) -> None:
    """Noise in the record and another damper change nothing."""
    off = oscillator("k*d + k3*d**3 + c*v", k=950.0, k3=2e6, c=99.0).links[0]
    noisy = forced.with_noise(0.0, seed=1)
    d = present(forced.simulated).displacement[:, 0]
    expected = 100.0 * np.mean((50.0 * d) ** 2) / np.var(900.0 * d + 2e6 * d**3)  # in %
    assert lw.nmse(duffing().links[0], off, forced) == pytest.approx(expected, rel=1e-12)
    assert lw.nmse(duffing().links[0], off, noisy) == lw.nmse(duffing().links[0], off, forced)
    measured = replace(noisy, simulated=None)
    assert lw.nmse(duffing().links[0], off, measured) != lw.nmse(duffing().links[0], off, forced)
    values = forced.values.copy()
    values[::2, 0] = np.nan  # every other one, over 50 periods and more; measured 2e-5
    half = lw.nmse(duffing().links[0], off, replace(forced, values=values, simulated=None))
    assert half == pytest.approx(lw.nmse(duffing().links[0], off, forced), rel=0.1)


def test_nmse_of_a_force_that_does_not_vary(forced: lw.Record) -> None:
    constant = oscillator("f0", name="spring", f0=3.0).links[0]
    with pytest.raises(lw.RecordError, match='true force of link "spring" does not vary'):
        lw.nmse(constant, constant, forced)
    elsewhere = link("spring", "m7-ground", "k*d", k=1.0)
    with pytest.raises(lw.RecordError, match=r"x:m7.*is not in the record"):
        lw.nmse(elsewhere, elsewhere, replace(forced, simulated=None))


# --- links with memory and points of hosts

JOINT = {"k": 400.0, "c": 1.5, "F": 12.0, "x0": 0.02, "s": 0.7}
TONES = {"m1": "9*sin(17*t) + 5*sin(7.3*t) + 4*sin(41*t)"}
PUSH: dict[str, Any] = {"forces": TONES, "duration": 4.0, "rate": 200.0}
TAP: dict[str, Any] = {"impulses": [lw.model.Impulse("m1", 0.8, 0.503)], "duration": 3.0, "rate": 200.0}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("start", "drive", "tolerance"),
    [
        ({}, PUSH, 1e-4),  # (w h)^2/12 of the component at 41 rad/s in tenths of samples is 4e-5
        ({"state:joint.z": -0.6}, PUSH, 1e-4),
        ({}, TAP, 1e-3),  # after rest; the spline rings once about the blow, over some of 600 samples
    ],
)
def test_nmse_of_a_link_with_memory_is_that_of_its_force_along_the_motion(
    start: dict[str, float], drive: dict[str, Any], tolerance: float
) -> None:
    """Against a second way: the identified link beside the true one in one simulation, too soft to move it."""
    true = hysteretic_oscillator(**JOINT)
    off = named("off", "m1-ground", "bouc-wen", **(JOINT | {"x0": 0.018, "c": 1.6, "F": 11.0}))
    silent = named("off", "m1-ground", "bouc-wen", **(JOINT | {"x0": 0.018, "F": 1e-9, "k": 0.0, "c": 0.0}))
    both = with_links(true, silent)
    released = start | {name.replace("joint", "off"): value for name, value in start.items()}
    seen = lw.simulate(both, release=released, sensors=["x", "v", "state", "f:joint"], **drive)
    z = seen.channel("state:off.z")
    force = 400.0 * seen.channel("x:m1") + 1.6 * seen.channel("v:m1") + 11.0 * z
    right = seen.channel("f:joint")
    expected = 100.0 * np.mean((force - right) ** 2) / np.var(right)
    record = lw.simulate(true, release=start, **drive)
    assert lw.nmse(true.links[0], off, record) == pytest.approx(expected, rel=tolerance)
    assert lw.nmse(true.links[0], true.links[0], record) == 0.0
    noisy = record.with_noise(20.0, seed=1)
    assert lw.nmse(true.links[0], off, noisy) == lw.nmse(true.links[0], off, record)


def test_nmse_of_a_law_without_memory_in_place_of_one_and_of_a_state_that_runs_away() -> None:
    """The damper counts: both whole forces are compared."""
    true = hysteretic_oscillator(**JOINT)
    record = lw.simulate(true, sensors=["x", "v", "f"], **PUSH)
    plain = link("joint", "m1-ground", "k*d + c*v", k=600.0, c=4.0)
    left = 600.0 * record.channel("x:m1") + 4.0 * record.channel("v:m1") - record.channel("f:joint")
    expected = 100.0 * np.mean(left**2) / np.var(record.channel("f:joint"))
    assert lw.nmse(true.links[0], plain, record) == pytest.approx(expected, rel=1e-4)  # as above
    record = lw.simulate(true, **PUSH)
    wild = link("joint", "m1-ground", "k*d + F*z", {"z": "v/x0 + r*z**3"}, k=400.0, F=12.0, x0=0.002, r=1e5)
    with pytest.raises(lw.RecordError, match='a state of link "joint" runs away along the motion'):
        lw.nmse(true.links[0], wild, record)
    with pytest.raises(lw.SimulationError, match="inputs must not have gaps"):
        lw.nmse(true.links[0], true.links[0], without(record, **{str(record.channels[0]): 30}))
