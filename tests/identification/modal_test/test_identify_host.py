"""Hosts from the records of a modal test: modes with standard errors, and what the records do not tell."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from present import present
from structures import CANTILEVER, host, structure
from tapped_beam import SHAPES, beam, shaken, tapped

import linkwise as lw
from linkwise.modal.measurement import ModalMeasurement


def errors(host: lw.Host) -> np.ndarray:
    """(n, 2 + m) errors of frequency, damping and shapes, in standard errors; a shape may have either sign."""
    rows = []
    for mode, true in zip(host.modes, beam().modes, strict=True):
        sign = np.sign(mode.shape["tip"] * true.shape["tip"])
        pairs = (mode.frequency, true.frequency), (mode.damping, true.damping)
        row = [(present(found.value) - present(was.value)) / found.sigma for found, was in pairs]
        row += [(sign * mode.shape[point] - true.shape[point]) / mode.shape_sigma[point] for point in SHAPES]
        rows.append(row)
    return np.array(rows)


def test_modes_of_a_tapped_beam_are_within_their_intervals() -> None:
    estimate = lw.modal.identify_host(tapped().with_noise(40.0, seed=1))
    assert estimate.trusted
    assert estimate.host.name == "beam"
    assert estimate.host.points == ("beam.tip", "beam.mid")
    assert len(estimate.host.modes) == 3
    assert np.abs(errors(estimate.host)).max() < 4.0  # twelve values: beyond 4 once in 1300
    assert estimate.host.modes[1].frequency.sigma < 0.01 / 1.5  # Hz: noise of 1 % of the resolution of 1.5 s
    assert estimate.chi_square_per_sample == pytest.approx(1.0, abs=0.08)  # where the verdict calls it off
    assert "3 modes at 2 points, can be trusted" in str(estimate)
    assert "beam.mode3" in str(estimate)


def test_a_structure_that_moves_before_the_tap_is_identified_from_two_records_with_a_gap() -> None:
    records = [tapped(release=0.05).with_noise(40.0, seed=2), tapped("tip").with_noise(35.0, seed=3)]
    values = records[0].values.copy()
    values[100:130, 0] = np.nan
    estimate = lw.modal.identify_host([replace(records[0], values=values), records[1]], modes=3)
    assert estimate.trusted
    # four standard errors: of twelve values beyond once in 1300
    assert np.abs(errors(estimate.host)).max() < 4.0


@pytest.mark.slow
def test_errors_of_modes_that_are_not_quite_linear_are_the_scatter_at_this_level() -> None:
    estimates = [
        lw.modal.identify_host(shaken(seed, cubic=3e2, samples=5000).with_noise(60.0, seed=seed))
        for seed in (22, 23)
    ]
    first, second = ([mode.frequency for mode in estimate.host.modes] for estimate in estimates)
    for estimate in estimates:
        assert estimate.verdicts == (lw.Verdict.NOISE_MISMATCH,)
        assert "not quite linear, they are those of this level" in estimate.remarks[0]
        assert max(mode.damping.sigma / present(mode.damping.value) for mode in estimate.host.modes) < 0.3
    for one, other in zip(first, second, strict=True):  # four standard errors: beyond once in 5000
        assert abs(present(one.value) - present(other.value)) < 4.0 * np.hypot(one.sigma, other.sigma)


@pytest.mark.slow
def test_a_long_record_is_reduced_to_the_band_that_its_force_excites() -> None:
    record = shaken(22, samples=17_000, highest=25.0).with_noise(40.0, seed=1)
    estimate = lw.modal.identify_host(record)
    assert estimate.samples < 2 * 17_000 / 3  # two responses
    in_band = CANTILEVER[:2]
    for mode, frequency in zip(estimate.host.modes, in_band, strict=False):
        assert abs(present(mode.frequency.value) - frequency) < 4.0 * mode.frequency.sigma < 0.01 * frequency


@pytest.mark.slow
def test_a_mode_at_whose_node_the_force_acts_has_no_scale() -> None:
    estimate = lw.modal.identify_host(tapped("mid").with_noise(30.0, seed=5), modes=3)
    third = estimate.host.modes[2]
    remarked = any("beam.mode3 hardly moves" in text for text in estimate.remarks)
    assert estimate.faint == ("beam.mode3",) or remarked
    # from this part of the largest on a scale is called undetermined
    assert max(third.shape_sigma.values()) > 0.2 * max(map(abs, third.shape.values()))


NOISE = np.column_stack([np.random.default_rng(1).standard_normal(600), np.arange(600) == 100])


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (lambda tap: tap.select(["a:beam.mid", "force:beam.tip"]), r"no response was measured at beam\.tip"),
        (lambda tap: tap.select(["force:beam.tip"]), "needs the motion at points"),
        (lambda tap: [], "at least one record"),
        (lambda tap: [tap, tap], "hold the same samples; give each record once"),
        (lambda tap: tap[:40], "too few to determine modes"),
        (lambda tap: lw.Record(0.0, 400.0, ("a:beam.tip", "force:beam.tip"), NOISE), "not stand above the noise"),
    ],
)  # fmt: skip
def test_what_a_modal_test_needs_is_told(given: Callable[[lw.Record], lw.Record], message: str) -> None:
    with pytest.raises((lw.IdentificationError, lw.RecordError), match=message):
        lw.modal.identify_host(given(tapped()))


def test_the_name_of_a_host_is_that_of_its_channels() -> None:
    record = tapped()
    with pytest.raises(lw.IdentificationError, match='is of the host "beam", not of "blade"'):
        lw.modal.identify_host(record, name="blade")
    with pytest.raises(lw.IdentificationError, match="must be positive, got 0"):
        lw.modal.identify_host(record, modes=0)
    own = [channel.replace("beam.", "") for channel in record.channels]
    short = lw.Record(0.0, 400.0, tuple(own), record.values)
    assert ModalMeasurement.of([record], "beam").host == "beam"
    assert ModalMeasurement.of([short], "blade").host == "blade"


@pytest.mark.slow
def test_points_whose_channels_are_in_rad_turn() -> None:
    carrier = host("beam", (5.0, 31.4), 0.01, {"tip": (1.7, -1.7), "r": (2.3, -8.0)}, rotations=["r"])
    tap, sensors = {"beam.tip": "40*exp(-((t-0.1)/0.004)**2)"}, ("a:beam.tip", "a:beam.r")
    turning = structure({}, hosts=[carrier], name="beam")
    clean = lw.simulate(turning, forces=tap, duration=3.0, rate=500.0, sensors=sensors)
    record = clean.with_noise(40.0, seed=5413013)
    found = lw.modal.identify_host(record, modes=2)
    assert found.trusted
    assert found.host.rotations == ("beam.r",)
    plain = lw.modal.identify_host(replace(record, units={}), modes=2)
    assert plain.host.rotations == ()
    assert [mode.shape for mode in plain.host.modes] == [mode.shape for mode in found.host.modes]
    moved = replace(record[:-1], units={"a:beam.r": "m/s^2"})
    with pytest.raises(lw.RecordError, match=r"another channel of beam\.r says that it is displaced in rad"):
        lw.modal.identify_host([record, moved], modes=2)
