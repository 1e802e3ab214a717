"""Records at several levels: modes that stay or move, distortion, and ring-downs against known answers."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import scipy
from commands import refusal, said
from matplotlib.lines import Line2D
from record_faults import without
from structures import oscillator, row_of_masses

import linkwise as lw
from linkwise.inspection.level_quantities import distortion

pytestmark = pytest.mark.slow


THREE_TONES = "sin(2*pi*4*t) + sin(2*pi*12*t + 1) + sin(2*pi*28*t + 2)"
"""Odd multiples of 4 Hz, 20 Hz left out."""
MASS, STIFFNESS, DAMPER = 1.0, 4e3, 1.0  # 10.07 Hz, 0.79 % of critical


def spring(*, cubic: float = 0.0, square: float = 0.0) -> lw.Structure:
    law = "k*d + k2*d**2 + k3*d**3 + c*v"
    return oscillator(law, mass=MASS, name="spring", k=STIFFNESS, k2=square, k3=cubic, c=DAMPER)


def driven(
    subject: lw.Structure, force: str, duration: float, rate: float = 400.0, sensor: str = "a:m1"
) -> lw.Record:
    return lw.simulate(subject, forces={"m1": force}, duration=duration, rate=rate, sensors=[sensor])


@cache
def tap(size: float, cubic: float, sensor: str = "a:m1") -> lw.Record:
    return driven(spring(cubic=cubic), f"{size}*exp(-((t - 0.1)/0.01)**2)", 6.0, 200.0, sensor)


@cache
def released(cubic: float, rate: float = 256.0) -> lw.Record:
    """Two masses, 5.33 and 10.41 Hz, that start with a velocity."""
    joint = ("k*d + k3*d**3 + c*v", {"k": 800.0, "k3": cubic, "c": 0.5})
    structure = row_of_masses([1.0, 0.5], ground=("k*d + c*v", {"k": 3e3, "c": 1.0}), joint=joint)
    release = {"v:m1": -0.2, "v:m2": 0.3}
    return lw.simulate(structure, release=release, duration=12.0, rate=rate, sensors=["a:m1", "a:m2"])


def linear_frequencies() -> np.ndarray:
    """Of `released` without its cubic term."""
    stiffness, mass = np.array([[3800.0, -800.0], [-800.0, 800.0]]), np.diag([1.0, 0.5])
    return np.asarray(np.sqrt(scipy.linalg.eigh(stiffness, mass, eigvals_only=True)) / (2.0 * np.pi))


def test_modes_of_a_linear_structure_stay() -> None:
    levels = enumerate(((0.1, 30.0), (1.0, 40.0), (10.0, 50.0)))
    records = [tap(size, 0.0).with_noise(snr, seed=seed) for seed, (size, snr) in levels]
    comparison = lw.inspection.compare_levels(records)
    assert comparison.first_nonlinear is None
    assert comparison.frequencies.shape == (3, 1)
    true = np.sqrt(STIFFNESS / MASS) / (2.0 * np.pi)
    # four standard errors: 6e-5 of chance each
    assert np.abs((comparison.frequencies - true) / comparison.frequency_errors).max() < 4.0
    ratio = DAMPER / (2.0 * np.sqrt(STIFFNESS * MASS))
    assert np.abs((comparison.damping - ratio) / comparison.damping_errors).max() < 4.0
    assert str(comparison).startswith("Linear up to")
    loudest = comparison.responses[2].coherence
    # eight blocks that overlap by half count as seven: unrelated signals show this much once in 10 000 records
    assert np.nanmax(loudest) > 1.0 - (1e-4 / loudest.size) ** (1.0 / 6.0)
    assert comparison.distortions == (None, None, None)
    assert comparison.verdicts == (lw.Verdict.LINEAR_IN_RANGE,)


def test_the_level_from_which_on_a_structure_is_not_linear_is_told() -> None:
    records = [tap(size, 4e9).with_noise(40.0, seed=1) for size in (2.0, 0.1, 0.2)]  # in any order
    comparison = lw.inspection.compare_levels(records)
    assert np.all(np.diff(comparison.levels) > 0.0)
    assert comparison.first_nonlinear == 2
    assert comparison.moved(2) == (1,)
    assert comparison.frequency_changes[2, 0] > 0.01  # it hardens
    assert str(comparison).startswith("Not linear from")
    assert comparison.verdicts == (lw.Verdict.MODES_MOVE,) and comparison.trusted
    document = comparison.to_dict()
    assert document["first_nonlinear"] == comparison.labels[2]
    assert document["levels"][0]["modes"][0]["frequency"] == comparison.frequencies[0, 0]


def test_what_is_no_mode_at_a_level_is_lost_and_has_not_moved() -> None:
    """A resonance that bends away is followed to a line of the force: 5.4e-05 Hz, without damping, "moved"."""
    records = [tap(size, 4e9).with_noise(40.0, seed=1) for size in (0.1, 0.2, 2.0)]
    comparison = lw.inspection.compare_levels(records)
    assert not comparison.lost.any()
    frequencies, damping = comparison.frequencies.copy(), comparison.damping.copy()
    frequencies[2], damping[2] = 5e-5, 1e-5
    lost = replace(comparison, frequencies=frequencies, damping=damping)
    assert lost.lost.tolist() == [[False], [False], [True]] and lost.moved(2) == ()
    assert lost.verdicts[0] is lw.Verdict.MODES_NOT_DETERMINED and not lost.trusted
    assert "5e-05" not in str(lost) and any(line.endswith(" lost") for line in str(lost).splitlines())
    (drawn, *_) = lw.plot.level_modes(lost).containers[0].get_children()
    assert isinstance(drawn, Line2D)
    assert np.isnan(np.asarray(drawn.get_ydata())).tolist() == [False, False, True]


def test_records_too_short_to_tell_are_not_trusted() -> None:
    # 0.5 s at 10 dB: the cubic spring moves the mode by 1.2 %, and the damping is uncertain by half
    records = [tap(size, 1e9).with_noise(10.0, seed=1)[:101] for size in (0.1, 1.0)]
    comparison = lw.inspection.compare_levels(records)
    assert comparison.first_nonlinear is None
    assert comparison.verdicts == (lw.Verdict.MODES_NOT_DETERMINED,) and not comparison.trusted
    text = " ".join(str(comparison).split())
    assert text.startswith("Perhaps linear up to") and comparison.verdicts[0].value in text


def test_distortion_that_moves_no_mode_is_not_called_linear() -> None:
    runs = [driven(spring(square=1e5), f"{size}*({THREE_TONES})", 16.0) for size in (0.05, 0.5)]
    records = [run.with_noise(50.0, seed=seed) for seed, run in enumerate(runs)]
    comparison = lw.inspection.compare_levels(records, modes=1)
    # the even term leaves 6.7 times the power of the noise at the higher level, and moves the mode by 1 in 10^5
    assert comparison.first_nonlinear is None
    assert comparison.verdicts == (lw.Verdict.RESIDUALS_GROW_WITH_LEVEL,) and not comparison.trusted


def test_a_ring_down_follows_the_backbone() -> None:
    cubic = 4e8
    records = [tap(size, cubic, "x:m1").with_noise(60.0, seed=1) for size in (0.1, 4.0)]
    [ring] = lw.inspection.compare_levels(records, modes=1).ring_downs
    backbone = np.sqrt((STIFFNESS + 0.75 * cubic * ring.amplitude**2) / MASS) / (2.0 * np.pi)
    assert ring.amplitude[0] > np.e * ring.amplitude[-1]  # for more than a time constant of the decay
    # the harmonic balance of one term: its error is of the order of the square of the relative stiffening, below 0.1 %
    balance = 2e-3
    assert np.abs(ring.frequency / backbone - 1.0).max() < balance
    assert backbone[0] / backbone[-1] - 1.0 > 5.0 * balance  # no constant frequency is as near
    ratio = DAMPER / (2.0 * MASS * 2.0 * np.pi * ring.frequency)
    # the amplitude decays by (1 + 3q/4)/(1 + q) of the rate of a linear one, q = k3 A^2/k, and the noise of 60 dB is less
    stiffening = cubic * ring.amplitude[0] ** 2 / STIFFNESS
    assert np.median(np.abs(ring.damping / ratio - 1.0)) < stiffening


def test_one_decay_without_a_force_shows_the_backbone_of_each_mode() -> None:
    """Two masses, the second on a hardening spring, released: the modes are those of its small motion, and move."""
    comparison = lw.inspection.compare_levels([released(4e6).with_noise(50.0, seed=1)])
    lower, upper = comparison.ring_downs
    for ring, true in zip((lower, upper), linear_frequencies(), strict=True):
        difference, error = ring.ends[0, 1, 0] - true, ring.ends[1, 1, 0]
        assert abs(difference) < 4.0 * error + 1e-3 * true  # the last third still stiffens by less
        assert ring.moves and ring.frequency[0] > 1.005 * ring.frequency[-1]  # it hardens
    assert comparison.verdicts == (lw.Verdict.MODES_MOVE,) and comparison.first_nonlinear is None
    assert comparison.channel in ("a:m1", "a:m2") and comparison.unit == "m/s^2"
    assert str(comparison).startswith("Not linear: as it rings down, a mode moves from")
    document = comparison.to_dict()
    assert document["levels"][0]["motion_peak"] == comparison.levels[0] and document["ring_down"][0]["moves"]


def test_modes_of_a_linear_decay_do_not_move() -> None:
    deviations = []
    for seed in range(2):
        comparison = lw.inspection.compare_levels([released(0.0).with_noise(40.0, seed=seed)])
        assert comparison.verdicts == (lw.Verdict.LINEAR_IN_RANGE,)
        assert str(comparison).startswith(f"Linear up to a peak {comparison.channel} of")
        assert len(comparison.ring_downs) == 2
        for ring, true in zip(comparison.ring_downs, linear_frequencies(), strict=True):
            deviations.append((ring.frequency - true) / ring.frequency_error)
    squares = np.concatenate(deviations) ** 2
    assert 0.5 < squares.mean() < 2.0 and squares.max() < 5.0**2


def test_a_channel_with_gaps_is_left_out_of_ring_downs_and_named() -> None:
    gappy = without(released(4e6).with_noise(50.0, seed=1), a_m1=slice(300, 340))
    comparison = lw.inspection.compare_levels([gappy])
    assert comparison.with_gaps == ("a:m1",)
    assert {ring.channel for ring in comparison.ring_downs} == {"a:m2"}
    assert "a:m1 lacks samples at the highest level" in " ".join(str(comparison).split())
    assert comparison.to_dict()["without_ring_down"] == ["a:m1"]
    with pytest.raises(lw.RecordError, match=r"a:m1, a:m2 lack samples\. Cut the record"):
        lw.inspection.compare_levels([without(gappy, a_m2=slice(300, 340))])


@pytest.mark.parametrize("sensor", ["x:m1", "v:m1", "a:m1"])
def test_acceleration_over_displacement_is_the_restoring_force(sensor: str) -> None:
    cubic = 4e8
    [surface] = lw.inspection.compare_levels([tap(8.0, cubic, sensor).with_noise(60.0, seed=1)]).surfaces
    d, v = surface.displacement, surface.velocity
    force = (STIFFNESS * d + cubic * d**3 + DAMPER * v) / MASS
    linear = d * float(surface.acceleration @ d) / float(d @ d)
    # integrals lose what is slower than the mode, second derivatives amplify the noise of 60 dB: 1 and 2 %
    assert np.std(surface.acceleration + force) < 0.03 * np.std(force)
    assert np.std(surface.acceleration - linear) > 0.06 * np.std(force)  # no linear spring comes near


@pytest.mark.parametrize(
    ("law", "kind", "absent"), [({"cubic": 4e8}, "odd", "even"), ({"square": 2e6}, "even", "odd")]
)
def test_distortion_tells_odd_from_even_terms(law: dict[str, float], kind: str, absent: str) -> None:
    record = driven(spring(**law), f"0.5*({THREE_TONES})", 16.0).with_noise(70.0, seed=1)
    measured = distortion(record, "a:m1", "force:m1")
    assert measured is not None
    assert measured.period == pytest.approx(0.25)
    assert measured.odd is not None and measured.even is not None
    levels = {"odd": measured.odd, "even": measured.even}
    # noise alone would have this ratio of powers once in a million records: sums over 22 odd and 24 even lines or more
    chance = 10.0 * np.log10(scipy.stats.f.ppf(1.0 - 1e-6, 2 * 22, 2 * 22))
    assert levels[kind] > levels[absent] + chance


def test_a_few_missing_samples_are_bridged_and_told() -> None:
    complete = [tap(size, 4e9).with_noise(40.0, seed=5205001) for size in (0.1, 2.0)]
    gappy = [
        without(complete[0], a_m1=slice(300, 301)),
        without(complete[1], a_m1=slice(400, 406), force_m1=slice(500, 502)),
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


def test_gaps_do_not_make_modes_move() -> None:
    """Each channel lacks 5 % of its samples in gaps of one to six."""
    for seed in range(5205010, 5205013):
        record, rng = released(0.0, 128.0).with_noise(40.0, seed=seed), np.random.default_rng(seed)
        values = record.values.copy()
        for column in range(2):
            for first in rng.integers(5, len(values) - 10, 22).tolist():
                values[first : first + int(rng.integers(1, 7)), column] = np.nan
        found = lw.inspection.compare_levels([replace(record, values=values)])
        assert len(found.ring_downs) == 2 and found.verdicts == (lw.Verdict.LINEAR_IN_RANGE,)


@pytest.mark.parametrize("missing", [slice(19, 21), slice(500, 520), slice(0, 2)])
def test_a_force_that_acts_or_lacks_more_is_not_guessed(missing: slice) -> None:
    record = without(tap(2.0, 4e9).with_noise(40.0, seed=5205001), force_m1=missing)
    with pytest.raises(lw.IdentificationError, match=r"force:m1: .* inputs must be complete"):
        lw.inspection.compare_levels([tap(0.1, 4e9), record])


def test_distortion_is_measured_beside_a_missing_sample() -> None:
    runs = (driven(spring(square=2e6), f"{size}*({THREE_TONES})", 8.0) for size in (0.05, 0.5))
    records = [run.with_noise(60.0, seed=5205020) for run in runs]
    complete, gappy = (
        lw.inspection.compare_levels(runs, modes=1).distortions[1]
        for runs in (records, [records[0], without(records[1], a_m1=slice(2500, 2501))])
    )
    assert complete is not None and gappy is not None and complete.even is not None
    # the cubic through 14 samples a period of the fastest line errs by 1e-2 of one sample of 1600: far below -40 dB
    assert gappy.even == pytest.approx(complete.even, abs=0.1)


def test_what_a_comparison_needs_is_told() -> None:
    steady = driven(spring(), "sin(2*pi*4*t)", 4.0, 200.0).with_noise(40.0, seed=1)
    with pytest.raises(lw.RecordError, match="two records or more, and this one alone does not ring down"):
        lw.inspection.compare_levels([steady])
    unforced = lw.Record(0.0, 200.0, ("a:m1",), steady.channel("a:m1")[-30:, None])
    message = "no applied force was recorded, and a record does not decay"
    with pytest.raises(lw.IdentificationError, match=message):
        lw.inspection.compare_levels([unforced])
    values = np.random.default_rng(1).standard_normal((600, 2))
    values[:, 1] = np.where(np.arange(600) == 100, 1.0, 0.0)
    noise = lw.Record(0.0, 200.0, ("a:m1", "force:m1"), values)
    with pytest.raises(lw.RecordError, match="no mode stands above the noise"):
        lw.inspection.compare_levels([noise, noise])
    with pytest.raises(lw.IdentificationError, match="x:m1 is missing, and a:m1 is not in the first"):
        lw.inspection.compare_levels([tap(1.0, 0.0, "x:m1"), tap(2.0, 0.0)])


@pytest.mark.usefixtures("unrendered")
def test_inspect(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name, size in (("soft", 0.1), ("hard", 2.0)):
        lw.write_record(tap(size, 4e9).with_noise(40.0, seed=1), f"{name}.csv")
    out = said("inspect hard.csv soft.csv --levels -o levels").out
    assert "Not linear from a peak force of 2 N on" in out  # the peak of the hard tap
    document = json.loads((tmp_path / "levels" / "inspection.json").read_text())
    assert document["levels"]["first_nonlinear"] == "hard.csv"
    page = (tmp_path / "levels" / "report.html").read_text()
    assert "Modes over level" in page
    for figure in ("levels", "responses", "ring_down"):
        assert (tmp_path / "levels" / f"{figure}.png").exists()
    assert "--modes is for --levels" in refusal("inspect soft.csv --modes 2")
