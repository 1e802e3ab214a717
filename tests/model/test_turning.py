"""Places that turn: units of links there, where hosts say so, and what is refused."""

import re
from dataclasses import replace
from pathlib import Path

import pytest
from structures import torsion_chain

import linkwise as lw

MODES = """frequency[Hz],damping,tip,tip_r[rad],mid
5.0131,0.01,-1.682515,-2.315991,-0.571253
31.416625,0.01,1.682522,8.043765,-1.200758
"""
TORSION = """
[[link]]
name = "torsion"
between = ["beam.tip_r", "ground"]
law = "k*d + k3*d**3 + c*v"
coefficients = { k = "5 N m/rad", k3 = 2000.0, c = "unknown" }
"""
IN_PLACE = """
[[host]]
name = "beam"
units = { tip_r = "rad" }
modes = [{ frequency = 5.0, damping = 0.01, shape = { tip = -1.7, tip_r = -2.3 } }]
"""


def beam(folder: Path, link: str = TORSION, modes: str = MODES, more: str = "") -> lw.Structure:
    (folder / "beam.csv").write_text(modes)
    path = folder / "beam.toml"
    path.write_text(f'name = "beam"\n[[host]]\nname = "beam"\nmodes = "beam.csv"\n{more}{link}')
    return lw.read_structure(path)


@pytest.mark.parametrize("unit", ["rad", "rad/(m sqrt(kg))"])
def test_a_column_of_modes_says_that_a_point_turns(tmp_path: Path, unit: str) -> None:
    structure = beam(tmp_path, modes=MODES.replace("[rad]", f"[{unit}]"))
    assert structure.rotations == ("beam.tip_r",)
    assert dict(structure.link("torsion").law.units) == {"k": "N m/rad", "k3": "N m/rad^3", "c": "N m s/rad"}
    freed = structure.unknown("beam.mode1.shape.tip", "beam.mode1.shape.tip_r")
    units = {str(parameter.name): parameter.unit for parameter in freed.parameters}
    assert units["beam.mode1.shape.tip"] == "1/sqrt(kg)"
    assert units["beam.mode1.shape.tip_r"] == "rad/(m sqrt(kg))"


def test_a_key_says_it_and_is_written() -> None:
    text = f'name = "beam"{IN_PLACE}{TORSION}'
    structure = lw.parse_structure(text)
    assert structure.rotations == ("beam.tip_r",)
    assert lw.parse_structure(lw.model.format_structure(structure)) == structure
    assert structure.unknown("torsion").rotations == structure.hosts[0].known_to_within(shape=0.02).rotations


def test_an_angle_is_a_number_where_a_law_needs_one() -> None:
    law = replace(lw.Law.parse("k*sin(d) + Fc*tanh(v/v0)"), angular=True)
    assert dict(law.units) == {"k": "N m", "Fc": "N m", "v0": "rad/s"}
    number = replace(lw.Law.parse("k*d - k*d**3"), angular=True)
    assert dict(number.units) == {"k": "N m"}
    gap = replace(lw.Law.parse("k*max(abs(d) - gap, 0)*sign(d)"), angular=True)
    assert dict(gap.units) == {"k": "N m/rad", "gap": "rad"}
    with pytest.raises(lw.LawError, match="No units of the coefficients are consistent"):
        _ = replace(lw.Law.parse("k*d + k*v"), angular=True).units


@pytest.mark.parametrize(
    ("link", "modes", "more", "message"),
    [
        (TORSION.replace('"ground"', '"beam.tip"'), MODES, "", 'the end "beam.tip_r" turns, in rad, and "beam.tip" moves'),
        (TORSION.replace('"ground"', '"base"'), MODES, "", 'turns, in rad, and "base" moves in m'),
        (TORSION.replace("N m/rad", "N/m"), MODES, "", "'5 N/m' is in N/m: expected a number in N m/rad"),
        (TORSION, MODES.replace("[rad]", "[deg]"), "", "the unit of tip_r must be 1/sqrt(kg)"),
        (TORSION, MODES, 'units = { tip_r = "deg" }\n', 'is displaced in "rad" or "m", got \'deg\'; a record may be in other'),
        (TORSION, MODES, 'units = { top = "rad" }\n', "top"),
        (
            TORSION,
            MODES.replace("tip_r[rad]", "7z"),
            'units = { 7z = "rad" }\n',
            "is the direction 7z, which is in m, not in rad",
        ),
    ],
)  # fmt: skip
def test_contradictions_are_refused(tmp_path: Path, link: str, modes: str, more: str, message: str) -> None:
    with pytest.raises(lw.StructureError, match=re.escape(message)) as error:
        beam(tmp_path, link, modes, more)
    assert "\n" not in str(error.value)


DISCS = """name = "discs"
[[mass]]
name = "disc1"
{first}
[[mass]]
name = "disc2"
{second}
[[link]]
name = "shaft"
between = ["disc1", "ground"]
law = "k*d + c*v"
coefficients = {{ k = "5 N m/rad", c = 0.1 }}
[[link]]
name = "clutch"
between = ["disc2", "disc1"]
law = "k*d"
coefficients = {{ k = 2.0 }}
"""
TURNS = 'unit = "rad"\nmass = '


@pytest.mark.parametrize(
    ("second", "value", "known"),
    [
        ('mass = "20 g m^2"', 0.02, True),
        (f"{TURNS}0.02", 0.02, True),
        (f'{TURNS}"200 kg cm^2"', 0.02, True),
        (f'{TURNS}"unknown"', None, False),
        ('mass = { start = "20 g m^2", sigma = "5 %" }', 0.02, False),
        (f'{TURNS}"=disc1.mass"', 1.0, True),
    ],
)
def test_a_mass_that_turns_has_a_moment_of_inertia(second: str, value: float | None, known: bool) -> None:
    discs = lw.parse_structure(DISCS.format(first=f"{TURNS}1.0", second=second))
    assert discs.rotations == ("disc1", "disc2")
    disc = discs.mass("disc2")
    assert (disc.unit, disc.mass_unit, disc.mass.value, disc.mass.known) == ("rad", "kg m^2", value, known)
    assert discs.link("clutch").law.units == {"k": "N m/rad"}
    assert lw.parse_structure(lw.model.format_structure(discs)) == discs
    assert [parameter.unit for parameter in discs.unknown("mass:disc2").parameters] == ["kg m^2"]
    assert discs.with_values({"disc2.mass": 0.5}).mass("disc2").unit == "rad"


@pytest.mark.parametrize(
    ("second", "message"),
    [
        (f'{TURNS}"2 kg"', "mass[1].mass: '2 kg' is in kg: expected a number in kg m^2"),
        ('unit = "m"\nmass = "2 kg m^2"', "'2 kg m^2' is in kg*m**2: expected a number in kg or"),
        ('mass = "2 kg m"', "'2 kg m' is in kg*m: expected a number in kg or"),
        ('unit = "deg"\nmass = 1.0', 'a mass is displaced in "m" or, where it turns, in "rad", got \'deg\''),
        (f"{TURNS}-1.0", "the mass must be positive, got -1.0 kg m^2"),
        ("mass = 0.02", 'the end "disc1" turns, in rad, and "disc2" moves in m'),
    ],
)
def test_what_contradicts_the_unit_of_a_mass_is_refused(second: str, message: str) -> None:
    with pytest.raises(lw.StructureError, match=re.escape(message)) as error:
        lw.parse_structure(DISCS.format(first=f"{TURNS}1.0", second=second))
    assert "\n" not in str(error.value)
    text = DISCS.format(first=f"{TURNS}1.0", second='mass = "=disc1.mass"')
    with pytest.raises(lw.StructureError, match=re.escape('cannot be equal to "disc1.mass" in kg m^2')):
        lw.parse_structure(text.replace('"disc2", "disc1"', '"disc2", "ground"'))


def test_notes_and_errors_of_motions_are_in_rad() -> None:
    unstable = torsion_chain(sink="k*d + c*v", k=-900.0, c=0.0)
    with pytest.raises(lw.SimulationError, match=r"the displacement of mass disc\d is [\d.e+]+ rad;"):
        lw.simulate(unstable, release={"v:disc1": 1.0}, duration=30.0, rate=100.0)
    found = lw.analysis.modes(torsion_chain(), at=[0.1, 0.2])
    assert re.search(r"the links exert [-\d.]+ N m on mass", found.note)
