"""The weak form of links with memory whose states are measured, and those that it must refuse."""

from dataclasses import replace

import numpy as np
import pytest
from structures import harvester, hysteretic_oscillator, link, structure

import linkwise as lw

UNKNOWN = lw.Coefficient.unknown
TRUE = {"alpha": -40.0, "beta": 9e4, "c": 0.3, "theta": 2e-3, "C": 5e-6, "R": 5e4}
BASE = "0.004*sin(40*t) + 0.003*sin(57*t + 1) + 0.002*sin(33*t + 2)"
SEEDS = range(4600, 4606)


@pytest.fixture(scope="module")
def clean() -> lw.Record:
    return lw.simulate(
        harvester(0.02, **TRUE), duration=6.0, rate=500.0, base=BASE, sensors=["x:m1", "state", "x:base"]
    )


def asked(off: float = 1.2) -> lw.Structure:
    """A harvester of which all is unknown; capacitance and resistance start from values that are `off`."""
    return harvester(0.02, C=UNKNOWN(off * TRUE["C"]), R=UNKNOWN(TRUE["R"] / off))


def noisy(clean: lw.Record, snr_db: float, seed: int) -> lw.Record:
    values = clean.with_noise(snr_db, seed=seed).values.copy()
    values[:, clean.channels.index("x:base")] = clean.channel("x:base")
    return replace(clean, values=values, simulated=None)


def scores(fit: lw.Estimate) -> np.ndarray:
    true = [TRUE[parameter.name.removeprefix("piezo.")] for parameter in fit.parameters]
    return np.asarray((fit.values - true) / np.sqrt(fit.covariance.diagonal()))


@pytest.mark.slow
def test_an_exact_motion_gives_the_law(clean: lw.Record) -> None:
    """To the alias of the test functions."""
    exact = replace(
        clean, noise=dict.fromkeys(clean.channels, 1e-6), simulated=None
    )  # below, rounding decides
    fit = lw.identify(exact, asked(1.0), method="weak")
    true = [TRUE[parameter.name.removeprefix("piezo.")] for parameter in fit.parameters]
    assert fit.values == pytest.approx(true, rel=1e-3)


@pytest.mark.slow
def test_intervals_of_a_harvester(clean: lw.Record) -> None:
    """Six records at 40 dB from starts 20 % off: 36 squares of errors over standard errors, in the central 99.9 % of three
    sixths as many independent ones, since coupling, capacitance and resistance are nearly one number.
    """
    fits = [lw.identify(noisy(clean, 40.0, seed), asked(), method="weak") for seed in SEEDS]
    assert sum(fit.trusted for fit in fits) >= len(fits) - 1
    assert 2.0 * 4.4 < float(np.sum([scores(fit) ** 2 for fit in fits])) < 2.0 * 44.0
    assert "state:piezo.V" in fits[0].noise
    motion, values = (
        fits[0].motion,
        dict(zip([p.name for p in fits[0].parameters], fits[0].values, strict=True)),
    )
    voltage = np.interp(motion.time, clean.time, clean.channel("state:piezo.V"))
    spring = (
        values["piezo.alpha"] * motion.d + values["piezo.beta"] * motion.d**3 + values["piezo.c"] * motion.v
    )
    expected = spring[:, 0] - values["piezo.theta"] * voltage
    assert motion.identified_force is not None
    apart = motion.identified_force[:, 0] - expected
    assert np.sqrt(np.mean(apart**2)) < 0.005 * np.sqrt(
        np.mean(expected**2)
    )  # noise of 1 % in a voltage that is 8 % of it


def test_starts_far_off_that_lead_past_zero(clean: lw.Record) -> None:
    """A step that would make the resistance 0, by which the rate is divided, is halved."""
    far = [lw.identify(noisy(clean, 25.0, seed), asked(1.5), method="weak") for seed in SEEDS[:3]]
    near = [lw.identify(noisy(clean, 25.0, seed), asked(1.0), method="weak") for seed in SEEDS[:3]]
    for one, other in zip(far, near, strict=True):
        apart = np.abs(one.values - other.values) / np.sqrt(other.covariance.diagonal())
        assert apart.max() < 0.02  # both ended within 1e-3 standard errors of their last step


def test_what_is_hardly_known_has_no_interval(clean: lw.Record) -> None:
    """At 20 dB the resistance is known to 30 %, and 1/R is not linear over that."""
    fit = lw.identify(noisy(clean, 20.0, SEEDS[0]), asked(), method="weak")
    assert lw.Verdict.HARDLY_DETERMINED in fit.verdicts and not fit.trusted
    assert "piezo.R, piezo.C" in fit.message


def test_a_law_that_lacks_a_term_is_not_trusted(clean: lw.Record) -> None:
    linear = harvester(0.02, "base", "piezo", C=UNKNOWN(TRUE["C"]), R=UNKNOWN(TRUE["R"]))
    assert lw.identify(noisy(clean, 40.0, SEEDS[0]), asked(1.0), method="weak").trusted
    assert not lw.identify(noisy(clean, 40.0, SEEDS[0]), linear, method="weak").trusted


def test_a_state_that_is_a_force() -> None:
    """A Maxwell branch with a load cell on it: f = q alone, and a rate that is linear in its coefficients."""
    states = {"q": lw.model.LinkState("k*v - s*q", unit="N")}
    true = structure({"m1": 1.0}, link("branch", "m1-ground", "q", states, k=400.0, s=6.0))
    record = lw.simulate(
        true, forces={"m1": "20*sin(23*t) + 9*sin(31*t)"}, duration=8.0, rate=500.0, sensors=["x:m1", "state"]
    ).with_noise(40.0, seed=4700)
    open_branch = structure({"m1": 1.0}, link("branch", "m1-ground", "q", states))
    fit = lw.identify(record, open_branch, method="weak")
    assert fit.trusted
    for name, value in (("k", 400.0), ("s", 6.0)):
        found = fit.coefficient(f"branch.{name}")
        assert found.standard_error is not None
        assert abs(found.value - value) < 4.0 * found.standard_error < 0.1 * value


def test_states_that_are_not_linear_are_refused() -> None:
    joint = hysteretic_oscillator(k=400.0, c=1.5, F=12.0, x0=0.02, s=0.7)
    record = lw.simulate(joint, release={"v:m1": 0.3}, duration=1.0, rate=200.0, sensors=["x", "state"])
    with pytest.raises(
        lw.StructureError,
        match=r"memory \(state z\).*does not enter its law and the rates linearly.*likelihood",
    ):
        lw.identify(record, joint.unknown("joint"), method="weak")


def test_coefficients_that_a_rate_is_divided_by_need_starts(clean: lw.Record) -> None:
    with pytest.raises(lw.IdentificationError, match=r"C enters.* nonlinearly and needs a start"):
        lw.identify(noisy(clean, 40.0, SEEDS[0]), harvester(0.02), method="weak")
