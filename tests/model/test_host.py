"""Hosts: their modes in structure files and tables, damping between them, and what is refused."""

import pickle
from pathlib import Path

import numpy as np
import pytest
import pyuff
import scipy
from structures import host, link, structure

import linkwise as lw
from linkwise.arrays import Floats

WING = """
name = "wing with a store"

[[host]]
name = "wing"
modes = [
    { frequency = "5.2 Hz", damping = 0.01, shape = { tip = 1.0, joint = 0.62 } },
    { frequency = { start = 21.0, sigma = 0.2 }, shape = { tip = -1.0, joint = 0.3 } },
]

[[mass]]
name = "store"
mass = "50 g"

[[link]]
name = "payload"
between = ["store", "wing.tip"]
law = "k*d + c*v"
coefficients = { k = 200.0, c = 0.05 }
"""


def test_points_are_rows_of_shapes_and_are_written_and_read_back() -> None:
    wing = lw.parse_structure(WING)
    assert wing.places == ("wing.tip", "wing.joint", "store")
    assert wing.mass_names == ("wing.mode1", "wing.mode2", "store")
    # columns: the modes to the ground, then the store less the tip, which moves by 1 and -1 of the modes
    expected = [[1.0, 0.0, -1.0], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]]
    assert wing.incidence.toarray().tolist() == expected
    assert wing.elongations([0.1, 0.02, 0.3])[2] == pytest.approx(0.3 - (0.1 - 0.02))
    assert lw.parse_structure(lw.model.format_structure(wing)) == wing
    changed = wing.with_values({"wing.mode2.frequency": 20.5})
    again = lw.parse_structure(lw.model.format_structure(changed))
    assert again.coefficient("wing.mode2.frequency") == lw.Coefficient.number(20.5)
    assert [parameter.name for parameter in wing.parameters] == ["wing.mode2.frequency"]
    assert [parameter.unit for parameter in wing.parameters] == ["Hz"]


def test_a_link_that_nothing_stretches_is_told() -> None:
    alike = WING.replace("tip = -1.0, joint = 0.3", "tip = -1.0, joint = -1.0").replace(
        "joint = 0.62", "joint = 1.0"
    )
    still = alike.replace('["store", "wing.tip"]', '["wing.joint", "wing.tip"]')
    still = still[: still.index("[[mass]]")] + still[still.index("[[link]]") :]
    with pytest.raises(lw.StructureError, match="move alike in every mode"):
        _ = lw.parse_structure(still).incidence


def test_modes_are_read_from_a_table(tmp_path: Path) -> None:
    (tmp_path / "modes.csv").write_text(
        "frequency[kHz],damping,tip,joint\n0.0052,0.01,1.0,0.62\n0.021,0,-1,0.3\n"
    )
    text = WING[: WING.index("modes = [")] + 'modes = "modes.csv"\n' + WING[WING.index("[[mass]]") :]
    (tmp_path / "wing.toml").write_text(text)
    wing = lw.read_structure(tmp_path / "wing.toml")
    assert wing.coefficient("wing.mode1.frequency").value == pytest.approx(5.2)
    assert wing.hosts[0].modes[1].shape == {"tip": -1.0, "joint": 0.3}
    (tmp_path / "modes.csv").write_text("Frequency[Hz],damping[%],tip[1/sqrt(kg)]\n5.2,1.5,1.0\n")
    (mode,) = lw.modal.read_modes(tmp_path / "modes.csv")
    assert mode.damping.value == pytest.approx(0.015)
    assert dict(mode.shape) == {"tip": 1.0}
    plain = "frequency[Hz],damping[%],tip\n5.2,1.5,1.25\n33.1,2,-0.5\n"
    (tmp_path / "plain.csv").write_text(plain)
    for delimiter in (";", "\t"):  # as records may have: decimal commas
        (tmp_path / "local.csv").write_text(plain.replace(",", delimiter).replace(".", ","))
        assert lw.modal.read_modes(tmp_path / "local.csv") == lw.modal.read_modes(tmp_path / "plain.csv")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("wing.tip", "wing.tp", 'unknown end "wing.tp", did you mean "wing.tip"'),
        ("joint = 0.3 }", "root = 0.3 }", "mode 2 has a shape at tip, root, and the first mode at tip, joint"),
        ('"5.2 Hz"', "-5.2", "the frequency of a mode must not be negative"),
        ("joint = 0.62", 'joint = "0.62"', "expected `float"),
        ("joint = 0.62", "joint = { sigma = 0.02 }", "needs a start"),
        ("joint = 0.62", "joint = { lower = 0.1 }", "a table of start and sigma"),
        ("joint = 0.62", "joint = { start = 0.62, sigma = -0.02 }", "sigma must be positive"),
        ('name = "wing"', 'name = "wing"\nshape_sigma = "2"', "expected a percentage, such as \"2 %\", got '2'"),
        ('name = "wing"', 'name = "wing"\nkeep = 1', "keep belongs to matrices"),
        ('name = "wing"', 'name = "wing"\nfrequency_sigma = "-1 %"', "must not be negative"),
        ('name = "wing"', 'name = "wing.left"', "its name has no dot"),
        ("damping = 0.01", 'damping = "0.01 kg"', "kg"),
        ("joint", "mode1", "has the name of a mode"),
        ('"5.2 Hz"', '"31.4 rad/s"', "a frequency is given in Hz, not in rad/s"),
        ("damping = 0.01", "damping = -0.01", "the damping of a mode must not be negative"),
        ("joint", "'a(1)'", "cannot be part of the name of a channel: leave out ( )"),
        ('name = "store"', 'name = "wing.tip"', "names must be unique"),
    ],
)  # fmt: skip
def test_a_wrong_host_is_told(old: str, new: str, message: str) -> None:
    with pytest.raises(lw.StructureError) as error:
        lw.parse_structure(WING.replace(old, new), "wing.toml")
    assert message.replace(", did", "").split(" you mean")[0] in str(error.value)
    assert "wing.toml" in str(error.value)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("frequency[Hz],damping\n", "expected a line of column names"),
        ("f,damping,tip\n5,0.01,1\n", "there is no column frequency[Hz]"),
        ("time,a:wing.tip,force:wing.tip\n0,1,1\n", "the record of a test: identify its modes"),
        ("frequency[kg],tip\n5,1\n", "unit of the frequency"),
        ("frequency[Hz],tip\n5\n", "line 2: expected 2 cells"),
        ("frequency[Hz],tip\n5,x\n", "expected a number in the column tip, got 'x'"),
        ("frequency[Hz],tip,tip\n5,1,1\n", "the column tip is listed twice"),
        ("frequency[rpm],tip\n5,1\n", "a frequency is given in Hz, not in rpm"),
        ("frequency[Hz];tip\n5,2;1,0,0\n", "expected a number in the column tip, got '1.0.0'"),
        ("frequency[Hz],tip[mm]\n5,1\n", "the unit of tip must be 1/sqrt(kg)"),
        ("frequency[Hz],\n5,1\n", "a column has no name"),
    ],
)
def test_a_wrong_table_of_modes_is_told(tmp_path: Path, table: str, message: str) -> None:
    (tmp_path / "modes.csv").write_text(table)
    with pytest.raises(lw.StructureError) as error:
        lw.modal.read_modes(tmp_path / "modes.csv")
    assert message in str(error.value)
    assert "modes.csv" in str(error.value)


def _universal(path: Path, modes: list[tuple[float, float, float, list[float]]], analysis: int = 2) -> None:
    """Data sets of type 55 with frequency, damping, modal mass and displacement along z at the nodes 12 and 15."""
    sets = [
        {
            "type": 55, "analysis_type": analysis, "data_ch": 2, "spec_data_type": 8, "data_type": 2, "data_type_id": 2,
            "load_case": 0, "mode_n": number, "freq": frequency, "modal_m": mass, "modal_damp_vis": damping,
            "modal_damp_his": 0.0, "eig": 1.0 + 0j, "modal_a": 1.0 + 0j, "modal_b": 1.0 + 0j, "freq_step_n": 1,
            "node_nums": np.array([12, 15]), "r1": np.zeros(2), "r2": np.zeros(2), "r3": np.array(shape),
        }
        for number, (frequency, damping, mass, shape) in enumerate(modes, start=1)
    ]  # fmt: skip
    pyuff.UFF(str(path)).write_sets(sets, mode="overwrite")


def test_modes_are_read_from_a_universal_file(tmp_path: Path) -> None:
    path = tmp_path / "wing.uff"
    _universal(path, [(5.2, 0.01, 4.0, [2.0, 1.24]), (21.0, 0.02, 1.0, [-1.0, 0.3])])
    modes = lw.modal.read_modes(path)
    assert [mode.frequency.value for mode in modes] == [5.2, 21.0]
    assert [mode.damping.value for mode in modes] == [0.01, 0.02]
    assert modes[0].shape == {"12z": 1.0, "15z": 0.62}  # over the root of the modal mass
    _universal(path, [(5.2, 0.01, 0.0, [2.0, 1.24])])
    with pytest.raises(lw.StructureError, match="has the modal mass 0"):
        lw.modal.read_modes(path)
    path.write_text("no universal file")
    with pytest.raises(lw.StructureError, match=r"wing\.uff: (holds no modes|cannot be read)"):
        lw.modal.read_modes(path)


def test_shapes_known_to_within_are_parameters_and_are_written() -> None:
    text = WING.replace('name = "wing"\n', 'name = "wing"\nshape_sigma = "2 %"\nfrequency_sigma = "1 %"\n')
    text = text.replace(
        "tip = 1.0, joint = 0.62", 'tip = 1.0, joint = { start = 0.62, sigma = "5 %" }, root = 0.0'
    )
    wing = lw.parse_structure(text.replace("joint = 0.3", "joint = 0.3, root = 0.0"))
    priors = {parameter.name: (parameter.start, parameter.sigma) for parameter in wing.parameters}
    assert priors == {
        "wing.mode1.frequency": (5.2, pytest.approx(0.052)),
        "wing.mode2.frequency": (21.0, 0.2),  # its own
        "wing.mode1.shape.tip": (1.0, pytest.approx(0.02)),
        "wing.mode1.shape.joint": (0.62, pytest.approx(0.031)),  # its own
        "wing.mode2.shape.tip": (-1.0, pytest.approx(0.02)),
        "wing.mode2.shape.joint": (0.3, pytest.approx(0.02)),  # a part of the largest, that of the tip
    }  # at the root, which does not move, they are known
    assert {parameter.unit for parameter in wing.parameters} == {"Hz", "1/sqrt(kg)"}
    assert lw.parse_structure(lw.model.format_structure(wing)) == wing
    assert pickle.loads(pickle.dumps(wing)) == wing


@pytest.mark.parametrize(
    ("taken", "kind", "clash"),
    [
        ("wing.mode1", "mass", "mode 1 of the host"),
        ("wing.tip", "mass", "a point of the host"),
        ("wing.mode2", "link", "mode 2 of the host"),
    ],
)
def test_a_mass_or_link_named_as_a_part_of_a_host_is_told_with_both(
    taken: str, kind: str, clash: str
) -> None:
    mass, name = (taken, "spring") if kind == "mass" else ("store", taken)
    wing = host("wing", [5.0, 9.0], 0.01, {"tip": [1.0, 2.0]})
    with pytest.raises(lw.StructureError) as caught:
        structure({mass: 1.0}, link(name, f"{mass}-ground", "k*d", k=10.0), hosts=[wing])
    message = str(caught.value)
    assert f'{kind} "{taken}"' in message and f'{clash} "wing" has the same name' in message


FREQUENCIES, RATIOS = (5.0, 6.0, 9.0), (0.01, 0.02, 0.015)
SHAPES = np.array([[1.0, 0.4], [-0.8, 0.6], [0.5, -0.7]])  # of each mode at tip and joint
BETWEEN = {(1, 2): 0.4, (3, 2): -0.3}


def coupled(damping: dict[tuple[int, int], float]) -> lw.Host:
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
    structure = lw.Structure("wing", (), (), (coupled(BETWEEN),))
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
    structure = lw.Structure("wing", (), (), (coupled(BETWEEN).known_to_within(damping=0.1),))
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
            wing = structure({}, hosts=[coupled(damping)])
            path = lw.export_answer(wing, tmp_path / f"wing_{len(damping)}.{suffix}")
            assert ("-modeN moves as minus mode N" in path.read_text(encoding="utf-8")) == says
