"""Hosts from free decays without a force: the scale of shapes is that of known masses, or open."""

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
import scipy
from present import present

import linkwise as lw

MASSES = {"a": 1.2, "b": 0.5, "c": 0.8}  # kg
STIFFNESS = (2000.0, 1500.0, 900.0)  # N/m, from the ground on


@cache
def decay() -> lw.Record:
    """A chain let go, seen by an accelerometer, a laser for displacements and one for velocities, as points of a host."""
    names = ["ground", *MASSES]
    links = {f"{low}{high}": f"{high} - {low}: k*d + c*v" for low, high in pairwise(names)}
    known = {f"{name}.k": k for name, k in zip(links, STIFFNESS, strict=True)}
    known |= {f"{name}.c": 1e-4 * known[f"{name}.k"] for name in links}
    chain, start, sensors = lw.rig(MASSES, links, known), {"x:c": 0.01, "v:a": 0.3}, ["a:a", "x:b", "v:c"]
    clean = lw.simulate(chain, release=start, duration=4.0, rate=100.0, sensors=sensors)
    record = clean.with_noise(40.0, seed=1)
    return lw.Record(0.0, 100.0, ("a:frame.a", "x:frame.b", "v:frame.c"), record.values)


def true_modes() -> tuple[np.ndarray, np.ndarray]:
    """Frequencies in Hz and mass-normalised shapes, one a row."""
    k1, k2, k3 = STIFFNESS
    stiffness = np.array([[k1 + k2, -k2, 0.0], [-k2, k2 + k3, -k3], [0.0, -k3, k3]])
    squares, columns = scipy.linalg.eigh(stiffness, np.diag(list(MASSES.values())))
    return np.sqrt(squares) / (2.0 * np.pi), columns.T


def test_known_masses_set_the_scale() -> None:
    found = lw.modal.identify_host(decay(), masses=MASSES)
    assert found.trusted
    for mode, frequency, shape in zip(found.host.modes, *true_modes(), strict=True):
        assert abs(present(mode.frequency.value) - frequency) < 4.0 * mode.frequency.sigma < 1e-3 * frequency
        sign = np.sign(mode.shape["b"] * shape[1])
        for point, true in zip(MASSES, shape, strict=True):  # of nine beyond four once in 1700
            assert abs(sign * mode.shape[point] - true) < 4.0 * mode.shape_sigma[point] < 0.02


def test_without_them_the_scale_is_open_and_ratios_hold() -> None:
    found = lw.modal.identify_host(decay())
    assert found.verdicts == (lw.Verdict.HARDLY_DETERMINED,)
    assert "State the masses that move" in found.remarks[-1]
    for mode, shape in zip(found.host.modes, true_modes()[1], strict=True):
        assert max(map(abs, mode.shape.values())) == pytest.approx(1.0, rel=1e-12)
        assert set(mode.shape_sigma.values()) == {1.0}
        ratios = np.array(list(mode.shape.values())) / mode.shape["b"]
        np.testing.assert_allclose(ratios, shape / shape[1], atol=0.02)  # of noise of a hundredth


def test_a_long_decay_is_reduced_to_the_band_of_its_motion() -> None:
    fine = 20.0  # times the rate of the others
    time = np.arange(20_000) / (100.0 * fine)
    moving = np.exp(-0.3 * time) * np.sin(2.0 * np.pi * 7.0 * time)
    noise = 1e-3 * np.random.default_rng(1).standard_normal((2, len(time)))
    values = np.column_stack([moving + noise[0], -0.4 * moving + noise[1]])
    found = lw.modal.identify_host(lw.Record(0.0, 100.0 * fine, ("a:frame.a", "a:frame.b"), values))
    assert found.samples < 2 * len(time) / fine
    [mode] = found.host.modes
    undamped = np.hypot(7.0, 0.3 / (2.0 * np.pi))
    assert abs(present(mode.frequency.value) - undamped) < 4.0 * mode.frequency.sigma
    assert mode.shape["b"] / mode.shape["a"] == pytest.approx(-0.4, abs=0.002)  # of noise of a thousandth


def test_a_mass_that_cannot_be_is_refused() -> None:
    with pytest.raises(lw.IdentificationError, match="is stated at d, which is none of the points a, b, c"):
        lw.modal.identify_host(decay(), masses={"d": 1.0})
    with pytest.raises(lw.IdentificationError, match="must be positive, got -1 kg"):
        lw.modal.identify_host(decay(), masses={"a": -1.0})
    with pytest.raises(
        lw.IdentificationError, match=r"masses at 1 points cannot be all that moves in 3 modes \("
    ):
        lw.modal.identify_host(decay(), masses={"a": 1.0})
