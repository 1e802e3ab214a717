"""Records that lack a few samples: modes are followed all the same, and what was interpolated is told."""

from dataclasses import replace

import numpy as np
import pytest
from structures import oscillator, row_of_masses

import linkwise as lw


def _taps(size: float) -> lw.Record:
    """An oscillator of 10.07 Hz and 0.79 % of critical damping, hit at 0.1 s."""
    subject = oscillator("k*d + k3*d**3 + c*v", mass=1.0, name="spring", k=4e3, k3=4e9, c=1.0)
    force = {"m1": f"{size}*exp(-((t - 0.1)/0.01)**2)"}
    clean = lw.simulate(subject, forces=force, duration=4.0, rate=200.0, sensors=["a:m1"])
    return clean.with_noise(40.0, seed=5205001)


def _without(record: lw.Record, **samples: slice) -> lw.Record:
    """The record without some samples of channels, KIND_MASS."""
    values = record.values.copy()
    for name, missing in samples.items():
        values[missing, record.channels.index(name.replace("_", ":"))] = np.nan
    return replace(record, values=values)


@pytest.mark.slow
def test_a_few_missing_samples_are_bridged_and_told() -> None:
    complete = [_taps(0.1), _taps(2.0)]
    gappy = [
        _without(complete[0], a_m1=slice(300, 301)),
        _without(complete[1], a_m1=slice(400, 406), force_m1=slice(500, 502)),
    ]
    expected, found = (lw.inspection.compare_levels(records) for records in (complete, gappy))
    assert found.with_gaps == () and found.first_nonlinear == 1
    bridged = [(gaps.record, gaps.channel, gaps.samples) for gaps in found.bridged]
    assert bridged == [("level 1", "a:m1", 1), ("level 2", "a:m1", 6), ("level 2", "force:m1", 2)]
    assert expected.bridged == ()
    [ring], [true] = found.ring_downs, expected.ring_downs
    assert np.all(np.abs(ring.frequency - true.frequency) < ring.frequency_error + true.frequency_error)
    sentence = "interpolated: 1 of a:m1 (level 1), 6 of a:m1 (level 2), 2 of force:m1 (level 2)."
    assert sentence in " ".join(str(found).split())
    assert found.to_dict()["bridged"][2] == {"record": "level 2", "channel": "force:m1", "samples": 2}


@pytest.mark.slow
def test_gaps_do_not_make_modes_move() -> None:
    """Two linear masses, 5.33 and 10.41 Hz, released; each channel lacks 5 % of its samples in gaps of one to six."""
    ground, joint = (("k*d + c*v", {"k": k, "c": c}) for k, c in ((3e3, 1.0), (800.0, 0.5)))
    structure, release = row_of_masses([1.0, 0.5], ground=ground, joint=joint), {"v:m1": -0.2, "v:m2": 0.3}
    motion = lw.simulate(structure, release=release, duration=12.0, rate=128.0, sensors=["a:m1", "a:m2"])
    for seed in range(5205010, 5205013):
        record, rng = motion.with_noise(40.0, seed=seed), np.random.default_rng(seed)
        values = record.values.copy()
        for column in range(2):
            for first in rng.integers(5, len(values) - 10, 22).tolist():
                values[first : first + int(rng.integers(1, 7)), column] = np.nan
        found = lw.inspection.compare_levels([replace(record, values=values)])
        assert len(found.ring_downs) == 2 and found.verdicts == (lw.Verdict.LINEAR_IN_RANGE,)


@pytest.mark.parametrize("missing", [slice(19, 21), slice(500, 520), slice(0, 2)])
def test_a_force_that_acts_or_lacks_more_is_not_guessed(missing: slice) -> None:
    record = _without(_taps(2.0), force_m1=missing)
    with pytest.raises(lw.IdentificationError, match=r"force:m1: .* inputs must be complete"):
        lw.inspection.compare_levels([_taps(0.1), record])


@pytest.mark.slow
def test_distortion_is_measured_beside_a_missing_sample() -> None:
    force = "sin(2*pi*4*t) + sin(2*pi*12*t + 1) + sin(2*pi*28*t + 2)"
    uneven = oscillator("k*d + k2*d**2 + c*v", mass=1.0, name="spring", k=4e3, k2=2e6, c=1.0)
    forces = ({"m1": f"{size}*({force})"} for size in (0.05, 0.5))
    runs = (lw.simulate(uneven, forces=each, duration=8.0, rate=400.0, sensors=["a:m1"]) for each in forces)
    records = [run.with_noise(60.0, seed=5205020) for run in runs]
    complete, gappy = (
        lw.inspection.compare_levels(runs, modes=1).distortions[1]
        for runs in (records, [records[0], _without(records[1], a_m1=slice(2500, 2501))])
    )
    assert complete is not None and gappy is not None and complete.even is not None
    # the cubic through 14 samples a period of the fastest line errs by 1e-2 of one sample of 1600: far below -40 dB
    assert gappy.even == pytest.approx(complete.even, abs=0.1)
