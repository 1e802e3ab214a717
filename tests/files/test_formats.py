"""Every format but CSV: exact there and back, foreign files by name or by mapping, one clear error for a damaged one."""

import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow
import pytest
from foreign_files import Response, lab_view, matlab_v73, universal
from present import some
from pyarrow import parquet
from scipy.io import savemat, whosmat

import linkwise as lw

N = 200
RATE = 250.0
T = np.arange(N) / RATE
X = np.sin(20.0 * T)
A = np.cos(31.0 * T)
F = np.sin(9.0 * T)
WRITTEN = (".csv", ".mat", ".h5", ".hdf5", ".parquet")
KEEPING = WRITTEN[1:]  # the formats that keep noise, source and notes


@pytest.fixture
def record() -> lw.Record:
    values = np.random.default_rng(0).standard_normal((N, 6)) * [1.0, 1e-9, 1e12, 1.0, 1.0, 1.0]
    values[7, 1] = np.nan
    values[50:60] = np.nan
    names = ("x:m1", "a:left arm-2", "force:m1", "v:base", "f:link", "state:link.V")
    stated: dict[str, Any] = {"noise": {"a:left arm-2": 0.25}, "interpolation": {"force:m1": "held"}}
    stated["uncertainty"] = {
        "x:m1": lw.records.SensorUncertainty(gain=0.01, offset=1e-4, delay=np.inf),
        "common": lw.records.SensorUncertainty(gain=0.02),
    }
    return lw.Record(0.3, 100.0 * np.pi, names, values, source="rig", notes=("As built.",), **stated)


# There and back ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", WRITTEN)
def test_there_and_back_nothing_changes(record: lw.Record, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"run{suffix}"
    lw.write_record(record, path)
    again = lw.read_record(path)
    assert again.channels == record.channels
    assert np.array_equal(again.values, record.values, equal_nan=True)
    assert np.array_equal(again.time, record.time)
    assert (again.start, again.rate) == (record.start, record.rate)
    lw.write_record(again, path)  # over the old one
    third = lw.read_record(path)
    assert np.array_equal(third.values, record.values, equal_nan=True)
    assert np.array_equal(third.time, record.time)
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]  # no part of a file is left
    if suffix in KEEPING:
        assert again.noise == {"a:left arm-2": 0.25}
        assert again.source == "rig"
        assert again.interpolation == {"force:m1": "held"}
        assert again.uncertainty == record.uncertainty
        assert again.notes[0] == "As built."
        assert not any("ignored" in note for note in again.notes)


# Errors that all formats share ---------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".mat", ".h5", ".parquet", ".uff", ".tdms", ".npy", ".npz", ".xlsx"])
def test_a_damaged_file_is_one_clear_error(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"run{suffix}"
    path.write_bytes(b"this is not what the suffix says, " * 20)
    with pytest.raises(lw.RecordError) as caught:
        lw.read_record(path)
    said = str(caught.value)
    assert said.startswith(str(path)) and "\n" not in said
    words = (f"cannot be read as a {suffix} file: ", "is not an HDF5 file", "contains no time response")
    assert any(word in said for word in words)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("run.xyz", "unknown suffix '.xyz'; choose from .csv, .txt, .dat, .tsv, .asc, .mat"),
        ("run", "the file name has no suffix; choose from"),
        ("rum.mat", 'there is no such file; did you mean "run.mat"?'),
        ("other.h5", "there is no such file"),
        ("folder.csv", "is a folder, not a record file"),
        ("nowhere/run.csv", "nowhere' does not exist"),
    ],
)
def test_a_path_that_leads_nowhere(tmp_path: Path, name: str, message: str) -> None:
    for file_name in ("run.xyz", "run", "run.mat"):
        (tmp_path / file_name).write_text("x")
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(lw.RecordError) as caught:
        lw.read_record(tmp_path / name)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("suffix", "library", "module"),
    [(".parquet", "pyarrow", "parquet"), (".uff", "pyuff", "uff"), (".tdms", "nptdms", "tdms")],
)
def test_a_library_that_is_missing_is_named_with_its_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str, library: str, module: str
) -> None:
    (tmp_path / f"run{suffix}").write_text("x")
    monkeypatch.setitem(sys.modules, library, None)
    monkeypatch.delitem(sys.modules, f"linkwise.files.{module}", raising=False)
    with pytest.raises(lw.RecordError) as caught:
        lw.read_record(tmp_path / f"run{suffix}")
    assert f"{suffix} files need the library {library}" in str(caught.value)
    assert "pip install 'linkwise[files]'" in str(caught.value)


def test_writing_refuses_what_it_cannot_write(record: lw.Record, tmp_path: Path) -> None:
    message = r"records cannot be written as .tdms; use one of .csv, .mat, .h5, .hdf5, .parquet"
    with pytest.raises(lw.RecordError, match=message):
        lw.write_record(record, tmp_path / "run.tdms")
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(lw.RecordError, match="cannot be written: File exists"):
        lw.write_record(record, tmp_path / "file" / "run.csv")


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), MemoryError()])
def test_a_write_that_fails_leaves_the_old_file(
    record: lw.Record, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    path = tmp_path / "run.mat"
    lw.write_record(record, path)
    before = path.read_bytes()

    def broken(_record: lw.Record, part: Path) -> None:
        part.write_bytes(before[:100])
        raise error

    monkeypatch.setattr("linkwise.files.mat.write", broken)
    with pytest.raises((lw.RecordError, MemoryError)):
        lw.write_record(record, path)
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["run.mat"]


# MATLAB --------------------------------------------------------------------------------------------------------


def check(record: lw.Record, channels: tuple[str, ...] = ("x:m1", "a:m2", "force:m1")) -> None:
    assert record.channels == channels
    assert record.rate == RATE
    for name, expected in (("x:m1", X), ("a:m2", A), ("force:m1", F)):
        if name in channels:
            assert np.array_equal(record.channel(name), expected)


def test_mat_v5_variables_structs_matrices_and_rates(tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    savemat(path, {"time": T, "x_m1": X, "a_m2": A[:, np.newaxis], "force_m1": F, "comment": "as measured"})
    check(lw.read_record(path))
    savemat(path, {"run": {"x_m1": X, "rest": np.column_stack([A, F])}, "fs": RATE})
    record = lw.read_record(path, channels={"a:m2": "run/rest(:,1)", "force:m1": "rest(:,2)"})
    check(record, ("a:m2", "force:m1", "x:m1"))
    # names that name no mass are not guessed
    savemat(path, {"time": T, "x_m1": X, "a_1": A, "v_max": F})
    record = lw.read_record(path, known_masses=["m1", "m2"])
    assert record.channels == ("x:m1",)
    assert record.notes == ("Columns that are not channels were ignored: a_1, v_max.",)


def test_mat_v73(tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    run = {"comment": "as measured", "gain": 2.0, "force_m1": F[:, np.newaxis]}
    data = np.column_stack([A, F])
    matlab_v73(path, {"time": T[:, np.newaxis], "x_m1": X, "data": data, "run": run, "parts": ["one", "two"]})
    record = lw.read_record(path, channels={"a:m2": "data(:,1)"})
    check(record, ("a:m2", "force:m1", "x:m1"))
    ignored = "Columns that are not channels were ignored: data(:,2), nothing (empty), parts (a cell array)."
    assert record.notes == (ignored,)
    # with names and statements as linkwise writes them
    names = ["x:m1", "a:m2", "force:m1"]
    variables = {"c1": X, "c2": A, "c3": F}
    noise = np.array([0.5, np.nan, np.nan])
    stated = {"start": 0.0, "rate": RATE, "noise": noise, "notes": ["One."], "source": "rig"}
    matlab_v73(path, {**variables, "channels": names, "variables": list(variables), **stated})
    record = lw.read_record(path)
    assert set(record.channels) == set(names)
    assert record.noise == {"x:m1": 0.5}
    assert record.notes == ("One.", "Columns that are not channels were ignored: nothing (empty).")
    assert record.source == "rig"
    assert np.array_equal(record.channel("a:m2"), A)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (X[:-1], r"channel x:m1: has shape \(199,\), but time has shape \(200,\)"),
        (X + 1j, r"channel x:m1: .* is not a number"),
    ],
)
def test_mat_columns_that_do_not_fit_are_refused(tmp_path: Path, values: Any, message: str) -> None:
    savemat(tmp_path / "run.mat", {"time": T, "x_m1": values})
    with pytest.raises(lw.RecordError, match=message):
        lw.read_record(tmp_path / "run.mat")


def test_mat_names_stay_apart_and_within_matlabs_length(tmp_path: Path) -> None:
    names = (*(f"x:{'m' * 70}{i}" for i in range(3)), "a:m-1", "a:m 1")
    values = np.random.default_rng(6).normal(size=(N, len(names)))
    lw.write_record(lw.Record(0.0, RATE, names, values), tmp_path / "run.mat")
    assert all(name.isidentifier() and len(name) <= 63 for name, *_ in some(whosmat(tmp_path / "run.mat")))
    again = lw.read_record(tmp_path / "run.mat")
    assert again.channels == names and np.array_equal(again.values, values)


# HDF5 ----------------------------------------------------------------------------------------------------------


def test_hdf5_flat_data_sets_with_units(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    with h5py.File(path, "w") as file:
        file["t"], file["x:m1"], file["a:m2"], file["force:m1"] = T, 1e3 * X, A, F
        file["label"] = "as measured"
        file["x:m1"].attrs["units"] = b"mm"
        file["a:m2"].attrs["unit"] = "m/s^2"
    record = lw.read_record(path)
    assert set(record.channels) == {"x:m1", "a:m2", "force:m1"}
    assert record.channel("x:m1") == pytest.approx(X, rel=1e-15)
    assert np.array_equal(record.channel("a:m2"), A)
    with h5py.File(path, "w") as file:  # a stated rate that contradicts the time gives way
        file["time"], file["x:m1"], file.attrs["rate"] = T, X, 2.0 * RATE
    check(lw.read_record(path), ("x:m1",))


def test_hdf5_groups_a_rate_at_the_root_and_a_later_layout(record: lw.Record, tmp_path: Path) -> None:
    path = tmp_path / "run.hdf5"
    with h5py.File(path, "w") as file:
        file["day 1/rig/x:m1"] = X
        file["day 1/rig/probe"] = F
        file.attrs["rate"] = RATE
    check(lw.read_record(path, channels={"force:m1": "day 1/rig/probe"}), ("force:m1", "x:m1"))
    lw.write_record(record, path)
    with h5py.File(path, "a") as file:
        file.attrs["version"] = 99
    message = r"by a later version of linkwise \(layout 99; this version reads up to 1\)"
    with pytest.raises(lw.RecordError, match=message):
        lw.read_record(path)


# Parquet, UFF, TDMS --------------------------------------------------------------------------------------------


def test_parquet_with_nulls_integers_and_text(tmp_path: Path) -> None:
    path = tmp_path / "run.parquet"
    steps = [None if i == 5 else i % 7 for i in range(N)]
    table = pyarrow.table({"time": T, "x:m1[mm]": X, "x:m2": steps, "day": ["mon"] * N, "v:m1": ["fast"] * N})
    parquet.write_table(table, path)
    record = lw.read_record(path, channels={"v:m1[m/s]": "x:m1"})
    assert record.channels == ("v:m1", "x:m2")
    assert np.argwhere(record.missing).tolist() == [[5, 1]]
    with pytest.raises(lw.RecordError, match="channel v:m1: 'fast' is not a number"):
        lw.read_record(path)


def test_uff_58_by_name_by_node_and_by_mapping(tmp_path: Path) -> None:
    path = tmp_path / "run.uff"
    step = 1.0 / RATE
    hammer = Response("hammer", F, step, 13, 1, "N")
    universal(
        path,
        [Response("x:m1", 1e3 * X, step, 8, unit="mm"), Response("NONE", A, step, 12, 2, "m/s^2"), hammer],
    )
    record = lw.read_record(path, channels={"force:m1": "hammer"})
    assert record.channels == ("force:m1", "x:m1", "a:2")
    assert record.rate == RATE
    # The ASCII format is written with 12 significant digits.
    for name, expected in (("x:m1", X), ("a:2", A), ("force:m1", F)):
        assert record.channel(name) == pytest.approx(expected, rel=1e-11, abs=1e-15)
    universal(path, [Response("x:m1", X, step, unit="m"), Response("x:m2", A, 0.5 / RATE, unit="m")])
    with pytest.raises(lw.RecordError, match=r"channel x:m2\[m\]: has a different time axis than x:m1\[m\]"):
        lw.read_record(path)


@pytest.mark.parametrize(("step", "rate"), [(1.0 / 48000.0, 48000.0), (T, RATE)])
def test_uff_58_rate_from_six_digits_or_a_time_column(tmp_path: Path, step: Any, rate: float) -> None:
    universal(tmp_path / "run.unv", [Response("x:m1", X, step)])
    record = lw.read_record(tmp_path / "run.unv")
    assert record.rate == rate
    assert record.channel("x:m1") == pytest.approx(X, rel=1e-11, abs=1e-15)


STRAIN = Path(__file__).parents[3] / "shared" / "cases" / "tdms-strain"


def test_tdms_with_a_waveform_step_with_a_time_channel_and_with_a_text_that_cannot_be_decoded(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "run.tdms"
    channels = {"x:m1": (X, "m"), "a:m2": (A, "m/s^2"), "probe": (F, "N")}
    lab_view(path, channels, wf_increment=1.0 / RATE, wf_start_offset=0.5)
    record = lw.read_record(path, channels={"force:m1": "probe"})
    check(record, ("force:m1", "x:m1", "a:m2"))
    assert record.start == 0.5
    lab_view(path, {"time": (1000.0 * T, "ms"), "x:m1": (X, "")})
    check(lw.read_record(path), ("x:m1",))
    lab_view(path, {"x:m1": (X, "m")}, wf_increment=1.0 / RATE, remark="sound")
    path.write_bytes(path.read_bytes().replace(b"sound", b"\x87ound"))
    damaged = lw.read_record(path)
    check(damaged, ("x:m1",))
    assert damaged.notes[0].startswith("nptdms: Error decoding string from bytes")
    assert not caplog.records


@pytest.mark.parametrize("kind", ["Reciprocal", "PieceWisePolynomial"])
def test_tdms_with_a_scale_that_the_library_does_not_know_is_refused(kind: str, tmp_path: Path) -> None:
    """It gives counts for what the file states to be in the unit of the channel."""
    path = tmp_path / "run.tdms"
    counts = (1000.0 * X).astype(np.int16)
    scale: dict[str, Any] = {
        "wf_increment": 1.0 / RATE,
        "NI_Scaling_Status": "unscaled",
        "NI_Number_Of_Scales": 1,
    }
    scale |= {"NI_Scale[0]_Scale_Type": kind, f"NI_Scale[0]_{kind}_Input_Source": 2**32 - 1}
    lab_view(path, {"x:m1": (counts, "mm")}, **scale)
    with pytest.raises(
        lw.RecordError, match=f"the samples of 'x:m1' are counts, which a scale of the kind {kind}"
    ):
        lw.read_record(path)
    lab_view(path, {"x:m1": (1000.0 * X, "mm")}, **{**scale, "NI_Scaling_Status": "scaled"})
    assert lw.read_record(path).channel("x:m1") == pytest.approx(X, rel=1e-12)
    linear = {key.replace(kind, "Linear"): value for key, value in scale.items()}
    linear |= {"NI_Scale[0]_Scale_Type": "Linear", "NI_Scale[0]_Linear_Slope": 1e-3}
    linear["NI_Scale[0]_Linear_Y_Intercept"] = 0.0
    lab_view(path, {"x:m1": (counts, "m")}, **linear)
    assert lw.read_record(path).channel("x:m1") == pytest.approx(1e-3 * counts, rel=1e-12)


@pytest.mark.skipif(not STRAIN.exists(), reason="the shared cases are not here")
def test_shared_scales_of_tdms_are_read_told_or_refused() -> None:
    a = {"a:m1[g]": "Acc1"}
    for kind, name in (("Reciprocal", "reciprocal"), ("PieceWisePolynomial", "piecewise")):
        with pytest.raises(lw.RecordError, match=f"'Acc1' are counts, which a scale of the kind {kind}"):
            lw.read_record(STRAIN / f"{name}.tdms", channels=a)
    assert lw.read_record(STRAIN / "linear.tdms", channels=a).notes == ()
    assert "Acc1 holds a strain" in lw.read_record(STRAIN / "halfbridge.tdms", channels=a).notes[0]


def test_what_a_library_warns_of_is_a_note(tmp_path: Path) -> None:
    """SciPy reads the last of two variables of one name."""
    first, second = tmp_path / "first.mat", tmp_path / "second.mat"
    savemat(first, {"fs": RATE, "x_m1": X})
    savemat(second, {"x_m1": 2.0 * X})
    first.write_bytes(first.read_bytes() + second.read_bytes()[128:])
    record = lw.read_record(first)
    assert np.array_equal(record.channel("x:m1"), 2.0 * X)
    assert record.notes[0].startswith('While reading: Duplicate variable name "x_m1" in stream')
