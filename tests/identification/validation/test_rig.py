"""Validation of links alone on a rig: forces predicted along a motion that was not fitted."""

from pathlib import Path

import numpy as np
import pytest
from commands import said
from present import some
from rigs import MOTION, hysteretic, measured, rig, run
from structures import named, structure

import linkwise as lw


@pytest.fixture(scope="module")
def record() -> lw.Record:
    return measured(run(hysteretic()), 1)


@pytest.fixture(scope="module")
def fit(record: lw.Record) -> lw.Estimate:
    return lw.identify(record[:1000], hysteretic().unknown("damper"))


@pytest.mark.slow
def test_the_force_on_another_part_is_predicted_to_its_noise(record: lw.Record, fit: lw.Estimate) -> None:
    """A part is validated with an error of 0.1 % level; the noise of the cell is 1 N, of a force of 90 N."""
    result = lw.validate(record[1000:], fit, refit=True)
    score = result.channels["f:damper"]
    assert result.trusted and result.free_run
    assert score.rmse == pytest.approx(score.expected, rel=0.1)  # 950 samples of noise: 5 standard deviations
    assert np.isnan(result.predicted.values[:50]).all() and np.isfinite(result.predicted.values[50:]).all()
    names = [f"damper.{name}" for name in ("k", "c", "F", "s", "x0")]
    assert [entry.name for entry in result.coefficients] == names
    assert all(entry.agrees for entry in some(result.coefficients))
    # the part starts where the link has slipped: with a state of 0, its first samples would be off by 60 N
    result = lw.validate(record[1000:], fit, burn=0.1)
    early = result.record.channel("f:damper")[20:60] - result.predicted.channel("f:damper")[20:60]
    assert np.abs(early).max() < 5.0  # of noise of 1 N
    message = "compared along x:base with f:damper, and the record holds x:base"
    with pytest.raises(lw.RecordError, match=message):
        lw.validate(record.select(["x:base"]), hysteretic())


def test_a_law_that_lacks_the_state_is_refused(record: lw.Record) -> None:
    wrong = rig("k*d + c*v", {"k": 5000.0, "c": 900.0})
    result = lw.validate(record[1000:], wrong)
    assert not result.trusted
    exact, motion = run(hysteretic())[1050:], lw.model.TimeFunction(MOTION)  # after a burn of 50 samples
    force = exact.channel("f:damper")
    missed = force - 5000.0 * motion.value(exact.time) - 900.0 * motion.derivative(exact.time)
    expected = 100.0 * np.mean(missed**2) / np.var(force)
    # noise of 1 N beside some 50 N that are missed, 950 samples: 2/50/sqrt(950), four of them
    nmse = result.channels["f:damper"].nmse_percent
    assert nmse == pytest.approx(expected, rel=8.0 / 50.0 / np.sqrt(950.0))


@pytest.mark.slow
def test_a_state_that_the_start_does_not_show_is_as_uncertain_as_it_is_large() -> None:
    """Within the backlash the force says nothing of the state: its variance was infinite, and the record refused."""
    values = {"k": 2000.0, "c": 50.0, "F": 100.0, "x0": 1e-3, "g": 0.5}
    true = structure({}, named("damper", "base-ground", "backlash-slip", **values), name="rig")
    base = "0.0002*sin(3*t) + 0.003*sin(9*t)*t**2/(10 + t**2)"
    record = measured(lw.simulate(true, duration=6.0, rate=200.0, base=base), 3)
    result = lw.validate(record, true, burn=0.2)
    deviation = result.deviation.channel("f:damper")[40:]
    assert np.isfinite(deviation).all() and result.trusted
    # noise of 1 N; a state of at most 1 that is unknown is worth at most the slope F/(1 - g), and nothing once it slid
    assert 50.0 < deviation.max() < 200.0 and np.median(deviation[800:]) < 1.5


@pytest.mark.slow
def test_from_files_to_a_prediction(tmp_path: Path, record: lw.Record) -> None:
    lw.write_record(record, tmp_path / "run.csv")
    lw.write_structure(hysteretic().unknown("damper"), tmp_path / "rig.toml")
    said(f"identify {tmp_path}/run.csv {tmp_path}/rig.toml --to 5 -o {tmp_path}/answer")
    files = {"report.html", "result.json", "structure.toml", "force_damper.csv", "force_damper.png"}
    assert files <= {path.name for path in (tmp_path / "answer").iterdir()}
    validated = said(f"validate {tmp_path}/run.csv {tmp_path}/answer --from 5 -o {tmp_path}/validation")
    assert "The prediction agrees" in validated.out
    assert "damper" in said(f"structure show {tmp_path}/answer/structure.toml").out
