"""Hosts from matrices: receptances of a beam, free structures, and what is refused."""

from pathlib import Path

import numpy as np
import pytest
import scipy
from present import some

import linkwise as lw

# of cos(r) cosh(r) = -1
ROOTS = np.array([1.8751041, 4.6940911, 7.8547574, *((np.arange(4, 2000) - 0.5) * np.pi)])
# of the sum over the modes from the fourth on, of which 1999 are counted: the rest is 1e-10 of it
LEFT_OUT = 1e-4

Matrices = tuple[scipy.sparse.csc_array, scipy.sparse.csc_array]


def beam(elements: int = 40, *, clamped: bool = True) -> Matrices:
    """Mass and stiffness of a beam of Euler-Bernoulli elements: displacement and slope at every node, in order."""
    length, bending, line_mass = 1.0 / elements, 11.2, 0.324  # 1 m of aluminium, 30 mm by 4 mm
    h = length
    stiffness = bending / h**3 * np.array(
        [[12, 6 * h, -12, 6 * h], [6 * h, 4 * h**2, -6 * h, 2 * h**2],
         [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h**2, -6 * h, 4 * h**2]]
    )  # fmt: skip
    mass = line_mass * h / 420 * np.array(
        [[156, 22 * h, 54, -13 * h], [22 * h, 4 * h**2, 13 * h, -3 * h**2],
         [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h**2, -22 * h, 4 * h**2]]
    )  # fmt: skip
    size = 2 * elements + 2
    K, M = scipy.sparse.lil_array((size, size)), scipy.sparse.lil_array((size, size))
    for element in range(elements):
        own = slice(2 * element, 2 * element + 4)
        K[own, own] += stiffness
        M[own, own] += mass
    first = 2 if clamped else 0
    return scipy.sparse.csc_array(M[first:, first:]), scipy.sparse.csc_array(K[first:, first:])


def receptance(host: lw.Host, frequency: float) -> float:
    """Displacement of the first point for a unit force there, at a frequency in Hz, undamped."""
    omega2 = (2.0 * np.pi * frequency) ** 2
    return sum(
        next(iter(mode.shape.values())) ** 2 / ((2.0 * np.pi * (mode.frequency.value or 0.0)) ** 2 - omega2)
        for mode in host.modes
    )


def test_residual_modes_keep_the_flexibility_of_those_left_out() -> None:
    mass, stiffness = beam()
    unit = np.zeros(80)
    unit[78] = 1.0
    # at rest but for rounding, with matrices of condition 1e9
    for frequency, limit in ((0.0, 1e-6), (30.0, 1e-4)):
        matrix = stiffness - (2.0 * np.pi * frequency) ** 2 * mass
        exact = scipy.sparse.linalg.spsolve(scipy.sparse.csc_array(matrix), unit)[78]
        matrices = lw.modal.HostMatrices(mass, stiffness)
        with_residual = matrices.reduce("beam", {"tip": 79}, keep=3)
        without = matrices.reduce("beam", {"tip": 79}, keep=3, residual=False)
        assert receptance(with_residual.host, frequency) == pytest.approx(exact, rel=limit)
        # under a force at its tip the modes of a cantilever take 12 / root^4 of the static deflection L^3 / (3 EI)
        fourth = ROOTS[3:] ** 4
        parts = 12.0 / fourth / (1.0 - (2.0 * np.pi * frequency) ** 2 / (11.2 / 0.324 * fourth))
        missing = exact - receptance(without.host, frequency)
        assert missing * 3.0 * 11.2 == pytest.approx(parts.sum(), rel=LEFT_OUT)
        # at half the frequency of the first mode that was left out a quarter of its part and less is not static
        assert without.error >= 4.0 * with_residual.error


@pytest.mark.slow
def test_a_model_is_the_same_large_in_any_sparse_format_and_in_single_precision() -> None:
    """Its frequencies are (root)^2 sqrt(EI/m)/(2 pi L^2); 400 elements are past the size of dense matrices."""
    points = {"tip": 79, "mid": 39}
    host = lw.modal.HostMatrices(*beam()).reduce("beam", points, keep=3).host
    frequencies = [mode.frequency.value or 0.0 for mode in host.modes[:2]]
    expected = ROOTS[:2] ** 2 * np.sqrt(11.2 / 0.324) / (2.0 * np.pi)
    np.testing.assert_allclose(frequencies, expected, rtol=1e-6)  # 40 cubic elements are off by less
    large = lw.modal.HostMatrices(*beam(400)).reduce("beam", {"tip": 799, "mid": 399}, keep=3).host
    for coarse, fine in zip(host.modes[:3], large.modes[:3], strict=True):
        assert coarse.frequency.value == pytest.approx(fine.frequency.value, rel=1e-5)
        ratios = [abs(mode.shape["mid"] / mode.shape["tip"]) for mode in (coarse, fine)]
        assert ratios[0] == pytest.approx(ratios[1], rel=1e-3)
    for form in ("csr_array", "coo_array", "csr_matrix"):
        mass, stiffness = (getattr(scipy.sparse, form)(matrix) for matrix in beam())
        assert host == lw.modal.HostMatrices(mass, stiffness).reduce("beam", points, keep=3).host
    mass, stiffness = (scipy.sparse.csr_array(matrix, dtype=np.float32) for matrix in beam())
    single = lw.modal.HostMatrices(mass, stiffness).reduce("beam", points, keep=3).host
    assert single.modes[2].frequency.value == pytest.approx(host.modes[2].frequency.value, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("elements", "rel"), [(40, 1e-6), (130, 1e-3), (170, 1e-3), (600, 1e-3)])
def test_a_free_beam_has_rigid_modes(elements: int, rel: float) -> None:
    """Of a long one the largest eigenvalue is 1e11 to 1e14 times the first elastic one, that of a free beam."""
    matrices = lw.modal.HostMatrices(*beam(elements, clamped=False))
    reduced = matrices.reduce("beam", {"tip": 2 * elements + 1}, keep=4)
    frequencies = [mode.frequency.value for mode in reduced.host.modes]
    assert frequencies[:2] == [0.0, 0.0]
    assert frequencies[2] == pytest.approx(4.7300407**2 * np.sqrt(11.2 / 0.324) / (2.0 * np.pi), rel=rel)
    # the rigid motion under a unit force at the tip of a free rod of mass m: (1 + 3)/m of its end
    rigid = sum(mode.shape["tip"] ** 2 for mode in reduced.host.modes[:2])
    assert rigid == pytest.approx(4.0 / 0.324, rel=rel)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"points": {"tip": 81}}, "rows 1 to 80, counted from 1"),
        ({"points": {}}, "at least one point"),
        ({"keep": 0}, "at least 1, got 0"),
        ({"modal_damping": 0.01, "rayleigh": (0.1, 0.0)}, "not both"),
        ({"mass": beam(3)[0]}, "they belong to different models"),
        ({"stiffness": scipy.sparse.csc_array(np.triu(beam()[1].toarray()))}, "is not symmetric: row "),
        ({"stiffness": -1.0 * beam()[1]}, "negative eigenvalues"),
        ({"mass": -1.0 * beam()[0]}, "positive semidefinite"),
        ({"mass": beam()[1], "stiffness": beam()[0]}, "mass and stiffness may be swapped"),
        ({"stiffness": (1.0 + 0.02j) * beam()[1]}, "complex128 values, not real numbers"),
        ({"mass": beam()[0][:, :60]}, "must be square, got the shape (80, 60)"),
        ({"stiffness": np.nan * beam()[1]}, "the stiffness matrix holds nan, not a finite number, in row 1 and column 1"),
        ({"mass": beam(clamped=False)[1], "stiffness": beam(clamped=False)[0]}, "swapped"),
    ],
)  # fmt: skip
def test_matrices_that_are_no_host_are_refused(change: dict[str, object], message: str) -> None:
    mass, stiffness = beam()
    given = {"mass": mass, "stiffness": stiffness, "points": {"tip": 79}, "keep": 3, **change}
    with pytest.raises(lw.StructureError) as error:
        lw.modal.HostMatrices(given.pop("mass"), given.pop("stiffness")).reduce("beam", **given)
    assert message in str(error.value)


def test_matrices_are_read_from_each_format_and_of_different_models_are_refused(tmp_path: Path) -> None:
    mass, stiffness = beam(5)
    scipy.io.savemat(tmp_path / "beam.mat", {"M": mass.tocsc(), "K": stiffness.toarray(), "title": "beam"})
    np.savez(tmp_path / "beam.npz", M=mass.toarray(), K=np.eye(2))
    scipy.sparse.save_npz(tmp_path / "sparse.npz", mass)
    scipy.io.mmwrite(tmp_path / "mass.mtx", mass)
    for named in ("beam.mat:M", "beam.npz:M", "sparse.npz", "mass.mtx"):
        read = lw.modal.read_matrix(named, tmp_path).toarray()
        np.testing.assert_allclose(read, mass.toarray(), rtol=1e-12)
    np.savez(tmp_path / "other.npz", K=np.eye(4))
    for named in ("beam.npz:K", "other.npz"):
        with pytest.raises(lw.StructureError, match=f"beam.npz:M and {named}: the mass matrix has 10 rows"):
            lw.modal.read_host_matrices("beam.npz:M", named, folder=tmp_path)


@pytest.mark.parametrize(
    ("named", "message"),
    [
        ("no.mat:M", "there is no such file"),
        ("beam.mat:Q", "holds no matrix 'Q'; choose from"),
        ("beam.mat", "holds several matrices; choose from"),
        ("bad.mat:M", "cannot be read as a .mat file"),
        ("bad.npz:M", "cannot be read as a .npz file"),
        ("wide.npz:W", "wide.npz: W must be square, got the shape (2, 3)"),
        ("complex.npz:K", "holds complex128 values, not real numbers"),
        ("gap.npz", "gap.npz: K holds nan, not a finite number, in row 2 and column 3"),
        ("bad.txt:M", "are read from .mat, .npz, .mtx, .pch, .dmig, .bdf and .op4 files"),
    ],
)
def test_a_wrong_matrix_file_is_told(tmp_path: Path, named: str, message: str) -> None:
    scipy.io.savemat(tmp_path / "beam.mat", {"M": np.eye(3), "K": np.eye(3)})
    np.savez(tmp_path / "wide.npz", W=np.ones((2, 3)))
    gap = np.eye(3)
    gap[1, 2] = np.nan
    np.savez(tmp_path / "gap.npz", K=gap)
    np.savez(tmp_path / "complex.npz", K=np.eye(3) * (1.0 + 0.01j))
    for name in ("bad.mat", "bad.npz", "bad.txt"):
        (tmp_path / name).write_bytes(b"MATLAB 5.0 MAT-file no more" * 20)
    with pytest.raises(lw.StructureError) as error:
        lw.modal.read_matrix(named, tmp_path)
    assert message in str(error.value)


def test_a_structure_file_names_matrices_and_tells_what_their_reduction_leaves_out(tmp_path: Path) -> None:
    mass, stiffness = beam()
    np.savez(tmp_path / "beam.npz", M=mass.toarray(), K=stiffness.toarray())
    text = (
        '[[host]]\nname = "beam"\npoints = { tip = "79", rotated = "-1*80" }\nkeep = 3\nmodal_damping = 0.01\n'
        'matrices = { mass = "beam.npz:M", stiffness = "beam.npz:K" }\n'
    )
    path, points = tmp_path / "beam.toml", {"tip": "79", "rotated": "-1*80"}
    matrices = lw.modal.HostMatrices(mass, stiffness, None, tuple(map(str, range(1, 81))))
    path.write_text(text)
    host = lw.read_structure(path).hosts[0]
    reduced = matrices.reduce("beam", points, keep=3, modal_damping=0.01)
    assert host == reduced.host and host.notes == reduced.notes
    assert f"{100.0 * reduced.error:.2g} %" in host.notes[0] and len(host.notes) == 1
    path.write_text(text.replace("keep = 3", "keep = 1"))
    coarse = matrices.reduce("beam", points, keep=1)
    assert lw.read_structure(path).hosts[0].notes == coarse.notes != reduced.notes
    path.write_text(text[: text.index("matrices")])
    with pytest.raises(lw.StructureError, match="either modes or matrices"):
        lw.read_structure(path)


def lumped(elements: int) -> Matrices:
    """A clamped beam whose mass is lumped at its nodes: rotations have none."""
    stiffness = beam(elements)[1]
    of_nodes = np.zeros(2 * elements)
    of_nodes[0::2] = 0.324 / elements
    of_nodes[-2] /= 2.0
    return scipy.sparse.csc_array(np.diag(of_nodes)), stiffness


@pytest.mark.parametrize("elements", [20, 250])
def test_rotations_without_mass_follow_statically(elements: int) -> None:
    """The modes are those of the matrices condensed to the degrees of freedom with mass."""
    mass, stiffness = lumped(elements)
    points = {"tip": 2 * elements - 1, "slope": 2 * elements}
    host = lw.modal.HostMatrices(mass, stiffness).reduce("beam", points, keep=4).host
    K = stiffness.toarray()
    condensed = K[::2, ::2] - K[::2, 1::2] @ np.linalg.solve(K[1::2, 1::2], K[1::2, ::2])
    squares, shapes = scipy.linalg.eigh(condensed, mass.toarray()[::2, ::2], subset_by_index=(0, 3))
    slopes = -np.linalg.solve(K[1::2, 1::2], K[1::2, ::2] @ shapes)
    for mode, square, shape, slope in zip(some(host.modes[:4]), squares, shapes.T, slopes.T, strict=True):
        assert mode.frequency.value == pytest.approx(np.sqrt(square) / (2.0 * np.pi), rel=1e-6)
        assert abs(mode.shape["tip"]) == pytest.approx(abs(shape[-1]), rel=1e-5)
        assert abs(mode.shape["slope"]) == pytest.approx(abs(slope[-1]), rel=1e-5)


def damped(damping: scipy.sparse.csc_array) -> lw.modal.HostMatrices:
    """A beam of ten elements with this damping matrix."""
    mass, stiffness = beam(10)
    return lw.modal.HostMatrices(mass, stiffness, damping, tuple(map(str, range(1, 21))))


def test_names_are_one_to_a_row_and_what_neither_weighs_nor_holds_is_named() -> None:
    mass, stiffness = beam(10)
    for names in (("1", "2"), ("1",) * 20):
        with pytest.raises(lw.StructureError, match="different names are given for 20 degrees of freedom"):
            lw.modal.HostMatrices(mass, stiffness, None, names)
    nothing = scipy.sparse.csc_array(np.diag([1.0, 0.0]))
    with pytest.raises(lw.StructureError, match="7rz has neither mass nor stiffness"):
        lw.modal.HostMatrices(nothing, nothing, None, ("7x", "7rz")).reduce("post", {"tip": "7x"})


@pytest.mark.parametrize(
    ("damping", "modal_damping", "message"),
    [
        (beam(10)[1], 0.01, "give a damping matrix, or modal or Rayleigh damping, not both"),
        (-1.0 * beam(10)[1], 0.0, "feeds energy into a mode"),
        (beam(5)[1], 0.0, "the mass matrix has 20 rows and the damping matrix 10"),
        (1j * beam(10)[1], 0.0, "the damping matrix holds complex128 values"),
    ],
)
def test_wrong_damping_is_refused(
    damping: scipy.sparse.csc_array, modal_damping: float, message: str
) -> None:
    with pytest.raises(lw.StructureError, match=message):
        damped(damping).reduce("beam", {"tip": 19}, modal_damping=modal_damping)


def two_and_two() -> Matrices:
    """Two directions of one node with the same frequency, and one of another with twice that."""
    return scipy.sparse.eye_array(3).tocsc(), scipy.sparse.diags_array([100.0, 100.0, 400.0]).tocsc()


def test_an_oblique_direction_is_a_point() -> None:
    """A force along (0.6, 0.8) moves the node by 0.36/100 + 0.64/400 along it; against a coordinate system turned by that."""
    mass, stiffness = scipy.sparse.eye_array(2).tocsc(), scipy.sparse.diags_array([100.0, 400.0]).tocsc()
    matrices = lw.modal.HostMatrices(mass, stiffness, None, ("7x", "7y"))
    points = {"along": "0.6*7x + 0.8*7y", "across": "-0.8*7x+0.6*7y", "x": "7x", "against": "-7x"}
    reduced = matrices.reduce("post", points, keep=2)
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    turned = lw.modal.HostMatrices(
        scipy.sparse.csc_array(turn.T @ mass @ turn),
        scipy.sparse.csc_array(turn.T @ stiffness @ turn),
        None,
        ("7x", "7y"),
    ).reduce("post", {"along": "7x", "across": "7y"}, keep=2)
    for mode, other in zip(some(reduced.host.modes), turned.host.modes, strict=True):
        assert mode.frequency.value == pytest.approx(other.frequency.value, rel=1e-12)
        products = [shape["along"] * shape["across"] for shape in (mode.shape, other.shape)]  # of either sign
        assert products[0] == pytest.approx(products[1], rel=1e-12)
    assert receptance(reduced.host, 0.0) == pytest.approx(0.36 / 100.0 + 0.64 / 400.0, rel=1e-12)
    for mode in some(reduced.host.modes):
        assert mode.shape["against"] == -mode.shape["x"]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("7x + 7y", r"squares add up to 2, not 1; write \"\+0.7071\*7x \+0.7071\*7y\""),
        ("7x - 7x", "does not move"),
        ("0.6*7x + 0.8*7w", r"is 0.6\*7x \+ 0.8\*7w, but its file names points"),
        ("0.6 7x", "is 0.6 7x, but its file names points"),
    ],
)
def test_a_point_that_is_no_direction_is_refused(given: str, message: str) -> None:
    matrices = lw.modal.HostMatrices(*two_and_two(), None, ("7x", "7y", "8x"))
    with pytest.raises(lw.StructureError, match=message):
        matrices.reduce("post", {"tip": given}, keep=1)
    moved = matrices.reduce("post", {"tip": "0.5*7x + 0.5*8x"}, keep=3)  # a mean of nodes is no direction
    assert sum(mode.shape["tip"] ** 2 for mode in moved.host.modes) == pytest.approx(0.5)


def test_what_has_no_mass_is_counted() -> None:
    """A mass matrix that was cut off leaves degrees of freedom without mass, and they follow statically in silence."""
    stiffness = scipy.sparse.csc_array(1e4 * (2.0 * np.eye(6) - np.eye(6, k=1) - np.eye(6, k=-1)))
    whole, cut = (scipy.sparse.diags_array([0.1] * 4 + [last] * 2).tocsc() for last in (0.1, 0.0))
    assert len(lw.modal.HostMatrices(whole, stiffness).reduce("rod", {"mid": 3}, keep=2).notes) == 1
    reduced = lw.modal.HostMatrices(cut, stiffness).reduce("rod", {"mid": 3}, keep=2)
    assert reduced.massless == 2 and "2 degrees of freedom have no mass" in reduced.notes[1]
