"""Matrices as finite-element programs write them: Abaqus, and Nastran's DMIG and OUTPUT4."""

from collections.abc import Callable
from itertools import product
from pathlib import Path

import numpy as np
import pandas
import pytest
import scipy
from present import some

import linkwise as lw
from linkwise.arrays import Floats

with np.printoptions():  # which the library changes
    from pyyeti import nastran
    from pyyeti.nastran import op4

STEP = 3  # between the labels of nodes
WRITTEN = 1e-12  # a hundred times the rounding of 15 digits, for sums of them
SIZE = 12  # degrees of freedom: displacement z and rotation ry of six nodes


def matrices() -> tuple[Floats, Floats]:
    """A mass and a stiffness matrix, both full of numbers that are all different."""
    random = np.random.default_rng(5)
    first, second = random.normal(size=(2, SIZE, SIZE))
    return first @ first.T + np.eye(SIZE), 1e4 * (second @ second.T + np.eye(SIZE))


def degrees() -> list[tuple[int, int]]:
    """Node and direction of each row."""
    return [(10 + STEP * (row // 2), 3 + 2 * (row % 2)) for row in range(SIZE)]


def abaqus(path: Path, matrix: Floats, order: Callable[[list[str]], list[str]] = list) -> None:
    """One triangle, as *MATRIX OUTPUT writes it."""
    lines = [
        f"{degrees()[row][0]},{degrees()[row][1]}, {degrees()[column][0]},{degrees()[column][1]},  {matrix[row, column]:.14e}"
        for row in range(SIZE)
        for column in range(row + 1)
    ]
    path.write_text("** written by a test\n" + "\n".join(order(lines)) + "\n")


def test_abaqus_names_nodes_and_directions(tmp_path: Path) -> None:
    mass, stiffness = matrices()
    abaqus(tmp_path / "m.mtx", mass, lambda lines: lines[::-1])
    abaqus(tmp_path / "k.mtx", stiffness)
    read = lw.modal.read_host_matrices("m.mtx", "k.mtx", folder=tmp_path)
    assert read.names[:3] == ("10z", "10ry", "13z")
    np.testing.assert_allclose(read.mass.toarray(), mass, rtol=WRITTEN)
    np.testing.assert_allclose(read.stiffness.toarray(), stiffness, rtol=WRITTEN)
    assert read.total_mass == pytest.approx(mass[::2, ::2].sum(), rel=WRITTEN)  # all in z
    by_name = read.reduce("beam", {"tip": "25ry", "root": "10z"}, keep=3)
    sparse = [scipy.sparse.csc_array(matrix) for matrix in (mass, stiffness)]
    by_row = lw.modal.HostMatrices(*sparse).reduce("beam", {"tip": SIZE, "root": 1}, keep=3)
    assert by_name.host.points == by_row.host.points
    for mode, other in zip(some(by_name.host.modes), by_row.host.modes, strict=True):
        # signs and eigenvectors of one routine: rounding
        assert dict(mode.shape) == pytest.approx(dict(other.shape), rel=1e-6)
    with pytest.raises(lw.StructureError, match=r'the point "tip" is 25x, .* nearest are 25'):
        read.reduce("beam", {"tip": "25x"})
    # what Abaqus holds fixed is left out
    stiffness[0, 0] += 1e36
    abaqus(tmp_path / "k.mtx", stiffness)
    read = lw.modal.read_host_matrices("m.mtx", "k.mtx", folder=tmp_path)
    np.testing.assert_allclose(read.mass.toarray(), mass[1:, 1:], rtol=WRITTEN)
    np.testing.assert_allclose(read.stiffness.toarray(), stiffness[1:, 1:], rtol=WRITTEN)
    with pytest.raises(lw.StructureError, match="not held fixed"):
        read.reduce("beam", {"root": "10z"})


def test_coordinates_keep_the_numbers_of_the_file(tmp_path: Path) -> None:
    mass, stiffness = matrices()
    stiffness[2, 2] += 1e36
    for name, matrix in (("m", mass), ("k", stiffness)):
        both = product(range(SIZE), repeat=2)  # triangles
        entries = [f"{i + 1:6d} {j + 1:6d} {matrix[i, j]:.14e}" for i, j in both]
        (tmp_path / f"{name}.mtx").write_text("\n".join(entries) + "\n")
    read = lw.modal.read_host_matrices("m.mtx", "k.mtx", "m.mtx", folder=tmp_path)
    np.testing.assert_allclose(read.mass.toarray(), np.delete(np.delete(mass, 2, 0), 2, 1), rtol=WRITTEN)
    assert read.damping is not None
    np.testing.assert_array_equal(read.damping.toarray(), read.mass.toarray())
    assert read.names == tuple(str(row) for row in range(1, SIZE + 1) if row != 3)
    with pytest.raises(lw.StructureError, match="rows 1 to 12, counted from 1; rows that are held fixed"):
        read.reduce("beam", {"mid": 3})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("*MATRIX,TYPE=STIFFNESS\n1.0\n", r"let Abaqus write the matrices of the whole model with \*MATRIX GENERATE"),
        ("1, 2\n", "its first line holds 2 values"),
        ("", "its first line holds 0 values"),
        ("1,1,1,1,2.0\n2,1,2,1\n", "the number of columns changed from 5 to 4 at row 2"),
        ("1,1,1,1,2.0\n1,1,1,one,2.0\n", "cannot be read as a .mtx file"),
        ("1,1,1,1,2.0\n1,1,1,1,2.0\n", "row 1 and column 1 is given twice"),
        ("1.5,1,1,1,2.0\n", "not a whole number"),
        ("0 1 2.0\n", "not a whole number from 1"),
        ("1,1,1,1,2.0\n2,1,2,1,2.1", "ends within a line and may be cut off"),
    ],
)  # fmt: skip
def test_a_file_that_abaqus_did_not_write_is_told(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "k.mtx").write_text(text)
    with pytest.raises(lw.StructureError, match=message) as error:
        lw.modal.read_matrix("k.mtx", tmp_path)
    assert "usecols" not in str(error.value)  # an argument of a library


def test_nastran_punches_and_outputs_matrices(tmp_path: Path) -> None:
    mass, stiffness = matrices()
    index = pandas.MultiIndex.from_tuples(degrees(), names=["id", "dof"])
    frames = {
        name: pandas.DataFrame(matrix, index=index, columns=index)
        for name, matrix in (("MAAX", mass), ("KAAX", stiffness))
    }
    nastran.wtdmig(str(tmp_path / "beam.pch"), frames)
    read = lw.modal.read_host_matrices("beam.pch:MAAX", "beam.pch:KAAX", folder=tmp_path)
    assert read.names[-2:] == ("25z", "25ry")
    np.testing.assert_allclose(read.stiffness.toarray(), stiffness, rtol=1e-8)  # ten digits are written
    written = {"maa": scipy.sparse.csr_array(mass), "kaa": stiffness}
    op4.write(str(tmp_path / "beam.op4"), written, sparse="auto")
    read = lw.modal.read_host_matrices("beam.op4:MAA", "beam.op4:KAA", folder=tmp_path)
    np.testing.assert_allclose(read.mass.toarray(), mass, rtol=WRITTEN)
    np.testing.assert_allclose(read.stiffness.toarray(), stiffness, rtol=WRITTEN)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("beam.bdf", b"BEGIN BULK\nGRID,1,,0.,0.,0.\nENDDATA\n", "holds no matrices"),
        ("beam.bdf", b"DMIG    KAAX           0       6       2       0\nDMIG*   KAAX      ", "ends within a line and may be"),
        ("bad.op4", b"\x00\x01DMIG* no more\xff" * 40, "bad.op4"),
        ("bad.pch", b"\x00\x01DMIG* no more\xff" * 40, "bad.pch"),
    ],
)  # fmt: skip
def test_a_nastran_file_without_matrix_is_told(
    tmp_path: Path, name: str, content: bytes, message: str
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(lw.StructureError, match=message):
        lw.modal.read_matrix(f"{name}:KAA", tmp_path)
