"""NumPy, JSON, WAV, LVM, Excel and Testlab files, and a line of units below a header, by name or by mapping."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import document
from foreign_files import lms_signal, lvm, workbook
from scipy.io import savemat, wavfile

import linkwise as lw

N, RATE = 120, 250.0
T = np.arange(N) / RATE
X, A = np.sin(20.0 * T), np.cos(31.0 * T)


def agrees(path: Path, **keywords: Any) -> None:
    """What is read has both motions in SI units at the sampling rate."""
    record = lw.read_record(path, **keywords)
    assert record.rate == pytest.approx(RATE, rel=1e-9)
    # texts of nine digits and a factor of a unit
    assert record.channel("x:m1") == pytest.approx(X, abs=1e-8)
    assert record.channel("a:m2") == pytest.approx(A, abs=1e-8)


@pytest.mark.parametrize(
    "arrays", [{"x:m1": X, "a_m2": A, "fs": RATE}, {"x_m1": X, "a_m2": A, "dt": 1.0 / RATE}]
)
def test_a_numpy_archive_by_name(tmp_path: Path, arrays: dict[str, Any]) -> None:
    np.savez(tmp_path / "run.npz", **arrays)
    agrees(tmp_path / "run.npz")


PERIODS = np.stack([np.sin(2.0 * np.pi * (k + 1) * np.arange(40) / 40) for k in range(6)]).reshape(2, 3, 40)


@pytest.mark.parametrize("time", [{"time": T[:40]}, {"time": T}, {"fs": RATE}])
@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_adjacent_periods_are_one_record(
    tmp_path: Path, time: dict[str, Any], order: tuple[int, int]
) -> None:
    """Three periods of 40 samples; the force is given for one of them."""
    arrays = {"x:m1": PERIODS[0].transpose(order), "force_m1": PERIODS[1, 0], **time}
    np.savez(tmp_path / "run.npz", **arrays)
    record = lw.read_record(tmp_path / "run.npz")
    assert record.rate == pytest.approx(RATE, rel=1e-9)
    assert np.array_equal(record.channel("x:m1"), PERIODS[0].ravel())
    assert np.array_equal(record.channel("force:m1"), np.tile(PERIODS[1, 0], 3))
    assert record.notes[0].startswith("x:m1: 3 periods of 40 samples were joined")


def test_realisations_are_records_of_their_own_and_odd_periods_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "run.npz", **{"x:m1": PERIODS, "fs": RATE})  # type: ignore[arg-type]  # stub takes a flag
    with pytest.raises(lw.RecordError, match=r"both have this name \(realisation 1/x:m1 and realisation 2"):
        lw.read_record(tmp_path / "run.npz")
    second = lw.read_record(tmp_path / "run.npz", channels={"x:m1": "realisation 2/x:m1"})
    assert np.array_equal(second.channel("x:m1"), PERIODS[1].ravel())
    three: dict[str, Any] = {"x:m1": np.ones((3, 50))}
    for more, message in (
        ({"time": T}, "time has 120 samples, and an array of a channel is 3 x 50"),
        ({"x:m2": np.ones((4, 50))}, "x:m1 has 3 x 50, x:m2 has 4 x 50"),
    ):
        np.savez(tmp_path / "run.npz", **three, **more)
        with pytest.raises(lw.RecordError, match=message):
            lw.read_record(tmp_path / "run.npz")


def test_a_numpy_array_by_number_with_fields_and_with_objects(tmp_path: Path) -> None:
    np.save(tmp_path / "run.npy", np.stack([T, X, A]))  # channels by samples, as the longer side says
    agrees(tmp_path / "run.npy", channels={"time": 1, "x:m1": 2, "a:m2": 3})
    with pytest.raises(lw.RecordError, match="there is no header"):
        lw.read_record(tmp_path / "run.npy")
    fields = np.zeros(N, dtype=[("time", float), ("x:m1", float), ("a:m2", np.float32)])
    fields["time"], fields["x:m1"], fields["a:m2"] = T, X, A
    np.save(tmp_path / "run.npy", fields)
    record = lw.read_record(tmp_path / "run.npy")
    assert record.channel("a:m2") == pytest.approx(A, abs=1e-7)  # single precision
    np.save(tmp_path / "run.npy", np.array([{"x": 1}, None]), allow_pickle=True)
    with pytest.raises(lw.RecordError, match=r"cannot be read as a \.npy file.*allow_pickle"):
        lw.read_record(tmp_path / "run.npy")
    np.save(tmp_path / "cube.npy", np.zeros((3, 4, 5)))
    with pytest.raises(lw.RecordError, match="an array of 3 x 4 x 5 numbers"):
        lw.read_record(tmp_path / "cube.npy")


@pytest.mark.parametrize(
    ("content", "keywords"),
    [
        ({"x:m1": X.tolist(), "a:m2": A.tolist(), "dt": 1.0 / RATE}, {}),
        ({"time": T.tolist(), "rig": {"x_m1": X.tolist(), "a_m2": A.tolist()}}, {}),
        ({"columns": ["time", "x:m1", "a:m2"], "data": np.stack([T, X, A], axis=1).tolist()}, {}),
        (
            {"data": np.stack([X, A], axis=1).tolist(), "sampling freq": RATE},
            {"channels": {"x:m1": "data(:,1)", "a:m2": "data(:,2)"}},
        ),
        ([{"time": t, "x:m1": x, "a:m2": a} for t, x, a in zip(T, X, A, strict=True)], {}),
    ],
    ids=["columns", "groups", "named rows", "rows", "objects"],
)
def test_json_in_its_usual_forms(content: Any, keywords: dict[str, Any], tmp_path: Path) -> None:
    (tmp_path / "run.json").write_text(json.dumps(content))
    agrees(tmp_path / "run.json", **keywords)
    values: list[float | None] = X.tolist()
    values[7] = None  # a missing sample
    (tmp_path / "run.json").write_text(json.dumps({"time": T.tolist(), "x:m1": values, "a:m2": A.tolist()}))
    assert np.flatnonzero(np.isnan(lw.read_record(tmp_path / "run.json").channel("x:m1"))).tolist() == [7]


@pytest.mark.parametrize(
    ("content", "time", "motion"),
    [
        (
            {
                "buffer": {
                    name: {"size": 0, "updateMode": "full", "buffer": values.tolist()}
                    for name, values in (("acc_time", T), ("accX", A))
                },
                "status": {"session": "1f", "measuring": False},
            },
            "acc_time",
            "accX",
        ),
        ({"buffers": [{"name": "t", "data": T.tolist()}, {"name": "accX", "data": A.tolist()}]}, "t", "accX"),
        (
            [
                {"sensor": sensor, "seconds_elapsed": f"{t:.9g}", "x": f"{a:.12g}"}
                for t, a in zip(T, A, strict=True)
                for sensor in ("Gyroscope", "Accelerometer")
            ],
            "Accelerometer/seconds_elapsed",
            "Accelerometer/x",
        ),
        ({"device": {"model": "a"}, "data": [{"s": t, "ax": a} for t, a in zip(T, A, strict=True)]}, "s", "ax"),
    ],
    ids=["buffers with settings", "lists with names", "rows of sensors", "objects"],
)  # fmt: skip
def test_json_of_phones(content: Any, time: str, motion: str, tmp_path: Path) -> None:
    (tmp_path / "run.json").write_text(json.dumps(content))
    record = lw.read_record(tmp_path / "run.json", channels={"time": time, "a:m1": motion})
    assert record.rate == pytest.approx(RATE, rel=1e-9)
    assert record.channel("a:m1") == pytest.approx(A, abs=1e-8)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "is not valid JSON"),
        ("3.5", "holds a single value"),
        ("[" * 5000, "is not valid JSON|objects within objects"),
        ('{"x:m1": [[1, 2], [3]], "time": [0, 1]}', "rows of unequal length"),
        ("[]", "no channel is recognised"),
    ],
)
def test_json_that_is_no_record_is_refused(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "run.json").write_text(text)
    with pytest.raises(lw.RecordError, match=said):
        lw.read_record(tmp_path / "run.json")


@pytest.mark.parametrize(
    ("kind", "full", "middle"), [("u1", 128, 128), ("i2", 2**15, 0), ("i4", 2**31, 0), ("f4", 1, 0)]
)
def test_tracks_of_a_wav_file_are_parts_of_full_scale(
    kind: str, full: int, middle: int, tmp_path: Path
) -> None:
    tracks = 0.5 * np.stack([X, A], axis=1)
    wavfile.write(tmp_path / "run.wav", int(RATE), (full * tracks + middle).astype(kind))
    record = lw.read_record(tmp_path / "run.wav", channels={"x:m1": 1, "a:m2[g]": 2})
    last = 1.0 / full if full > 1 else 1e-7
    assert record.rate == RATE
    assert record.channel("x:m1") == pytest.approx(tracks[:, 0], abs=last)
    assert record.channel("a:m2") == pytest.approx(G * tracks[:, 1], abs=G * last)
    (tmp_path / "cut.wav").write_bytes((tmp_path / "run.wav").read_bytes()[:36])
    with pytest.raises(lw.RecordError, match=r"cannot be read as a \.wav file: Unexpected end"):
        lw.read_record(tmp_path / "cut.wav", channels={"x:m1": 1})


OWN: dict[str, Any] = {"units": "mm\tg", "step": 1.0 / RATE}
CELLS = [(f"{t:.9g}", f"{1e3 * x:.12g}", f"{a / 9.80665:.12g}") for t, x, a in zip(T, X, A, strict=True)]


@pytest.mark.parametrize("separator", ["\t", ","])
def test_lvm_with_one_clock_with_several_and_without(separator: str, tmp_path: Path) -> None:
    path = tmp_path / "run.lvm"
    for clocks, rows, names in (
        ("One", CELLS, "X_Value\tx:m1\ta:m2"),
        ("Multi", [(t, x, t, a) for t, x, a in CELLS], "X_Value\tx:m1\tX_Value\ta:m2"),
        ("No", [("", x, a) for _, x, a in CELLS], "X_Value\tx:m1\ta:m2"),
    ):
        path.write_text(
            lvm(clocks, ["\t".join(row) for row in rows], f"{names}\tComment", **OWN, separator=separator)
        )
        agrees(path)


def test_lvm_that_is_cut_or_in_segments_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.lvm"
    rows = ["\t".join(row) for row in CELLS]
    whole = lvm("One", rows, "X_Value\tx:m1\ta:m2\tComment", **OWN)
    segment = whole[whole.index("Channels") :]
    shifted = ["\t".join((t, x, f"{float(t) + 0.001:.9g}", a)) for t, x, a in CELLS]
    uneven = lvm("Multi", shifted, "X_Value\tx:m1\tX_Value\ta:m2\tComment", **OWN)
    for text, said in (
        (whole + "\n" + segment, "holds 2 segments of measurements"),
        ("time\tx:m1\n0\t1\n", "is not an LVM file"),
        (whole[: whole.index("X_Value")], "no measurements below the header"),
        (uneven, "clocks of their own"),
    ):
        path.write_text(text)
        with pytest.raises(lw.RecordError, match=said):
            lw.read_record(path)
    path.write_text(whole[:-3])
    assert len(lw.read_record(path)) == N  # a last number that lost digits cannot be told from another


def test_a_workbook_with_units_below_its_header(tmp_path: Path) -> None:
    numbers = [[float(t), 1e3 * float(x), float(a)] for t, x, a in zip(T, X, A, strict=True)]
    rows: list[list[Any]] = [["time", "x:m1", "a:m2"], ["s", "mm", "m/s^2"], *numbers]
    workbook(tmp_path / "run.xlsx", rows, notes=[["Rig 3"]], second=[[1.0]])
    agrees(tmp_path / "run.xlsx")
    notes = lw.read_record(tmp_path / "run.xlsx").notes
    assert "Sheet Sheet was read; second was not." in notes
    assert "The line below the header was read as the units of the columns." in notes
    workbook(tmp_path / "empty.xlsx", [["time", "x:m1"]])
    with pytest.raises(lw.RecordError, match="no sheet of the workbook holds numbers"):
        lw.read_record(tmp_path / "empty.xlsx")


def test_units_below_the_header_of_a_text_file(tmp_path: Path) -> None:
    body = [";".join(row) for row in CELLS]
    path = tmp_path / "run.csv"
    path.write_text("\n".join(["Operator;me", "time;x:m1;a:m2", "[s];[mm];[g]", *body]) + "\n")
    agrees(path)
    path.write_text("\n".join(["time;x:m1[mm];a:m2[g]", ";;-", *body]) + "\n")  # an empty line is data
    assert np.isnan(lw.read_record(path, rate=RATE).values[0]).all()
    path.write_text("\n".join(["time;x:m1;a:m2", "s;mm;wombats", *body]) + "\n")
    with pytest.raises(lw.RecordError, match="'mm' is not a number"):
        lw.read_record(path)


SAMPLES, STEP = 256, 1.0 / 512.0
TIMES = 0.5 + STEP * np.arange(SAMPLES)
FORCE, MOTION = np.exp(-20.0 * TIMES) * 100.0, 30.0 * np.sin(40.0 * TIMES)
G = 9.80665
CASES = Path(__file__).parents[3] / "shared" / "cases" / "lms-mat"


def signal(values: Any, label: Any, name: Any, factor: float = 1.0, step: float = STEP) -> dict[str, Any]:
    return lms_signal(values, label, name, step, start=0.5, factor=factor)


def export(path: Path, **signals: dict[str, Any]) -> Path:
    savemat(path, signals)
    return path


@pytest.mark.parametrize("columns", [("HAM", "P1"), ("Signal_0/y_values/values", "Signal_1/y_values/values")])
def test_names_rate_and_units_are_those_of_the_file(columns: tuple[str, str], tmp_path: Path) -> None:
    hammer, sensor = signal(FORCE, "N", "HAM"), signal(MOTION, "g", "P1", G)
    path = export(tmp_path / "run.mat", Signal_0=hammer, Signal_1=sensor)
    force, motion = columns
    record = lw.read_record(path, channels={"force:m1": force, "a:m1": motion})
    assert (record.rate, record.start) == (512.0, 0.5)
    assert np.array_equal(record.channel("a:m1"), MOTION)
    assert record.notes == (
        "P1 is taken to be in m/s^2, in which Testlab stores values; g beside them is the unit of its display. "
        "Where they were exported in it, state it, as in a:m1[g].",
    )
    in_g = lw.read_record(path, channels={"a:m1[g]": motion})
    assert in_g.channel("a:m1") == pytest.approx(G * MOTION, rel=1e-12)
    assert "a:m1 is taken to be in g, as its mapping states" in " ".join(in_g.notes)


def test_labels_without_a_factor_are_units_and_columns_of_a_matrix_have_names(tmp_path: Path) -> None:
    both = signal(np.stack([MOTION, 2.0 * MOTION], axis=1), "g", ["Left", "Right"])
    record = lw.read_record(
        export(tmp_path / "run.mat", Signal=both), channels={"a:m1": "Left", "a:m2": "Right"}
    )
    assert record.channel("a:m2") == pytest.approx(2.0 * G * MOTION, rel=1e-12)
    assert record.notes == ()


def test_equal_names_give_way_to_points_with_directions_and_own_axes_are_told(tmp_path: Path) -> None:
    first, second = signal(FORCE, "N", "Time"), signal(MOTION, "mm", "Time", 1e-3)
    first["function_record"]["primary_channel"]["point_id"] = "HAM"
    path = export(tmp_path / "run.mat", Signal_0=first, Signal_1=second)
    record = lw.read_record(path, channels={"force:m1": "HAM", "x:m1": "Time +Z"})
    assert np.array_equal(record.channel("x:m1"), MOTION)
    with pytest.raises(lw.RecordError, match=r"the columns are HAM\[N\], Time \+Z\[m\]"):
        lw.read_record(path)
    slow = signal(MOTION, "m", "slow", step=2.0 * STEP)
    path = export(tmp_path / "run.mat", Signal_0=first, Signal_1=slow)
    with pytest.raises(lw.RecordError, match="there is no time column"):
        lw.read_record(path, channels={"force:m1": "HAM"})
    noted = lw.read_record(path, channels={"force:m1": "HAM", "x:m1": "slow"}, rate=512.0).notes
    assert "have axes of their own" in noted[0]


@pytest.mark.skipif(not CASES.exists(), reason="the shared cases are not here")
@pytest.mark.parametrize("columns", [("HAM", "P1"), ("Signal_0/y_values/values", "Signal_1/y_values/values")])
def test_the_shared_export_is_read(columns: tuple[str, str]) -> None:
    answer = document(f"inspect {CASES}/run.mat --channel force:m1={columns[0]} --channel a:m1={columns[1]}")
    channels = answer["channels"]
    assert (channels["a:m1"]["rate"], channels["a:m1"]["unit"]) == (1024.0, "m/s^2")
    assert [alert["kind"] for alert in answer["alerts"]] == ["few-samples"]  # hits of five samples
