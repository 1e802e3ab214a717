"""Damaged files whose libraries crash or never end: an error of the file, and this process lives."""

from collections.abc import Callable
from pathlib import Path
from struct import pack

import numpy as np
import pytest
import scipy.io
import scipy.sparse

import linkwise as lw

TIME = np.arange(40) / 100.0
X = np.sin(20.0 * TIME)
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
