"""Damaged files, and channels that a file holds and a reader cannot have: told, by an error or a note, and never lost."""

import os
from collections.abc import Callable
from dataclasses import replace
from errno import ENOSPC
from pathlib import Path
from struct import pack
from typing import Any

import h5py
import numpy as np
import pyarrow
import pytest
import scipy.io
import scipy.sparse
from commands import refusal
from foreign_files import Response, lab_view, universal
from pyarrow import parquet
from scipy.io import loadmat, savemat

import linkwise as lw

N = 64
TIME = np.arange(N) / 100.0
X, Y = np.sin(20.0 * TIME), np.cos(23.0 * TIME)
HEADER = b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM"


def element(kind: int, data: bytes) -> bytes:
    """An element of a MAT file of version 5."""
    return pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def matrix(mclass: int, dimensions: tuple[int, ...], *more: bytes) -> bytes:
    """A matrix x_m1 of the class with elements after its name."""
    flags, size = element(6, pack("<II", mclass, 0)), element(5, pack(f"<{len(dimensions)}i", *dimensions))
    return element(14, b"".join([flags, size, element(1, b"x_m1"), *more]))


def nested(depth: int) -> bytes:
    return matrix(1, (1, 1), nested(depth - 1)) if depth else matrix(6, (1, 1), element(9, bytes(8)))


COLUMNS = [element(5, pack("<3i", 0, 1, 0)), element(5, pack("<4i", 0, 900_000, 0, 0)), element(9, bytes(24))]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (matrix(6, (2, 1), element(99, bytes(16))), "an element is of the unknown type 99"),
        (matrix(6, (2, 1), pack("<II", 9, 1 << 20)), "an element of 1048576 bytes runs past its end"),
        (matrix(6, (2, 1)), "a matrix of class 6 has 3 elements"),
        (matrix(99, (2, 1)), "a matrix of class 99 has 3 elements"),
        (matrix(6, (-2, 1), element(9, bytes(16))), "a matrix states dimensions of -2 x 1"),
        (matrix(4, (1 << 30, 4), element(16, b"")), "a matrix states dimensions of 1073741824 x 4"),
        (matrix(4, (), element(16, b"text")), "a matrix states dimensions of "),
        (matrix(1, (3, 1), nested(0)), "a matrix of class 1 holds 1 others, not 3"),
        (matrix(2, (1, 1), element(5, pack("<i", 0)), element(1, b"a\0")), "a struct states no width of its names"),
        (nested(60), "matrices within matrices do not end where they state"),
        (element(14, element(5, bytes(8))), "a matrix has no flags"),
        (element(9, bytes(16)), "it is of type 9 and of 16 bytes, not a matrix of 16"),
        (element(15, b"no zlib"), "Error -3 while decompressing"),
        (matrix(5, (3, 3), *COLUMNS), "the columns of a sparse matrix are out of order"),
    ],
)  # fmt: skip
def test_what_a_mat_file_states_is_checked_before_scipy(content: bytes, message: str, tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    path.write_bytes(HEADER + content)
    with pytest.raises(lw.RecordError) as error:
        lw.read_record(path)
    assert message in error.value.message
    assert error.value.message.startswith("cannot be read as a .mat file: ")
    with pytest.raises(lw.StructureError) as refusal:
        lw.modal.read_matrix(str(path))
    assert message in str(refusal.value)
    path.write_bytes(HEADER[:-2] + b"MM" + content)
    with pytest.raises(lw.RecordError, match="its header is damaged"):
        lw.read_record(path)


def test_the_texts_of_an_hdf5_file_are_checked_before_libhdf5_follows_them(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    lw.write_record(lw.Record.from_arrays(TIME, {"x:m1": X}, notes=["A note."]), path)
    content = bytearray(path.read_bytes())
    heap = content.index(b"GCOL")
    content[heap + 16 : heap + 32] = bytes(16)  # an entry of no bytes, after which it looks at the same place
    path.write_bytes(content)
    with pytest.raises(lw.RecordError, match=f"the texts that begin at byte {heap} have no end"):
        lw.read_record(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("array real general\n2 2\n1\n2\n3\n4J", "could not be read to its end|unmatched data"),
        ("array real symmetric\n90000 90000\n1\n", "it states 4050045000 numbers and holds 1"),
        ("coordinate real general\n2 2 2\n1 1 1.0\n", "it states 6 numbers and holds 3"),
        ("coordinate real general\n2 2 1\n1.5 1 1.0\n", "a row or a column is not a whole number"),
        ("coordinate complex general\n2 2 1\n1 1 1 2\n", "its entries are complex, not real numbers"),
        ("coordinate real odd\n2 2 1\n1 1 1\n", "its symmetry is 'odd'"),
    ],
)
def test_what_a_matrix_market_file_states_is_what_it_holds(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "k.mtx").write_text(f"%%MatrixMarket matrix {text}")
    with pytest.raises(lw.StructureError, match=message):
        lw.modal.read_matrix("k.mtx", tmp_path)


FULL = np.arange(9.0).reshape(3, 3) + 1.0


@pytest.mark.parametrize("values", [FULL, FULL + FULL.T, FULL - FULL.T], ids=["general", "symmetric", "skew"])
@pytest.mark.parametrize("layout", [np.asarray, scipy.sparse.coo_array])
def test_matrix_market_files_are_read(
    values: np.ndarray, layout: Callable[..., object], tmp_path: Path
) -> None:
    scipy.io.mmwrite(tmp_path / "k.mtx", layout(values), comment="of a test")
    np.testing.assert_array_equal(lw.modal.read_matrix("k.mtx", tmp_path).toarray(), values)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (np.zeros((0, 0)), "empty"),
        (np.arange(64.0).reshape(4, 4, 4), "an array of 4 x 4 x 4"),
        (np.array([Y, Y[:9]], dtype=object), "a number"),
        (Y + 1j * X, "a number"),
        (scipy.sparse.csc_array((100_000, 100_000)), "a sparse matrix of 100000 x 100000"),
    ],
)
def test_mat_variable_that_is_no_row_of_numbers(value: Any, message: str, tmp_path: Path) -> None:
    savemat(tmp_path / "run.mat", {"time": TIME, "x_m1": X, "x_m2": value})
    with pytest.raises(lw.RecordError, match=message) as error:
        lw.read_record(tmp_path / "run.mat", known_masses=["m1", "m2"])
    assert error.value.channel == "x:m2"


@pytest.mark.parametrize("value", [np.zeros((0, 0)), np.arange(64.0).reshape(4, 4, 4)])
def test_mat_variable_that_may_be_something_else_is_in_the_notes(value: Any, tmp_path: Path) -> None:
    savemat(
        tmp_path / "run.mat", {"time": TIME, "x_m1": X, "remainder": value, "comment": "text", "gain": 2.0}
    )
    record = lw.read_record(tmp_path / "run.mat")
    (note,) = record.notes
    assert "remainder (" in note and "comment" not in note and "gain" not in note


@pytest.mark.parametrize("version", ["5", "7.3"])
def test_mat_sparse_vector_is_read(version: str, tmp_path: Path) -> None:
    sparse = scipy.sparse.csc_array(np.where(np.arange(N) % 3 == 0, Y, 0.0)[:, None])
    if version == "5":
        savemat(tmp_path / "run.mat", {"time": TIME, "x_m1": X, "x_m2": sparse})
    else:
        with h5py.File(tmp_path / "run.mat", "w") as file:
            file["time"], file["x_m1"] = TIME[None, :], X[None, :]
            group = file.create_group("x_m2")
            group.attrs["MATLAB_sparse"] = np.uint64(N)
            group["data"], group["ir"], group["jc"] = sparse.data, sparse.indices, sparse.indptr
    record = lw.read_record(tmp_path / "run.mat")
    np.testing.assert_array_equal(record.channel("x:m2"), sparse.toarray()[:, 0])


SETS = [Response("x:m1", X, 0.01), Response("force:m1", Y, 0.01)]
COMPOUND = np.array(list(zip(X, Y, strict=True)), dtype=[("a", "f8"), ("b", "f8")])


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (np.zeros(0), "is empty"),
        (np.float64(3.0), "is a single value"),
        (np.arange(64.0).reshape(4, 4, 4), "is an array of 4 x 4 x 4"),
        (Y + 1j * X, "is not a number"),
        (COMPOUND, "is not a number"),
        (h5py.SoftLink("/nowhere"), "is a link to nothing"),
        (h5py.ExternalLink("other.h5", "x"), "is a link into another file"),
        (h5py.Empty("f8"), "is empty"),
    ],
)
def test_hdf5_data_set_that_is_no_row_of_numbers(value: Any, message: str, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["time"], file["x:m1"], file["x:m2"] = TIME, X, value
    with pytest.raises(lw.RecordError, match=message) as error:
        lw.read_record(tmp_path / "run.h5")
    assert error.value.channel == "x:m2"


@pytest.mark.parametrize("suffix", ["h5", "mat"])
def test_channel_that_our_own_file_states_and_has_not(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"run.{suffix}"
    lw.write_record(lw.Record.from_arrays(TIME, {"x:m1": X, "x:m2": Y}), path)
    if suffix == "h5":
        with h5py.File(path, "a") as file:
            del file["x:m2"]
    else:
        content = loadmat(path)
        savemat(path, {key: value for key, value in content.items() if key != "x_m2" and key[:2] != "__"})
    with pytest.raises(lw.RecordError, match="is missing"):
        lw.read_record(path)


def test_uff_file_that_was_cut_anywhere_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "run.uff"
    universal(path, SETS)
    assert lw.read_record(path).channels == ("x:m1", "force:m1")
    content = path.read_bytes()
    for share in (0.3, 0.6, 0.8, 0.99):
        path.write_bytes(content[: int(share * len(content))])
        with pytest.raises(lw.RecordError, match=r"damaged|cut off|cannot be read|no time response"):
            lw.read_record(path)


def test_uff_data_set_of_another_type_or_function_is_told(tmp_path: Path) -> None:
    path = tmp_path / "run.uff"
    universal(path, [SETS[0], SETS[1]._replace(function=4)])
    assert "Data sets that are not time responses were ignored: force:m1." in lw.read_record(path).notes
    universal(path, SETS)
    head, _, tail = path.read_bytes().rpartition(b"    58")
    path.write_bytes(head + b"    x8" + tail)
    with pytest.raises(lw.RecordError, match="type of data set 2 cannot be read"):
        lw.read_record(path)


def test_tdms_file_that_was_cut_or_whose_segments_are_damaged_is_an_error(tmp_path: Path) -> None:
    """nptdms stops at the first segment that leads nowhere, and says nothing of the channels behind it."""
    path = tmp_path / "run.tdms"
    lab_view(path, {"x:m1": (X, ""), "x:m2": (Y, "")}, wf_increment=0.01)
    content = path.read_bytes()
    assert lw.read_record(path).channels == ("x:m1", "x:m2")
    longer = bytearray(content)
    longer[14] = 1  # of the length of the first segment: 65 536 bytes more
    for damaged in (bytes(longer), content[:-100], content + b"TDS", content[:-1]):
        path.write_bytes(damaged)
        with pytest.raises(lw.RecordError, match=r"damaged"):
            lw.read_record(path)


def test_tdms_file_of_a_program_that_crashed_is_read_with_a_note(tmp_path: Path) -> None:
    path = tmp_path / "run.tdms"
    lab_view(path, {"x:m1": (X, "")}, wf_increment=0.01)
    content = bytearray(path.read_bytes())
    content[12:20] = b"\xff" * 8
    path.write_bytes(content)
    record = lw.read_record(path)
    assert "The last segment of the file has no end: the program that wrote it has crashed." in record.notes


@pytest.mark.parametrize(
    "stated",
    ["{", "[1]", '{"rate": "fast"}', '{"start": []}', '{"noise": {"x:m1": null}}', '{"notes": 3}', "\udcff"],
)
def test_parquet_metadata_that_are_not_ours(stated: str, tmp_path: Path) -> None:
    path = tmp_path / "run.parquet"
    columns = {"time": TIME, "x:m1": X}
    metadata = {b"linkwise record": stated.encode("utf-8", "surrogateescape")}
    schema = pyarrow.schema([(name, pyarrow.float64()) for name in columns], metadata=metadata)
    parquet.write_table(pyarrow.table(columns, schema=schema), path)
    with pytest.raises(lw.RecordError, match="its metadata is not that of a record"):
        lw.read_record(path)


def test_a_record_is_written_through_a_link_and_full_disks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record = lw.Record.from_arrays(TIME, {"x:m1": X})
    (tmp_path / "disk").mkdir()
    (tmp_path / "run.csv").symlink_to(tmp_path / "disk" / "run.csv")
    lw.write_record(record, tmp_path / "run.csv")
    assert (tmp_path / "run.csv").is_symlink()
    assert lw.read_record(tmp_path / "disk" / "run.csv").channels == ("x:m1",)

    def full(*_: object, **__: object) -> None:
        raise OSError(ENOSPC, "No space left on device")

    monkeypatch.setattr("linkwise.files.text.write_csv", full)
    with pytest.raises(lw.RecordError, match=r"run.csv: cannot be written: No space left on device") as error:
        lw.write_record(record, tmp_path / "run.csv")
    assert error.value.exit_code == 1


def test_digits_in_groups_are_no_number(tmp_path: Path) -> None:
    """Python reads 1_5 as 15."""
    rows = [f"{time:g},{x:.17g},{y:.17g}" for time, x, y in zip(TIME, X, Y, strict=True)]
    rows[7] = f"{TIME[7]:g},1_5,0.5"
    (tmp_path / "run.csv").write_text("\n".join(["time,x:m1,x:m2", *rows]))
    with pytest.raises(lw.RecordError, match="'1_5' is not a number") as error:
        lw.read_record(tmp_path / "run.csv")
    assert (error.value.line, error.value.channel) == (9, "x:m1")


@pytest.mark.parametrize("rate", [1e-320, 1e-31, 1e31, 1e300])
def test_a_rate_at_which_nothing_is_measured_is_refused(rate: float, tmp_path: Path) -> None:
    record = lw.Record.from_arrays(TIME, {"x:m1": X, "x:m2": Y})
    with pytest.raises(lw.RecordError, match=r"rate must be between 1e-30 and 1e\+30 Hz"):
        replace(record, rate=rate)
    lw.write_record(record, tmp_path / "run.csv")
    with pytest.raises(lw.RecordError, match=r"rate must be between 1e-30 and 1e\+30 Hz"):
        lw.read_record(tmp_path / "run.csv", rate=rate)
    with pytest.raises(lw.RecordError, match=r"rate must be between|infinite|finite"):
        lw.Record.from_arrays(np.arange(len(X)) / max(rate, 1e-299), {"x:m1": X, "x:m2": Y})


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names")
def test_a_record_does_not_take_the_place_of_a_pipe_or_a_folder(tmp_path: Path) -> None:
    record = lw.Record.from_arrays(TIME, {"x:m1": X})
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "folder.csv").mkdir()
    for name in ("pipe.csv", "folder.csv"):
        with pytest.raises(lw.RecordError, match=rf"{name}: exists and is not a regular file"):
            lw.write_record(record, tmp_path / name)
    assert (tmp_path / "pipe.csv").is_fifo() and (tmp_path / "folder.csv").is_dir()
    assert sorted(os.listdir(tmp_path)) == ["folder.csv", "pipe.csv"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names")
@pytest.mark.parametrize(
    ("place", "message"),
    [
        ("run", "records cannot be written as a file without suffix"),
        ("pipe.csv", "exists and is not a regular file"),
        ("chain.toml/run.csv", "cannot be written"),
        ("x" * 300 + ".csv", "cannot be written: File name too long"),
    ],
)
def test_a_record_that_cannot_be_written_is_refused_before_the_simulation(
    place: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe.csv")
    lw.write_structure(lw.bnes_chain(2), "chain.toml")
    monkeypatch.setattr(lw, "simulate", lambda *_, **__: pytest.fail("simulated"))
    assert message in refusal(f"simulate chain.toml --duration 1 --rate 100 -o {place}")
    assert sorted(os.listdir(tmp_path)) == ["chain.toml", "pipe.csv"]
