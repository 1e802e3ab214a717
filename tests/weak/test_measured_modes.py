"""The weak form on hosts: modal coordinates from displacements of points, and records that do not tell them."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest
from problems import parsed
from structures import CANTILEVER, CANTILEVER_SHAPES, CANTILEVER_SINK, NES, host, link, structure

import linkwise as lw
from linkwise.weak.displacements import read_displacements

UNKNOWN = lw.Coefficient.unknown
HITS = "60*exp(-((t - 0.05)/0.004)**2) + 40*exp(-((t - 1.05)/0.004)**2)"
POINTS = ("tip", "mid", "root")
SEEDS = range(4100, 4112)


def beam_with_sink(
    points: Mapping[str, Sequence[float]], *, modes: int = 3, sink: Mapping[str, float] | None = None
) -> lw.Structure:
    """A cantilever by its first modes, with a bistable sink at its tip."""
    beam = host("beam", CANTILEVER[:modes], 0.01, points)
    return structure(
        {"sink": 0.05}, link("nes", "sink-beam.tip", NES, **(sink or {})), hosts=[beam], name="beam"
    )


def ringing(true: lw.Structure, *points: str) -> lw.Record:
    return lw.simulate(
        true,
        forces={"beam.mid": HITS},
        release={"x:sink": 0.007},
        duration=2.0,
        rate=1000.0,
        sensors=["x:sink", *(f"x:beam.{point}" for point in points)],
    )


@pytest.fixture(scope="module")
def record() -> lw.Record:
    return ringing(beam_with_sink(CANTILEVER_SHAPES, sink=CANTILEVER_SINK), *POINTS)


def scores(fit: lw.Estimate) -> np.ndarray:
    true = [CANTILEVER_SINK[p.name.removeprefix("nes.")] for p in fit.parameters]
    return np.asarray((fit.values - true) / np.sqrt(fit.covariance.diagonal()))


@pytest.mark.slow
def test_modes_that_are_single_points_are_masses() -> None:
    """Shapes of 1 at one point each make a host of masses of 1 kg on springs: the same equations."""
    shapes = {"first": (1.0, 0.0), "second": (0.0, 1.0)}
    joint = {"k": 300.0, "k3": 4e6, "c": 0.8}
    law = "k*d + k3*d**3 + c*v"
    oscillators = host("two", [3.0, 5.0], 0.02, shapes)
    modal = structure({}, link("joint", "two.first-two.second", law, **joint), hosts=[oscillators])
    springs = [
        link(name, f"{name}-ground", "k*d + c*v", k=(2.0 * np.pi * hz) ** 2, c=0.08 * np.pi * hz)
        for name, hz in (("m1", 3.0), ("m2", 5.0))
    ]
    plain = structure({"m1": 1.0, "m2": 1.0}, *springs, link("joint", "m1-m2", law, **joint))
    moved = lw.simulate(plain, forces={"m1": "20*sin(23*t)"}, duration=4.0, rate=500.0).with_noise(
        30.0, seed=4
    )
    moved = moved.select(["x:m1", "x:m2", "force:m1"])
    at_points = replace(
        moved, channels=parsed("x:two.first", "x:two.second", "force:two.first"), simulated=None
    )
    by_modes, by_masses = (
        lw.identify(noisy, asked.unknown("joint"), method="weak")
        for noisy, asked in ((at_points, modal), (moved, plain))
    )
    apart = np.abs(by_modes.values - by_masses.values) / np.sqrt(by_masses.covariance.diagonal())
    assert apart.max() < 1e-4  # what the third of three rounds of weights still changes
    assert by_modes.covariance == pytest.approx(by_masses.covariance, rel=1e-4)
    assert by_modes.chi_square_per_sample == pytest.approx(by_masses.chi_square_per_sample, rel=1e-6)
    assert set(by_modes.noise) == {"x:two.first", "x:two.second"}


@pytest.mark.slow
def test_intervals_of_a_sink_on_a_beam(record: lw.Record) -> None:
    """Twelve records: the sum of 36 squares of errors over standard errors is within the central 99.9 % of chi-square; the
    noise of three modes comes from three sensors, so that it is correlated.
    """
    asked = beam_with_sink(CANTILEVER_SHAPES)
    fits = [lw.identify(record.with_noise(35.0, seed=seed), asked, method="weak") for seed in SEEDS]
    assert sum(fit.trusted for fit in fits) >= len(fits) - 1
    squares = float(np.sum([scores(fit) ** 2 for fit in fits]))
    assert (
        12.0 < squares < 74.0
    )  # three coefficients of one record are correlated: wider than 36 independent ones


def test_frequencies_that_are_unknown(record: lw.Record) -> None:
    """Frequencies known to within and unknown dampings, from starts 3 % off."""
    within = [UNKNOWN(1.03 * hz, sigma=0.1 * hz) for hz in CANTILEVER]
    beam = host("beam", within, 0.01, CANTILEVER_SHAPES)
    asked = structure({"sink": 0.05}, link("nes", "sink-beam.tip", NES), hosts=[beam])
    asked = asked.unknown(*(f"{mode}.damping" for mode in beam.coordinates))
    fit = lw.identify(record.with_noise(40.0, seed=4200), asked, method="weak")
    assert fit.trusted and len(fit.parameters) == 9
    for number, hz in enumerate(CANTILEVER, start=1):
        frequency = fit.coefficient(f"beam.mode{number}.frequency")
        assert frequency.standard_error is not None
        assert abs(frequency.value - hz) < 4.0 * frequency.standard_error < 0.05 * hz


@pytest.mark.slow
def test_a_wrong_frequency_is_not_trusted(record: lw.Record) -> None:
    wrong = host("beam", (CANTILEVER[0], 1.03 * CANTILEVER[1], CANTILEVER[2]), 0.01, CANTILEVER_SHAPES)
    asked = structure({"sink": 0.05}, link("nes", "sink-beam.tip", NES), hosts=[wrong])
    assert not lw.identify(record.with_noise(35.0, seed=4300), asked, method="weak").trusted


@pytest.mark.slow
def test_more_sensors_than_modes_show_a_wrong_shape() -> None:
    """Three sensors on a host of two modes: what they show beside the modes is noise, unless a shape is 5 % wrong."""
    shapes = {point: shape[:2] for point, shape in CANTILEVER_SHAPES.items()}
    record = ringing(beam_with_sink(shapes, modes=2, sink=CANTILEVER_SINK), *POINTS).with_noise(
        35.0, seed=4400
    )
    asked = beam_with_sink(shapes, modes=2)
    assert lw.identify(record, asked, method="weak").trusted
    motion = read_displacements(record, asked)
    assert motion.surplus == pytest.approx(
        1.0, abs=4.0 * np.sqrt(2.0 / len(record)) + 0.1
    )  # noise known to 5 %
    wrong = beam_with_sink({**shapes, "mid": (1.05 * shapes["mid"][0], shapes["mid"][1])}, modes=2)
    refused = lw.identify(record, wrong, method="weak")
    likeliest = refused.diagnosis[0]
    assert not refused.trusted and (likeliest.kind, likeliest.where) == ("shape", "beam.mid")
    assert likeliest.source == "mode1" or "beam.mode1" in likeliest.description


def test_too_few_sensors_are_counted(record: lw.Record) -> None:
    asked = beam_with_sink(CANTILEVER_SHAPES)
    with pytest.raises(
        lw.IdentificationError, match=r"3 modes.* has 2 \(x:beam.tip, x:beam.mid\), so 1 more is needed.*ml"
    ):
        lw.identify(
            record.select(["x:sink", "x:beam.tip", "x:beam.mid", "force:beam.mid"]), asked, method="weak"
        )
    alike = {**CANTILEVER_SHAPES, "root": tuple(0.5 * part for part in CANTILEVER_SHAPES["mid"])}
    with pytest.raises(
        lw.IdentificationError, match=r"has 2 \(x:beam.tip, x:beam.mid, x:beam.root\), so 1 more"
    ):
        lw.identify(record, beam_with_sink(alike), method="weak")


def test_shapes_that_are_not_known_are_refused(record: lw.Record) -> None:
    beam = host("beam", CANTILEVER, 0.01, CANTILEVER_SHAPES).known_to_within(shape=0.02)
    asked = structure({"sink": 0.05}, link("nes", "sink-beam.tip", NES), hosts=[beam])
    with pytest.raises(
        lw.IdentificationError, match=r"shape of beam.mode1 is not known exactly at tip, mid, root.*ml"
    ):
        lw.identify(record, asked, method="weak")
