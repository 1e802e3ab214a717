"""Harmonic balance: its Jacobian against differences, its motions against shooting and simulation."""

import numpy as np
import pytest
from structures import HARDENING, link, oscillator, structure

import linkwise as lw
from linkwise.response.harmonic_balance import HarmonicBalance
from linkwise.response.options import Drive, ResponseKeywords

BOUC_WEN = {"z": "(v - s*abs(v)*z - (1 - s)*v*abs(z))/x0"}
JOINT = structure(
    {"m1": 1.0, "m2": 0.5},
    link("mount", "m1-base", "k*d + c*v", k=400.0, c=0.8),
    link("joint", "m2-m1", "k*d + c*v + F*z", BOUC_WEN, k=150.0, c=0.3, F=0.1, x0=0.002, s=0.6),
)


@pytest.mark.parametrize("kind", ["x", "v", "a"])
def test_the_jacobian_is_that_of_differences(kind: str) -> None:
    balance = HarmonicBalance(JOINT, Drive(kind, "base"), 0.3, (5.0, 20.0), 5)
    unknowns = balance.at_rest(np.array([0.001, -0.002]), 13.0)
    unknowns[:-1] += 0.01 * np.random.default_rng(0).standard_normal(len(unknowns) - 1)
    _, jacobian = balance(unknowns)
    for column, step in enumerate(np.eye(len(unknowns)) * 1e-7):
        difference = (balance(unknowns + step)[0] - balance(unknowns - step)[0]) / 2e-7
        np.testing.assert_allclose(jacobian[:, column], difference, atol=2e-5 * np.abs(jacobian).max())


def test_harmonic_balance_and_shooting_agree_on_a_smooth_law() -> None:
    spring = oscillator(HARDENING, k=400.0, k3=1e5, c=0.4)
    shot, balanced = (
        lw.respond(spring, force={"m1": 0.4}, hz=(3.0, 4.0), starts=0, harmonics=count).levels[0].branches[0]
        for count in (0, 9)
    )
    np.testing.assert_allclose(balanced.folds_hz, shot.folds_hz, rtol=1e-9)
    assert balanced.amplitude.max() == pytest.approx(shot.amplitude.max(), rel=1e-8)
    assert balanced.largest_multiplier[0] == pytest.approx(shot.largest_multiplier[0], rel=1e-4)
    assert (balanced.stable[::10] == (balanced.largest_multiplier[::10] < 1.0)).all()
    assert balanced.stable.sum() > 10 and (~balanced.stable).sum() > 10


@pytest.mark.slow
def test_a_law_with_a_kink_responds_as_a_simulation_does() -> None:
    stop = oscillator("k*d + k2*max(d - gap, 0) + c*v", k=400.0, k2=600.0, gap=0.01, c=1.0)
    [branch] = lw.respond(stop, force={"m1": 1.0}, hz=(3.4, 3.8), harmonics=15).levels[0].branches
    number = int(np.flatnonzero(branch.stable & (branch.amplitude[:, 0] > 0.02))[0])
    hz = float(branch.hz[number])
    state = branch.starts[number]
    record = lw.simulate(
        stop,
        forces={"m1": f"cos({2 * np.pi * hz!r}*t)"},
        release={"x:m1": float(state[0]), "v:m1": float(state[1])},
        duration=20 / hz,
        rate=128 * hz,
    )
    assert 0.5 * np.ptp(record.channel("x:m1")[-128:]) == pytest.approx(branch.amplitude[number, 0], rel=1e-3)


@pytest.mark.slow
def test_a_joint_with_memory_responds_as_a_simulation_does() -> None:
    response = lw.respond(JOINT, base={"a": 0.5}, hz=(2.0, 2.3), harmonics=13)
    [branch] = response.levels[0].branches
    top = int(branch.amplitude[:, 0].argmax())
    hz = float(branch.hz[top])
    base = f"{float(-0.5 / (2 * np.pi * hz) ** 2)!r}*cos({2 * np.pi * hz!r}*t)"
    record = lw.simulate(JOINT, base=base, duration=100 / hz, rate=128 * hz)
    late = [0.5 * np.ptp(record.channel(name)[-128:]) for name in response.channels]
    np.testing.assert_allclose(branch.amplitude[top], late, rtol=2e-3)


def test_a_law_that_jumps_is_refused() -> None:
    rubbing = oscillator("k*d + F*sign(v)", k=400.0, F=0.1)
    with pytest.raises(lw.StructureError, match=r"jumps \(sign\); steady motion needs a steep slope"):
        lw.respond(rubbing, force={"m1": 1.0}, hz=(1.0, 2.0))


def test_smooth_laws_are_balanced_where_heyoka_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    pair = lw.bnes_chain(2)
    asked: ResponseKeywords = {"force": {"m1": 0.1}, "hz": (20.0, 24.0), "starts": 0}
    shot = lw.respond(pair, **asked)
    monkeypatch.setattr("linkwise.response.shooting.phase_integrator", lambda shape: None)
    balanced = lw.respond(pair, **asked)
    by_shooting, by_balance = (r.levels[0].branches[0].amplitude.max(axis=0) for r in (shot, balanced))
    np.testing.assert_allclose(by_balance, by_shooting, rtol=1e-6)
    assert not shot.findings and "were not looked for" in str(balanced)
    monkeypatch.setattr("linkwise.response.shooting.phase_integrator", lambda shape: None)
    with pytest.raises(lw.SimulationError, match="heyoka"):
        lw.backbone(pair, 1, to_energy=1e-3)
