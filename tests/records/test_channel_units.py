"""Units of channels of places that turn: read from files, compared with the structure, and written."""

import re
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from present import some
from structures import host, link, structure, torsion_chain

import linkwise as lw
from linkwise.records.channel_units import in_units_of, unit_in


def beam(turns: bool = True) -> lw.Structure:
    """A mode with a point that moves along a line and one that turns, on a torsion spring with a cubic term."""
    shapes = {"tip": (1.7, -1.7), "r": (2.3, -8.0)}
    carrier = host("beam", (5.0, 31.4), 0.01, shapes, rotations=["r"] if turns else [])
    spring = link("torsion", "beam.r-ground", "k*d + k3*d**3 + c*v", k=5.0, k3=2000.0, c=0.002)
    return structure({}, spring, hosts=[carrier], name="beam")


def recorded(folder: Path, header: str, factor: float = 1.0) -> lw.Record:
    time = np.arange(64) / 100.0
    path = folder / "record.csv"
    samples = np.sin(20.0 * time) * factor
    rows = "\n".join(f"{t!r},{x!r}" for t, x in zip(time.tolist(), samples.tolist(), strict=True))
    path.write_text(f"time,{header}\n{rows}\n")
    return lw.read_record(path)


@pytest.mark.parametrize(
    ("header", "unit", "factor"),
    [
        ("x:beam.r[deg]", "rad", 180.0 / np.pi), ("x:beam.r[rad]", "rad", 1.0), ("x:beam.r[mrad]", "rad", 1e3),
        ("v:beam.r[deg/s]", "rad/s", 180.0 / np.pi),
        ("v:beam.r[rad/s]", "rad/s", 1.0), ("v:beam.r[rpm]", "rad/s", 30.0 / np.pi),
        ("a:beam.r[rad/s^2]", "rad/s^2", 1.0), ("force:beam.r[N m]", "N m", 1.0), ("force:beam.r[Nm]", "N m", 1.0),
        ("force:beam.r[N mm]", "N m", 1e3), ("force:beam.r[mNm]", "N m", 1e3), ("force:beam.r[Ncm]", "N m", 1e2),
        ("x:beam.r[rev]", "rad", 0.5 / np.pi), ("v:beam.r[rev/min]", "rad/s", 30.0 / np.pi),
    ],
)  # fmt: skip
def test_angular_units_are_read_as_rad(tmp_path: Path, header: str, unit: str, factor: float) -> None:
    record = recorded(tmp_path, header, factor)
    (name,) = record.channels
    assert record.unit(name) == unit == unit_in(beam(), name)
    assert record.channel(name) == pytest.approx(np.sin(0.2 * np.arange(64)), rel=1e-12)
    assert in_units_of(record, beam()) is not None


@pytest.mark.parametrize("header", ["x:m1[%]", "v:m1[Hz]", "x:m1[1]", "force:m1[J]", "a:m1[deg/s]"])
def test_what_is_no_angle_is_refused(tmp_path: Path, header: str) -> None:
    with pytest.raises(lw.RecordError, match="is not a unit of"):
        recorded(tmp_path, header)


@pytest.mark.parametrize(
    ("header", "turns", "message"),
    [
        ("x:beam.r[mm]", True, 'stated in a unit that converts to m, and beam.r turns, so it is in rad'),
        ("x:beam.tip[deg]", True, 'stated in a unit that converts to rad, and beam.tip moves along a line, so it is in m'),
        ("x:beam.r[deg]", False, 'units = { r = "rad" }'),
        ("rel:x:beam.r", True, "the base moves in m: nothing turns relative to it; name the channel x:beam.r"),
        ("f:torsion[N m]", False, "the force of this link is in N"),
    ],
)  # fmt: skip
def test_units_of_record_and_structure_agree(tmp_path: Path, header: str, turns: bool, message: str) -> None:
    record, structure = recorded(tmp_path, header), beam(turns)
    with pytest.raises(lw.RecordError, match=re.escape(message)) as error:
        lw.identify(record, structure.unknown("torsion"))
    assert "\n" not in str(error.value)
    with pytest.raises(lw.RecordError, match=re.escape(message)):
        lw.discover(record, structure)


def test_an_inspection_shows_angles_in_rad(tmp_path: Path) -> None:
    """Rates that no structure reaches in m/s are none in rad/s."""
    seen = lw.inspect(recorded(tmp_path, "v:beam.r[rad/s]", 1e4))
    assert [channel.unit for channel in some(seen.channels)] == ["rad/s"]
    assert not [alert for alert in seen.alerts if alert.kind == "unit"]


@pytest.mark.parametrize("name", ["record.csv", "record.h5", "record.parquet", "record.mat"])
def test_a_simulation_writes_units(tmp_path: Path, name: str) -> None:
    release, sensors = {"x:beam.mode1": 0.01}, ("x:beam.r", "x:beam.tip")
    record = lw.simulate(beam(), release=release, duration=0.5, rate=400.0, sensors=sensors)
    assert [record.unit(channel) for channel in record.channels] == ["rad", "m"]
    path = tmp_path / name
    lw.write_record(record, path)
    again = in_units_of(lw.read_record(path), beam())
    assert [again.unit(channel) for channel in again.channels] == ["rad", "m"]
    assert again.values.tolist() == record.values.tolist()


@pytest.mark.parametrize(
    ("header", "turns", "message"),
    [
        ("x:disc2[mm]", True, 'disc2 turns, so it is in rad: correct the unit of the channel, or that of the mass'),
        ("x:disc2[deg]", False, 'correct the unit of the channel, or that of the mass: unit = "rad"'),
        ("force:disc2[N]", True, "is stated in a unit that converts to N, and disc2 turns, so it is in N m"),
    ],
)  # fmt: skip
def test_units_of_masses_are_compared_too(tmp_path: Path, header: str, turns: bool, message: str) -> None:
    record = recorded(tmp_path, header)
    with pytest.raises(lw.RecordError, match=re.escape(message)) as error:
        lw.identify(record, torsion_chain(turns=turns).unknown("sink"))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("method", ["ml", "weak", "sindy"])
def test_a_torsion_chain_has_the_answer_of_masses_on_springs(method: Literal["ml", "weak", "sindy"]) -> None:
    """To the last digit, and with other units: of coefficients, noise, wells, ranges and findings."""
    answers = []
    for turns in (True, False):
        truth = torsion_chain(turns=turns)
        clean = lw.simulate(truth, release={"v:disc1": 6.0}, duration=3.0, rate=500.0)
        record = clean.with_noise(40.0, seed=5413001)
        answers.append(lw.identify(record, truth.unknown("sink"), method=method))
    turned, plain = answers
    pairs = zip(turned.link("sink").coefficients, plain.link("sink").coefficients, strict=True)
    for own, other in some(pairs):
        assert (own.value, own.standard_error) == (other.value, other.standard_error)
    assert [c.unit for c in turned.link("sink").coefficients] == ["N m/rad", "N m/rad^3", "N m s/rad"]
    assert turned.noise["x:disc1"].sigma == plain.noise["x:disc1"].sigma
    assert {noise.unit for noise in turned.noise.values()} == {"rad"}
    wells = [[well.value for well in fit.link("sink").wells] for fit in answers]
    assert wells[0] == wells[1]
    assert {mass.unit for mass in turned.masses} == {"kg m^2"}
    assert "rad/s" in str(turned)
    assert not re.search(r"\d m(/s)?\b|N/m|\bkg\b(?! m)", str(turned))
    assert re.search(r"\d m(/s)?\b", str(plain))
