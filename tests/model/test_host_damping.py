"""Damping between the modes of hosts: the matrix that a structure has, its file, and what is refused."""

import pickle
from pathlib import Path

import numpy as np
import pytest
import scipy
from structures import structure

import linkwise as lw
from linkwise.arrays import Floats

FREQUENCIES, RATIOS = (5.0, 6.0, 9.0), (0.01, 0.02, 0.015)
SHAPES = np.array([[1.0, 0.4], [-0.8, 0.6], [0.5, -0.7]])  # of each mode at tip and joint
BETWEEN = {(1, 2): 0.4, (3, 2): -0.3}


def host(damping: dict[tuple[int, int], float]) -> lw.Host:
    modes = tuple(
        lw.model.HostMode(frequency, ratio, {"tip": float(tip), "joint": float(joint)})
        for frequency, ratio, (tip, joint) in zip(FREQUENCIES, RATIOS, SHAPES, strict=True)
    )
    return lw.Host("wing", modes, damping=damping)


def damping_matrix(structure: lw.Structure) -> Floats:
    """Of masses and modes, from the links."""
    incidence = structure.incidence.toarray()
    slopes = np.array([link.tangent(0.0)[1] for link in structure.links]).ravel()
    return np.asarray(incidence * slopes @ incidence.T)


@pytest.mark.slow
def test_entries_are_those_of_the_damping_matrix_and_a_run_is_that_of_the_matrices() -> None:
    structure = lw.Structure("wing", (), (), (host(BETWEEN),))
    assert structure.contents == "1 host, 3 modes, 0 masses, 0 links"
    assert pickle.loads(pickle.dumps(structure)) == structure
    expected = np.diag([4.0 * np.pi * f * z for f, z in zip(FREQUENCIES, RATIOS, strict=True)])
    expected[0, 1] = expected[1, 0] = 0.4
    expected[1, 2] = expected[2, 1] = -0.3
    np.testing.assert_allclose(damping_matrix(structure), expected, rtol=1e-12, atol=1e-12)  # rounding
    record = lw.simulate(
        structure,
        forces={"wing.tip": "5*exp(-((t - 0.1)/0.02)**2)"},
        duration=2.0,
        rate=200.0,
        sensors=["x:wing.joint"],
    )
    stiffness, damping = (2.0 * np.pi * np.array(FREQUENCIES)) ** 2, damping_matrix(structure)

    def rates(t: float, state: Floats) -> Floats:
        force = 5.0 * np.exp(-(((t - 0.1) / 0.02) ** 2))
        q, v = state[:3], state[3:]
        return np.concatenate([v, SHAPES[:, 0] * force - stiffness * q - damping @ v])

    solution = scipy.integrate.solve_ivp(
        rates, (0.0, 2.0), np.zeros(6), t_eval=record.time, rtol=1e-10, atol=1e-13, max_step=0.01
    )
    np.testing.assert_allclose(record.channel("x:wing.joint"), SHAPES[:, 1] @ solution.y[:3], atol=1e-10)


def test_known_and_unknown_entries_stand_in_a_file() -> None:
    structure = lw.Structure("wing", (), (), (host(BETWEEN).known_to_within(damping=0.1),))
    assert structure.coefficient("wing.mode2+mode3.damping").sigma == pytest.approx(0.03)
    again = lw.parse_structure(lw.model.format_structure(structure))
    assert again.hosts[0].entries == structure.hosts[0].entries
    changed = again.with_values({"wing.mode1+mode2.damping": 0.2})
    assert damping_matrix(changed)[0, 1] == pytest.approx(0.2)
    assert "modes = [1, 2], damping = 0.2" in lw.model.format_structure(changed)
    identified = structure.with_values({p.name: p.start or 0.0 for p in structure.parameters})
    identified = identified.with_values({"wing.mode1+mode2.damping": 0.2})
    np.testing.assert_allclose(damping_matrix(identified)[0, :2], [4.0 * np.pi * 5.0 * 0.01, 0.2], rtol=1e-9)
    [parameter] = identified.unknown("wing.mode1+mode2.damping").parameters
    assert len(parameter.members) == 2  # an entry keeps its two dampers together


MATRIX = """
[[host]]
name = "wing"
damping = [[0.65, 0.3], [0.3, 0.9]]
modes = [
    { frequency = 5.2, shape = { tip = 1.0 } },
    { frequency = 6.1, shape = { tip = 0.5 } },
]
"""


def test_a_whole_matrix_gives_ratios_and_entries_and_a_rigid_motion_is_damped_by_an_entry() -> None:
    structure = lw.parse_structure(MATRIX)
    np.testing.assert_allclose(damping_matrix(structure), [[0.65, 0.3], [0.3, 0.9]], rtol=1e-12)  # rounding
    assert set(structure.hosts[0].damping) == {(1, 2)}
    body = (lw.model.HostMode(0.0, 0.0, {"tip": 0.5}), lw.model.HostMode(8.0, 0.01, {"tip": 1.0}))
    rigid = lw.Host("body", body, damping={(1, 1): 0.2})
    assert damping_matrix(lw.Structure("body", (), (), (rigid,)))[0, 0] == pytest.approx(0.2)
    with pytest.raises(lw.StructureError, match="given by a ratio and by an entry"):
        lw.Host("body", body, damping={(2, 2): 0.2})


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("0.3, 0.9", "0.2, 0.9", "not symmetric"),
        ("[[0.65, 0.3], [0.3, 0.9]]", "[[0.65, 0.8], [0.8, 0.9]]", "feeds energy into a motion"),
        ("[[0.65, 0.3], [0.3, 0.9]]", "[[0.65]]", "2 rows of 2 numbers"),
        ("[[0.65, 0.3], [0.3, 0.9]]", "[{ modes = [1, 3], damping = 0.3 }]", "of modes 1 to 2"),
        ("[[0.65, 0.3], [0.3, 0.9]]", "[{ modes = [1, 2], damping = 0.3 }, { modes = [2, 1], damping = 0.3 }]", "given twice"),
        ("frequency = 6.1", "frequency = 6.1, damping = 0.01", "has a damping of its own"),
        ("[[0.65, 0.3], [0.3, 0.9]]", "[{ modes = [1, 2] }]", "damping"),
    ],
)  # fmt: skip
def test_wrong_damping_is_refused(old: str, new: str, message: str) -> None:
    with pytest.raises(lw.StructureError, match=message) as error:
        lw.parse_structure(MATRIX.replace(old, new), "wing.toml")
    assert "wing.toml" in str(error.value)


def test_a_dashpot_of_matrices_damps_between_modes() -> None:
    """A host of matrices moves as the full matrices do, near two resonances, where ratios alone are off."""
    count = 20
    mass = scipy.sparse.csc_array(0.1 * np.eye(count))
    chain = 2.0 * np.eye(count) - np.eye(count, k=1) - np.eye(count, k=-1)
    stiffness = scipy.sparse.csc_array(1e4 * chain)
    dashpot = scipy.sparse.csc_array(([6.0], ([18], [18])), shape=(count, count))
    matrices = lw.modal.HostMatrices(mass, stiffness, dashpot, tuple(map(str, range(1, count + 1))))
    reduced = matrices.reduce("beam", {"tip": 19, "mid": 9}, keep=8)
    assert any("couples" in note for note in reduced.notes)
    structure = lw.Structure("beam", (), (), (reduced.host,))
    squares = (2.0 * np.pi * np.array([mode.frequency.value for mode in reduced.host.modes])) ** 2
    rows = {point: structure.topology.row(f"beam.{point}") for point in ("tip", "mid")}

    def receptance(omega: float, damping: Floats) -> complex:
        return complex(
            rows["mid"] @ np.linalg.solve(np.diag(squares - omega**2) + 1j * omega * damping, rows["tip"])
        )

    whole, errors = damping_matrix(structure), []
    for omega in np.sqrt(squares[:3]):
        full = (stiffness - omega**2 * mass + 1j * omega * dashpot).toarray()
        exact = np.linalg.solve(full, np.eye(count)[18])[8]
        errors.append(abs(receptance(omega, whole) / exact - 1.0))
        assert abs(receptance(omega, np.diag(np.diag(whole))) / exact - 1.0) > 10.0 * errors[-1]
    assert max(errors) < 2e-3  # pairs below 0.1 % are left out


def test_an_export_says_what_ends_of_dampers_between_modes_are(tmp_path: Path) -> None:
    for damping, says in ((BETWEEN, True), ({}, False)):
        for suffix in ("py", "m"):
            wing = structure({}, hosts=[host(damping)])
            path = lw.export_answer(wing, tmp_path / f"wing_{len(damping)}.{suffix}")
            assert ("-modeN moves as minus mode N" in path.read_text(encoding="utf-8")) == says
