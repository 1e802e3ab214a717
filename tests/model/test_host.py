"""Hosts: their files, the coordinates and points that they give a structure, and what is refused."""

import pickle
from pathlib import Path

import numpy as np
import pytest
import pyuff
from structures import host, link, structure

import linkwise as lw

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
