"""Free runs: a structure let go from a state that the record tells, beside the record."""

from dataclasses import replace

import numpy as np
import pytest
from present import present
from problems import chain_record
from record_faults import without
from structures import THREE_TONES, duffing, hysteretic_oscillator, oscillator

import linkwise as lw


@pytest.fixture(scope="module")
def forced() -> lw.Record:
    return lw.simulate(duffing(), forces=THREE_TONES, duration=4.0, rate=500.0)


def test_the_truth_leaves_the_noise_and_a_wrong_structure_more(forced: lw.Record) -> None:
    """From a state that the run works out: to 3 % of 1700 samples and the interpolation of the force."""
    part = forced.with_noise(40.0, seed=1)[217:]
    run = lw.analysis.free_run(duffing(), part)
    assert run.rmse["x:m1"] == pytest.approx(present(part.simulated).noise["x:m1"], rel=0.06)
    assert run.motion.start == part.start and len(run.motion) == len(run.residual) == len(part)
    assert run.residual.channel("x:m1") == pytest.approx(part.channel("x:m1") - run.motion.channel("x:m1"))
    assert run.horizon is None
    stiff = oscillator("k*d + k3*d**3 + c*v", k=990.0, k3=2e6, c=2.0)
    assert lw.analysis.free_run(stiff, part).rmse["x:m1"] > 10 * present(part.simulated).noise["x:m1"]


@pytest.mark.slow
def test_base_motion_velocities_and_gaps() -> None:
    """A shaken mass of which only the velocity was seen, with a gap at the start and one later."""
    shaken = replace(duffing(), links=(replace(duffing().links[0], between=("m1", "base")),))
    base = "0.004*sin(26*t) + 0.002*cos(71*t)"
    record = lw.simulate(shaken, base=base, duration=3.0, rate=500.0, sensors=("v",))
    values = record.values.copy()
    values[[10, 11, 700]] = [[np.nan, base] for base in values[[10, 11, 700], 1]]
    run = lw.analysis.free_run(shaken, replace(record, values=values)[3:], settling=60)
    assert run.rmse["v:m1"] < 1e-4 * np.std(record.channel("v:m1"))
    assert np.isnan(run.residual.channel("v:m1")[7])


@pytest.mark.slow
def test_a_chaotic_run_tells_its_horizon() -> None:
    chain = lw.bnes_chain(10)
    record = chain_record(10, duration=2.0)
    run = lw.analysis.free_run(chain, record, settling=60)
    # chaos sets in at some tenths of a second; the record ends at 2 s
    assert 0.5 < present(run.horizon) < 2.0
    early = run.residual.between(0.06, 0.3)
    # before it errors have not grown, by orders of magnitude; measured 3e-8 of them
    assert np.std(early.channel("x:m2")) < 0.05 * run.rmse["x:m2"]


def test_records_that_cannot_be_run(forced: lw.Record) -> None:
    with pytest.raises(lw.RecordError, match="no response of m1 is in the record, which holds force:m1"):
        lw.analysis.free_run(duffing(), forced.select(["force:m1"]))
    message = "settling must be at least 2 and leave samples to compare, got 40 of 40 samples"
    with pytest.raises(lw.RecordError, match=message):
        lw.analysis.free_run(duffing(), forced[:40], settling=40)
    with pytest.raises(lw.IdentificationError, match=r"force:m1.*samples are missing.* inputs must be comp"):
        lw.analysis.free_run(duffing(), without(forced, force_m1=300))
    with pytest.raises(lw.RecordError, match=r"x:m1.*has no sample among the first 50"):
        lw.analysis.free_run(duffing(), without(forced, x_m1=slice(50)))
    shaken = replace(duffing(), links=(replace(duffing().links[0], between=("m1", "base")),))
    record = lw.Record(0.0, 500.0, ("x:m1", "a:base"), forced.values)
    message = r"a:base gives the displacement of the base only up to drift"
    with pytest.raises(lw.IdentificationError, match=message):
        lw.analysis.free_run(shaken, record)
    hysteretic = hysteretic_oscillator(k=400.0, F=8.0, x0=0.012, s=0.6)
    with pytest.raises(lw.StructureError, match=r"memory \(state z\), which is not supported in free runs"):
        lw.analysis.free_run(hysteretic, forced)
