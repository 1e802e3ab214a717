"""`linkwise respond` and `linkwise backbone`: what they print and write, bands of an answer, and what they refuse."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from commands import document, refusal, said

import linkwise as lw

pytestmark = pytest.mark.usefixtures("unrendered")

RANGE = "--from 21 --to 23 --starts 0"


@pytest.fixture(scope="module")
def chain_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("respond") / "chain.toml"
    lw.write_structure(lw.bnes_chain(2), path)
    return path


@pytest.mark.slow
def test_a_response_is_printed_written_and_handed_on(chain_file: Path) -> None:
    folder = chain_file.parent / "response"
    line = f"respond {chain_file} --force m1=0.5 --levels 0.3,0.1 --show x:m2 {RANGE}"
    result = document(f"{line} -o {folder}")
    assert [level["force"] for level in result["levels"]] == [0.1, 0.3]
    level = result["levels"][1]
    point = level["branches"][0]["points"][0]
    assert set(point) == {
        "hz", "amplitude", "first_harmonic", "phase_deg", "stable", "largest_multiplier"
    }  # fmt: skip
    assert list(point["amplitude"]) == ["x:m2"]
    assert len(level["folds_hz"]) == 2 * len(level["branches"])
    assert json.loads((folder / "response.json").read_text())["levels"] == result["levels"]
    with (folder / "branches.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == sum(len(b["points"]) for one in result["levels"] for b in one["branches"])
    assert float(rows[0]["x:m2 amplitude"]) == pytest.approx(
        result["levels"][0]["branches"][0]["points"][0]["amplitude"]["x:m2"]
    )
    assert "fold 2" in said(f"respond {chain_file} --force m1=0.3 --from 21 --to 22 --starts 0").out


@pytest.mark.slow
def test_an_answer_has_bands_and_tells_where_its_laws_are_extrapolated(answer_folder: Path) -> None:
    line = f"respond {answer_folder} --force m1=200 --from 24.5 --to 25.5 --starts 0 --draws 12 --show x:m2"
    result = document(line)
    branch = max(result["levels"][0]["branches"], key=lambda branch: len(branch["points"]))
    stable = [point for point in branch["points"] if point["stable"]]
    points = [point for point in branch["points"] if point["lower"]["x:m2"] is not None]
    assert all(point["stable"] for point in points)
    assert len(points) > 0.7 * len(stable) > 0
    inside = [p["lower"]["x:m2"] <= p["amplitude"]["x:m2"] <= p["upper"]["x:m2"] for p in points]
    assert np.mean(inside) > 0.9
    assert any(point["outside_range"] for point in points)
    assert "its law is extrapolated there" in result["findings"][0]


def test_a_backbone_is_printed_and_written(chain_file: Path) -> None:
    folder = chain_file.parent / "backbone"
    result = document(f"backbone {chain_file} --mode 1 --to-energy 1e-3 -o {folder}")
    assert result["mode"] == 1
    assert set(result["points"][0]) == {"hz", "energy", "amplitude"}
    assert result["points"][-1]["energy"] == pytest.approx(1e-3)
    assert {path.name for path in folder.iterdir()} >= {"backbone.json", "backbone.csv", "structure.toml"}


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (f"respond FILE {RANGE}", "On the command line: --force MASS=N or --base x|v|a=SIZE."),
        (f"respond FILE --force m1=0 {RANGE}", "must be positive, got 0.0. On the command line: --levels"),
        (f"respond FILE --base a=1 {RANGE}", 'no link has "base" as an end'),
        (f"respond FILE --force m1=1 --show a:m1 {RANGE}", "On the command line: --show x:m1"),
        ("respond FILE --force m1=1 --from 3 --to 2", "On the command line: --from HZ --to HZ."),
        ("backbone FILE --mode 3", "there is no vibration in mode 3"),
        ("backbone FILE --mode 1 --to-amplitude x:m1=nan", "got nan. On the command line: --to-amplitude"),
        ("backbone FILE --mode 1 --to-amplitude x:m1=5mm", "'5mm' is not a plain number in SI units"),
        ("backbone FILE --mode 1 --to-amplitude x:m9=1", "unknown mass 'm9' in the end of a backbone"),
        ("basins FILE --plane x:m2=1", "is not FROM:TO"),
        ("basins FILE --plane x:m2=1:-1,v:m2=-1:1", "to a higher one, in SI units, got 1 to -1"),
        ("basins FILE --plane x:m2=nan:1,v:m2=-1:1", "got nan to 1. On the command line: --plane"),
        ("basins FILE --plane a:m2=0:1,v:m2=-1:1", "a:m2 cannot be a state of the plane"),
        ("basins . --plane x:m2=0:1,v:m2=-1:1", "there is no structure.toml in this folder"),
    ],
)
def test_what_does_not_fit_is_wrong_usage(chain_file: Path, line: str, message: str) -> None:
    assert message in refusal(line.replace("FILE", str(chain_file)))


def test_basins_are_printed_and_written(chain_file: Path) -> None:
    folder = chain_file.parent / "basins"
    line = f"basins {chain_file} --plane x:m2=-0.02:0.02,v:m2=-0.2:0.2 --points 4"
    result = document(f"{line} -o {folder}")
    assert [rest["share"] for rest in result["rests"]] == [0.5, 0.5]
    assert np.array(result["ends"]).shape == (4, 4)
    assert {path.name for path in folder.iterdir()} >= {"basins.json", "basins.csv", "structure.toml"}
