"""Exports of Testlab to MATLAB: rate, names and units are those of the file, and what is stated takes precedence."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import document
from scipy.io import savemat

from linkwise.errors import RecordError
from linkwise.files import read_record

N, STEP = 256, 1.0 / 512.0
T = 0.5 + STEP * np.arange(N)
FORCE, MOTION = np.exp(-20.0 * T) * 100.0, 30.0 * np.sin(40.0 * T)
G = 9.80665
CASES = Path(__file__).parents[3] / "shared" / "cases" / "lms-mat"


def signal(values: Any, label: Any, name: Any, factor: float = 1.0, step: float = STEP) -> dict[str, Any]:
    point = {} if isinstance(name, list) else {"primary_channel": {"point_id": name, "direction": "+Z"}}
    return {
        "x_values": {
            "start_value": 0.5,
            "increment": step,
            "number_of_values": float(N),
            "quantity": {"label": "s"},
        },
        "y_values": {
            "values": values,
            "quantity": {"label": label, "unit_transformation": {"factor": factor, "offset": 0.0}},
        },
        "function_record": {"name": name, "type": "Signal", **point},
    }


def export(path: Path, **signals: dict[str, Any]) -> Path:
    savemat(path, signals)
    return path


@pytest.mark.parametrize("columns", [("HAM", "P1"), ("Signal_0/y_values/values", "Signal_1/y_values/values")])
def test_names_rate_and_units_are_those_of_the_file(columns: tuple[str, str], tmp_path: Path) -> None:
    hammer, sensor = signal(FORCE, "N", "HAM"), signal(MOTION, "g", "P1", G)
    path = export(tmp_path / "run.mat", Signal_0=hammer, Signal_1=sensor)
    force, motion = columns
    record = read_record(path, channels={"force:m1": force, "a:m1": motion})
    assert (record.rate, record.start) == (512.0, 0.5)
    assert np.array_equal(record.channel("a:m1"), MOTION)
    assert record.notes == (
        "P1 is taken to be in m/s^2, in which Testlab stores values; g beside them is the unit of its display. "
        "Where they were exported in it, state it, as in a:m1[g].",
    )
    in_g = read_record(path, channels={"a:m1[g]": motion})
    assert in_g.channel("a:m1") == pytest.approx(G * MOTION, rel=1e-12)
    assert "a:m1 is taken to be in g, as its mapping states" in " ".join(in_g.notes)


def test_labels_without_a_factor_are_units_and_columns_of_a_matrix_have_names(tmp_path: Path) -> None:
    both = signal(np.stack([MOTION, 2.0 * MOTION], axis=1), "g", ["Left", "Right"])
    record = read_record(
        export(tmp_path / "run.mat", Signal=both), channels={"a:m1": "Left", "a:m2": "Right"}
    )
    assert record.channel("a:m2") == pytest.approx(2.0 * G * MOTION, rel=1e-12)
    assert record.notes == ()


def test_equal_names_give_way_to_points_with_directions_and_own_axes_are_told(tmp_path: Path) -> None:
    first, second = signal(FORCE, "N", "Time"), signal(MOTION, "mm", "Time", 1e-3)
    first["function_record"]["primary_channel"]["point_id"] = "HAM"
    path = export(tmp_path / "run.mat", Signal_0=first, Signal_1=second)
    record = read_record(path, channels={"force:m1": "HAM", "x:m1": "Time +Z"})
    assert np.array_equal(record.channel("x:m1"), MOTION)
    with pytest.raises(RecordError, match=r"the columns are HAM\[N\], Time \+Z\[m\]"):
        read_record(path)
    slow = signal(MOTION, "m", "slow", step=2.0 * STEP)
    path = export(tmp_path / "run.mat", Signal_0=first, Signal_1=slow)
    with pytest.raises(RecordError, match="there is no time column"):
        read_record(path, channels={"force:m1": "HAM"})
    noted = read_record(path, channels={"force:m1": "HAM", "x:m1": "slow"}, rate=512.0).notes
    assert "have axes of their own" in noted[0]


@pytest.mark.skipif(not CASES.exists(), reason="the shared cases are not here")
@pytest.mark.parametrize("columns", [("HAM", "P1"), ("Signal_0/y_values/values", "Signal_1/y_values/values")])
def test_the_shared_export_is_read(columns: tuple[str, str]) -> None:
    answer = document(f"inspect {CASES}/run.mat --channel force:m1={columns[0]} --channel a:m1={columns[1]}")
    channels = answer["channels"]
    assert (channels["a:m1"]["rate"], channels["a:m1"]["unit"], answer["alerts"]) == (1024.0, "m/s^2", [])
