"""Distances from the truth and from records: the paper's Eq. (8), and free runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from present import present
from problems import chain_record, oscillator

import linkwise as lw


@pytest.fixture(scope="module")
def duffing() -> lw.Structure:
    return oscillator("k*d + k3*d**3 + c*v", k=900.0, k3=2e6, c=2.0)


@pytest.fixture(scope="module")
def forced(duffing: lw.Structure) -> lw.Record:
    """A force of three tones."""
    force = "3*sin(25*t) + 2*sin(61*t) + 2*cos(90*t)"
    return lw.simulate(duffing, forces={"m1": force}, duration=4.0, rate=500.0)


# --- nmse


def test_nmse_in_closed_form() -> None:
    """Forces k d and (1 + e) k d over d: mean(e^2 d^2)/var(d)."""
    true, off = oscillator("k*d", k=10.0).links[0], oscillator("k*d", k=10.5).links[0]
    d = 0.3 + np.sin(np.linspace(0.0, 20.0, 500))
    record = lw.Record(0.0, 100.0, ("x:m1",), d[:, None])
    assert lw.nmse(true, off, record) == pytest.approx(100 * 0.05**2 * np.mean(d**2) / np.var(d), rel=1e-12)
    assert lw.nmse(true, true, record) == 0.0


def test_nmse_takes_true_elongations_and_forces_at_rest(duffing: lw.Structure, forced: lw.Record) -> None:
    """Noise in the record and another damper change nothing."""
    off = oscillator("k*d + k3*d**3 + c*v", k=950.0, k3=2e6, c=99.0).links[0]
    noisy = forced.with_noise(0.0, seed=1)
    d = present(forced.simulated).displacement[:, 0]
    expected = 100.0 * np.mean((50.0 * d) ** 2) / np.var(900.0 * d + 2e6 * d**3)  # in %
    assert lw.nmse(duffing.links[0], off, forced) == pytest.approx(expected, rel=1e-12)
    assert lw.nmse(duffing.links[0], off, noisy) == lw.nmse(duffing.links[0], off, forced)
    measured = replace(noisy, simulated=None)
    assert lw.nmse(duffing.links[0], off, measured) != lw.nmse(duffing.links[0], off, forced)


def test_nmse_leaves_missing_samples_out(duffing: lw.Structure, forced: lw.Record) -> None:
    off = oscillator("k*d + k3*d**3 + c*v", k=950.0, k3=2e6, c=2.0).links[0]
    values = forced.values.copy()
    values[::2, 0] = np.nan
    half = replace(forced, values=values, simulated=None)
    # half of the samples, every other one: the mean of squares over 50 periods and more; measured 2e-5
    assert lw.nmse(duffing.links[0], off, half) == pytest.approx(
        lw.nmse(duffing.links[0], off, forced), rel=0.1
    )


def test_nmse_of_a_force_that_does_not_vary(forced: lw.Record) -> None:
    constant = oscillator("f0", name="spring", f0=3.0).links[0]
    with pytest.raises(lw.RecordError, match='true force of link "spring" does not vary'):
        lw.nmse(constant, constant, forced)
    elsewhere = lw.Link("spring", ("m7", "ground"), lw.Law.parse("k*d"), {"k": lw.Coefficient.number(1.0)})
    with pytest.raises(lw.RecordError, match=r"x:m7.*is not in the record"):
        lw.nmse(elsewhere, elsewhere, replace(forced, simulated=None))


# --- free runs


def test_the_true_structure_leaves_the_noise(duffing: lw.Structure, forced: lw.Record) -> None:
    """Cut anywhere, the run starts from a state it works out: what is left is the noise, to 3 % of 1700 samples and the
    interpolation of the force.
    """
    part = forced.with_noise(40.0, seed=1)[217:]
    run = lw.free_run(duffing, part)
    assert run.rmse["x:m1"] == pytest.approx(present(part.simulated).noise["x:m1"], rel=0.06)
    assert run.motion.start == part.start and len(run.motion) == len(run.residual) == len(part)
    assert run.residual.channel("x:m1") == pytest.approx(part.channel("x:m1") - run.motion.channel("x:m1"))
    assert run.horizon is None


def test_a_wrong_structure_leaves_more(duffing: lw.Structure, forced: lw.Record) -> None:
    stiff = oscillator("k*d + k3*d**3 + c*v", k=990.0, k3=2e6, c=2.0)
    part = forced.with_noise(40.0, seed=1)[217:]
    assert lw.free_run(stiff, part).rmse["x:m1"] > 10 * present(part.simulated).noise["x:m1"]


def test_without_noise_the_run_is_the_record(duffing: lw.Structure) -> None:
    """A free decay has no input to interpolate: the state is found to the solver's tolerance."""
    record = lw.simulate(duffing, release={"x:m1": 0.02, "v:m1": 0.3}, duration=2.0, rate=500.0)[100:]
    run = lw.free_run(duffing, record)
    assert run.rmse["x:m1"] < 1e-8 * np.std(record.channel("x:m1"))


def test_base_motion_velocities_and_gaps(duffing: lw.Structure) -> None:
    """A shaken mass of which only the velocity was seen, with a gap at the start and one later."""
    shaken = replace(duffing, links=(replace(duffing.links[0], between=("m1", "base")),))
    record = lw.simulate(
        shaken, base="0.004*sin(26*t) + 0.002*cos(71*t)", duration=3.0, rate=500.0, sensors=("v",)
    )
    values = record.values.copy()
    values[[10, 11, 700]] = [[np.nan, base] for base in values[[10, 11, 700], 1]]
    run = lw.free_run(shaken, replace(record, values=values)[3:], settling=60)
    assert run.rmse["v:m1"] < 1e-4 * np.std(record.channel("v:m1"))
    assert np.isnan(run.residual.channel("v:m1")[7])


def test_two_masses_and_a_hidden_one() -> None:
    """The sink has no sensor; its state follows from what it does to the other."""
    chain = lw.bnes_chain(2, alpha=100.0)
    record = lw.simulate(chain, release={"v:m1": 0.3}, duration=1.0, rate=2000.0)
    run = lw.free_run(chain, record.select(["x:m1"]), settling=400)
    assert run.rmse["x:m1"] < 1e-3 * np.std(record.channel("x:m1"))


def test_a_chaotic_run_tells_its_horizon() -> None:
    chain = lw.bnes_chain(10)
    record = chain_record(10, duration=1.5)
    run = lw.free_run(chain, record, settling=60)
    # METHODS section 1: chaos sets in at some tenths of a second; the record ends at 1.5 s
    assert 0.5 < present(run.horizon) < 1.5
    early = run.residual.between(0.06, 0.3)
    # before it errors have not grown, by orders of magnitude; measured 3e-8 of them
    assert np.std(early.channel("x:m2")) < 0.05 * run.rmse["x:m2"]


def test_records_that_cannot_be_run(duffing: lw.Structure, forced: lw.Record) -> None:
    with pytest.raises(lw.RecordError, match="no response of m1 is in the record, which holds force:m1"):
        lw.free_run(duffing, forced.select(["force:m1"]))
    with pytest.raises(lw.RecordError, match="cannot settle on 40 samples: the record has 40"):
        lw.free_run(duffing, forced[:40], settling=40)
    values = forced.values.copy()
    values[300, 1] = np.nan
    with pytest.raises(
        lw.RecordError, match=r"force:m1.*samples are missing, and an input drives the motion"
    ):
        lw.free_run(duffing, replace(forced, values=values))
    values = forced.values.copy()
    values[:50, 0] = np.nan
    with pytest.raises(lw.RecordError, match=r"x:m1.*has no sample among the first 50"):
        lw.free_run(duffing, replace(forced, values=values))
    shaken = replace(duffing, links=(replace(duffing.links[0], between=("m1", "base")),))
    record = lw.Record(0.0, 500.0, ("x:m1", "a:base"), forced.values)
    with pytest.raises(
        lw.IdentificationError, match=r"a:base gives the displacement of the base only up to drift"
    ):
        lw.free_run(shaken, record)
