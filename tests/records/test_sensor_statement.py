"""What is stated of sensors: known errors are taken out of the samples, and the rest is kept as their uncertainty."""

import re
from dataclasses import replace

import numpy as np
import pytest
from structures import torsion_chain

import linkwise as lw
from linkwise.records.sensor_statement import attributes_of, with_statements

T = np.arange(400) / 200.0
MOTION = 1e-3 * np.sin(30.0 * T)


def statement(channel: str = "x:m1", **stated: object) -> lw.records.SensorStatement:
    return lw.records.SensorStatement.of(stated, channel)


@pytest.mark.parametrize(
    ("given", "value", "sigma"),
    [
        ("0.3 mm", 3e-4, 0.0),
        (3e-4, 3e-4, 0.0),
        ("0.0003", 3e-4, 0.0),
        ("+- 0.1 mm", 0.0, 1e-4),
        ("0.3mm+-0.1mm", 3e-4, 1e-4),
        ("0.3 mm ± 100 um", 3e-4, 1e-4),
        ("-0.3 mm +/- 0.1 mm", -3e-4, 1e-4),
        ("unknown", 0.0, np.inf),
        ({"sigma": "0.1 mm"}, 0.0, 1e-4),
        ({"start": "0.3 mm", "sigma": 1e-4}, 3e-4, 1e-4),
    ],
)
def test_an_error_is_known_known_to_within_or_unknown(given: object, value: float, sigma: float) -> None:
    assert statement(offset=given).offset == pytest.approx((value, sigma), rel=1e-12)


def test_a_gain_in_per_cent_is_known_to_within_that() -> None:
    """As in --sensor x:m1:gain=1%; what may be a factor is refused."""
    assert (
        statement(gain="1 %").gain == statement(gain="+- 1 %").gain == pytest.approx((1.0, 0.01), rel=1e-12)
    )
    for factor in ("98 %", "102 %"):
        with pytest.raises(lw.RecordError, match=r"cannot be read; write '1\.02' for a known gain"):
            statement(gain=factor)


def test_a_sensor_shows_gain_times_motion_and_offset() -> None:
    shown = 1.25 * MOTION + 2e-4
    record = lw.Record(0.0, 200.0, ("x:m1",), shown[:, None], noise={"x:m1": 1e-5})
    known = statement(gain="1.25 +- 1 %", offset="0.2 mm +- 0.05 mm", delay="+- 1 ms")
    corrected = with_statements(record, {"x:m1": known})
    assert corrected.channel("x:m1") == pytest.approx(MOTION, abs=1e-16)
    # standard deviations of what is left are those of the motion, not of what the sensor showed
    left = corrected.uncertainty["x:m1"]
    assert (left.gain, left.offset, left.delay) == pytest.approx((0.01, 4e-5, 1e-3), rel=1e-12)
    assert corrected.noise["x:m1"] == pytest.approx(8e-6, rel=1e-12)
    assert "x:m1: an offset of 0.0002 m and a gain of 1.25 were removed, as known." in corrected.notes


def test_a_known_delay_is_taken_out_and_what_is_found_beside_a_value_that_was_removed_is_told() -> None:
    """An offset of 1 mm that is stated as 0.3 +- 0.1 mm is found as 0.7 mm."""
    late = 1e-3 * np.sin(30.0 * (T - 0.01))
    record = lw.Record(0.0, 200.0, ("x:m1", "x:m2"), np.stack([MOTION, late], axis=1))
    corrected = with_statements(record, {"x:m2": statement(delay="10 ms")})
    # two whole samples, so that nothing is interpolated
    assert corrected.channel("x:m2") == pytest.approx(corrected.channel("x:m1"), abs=1e-12)
    assert not corrected.uncertainty
    record = lw.Record(0.0, 200.0, ("x:m1",), MOTION[:, None] + 1e-3)
    told = "x:m1: what is found of its offset comes on top of the value stated."
    assert told in with_statements(record, {"x:m1": statement(offset="0.3 mm +- 0.1 mm")}).notes
    for offset in ("0.3 mm", "+- 0.1 mm", "unknown"):
        assert told not in with_statements(record, {"x:m1": statement(offset=offset)}).notes


def test_what_is_known_of_sensors_is_written_and_read_back() -> None:
    known = lw.records.SensorUncertainty(gain=0.01, offset=1e-4, delay=np.inf)
    again = lw.records.SensorStatement.of(attributes_of(known, "m/s"), "v:m1")
    assert again.uncertainty == known
    state = lw.records.SensorStatement.of(attributes_of(known, "?"), "state:joint.z")
    assert state.uncertainty == known
    of_rotation = lw.records.SensorUncertainty(offset=1e-3)
    assert attributes_of(of_rotation, "rad") == {"offset": "+- 0.001 rad"}
    again = lw.records.SensorStatement.of(attributes_of(of_rotation, "rad"), "x:disc1")
    assert again.uncertainty == of_rotation


def test_a_record_refuses_what_is_stated_of_other_channels() -> None:
    record, known = (
        lw.Record(0.0, 200.0, ("x:m1",), MOTION[:, None]),
        lw.records.SensorUncertainty(offset=1e-4),
    )
    for channel, message in (
        ("x:m2", "channel x:m2: is not in the record, and something is stated of it"),
        ("common", "sensors share a gain, not an offset or a delay"),
    ):
        with pytest.raises(lw.RecordError, match=message):
            replace(record, uncertainty={channel: known})
    with pytest.raises(lw.RecordError, match="standard deviation of a delay must not be negative"):
        lw.records.SensorUncertainty(delay=-1.0)


@pytest.mark.parametrize("stated", [{"gain": "1.02"}, {"offset": 1.0}, {"delay": "1 ms"}, {"noise": 1e-3}])
def test_a_known_error_of_all_sensors_is_not_dropped_in_silence(stated: dict[str, object]) -> None:
    record = lw.Record(0.0, 200.0, ("x:m1",), MOTION[:, None])
    with pytest.raises(lw.RecordError, match=r"channel common: .* only its standard deviation can be stated"):
        with_statements(record, {"common": statement("common", **stated)})
    known = with_statements(record, {"common": statement("common", gain="+- 1 %")})
    assert known.uncertainty == {"common": lw.records.SensorUncertainty(gain=0.01)}


@pytest.mark.parametrize(
    ("given", "value", "sigma"),
    [
        ("0.3 deg", np.radians(0.3), 0.0),
        ("1 gon +- 0.1 grad", np.pi / 200.0, np.pi / 2000.0),
        ("+- 5 mgon", 0.0, np.pi / 40000.0),
        ("+- 2 mrad", 0.0, 0.002),
        ("0.3 deg +- 0.1 deg", np.radians(0.3), np.radians(0.1)),
        ({"start": "0.3 deg", "sigma": "0.1 deg"}, np.radians(0.3), np.radians(0.1)),
    ],
)
def test_offsets_of_rotations_are_angles(given: object, value: float, sigma: float) -> None:
    stated = lw.records.SensorStatement.of({"offset": given, "noise": "0.05 deg"}, "x:disc1")
    assert stated.offset == pytest.approx((value, sigma), rel=1e-12)
    assert stated.noise == pytest.approx(np.radians(0.05), rel=1e-12)
    record = with_statements(lw.Record(0.0, 200.0, ("x:disc1",), MOTION[:, None]), {"x:disc1": stated})
    assert record.units == {"x:disc1": "rad"}
    assert record.values[:, 0] == pytest.approx(MOTION - value)
    removed = [note for note in record.notes if "was removed" in note]
    assert removed == ([f"x:disc1: an offset of {value:.6g} rad was removed, as known."] if value else [])


@pytest.mark.parametrize(
    ("stated", "message"),
    [
        ({"offset": "0.3 deg", "noise": "0.1 mm"}, "'0.1 mm' is in mm: expected a number in rad"),
        ({"offset": "0.3 deg +- 0.1 mm"}, "expected a number in rad"),
        ({"offset": "0.3 kg"}, "expected a number in m"),
        ({"offset": "5 %"}, "'5 %' has no unit"),
    ],
)
def test_offsets_in_two_units_are_refused(stated: dict[str, object], message: str) -> None:
    with pytest.raises(lw.RecordError, match=message) as error:
        lw.records.SensorStatement.of(stated, "x:disc1")
    assert "\n" not in str(error.value)


def test_an_offset_in_another_unit_than_the_record_is_refused() -> None:
    record = lw.Record(0.0, 200.0, ("x:disc1",), MOTION[:, None], units={"x:disc1": "rad"})
    stated = lw.records.SensorStatement.of({"offset": "0.3 mm"}, "x:disc1")
    with pytest.raises(lw.RecordError, match="is in rad, and what is stated of its sensor is in m"):
        with_statements(record, {"x:disc1": stated})
    turned = lw.records.SensorStatement.of({"noise": "0.3 deg"}, "x:disc1")
    with pytest.raises(lw.RecordError, match="is in rad and in m: correct one of them"):
        stated.over(turned)
    moved = with_statements(replace(record, units={}), {"x:disc1": stated})
    with pytest.raises(lw.RecordError, match="converts to m, and disc1 turns, so it is in rad"):
        lw.identify(moved, torsion_chain().unknown("sink"))


def test_a_unit_that_cannot_be_read_is_answered_with_that_of_a_rotation_too() -> None:
    for kind, angular in (("x", "rad"), ("a", "rad/s^2"), ("force", "N m")):
        with pytest.raises(lw.RecordError, match=f"or 'unknown'; of what turns, in {re.escape(angular)}"):
            lw.records.SensorStatement.of({"offset": "+- 1 furlongs/week^3"}, f"{kind}:disc1")
