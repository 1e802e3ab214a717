"""Validation by an answer that found errors of sensors: they are taken out of the record that it is compared with."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from present import some
from record_faults import changed, without
from structures import THREE_TONES, duffing

import linkwise as lw
from linkwise.identification.validated_answer import without_exchanges

pytestmark = pytest.mark.usefixtures("unrendered")
RATE = 500.0


def shown(seed: int, *, offset: float = 0.0, gain: float = 1.0, late: int = 0) -> lw.Record:
    """A forced motion by a displacement with these errors, `late` in samples, and an acceleration without."""
    record = lw.simulate(duffing(), forces=THREE_TONES, duration=3.0, rate=RATE, sensors=("x", "a"))
    record = record.with_noise(40.0, seed=seed)
    return changed(record, x_m1=lambda x: gain * np.roll(x, late) + offset)[late:]


@pytest.mark.slow
@pytest.mark.parametrize("kinds", ["delay", "offset gain"])
def test_errors_of_sensors_that_the_answer_found_are_taken_out(kinds: str) -> None:
    offset, gain, late = 1e-3 * ("offset" in kinds), 1.0 + 0.1 * ("gain" in kinds), 2 * (kinds == "delay")
    options: dict[str, Any] = {f"{kind}s": ["x:m1"] for kind in kinds.split()}
    record = shown(3, offset=offset, gain=gain, late=late)
    answer = lw.identify(record, duffing().unknown("all"), **options)
    assert answer.trusted
    assert [error.kind for error in answer.sensor_errors] == kinds.split()
    truth = {"offset": offset, "gain": gain, "delay": late / RATE}
    for error in some(answer.sensor_errors):
        assert error.channel == "x:m1"
        assert abs(error.value - truth[error.kind]) < 4.0 * error.standard_error  # one in 16 000 by chance
        assert error.description in answer.findings
    other = shown(4, offset=offset, gain=gain, late=late)
    validation = lw.validate(other, answer)
    assert validation.trusted
    for score in some(validation.channels.values()):
        assert score.noise <= score.expected < 1.2 * score.noise  # the answer leaves little beside the noise
    assert not lw.validate(other, answer.structure).trusted
    if kinds == "delay":  # which stays in where samples are missing
        gap = lw.validate(without(other, x_m1=700), answer)
        stays = "The delay of x:m1 that the answer found was not removed"
        assert not gap.trusted and any(remark.startswith(stays) for remark in gap.remarks)


@pytest.mark.slow
def test_the_folder_of_an_answer_says_the_same(tmp_path: Path) -> None:
    answer = lw.identify(shown(3, offset=1e-3), duffing().unknown("all"), offsets=["x:m1"])
    folder = tmp_path / "answer"
    lw.report.write_result(answer, folder)
    (stated,) = json.loads((folder / "result.json").read_text())["sensor_errors"]
    assert stated["kind"] == "offset" and stated["unit"] == "m"
    record = shown(4, offset=1e-3)
    validation = lw.validate(record, folder)
    assert validation.trusted
    assert any("offset of x:m1" in remark for remark in validation.remarks)
    without = lw.validate(record.select(["a:m1", "force:m1"]), folder)
    assert without.trusted and not any("taken out" in remark.lower() for remark in without.remarks)


@pytest.mark.parametrize("change", [{"kind": "colour"}, {"value": float("nan")}, {"standard_error": -1.0}])
def test_what_is_no_error_of_a_sensor_is_refused(change: dict[str, object]) -> None:
    error = lw.estimates.SensorErrorEstimate("x:m1", "offset", 1e-3, 1e-5, "m")
    assert lw.estimates.SensorErrorEstimate.from_dict(error.to_dict()) == error
    with pytest.raises(ValueError, match="not an error of a sensor"):
        lw.estimates.SensorErrorEstimate.from_dict({**error.to_dict(), **change})


@pytest.mark.slow
def test_what_the_record_is_without_is_not_taken_out_again() -> None:
    """A gain that was taken out was taken out twice, and a sensor that was repaired could not be told."""
    answer = lw.identify(shown(3, gain=1.1), duffing().unknown("all"), gains=["x:m1"])
    repaired = shown(4)
    assert not lw.validate(repaired, answer).trusted
    for kinds in (["gain"], ["offset", "gain"]):
        validation = lw.validate(repaired, answer, corrected={"x:m1": kinds})
        assert validation.trusted
        (remark,) = (line for line in validation.remarks if "found" in line)
        assert remark.startswith("The gain of x:m1 that the answer found, 1.") and "not removed" in remark
    other = lw.validate(shown(4, gain=1.1), answer, corrected={"x:m1": ["offset", "delay"]})
    assert other.trusted and any("Removed from the record" in line for line in other.remarks)


@pytest.mark.parametrize("corrected", [{"x:m9": ["gain"]}, {"x:m1": ["colour"]}])
def test_what_is_corrected_must_be_an_error_of_a_channel(corrected: dict[str, list[str]]) -> None:
    with pytest.raises(lw.IdentificationError, match="corrected takes errors that the record is without"):
        lw.validate(shown(4), duffing(), corrected=corrected)


@pytest.mark.parametrize(("kind", "where"), [("sign", "x:m2"), ("swapped", "x:m1"), ("relative", "x:m1")])
def test_an_exchange_of_channels_that_the_record_lacks_is_not_taken_out(kind: str, where: str) -> None:
    record = shown(3)
    cause = lw.estimates.Cause(kind, where, 0.0, "1", 0.0, 0.0, source="x:m2" if kind == "swapped" else "")
    kept, remarks = without_exchanges(record, [cause])
    assert not remarks and np.array_equal(kept.values, record.values)
