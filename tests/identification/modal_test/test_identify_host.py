"""Hosts from tests: hammer taps and decays, masses that set the scale, damping between modes, and modes that slip."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
import scipy
from present import present
from structures import CANTILEVER, host, link, structure
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


FREQUENCIES, DAMPING = (5.0, 5.6, 9.0), 0.02
COUPLED = {"tip": (1.0, 0.7, -0.8), "mid": (0.5, -0.9, 0.4)}
BETWEEN = {(1, 2): 0.9, (2, 3): -0.6}  # of 1.4 N s/m at most, with which no motion gains energy


def taps(between: dict[tuple[int, int], float], seed: int) -> lw.modal.HostEstimate:
    record = lw.simulate(
        structure({}, hosts=[host("wing", FREQUENCIES, DAMPING, COUPLED, between)]),
        forces={"wing.tip": "8*exp(-((t - 0.05)/0.01)**2)", "wing.mid": "6*exp(-((t - 1.5)/0.01)**2)"},
        duration=4.0,
        rate=200.0,
        sensors=["a:wing.tip", "a:wing.mid"],
    )
    return lw.modal.identify_host(record.with_noise(40.0, seed=seed), modes=3)


@pytest.mark.slow
def test_it_is_found_to_within_its_error_and_without_it_ratios_are_enough() -> None:
    found = taps(BETWEEN, 1)
    assert found.trusted
    modes, scores = found.host.modes, []
    for (first, second), entry in found.host.entries.items():
        shapes = [modes[number - 1].shape["tip"] * COUPLED["tip"][number - 1] for number in (first, second)]
        true = BETWEEN.get((first, second), 0.0) * np.prod(np.sign(shapes))  # a mode may have either sign
        scores.append(((entry.value or 0.0) - true) / entry.sigma)
    assert len(scores) == 3
    assert np.abs(scores).max() < 4.0
    assert found.host.entries[1, 2].sigma < 0.1
    for mode, frequency in zip(modes, FREQUENCIES, strict=True):
        assert abs((mode.frequency.value or 0.0) - frequency) < 4.0 * mode.frequency.sigma
        assert abs((mode.damping.value or 0.0) - DAMPING) < 4.0 * mode.damping.sigma
    assert "damping between modes: 3 pairs are free" in str(found)
    assert len(found.to_dict()["damping"]) == 3
    without = taps({}, 3)
    assert without.trusted
    assert not without.host.damping
    assert "damping" not in without.to_dict()


MIXED = {"tip": (1.0, -0.9), "left": (0.2, 0.5), "right": (-0.25, 0.4)}
SLIP = "(v - s*abs(v)*z - (1 - s)*v*abs(z))/x0"


def tapped_joint(frequencies: tuple[float, float], *joints: lw.Link) -> lw.Record:
    return lw.simulate(
        structure({}, *joints, hosts=[host("beam", frequencies, 0.0012, MIXED)]),
        forces={"beam.tip": "2*exp(-((t - 0.02)/0.004)**2)"},
        duration=3.0,
        rate=600.0,
        sensors=["a:beam.tip", "a:beam.left", "a:beam.right"],
    ).with_noise(45.0, seed=3)


@pytest.mark.slow
def test_a_mode_that_slips_is_one() -> None:
    joint = link("joint", "beam.left-beam.right", "F*z", {"z": SLIP}, F=0.9, s=0.5, x0=4e-5)
    found = lw.modal.identify_host(tapped_joint((79.4, 140.0), joint))
    assert len(found.host.modes) == 2
    assert not found.trusted
    mode = found.host.modes[0]
    stiffness = (2.0 * np.pi * 79.4) ** 2 + 0.45**2 * 0.9 / 4e-5  # of small motion
    small = float(np.sqrt(stiffness)) / (2.0 * np.pi)
    # half a bandwidth: at this level the joint slips, which its scatter does not tell
    assert abs((mode.frequency.value or 0.0) - small) < 0.0012 * small
    assert abs(abs(mode.shape["tip"]) - 1.0) < 0.02


@pytest.mark.slow
def test_two_modes_within_their_bandwidth_are_two() -> None:
    found = lw.modal.identify_host(tapped_joint((80.0, 80.05)))
    assert len(found.host.modes) == 2
    assert found.trusted


@pytest.mark.slow
def test_what_a_joint_leaves_is_not_blamed_on_the_force() -> None:
    joint = link("joint", "beam.left-beam.right", "F*z", {"z": SLIP}, F=0.6, s=0.5, x0=1.2e-5)
    found = lw.modal.identify_host(tapped_joint((79.4, 140.0), joint))
    assert not any("hardly moves" in text for text in found.remarks)
