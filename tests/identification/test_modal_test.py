"""Hosts from the records of a modal test: modes with standard errors, and what the records do not tell."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import linkwise as lw
from linkwise.modal.measured import ModalMeasurement
from linkwise.modal.oscillators import SampledForce, free_motion
from linkwise.modal.output_error import _OutputError, _searched
from linkwise.modal.pursuit import PursuedModes

number = lw.Coefficient.number
FREQUENCIES = (3.3, 20.6, 57.7)  # Hz, of a slender cantilever
SHAPES = {"tip": (3.2, -3.2, 3.2), "mid": (1.1, 2.3, 0.06)}
DAMPING = 0.01
TAP = "8*exp(-((t - 0.05)/0.004)**2)"  # N, of a hammer


def beam() -> lw.Host:
    return lw.Host(
        "beam",
        tuple(
            lw.HostMode(
                number(frequency), number(DAMPING), {point: shape[r] for point, shape in SHAPES.items()}
            )
            for r, frequency in enumerate(FREQUENCIES)
        ),
    )


@cache
def tapped(point: str = "tip", *, release: float = 0.0, cubic: float = 0.0, level: float = 1.0) -> lw.Record:
    """A tap at a point, and two accelerometers; `release` in sqrt(kg) m/s of the first mode, a spring in N/m^3 at the tip."""
    links: tuple[lw.Link, ...] = ()
    if cubic:
        links = (lw.Link("stop", ("beam.tip", lw.GROUND), lw.Law.parse("k3*d**3"), {"k3": number(cubic)}),)
    return lw.simulate(
        lw.Structure("test", (), links, (beam(),)),
        forces={f"beam.{point}": f"{level}*{TAP}"},
        release={"v:beam.mode1": release} if release else {},
        duration=1.5,
        rate=400.0,
        sensors=["a:beam.tip", "a:beam.mid"],
    )


def errors(host: lw.Host) -> np.ndarray:
    """(n, 2 + m) errors of frequency, damping and shapes, in standard errors; a shape may have either sign."""
    rows = []
    for mode, true in zip(host.modes, beam().modes, strict=True):
        sign = np.sign(mode.shape["tip"] * true.shape["tip"])
        row = [
            (each.value - was.value) / each.sigma
            for each, was in ((mode.frequency, true.frequency), (mode.damping, true.damping))
            if each.value is not None and was.value is not None
        ]
        row += [(sign * mode.shape[point] - true.shape[point]) / mode.shape_sigma[point] for point in SHAPES]
        rows.append(row)
    return np.array(rows)


def test_modes_of_a_tapped_beam_are_within_their_intervals() -> None:
    found = lw.identify_host(tapped().with_noise(40.0, seed=1))
    assert found.trusted
    assert found.host.name == "beam"
    assert found.host.points == ("beam.tip", "beam.mid")
    assert len(found.host.modes) == 3
    assert np.abs(errors(found.host)).max() < 4.0  # twelve values: beyond 4 once in 1300
    assert found.host.modes[1].frequency.sigma < 0.01
    assert found.chi_square_per_sample == pytest.approx(1.0, abs=0.08)  # where the verdict calls it off
    assert "3 modes at 2 points, can be trusted" in str(found)
    assert "beam.mode3" in str(found)


def test_a_structure_that_moves_before_the_tap_is_identified_from_two_records_with_a_gap() -> None:
    records = [tapped(release=0.05).with_noise(40.0, seed=2), tapped("tip").with_noise(35.0, seed=3)]
    values = records[0].values.copy()
    values[100:130, 0] = np.nan
    found = lw.identify_host([replace(records[0], values=values), records[1]], modes=3)
    assert found.trusted
    assert np.abs(errors(found.host)).max() < 4.0


def test_a_structure_that_is_not_linear_is_not_trusted() -> None:
    found = lw.identify_host(tapped(cubic=1e6, level=2.0).with_noise(40.0, seed=4), modes=4)
    assert not found.trusted
    assert found.verdicts[0] in (lw.Verdict.NOISE_MISMATCH, lw.Verdict.COLOURED_RESIDUALS)


def test_a_mode_at_whose_node_the_force_acts_has_no_scale() -> None:
    found = lw.identify_host(tapped("mid").with_noise(30.0, seed=5), modes=3)
    third = found.host.modes[2]
    assert found.faint == ("beam.mode3",) or any("beam.mode3 hardly moves" in text for text in found.remarks)
    assert max(third.shape_sigma.values()) > 0.1 * max(map(abs, third.shape.values()))


def test_what_a_modal_test_needs_is_told() -> None:
    record = tapped()
    with pytest.raises(lw.IdentificationError, match=r"no response was measured at beam\.tip"):
        lw.identify_host(record.select(["a:beam.mid", "force:beam.tip"]))
    with pytest.raises(lw.IdentificationError, match="needs the applied force and the motion"):
        lw.identify_host(record.select(["a:beam.mid"]))
    with pytest.raises(lw.IdentificationError, match="must be positive, got 0"):
        lw.identify_host(record, modes=0)
    with pytest.raises(lw.IdentificationError, match="at least one record"):
        lw.identify_host([])
    with pytest.raises(lw.IdentificationError, match="too few to tell modes"):
        lw.identify_host(record[:40])
    values = np.random.default_rng(1).standard_normal((600, 2))
    values[:, 1] = np.where(np.arange(600) == 100, 1.0, 0.0)
    noise = lw.Record(0.0, 400.0, ("a:beam.tip", "force:beam.tip"), values)
    with pytest.raises(lw.IdentificationError, match="does not stand above the noise"):
        lw.identify_host(noise)


def test_the_name_of_a_host_is_that_of_its_channels() -> None:
    record = tapped()
    with pytest.raises(lw.IdentificationError, match='is of the host "beam", not of "blade"'):
        lw.identify_host(record, name="blade")
    own = [each.replace("beam.", "") for each in record.channels]
    short = lw.Record(0.0, 400.0, tuple(own), record.values)
    assert ModalMeasurement.of([record], "beam").host == "beam"
    assert ModalMeasurement.of([short], "blade").host == "blade"


@pytest.mark.parametrize("ratio", [np.inf, 1.5])
def test_a_search_that_finds_no_lower_cost_has_not_converged(
    ratio: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem, theta, noise = _problem_beside_the_optimum()
    cost = problem.equations(theta, noise).cost
    monkeypatch.setattr(_OutputError, "cost", lambda *_: ratio * cost)
    found, converged = _searched(problem, theta, noise)
    assert not converged
    assert np.array_equal(found, theta)


def test_a_search_that_starts_at_the_optimum_has_converged(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, theta, noise = _problem_beside_the_optimum()
    theta, converged = _searched(problem, theta, noise)
    assert converged
    cost = problem.equations(theta, noise).cost
    monkeypatch.setattr(_OutputError, "cost", lambda *_: cost)  # as where only rounding is left to gain
    assert _searched(problem, theta, noise)[1]


def _problem_beside_the_optimum() -> tuple[_OutputError, np.ndarray, np.ndarray]:
    measured = ModalMeasurement.of([tapped().with_noise(40.0, seed=1)])
    problem = _OutputError(measured, 3)
    theta = np.zeros(3 * problem.width + 6 + 2)  # free motions and offsets at rest
    theta[: 3 * problem.width] = np.concatenate(
        [
            [1.001 * f, DAMPING, *(SHAPES[point][r] for point in measured.points)]
            for r, f in enumerate(FREQUENCIES)
        ]
    )
    return problem, theta, problem.levels(theta)


def test_motion_of_a_mode_is_that_of_a_simulation() -> None:
    record = lw.simulate(
        lw.Structure(
            "one", (), (), (lw.Host("one", (lw.HostMode(number(21.0), number(0.02), {"p": 1.5}),)),)
        ),
        forces={"one.p": "8*exp(-((t - 0.05)/0.002)**2)"},
        duration=0.5,
        rate=2000.0,
        sensors=["x:one.p", "v:one.p", "a:one.p"],
    )
    motion = SampledForce(record.channel("force:one.p"), record.step).motion(21.0, 0.02)
    for kind, row in zip("xva", motion, strict=True):
        shown = record.channel(f"{kind}:one.p")
        assert np.abs(1.5**2 * row - shown).max() < 1e-5 * np.abs(shown).max()  # a spline of the fifth order


def test_free_motions_satisfy_the_equation_of_the_mode() -> None:
    x, v, a = free_motion(5.0, 0.1, 0.001, 400).transpose(1, 0, 2)
    w = 2.0 * np.pi * 5.0
    residual = a + 0.2 * w * v + w**2 * x
    assert np.abs(residual).max() < 1e-12 * np.abs(a).max()


def test_the_derivatives_of_the_response_are_those_of_differences() -> None:
    measured = ModalMeasurement.of([tapped(release=0.02)], None)
    problem = _OutputError(measured, 2)
    rng = np.random.default_rng(2)
    start = PursuedModes(np.array([3.4, 20.0]), np.array([0.02, 0.01]), rng.standard_normal((2, 2, 1)))
    theta = problem.start(start) + 0.1
    for channel, (rows, numbers) in enumerate(problem._jacobian(theta, 0)):
        for row, each in zip(rows, numbers, strict=True):
            step = np.zeros(len(theta))
            step[each] = 1e-5 * max(abs(theta[each]), 0.1)
            ahead, behind = (problem.response(theta + sign * step, 0)[channel] for sign in (1.0, -1.0))
            expected = (ahead - behind) / (2.0 * step[each])
            assert np.abs(row - expected).max() < 1e-5 * max(np.abs(expected).max(), 1e-9)
