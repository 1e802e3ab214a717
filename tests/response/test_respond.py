"""Steady motion: known solutions, folds against collocation, all attractors of a bistable sink, and what is refused."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from structures import HARDENING, link, oscillator, structure

import linkwise as lw
from linkwise.arrays import Floats
from linkwise.model.coefficient import Name
from linkwise.response.bands import drawn_structures, spread
from linkwise.response.search import LevelSearch
from linkwise.response.shooting import Shooting, driven_phase

K, C = 400.0, 0.4
LEVELS = {"hardening": (1e5, 0.4), "softening": (-5e4, 0.2)}


def duffing(k3: float) -> lw.Structure:
    return oscillator(HARDENING, k=K, k3=k3, c=C)


def collocated_fold(k3: float, force: float) -> tuple[float, float]:
    """Frequency in Hz and first harmonic of the fold beyond the peak of the response, by Fourier collocation at 64 moments.

    The lag of the motion behind the force is the parameter, of which the frequency has its extreme at the fold.
    """
    phase = 2 * np.pi * np.arange(64) / 64
    orders = np.fft.fftfreq(64, 1 / 64)
    first, second = (
        np.fft.ifft((1j * orders[:, None]) ** n * np.fft.fft(np.eye(64), axis=0), axis=0).real for n in (1, 2)
    )
    sign, size = (1.0 if k3 > 0 else -1.0), 0.95 * force / (C * np.sqrt(K))

    def solved(lag: float) -> tuple[float, float]:
        x, omega = size * np.cos(phase), np.sqrt(K + 0.75 * k3 * size**2)
        for _ in range(20):
            inner = omega**2 * second @ x + C * omega * first @ x + K * x + k3 * x**3
            motion = inner - force * np.cos(phase + lag)
            jacobian = omega**2 * second + C * omega * first + np.diag(K + 3 * k3 * x**2)
            by_omega = 2 * omega * second @ x + C * first @ x
            whole = np.block([[jacobian, by_omega[:, None]], [np.sin(phase), 0.0]])
            step = np.linalg.solve(whole, np.append(motion, np.sin(phase) @ x))
            x, omega = x - step[:-1], omega - step[-1]
        return omega / (2 * np.pi), float(np.cos(phase) @ x / 32)

    lags = sorted((np.pi / 2, np.pi / 2 + 0.3 * sign))
    best = minimize_scalar(
        lambda lag: -sign * solved(lag)[0], bounds=lags, method="bounded", options={"xatol": 1e-9}
    )
    return solved(best.x)


def test_branches_of_twin_wells_say_which_well_they_are_in() -> None:
    """The springs of a bistable link rest at -0.01 and 0.01 m; small motion is about those."""
    response = lw.respond(lw.bnes_chain(2), force={"m1": 0.02}, hz=(8.0, 10.0), starts=0)
    column = response.channels.index(lw.records.Channel.parse("x:m2"))
    means = sorted(float(branch.mean[0, column]) for branch in response.levels[0].branches)  # type: ignore[index]
    np.testing.assert_allclose(means, [-0.01, 0.01], rtol=1e-3)
    assert "Hz about -0.01 m" in str(response) and "Hz about 0.01 m" in str(response)
    assert "2 (mirror of 1)" in str(response) and "1 (mirror" not in str(response)
    symmetric = lw.respond(oscillator("k*d + c*v", k=K, c=4.0), force={"m1": 3.0}, hz=(1.0, 5.0), starts=0)
    assert "about" not in str(symmetric) and "mirror" not in str(symmetric)


@pytest.mark.parametrize("kind", LEVELS)
def test_folds_of_a_duffing_oscillator_are_those_of_collocation(kind: str) -> None:
    k3, force = LEVELS[kind]
    response = lw.respond(duffing(k3), force={"m1": force}, hz=(2.5, 4.5), starts=0)
    [branch] = response.levels[0].branches
    assert len(branch.folds_hz) == 2
    folds = [number for number, name in enumerate(branch.bifurcations) if name == "fold"]
    top = max(folds, key=lambda number: float(branch.amplitude[number, 0]))
    at_fold = abs(branch.first_harmonic[top, 0])
    hz, first_harmonic = collocated_fold(k3, force)
    assert branch.hz[top] == pytest.approx(hz, rel=1e-9)
    assert at_fold == pytest.approx(first_harmonic, rel=1e-6)
    between = slice(min(folds) + 1, max(folds))
    assert not branch.stable[between].any()
    assert branch.stable[: min(folds)].all() and branch.stable[max(folds) + 1 :].all()


def test_a_linear_oscillator_responds_as_its_transfer_function() -> None:
    spring = oscillator("k*d + c*v", mass=2.0, k=K, c=4.0)
    response = lw.respond(spring, force={"m1": 3.0}, hz=(1.0, 5.0), starts=0)
    [branch] = response.levels[0].branches
    omega = 2 * np.pi * branch.hz
    exact = 3.0 / (K - 2.0 * omega**2 + 4j * omega)
    np.testing.assert_allclose(branch.first_harmonic[:, 0], exact, rtol=1e-9)
    np.testing.assert_allclose(branch.amplitude[:, 0], np.abs(exact), rtol=1e-9)
    np.testing.assert_allclose(branch.largest_multiplier, np.exp(-np.pi / omega * 2.0), rtol=1e-8)
    peak = np.sqrt(K / 2.0 - 2 * 1.0**2) / (2 * np.pi)  # of omega0**2 - 2*(zeta*omega0)**2
    assert branch.hz[branch.amplitude[:, 0].argmax()] == pytest.approx(peak, rel=1e-6)


def test_a_band_is_as_wide_as_the_uncertain_stiffness_moves_the_transfer_function() -> None:
    """Of a linear oscillator, through the frequency above its resonance at which its stiffness moves nothing."""
    bounds = np.array([0.0]), np.array([np.inf])
    spring = oscillator("k*d + c*v", k=400.0, c=20.0)
    answer = lw.estimates.Posterior(spring, (Name("link", "k"),), np.array([[4.0]]), *bounds)
    (branch,) = lw.respond(answer, force={"m1": 1.0}, hz=(1.0, 8.0), starts=0, draws=20).levels[0].branches
    omega = 2.0 * np.pi * branch.hz
    sensitivity = (400.0 - omega**2) / ((400.0 - omega**2) ** 2 + (20.0 * omega) ** 2)
    assert branch.lower is not None and branch.upper is not None
    half = 0.5 * np.log(branch.upper / branch.lower)[:, 0]
    # to first order in the relative deviation of 0.5 %; between stations by interpolation
    np.testing.assert_allclose(half, 1.96 * 2.0 * np.abs(sensitivity), rtol=0.02, atol=2e-5)


def test_a_band_beside_an_antiresonance_is_that_of_draws_solved_for_there() -> None:
    pair = lw.rig(
        {"m1": 1.0, "m2": 0.3},
        {"leaf": "m1 - ground: k*d + c*v", "joint": "m2 - m1: k*d + c*v"},
        {"leaf.k": 900.0, "leaf.c": 1.5, "joint.k": 400.0, "joint.c": 0.5},
    )
    bounds = np.array([0.0]), np.array([np.inf])
    answer = lw.estimates.Posterior(pair, (Name("joint", "k"),), np.array([[4.0]]), *bounds)
    response = lw.respond(answer, force={"m1": 1.0}, hz=(2.0, 9.0), show=["x:m1"], starts=0)
    branch = response.levels[0].branches[0]
    assert branch.lower is not None and branch.upper is not None
    omega = 2 * np.pi * branch.hz

    def receptance(stiffness: float, omega: Floats = omega) -> Floats:
        joint = stiffness + 0.5j * omega
        return np.abs(1 / (900 + 1.5j * omega - omega**2 + 1 / (1 / joint - 1 / (0.3 * omega**2))))

    np.testing.assert_allclose(branch.amplitude[:, 0], receptance(400.0), rtol=1e-8)
    lowest = minimize_scalar(lambda w: receptance(400.0, w), bounds=(34.0, 38.0), method="bounded").fun
    assert branch.amplitude.min() == pytest.approx(lowest, rel=1e-4)
    drawn = np.array([receptance(s.link("joint").values["k"]) for s in drawn_structures(answer, 100, seed=0)])
    lower, upper = np.exp(spread(np.log(drawn / receptance(400.0))))
    width = upper - lower
    assert np.abs(branch.lower[:, 0] / branch.amplitude[:, 0] - lower).max() < 0.05 * width.max()
    assert (np.abs(branch.upper[:, 0] / branch.amplitude[:, 0] - upper) < 0.2 * width).all()


@pytest.mark.parametrize(("kind", "order"), [("x", 0), ("v", 1), ("a", 2)])
def test_motion_of_the_base_is_what_it_is_said_to_be(kind: str, order: int) -> None:
    rig = oscillator("k*d + c*v", to="base", k=K, c=4.0)
    response = lw.respond(rig, base={kind: 2.0}, hz=(2.0, 4.0), starts=0)
    omega = 2 * np.pi * (branch := response.levels[0].branches[0]).hz
    exact = 2.0 * (K + 4j * omega) / (K - omega**2 + 4j * omega) / (1j * omega) ** order
    np.testing.assert_allclose(branch.first_harmonic[:, 0], exact, rtol=1e-9)


def test_a_link_with_memory_and_a_mode_of_a_host_respond_as_their_transfer_functions() -> None:
    rates = {"V": "(-theta*v - V/R)/C"}
    law = ("piezo", "m1-ground", "k*d + c*v - theta*V")
    piezo = structure({"m1": 1.0}, link(*law, rates, k=K, c=2.0, theta=0.05, R=1e3, C=1e-4))
    host = lw.Host("beam", (lw.model.HostMode(3.0, 0.02, {"tip": 2.0}),))
    beam = structure({}, link("spring", "beam.tip-ground", "k*d", k=10.0), hosts=[host])
    own = 2 * np.pi * 3.0
    for subject, place in ((piezo, "m1"), (beam, "beam.tip")):
        response = lw.respond(subject, force={place: 0.3}, hz=(2.0, 4.0), starts=0)
        s = 2j * np.pi * (branch := response.levels[0].branches[0]).hz
        if place == "m1":
            exact = 0.3 / (s**2 + 2.0 * s + K + 0.05**2 * s / (1e-4 * s + 1e-3))
        else:
            exact = 4.0 * 0.3 / (s**2 + 0.04 * own * s + own**2 + 4.0 * 10.0)
        np.testing.assert_allclose(branch.first_harmonic[:, 0], exact, rtol=1e-9)


def test_a_published_chain_has_its_folds_and_peak() -> None:
    """Example 02 of NLvib (Krack and Gross 2019)."""
    chain = structure(
        {"m1": 1.0, "m2": 0.05},
        link("ground", "m1-ground", HARDENING, k=1.0, k3=1.0, c=0.002),
        link("sink", "m2-m1", HARDENING, k=0.0453, k3=0.0042, c=0.013),
    )
    response = lw.respond(chain, force={"m1": 0.11}, hz=(0.5 / (2 * np.pi), 1.4 / (2 * np.pi)), starts=0)
    level = response.levels[0]
    [branch] = level.branches
    peak = np.abs(branch.first_harmonic[:, 0]).argmax()
    assert len(level.folds_hz) == 2
    assert abs(branch.first_harmonic[peak, 0]) == pytest.approx(0.5918, abs=5e-5)
    assert 2 * np.pi * branch.hz[peak] == pytest.approx(1.0271, abs=1e-3)
    assert [motion.kind for motion in level.irregular] == ["quasi-periodic"]
    torus = [hz for hz, name in zip(branch.hz, branch.bifurcations, strict=True) if name == "Neimark-Sacker"]
    assert torus[0] < level.irregular[0].hz < torus[1]


@pytest.mark.slow
def test_simulations_of_a_bistable_sink_end_on_branches_or_where_motion_is_chaotic() -> None:
    chain, force = lw.bnes_chain(2), 3.0
    response = lw.respond(chain, force={"m1": force}, hz=(22.0, 29.0))
    level, rng = response.levels[0], np.random.default_rng(7)
    # from well to well, isolated
    assert any(branch.amplitude[:, 1].min() > 0.02 for branch in level.branches)
    for hz in (25.0, 27.0):
        for _ in range(3):
            release = {"x:m1": 0.01 * rng.standard_normal(), "x:m2": 0.03 * rng.standard_normal()}
            drive = {"m1": f"{force}*cos({2 * np.pi * hz!r}*t)"}
            run = lw.simulate(chain, forces=drive, release=release, duration=20.0, rate=64 * hz)
            late = run.channel("x:m2")[-640:]
            ends = [
                float(np.interp(hz, branch.hz[[k, k + 1]][order], branch.amplitude[[k, k + 1], 1][order]))
                for branch in level.branches
                for k in range(len(branch.hz) - 1)
                for order in [np.argsort(branch.hz[[k, k + 1]])]
                if min(branch.hz[k : k + 2]) <= hz <= max(branch.hz[k : k + 2])
                and branch.stable[k : k + 2].any()
            ]
            assert np.min(np.abs(np.array(ends) - 0.5 * np.ptp(late)) / np.array(ends)) < 0.02


def test_a_branch_that_loses_its_symmetry_is_left_for_the_other_one() -> None:
    """Fast forcing holds the hilltop of two wells up; below an amplitude of sqrt(-2/3*k/k3) motion falls to either side."""
    wells = oscillator("k*d + k3*d**3 + c*v", k=-100.0, k3=1e5, c=1.0)
    drive, size, bounds = lw.response.Drive("force", "m1"), 36.7, (2 * np.pi * 5.0, 2 * np.pi * 12.0)
    integrator = driven_phase(wells, drive)
    assert integrator is not None
    shooting = Shooting(wells, drive, size, bounds, integrator)
    search, omega = LevelSearch(shooting), 2 * np.pi * 8.0
    search.take(np.array([-size / omega**2, 0.0, omega]))  # about the hilltop
    symmetric, split = search.curves
    [at] = [point for point, name in symmetric.points if name == "branch point"]
    [there] = [point for point, name in split.points if name == "branch point"]
    # half of the digits of 1e-8: a double root
    assert at.parameter == pytest.approx(there.parameter, rel=1e-4)
    assert not any(name == "fold" for _, name in split.points)
    amplitude = 0.5 * np.ptp(shooting.motion(at.unknowns)[:, 0])
    # of first order in the square of the ratio of times
    assert amplitude == pytest.approx(np.sqrt(2e-3 / 3.0), rel=0.02)
    for well in (-1.0, 1.0):  # simulations from both wells end on the one that branched off
        search.settle(shooting, np.array([well * np.sqrt(1e-3), 0.0]), omega)
    assert search.curves == [symmetric, split]
    means = [shooting.motion(point.unknowns)[:-1, 0].mean() for point, _ in split.points]
    assert min(means) < -0.02 < 0.02 < max(means)


def test_motion_of_twice_the_period_is_followed_from_where_it_begins() -> None:
    response = lw.respond(lw.bnes_chain(2), force={"m1": 0.5}, hz=(27.5, 27.9), starts=0)
    ends: dict[int, set[tuple[float, float]]] = {1: set(), 2: set()}
    for branch in response.levels[0].branches:
        for number in np.flatnonzero(np.array(branch.bifurcations) == "period doubling").tolist():
            at = float(branch.hz[number]), float(branch.amplitude[number, 0])
            ends[branch.turns].add((round(at[0], 4), round(at[1], 6)))
    assert len(ends[1]) >= 2 and ends[1] <= ends[2]


def test_the_largest_amplitude_of_a_branch_is_one_that_a_test_shows() -> None:
    response = lw.respond(duffing(0.0), force={"m1": 1.0}, hz=(2.0, 4.0), starts=0)
    [branch] = response.levels[0].branches
    top = int(branch.amplitude[:, 0].argmax())
    for unstable, shown in ((slice(top - 9, top + 9), False), (slice(None), True)):
        multipliers = branch.multipliers.copy()
        multipliers[unstable] = 1.5
        level = replace(response.levels[0], branches=(replace(branch, multipliers=multipliers),))
        text = str(replace(response, levels=(level,)))
        assert (f"{branch.amplitude[top, 0]:.4g} m at {branch.hz[top]:.5g} Hz" in text) == shown


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"force": None}, "needs one excitation"),
        ({"force": None, "base": {"a": 1.0}}, 'no link has "base" as an end'),
        ({"force": {"m2": 1.0}}, "unknown mass 'm2' in a force; the masses are m1"),
        ({"hz": (2.0, 1.0)}, "from a positive one to a higher one"),
        ({"show": ("a:m1",)}, "a:m1 cannot be what is shown"),
    ],
)
def test_what_cannot_be_answered_is_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(lw.SimulationError, match=message):
        lw.respond(duffing(1e5), **{"force": {"m1": 1.0}, "hz": (1.0, 2.0), **changes})


def test_motion_that_diverges_is_refused() -> None:
    with pytest.raises(lw.SimulationError, match="every motion from rest diverges"):
        lw.respond(oscillator("k*d", k=-K), force={"m1": 1.0}, hz=(0.1, 0.2), starts=0)
