"""Exported answers: executed where Python can, evaluated where MATLAB would, and safe against what names hold."""

import csv
import re
import runpy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pytest
import scipy.io
from problems import chain_record
from structures import (
    CANTILEVER,
    CANTILEVER_SHAPES,
    LAWS,
    MEMORY,
    MEMORY_STATES,
    host,
    link,
    structure,
    torsion_chain,
)

import linkwise as lw
from linkwise.estimates.uncertainty import write_covariance
from linkwise.expression.tree import writable_functions


def built() -> lw.Structure:
    """A mass with a link of each law, and one with memory."""
    links = (link(name, "m1-ground", law, **values) for name, (law, values) in LAWS.items())
    joint = link("joint", "m1-ground", "k*d + c*v + F*z", MEMORY_STATES, **MEMORY)
    return structure({"m1": 2.0}, *links, joint, name='all "laws"')


def motion() -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    rng = np.random.default_rng(5)
    d, v, z = rng.normal(size=(3, 50)) * [[0.02], [0.3], [0.5]]
    return d, v, z


def test_the_python_module_has_the_forces_of_the_structure(tmp_path: Path) -> None:
    assert all(any(f"{name}(" in law for law, _ in LAWS.values()) for name in writable_functions())
    given, (d, v, z) = built(), motion()
    content = runpy.run_path(str(lw.export_answer(given, tmp_path / "forces.py")))
    assert list(content["FORCES"]) == [link.name for link in given.links]
    for name in LAWS:
        # the same operations in another order: an identity
        expected = given.link(name).force(d, v)
        assert content["FORCES"][name](d, v) == pytest.approx(expected, rel=1e-12, abs=1e-12, nan_ok=True)
        assert content["COEFFICIENTS"][name] == dict(given.link(name).values)
    joint = given.link("joint")
    assert content["force_joint"](d, v, z) == pytest.approx(joint.force(d, v, {"z": z}), rel=1e-12)
    (rate,) = content["RATES"]["joint"](d, v, z)
    assert rate == pytest.approx(joint.law.state_rates(d, v, {**MEMORY, "z": z})[0], rel=1e-12, abs=1e-12)
    assert content["force_cubic"](0.1, 0.0, beta=0.0) == pytest.approx(-10.0, rel=1e-12)
    assert content["MASSES"] == {"m1": 2.0} and content["NAME"] == 'all "laws"'


def matlab_value(line: str, names: dict[str, Any]) -> Any:
    """The right side of an assignment of MATLAB, by Python, for the little of that language that an export has."""
    text = line.partition(" = ")[2].rstrip(";").replace(".*", "*").replace("./", "/").replace(".^", "**")
    known = {
        **{name: getattr(np, name) for name in ("abs", "sign", "sqrt", "exp", "tanh", "sin", "cos")},
        "max": np.maximum, "min": np.minimum, "real_or_nan": lambda x: x,
    }  # fmt: skip
    assert not re.search(r"[^\w\s.()+\-*/,]", text), text
    with np.errstate(invalid="ignore"):
        return eval(text, {"__builtins__": {}}, {**known, **names})


def test_points_of_hosts_come_with_their_shapes(tmp_path: Path) -> None:
    """An end such as beam.tip cannot be followed from the modes without them."""
    beam = host("beam", CANTILEVER, 0.01, CANTILEVER_SHAPES)
    beam_with_sink = structure(
        {"sink": 0.03}, link("nes", "beam.tip-sink", "k*d", k=2.0), hosts=[beam], name="beam"
    )
    for suffix in ("py", "m", "mat", "csv"):
        lw.export_answer(beam_with_sink, tmp_path / f"beam.{suffix}")
    shapes = {
        f"beam.{point}": {f"beam.mode{n}": value for n, value in enumerate(values, start=1)}
        for point, values in CANTILEVER_SHAPES.items()
    }
    assert runpy.run_path(str(tmp_path / "beam.py"))["POINTS"] == shapes
    content = scipy.io.loadmat(tmp_path / "beam.mat", squeeze_me=True)
    assert content["points"].tolist() == list(shapes)
    assert content["coordinates"].tolist() == ["beam.mode1", "beam.mode2", "beam.mode3", "sink"]
    np.testing.assert_array_equal(content["shapes"][:, :3], list(CANTILEVER_SHAPES.values()))
    assert not content["shapes"][:, 3].any()
    assert "answer.shapes = [3.2, -3.2, 3.2, 0.0; ...\n" in (tmp_path / "beam.m").read_text()
    rows = list(csv.reader((tmp_path / "beam.csv").read_text(encoding="utf-8-sig").splitlines()))
    assert ["beam.mode2", "shape at beam.mid", "2.3", "1/sqrt(kg)", "", "", "", ""] in rows


def test_the_matlab_function_has_the_forces_of_the_structure(tmp_path: Path) -> None:
    given, (d, v, z) = built(), motion()
    text = lw.export_answer(given, tmp_path / "forces.m").read_text(encoding="utf-8")
    assert text.startswith("function [force, rates] = forces(link, d, v, states)\n%FORCES  Forces")
    cases = re.split(r"^    case ", text.partition("    otherwise")[0], flags=re.MULTILINE)[1:]
    assert len(cases) == len(given.links)
    for case, own in zip(cases, given.links, strict=True):
        label, *lines = case.splitlines()
        assert label == "'" + own.name.replace("'", "''") + "'"
        names: dict[str, Any] = {"d": d, "v": v}
        for line in (line.strip() for line in lines if not line.strip().startswith("%")):
            variable, _, right = line.partition(" = ")
            assert re.fullmatch(r"[A-Za-z]\w*", variable, re.ASCII)
            if right == "states{1};":
                names[variable] = z
            elif variable == "rates":
                expected = own.law.state_rates(d, v, {**MEMORY, "z": z})[0]
                value = matlab_value(line.replace("{", "(").replace("}", ")"), names)
                assert value == pytest.approx(expected, rel=1e-12, abs=1e-12)
            else:
                names[variable] = matlab_value(line, names)
        expected = own.force(d, v, {"z": z} if own.law.states else None)
        assert names["force"] == pytest.approx(expected, rel=1e-12, abs=1e-12, nan_ok=True)
    assert text.count("'") % 2 == 0 and text.isprintable() is False and "\r" not in text
    assert text.count("\nfunction ") == 2 and text.count("\nend\n") >= 4


@pytest.fixture(scope="module")
def answer(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a trusted answer."""
    record = chain_record(2, duration=2.0).with_noise(30.0, seed=1)
    fit = lw.identify(record, lw.bnes_chain(2).unknown("nes"))
    folder = tmp_path_factory.mktemp("export") / "answer"
    folder.mkdir()
    lw.write_structure(fit.structure, folder / "structure.toml")
    write_covariance(lw.estimates.Posterior.of(fit), folder / "covariance.csv")
    return folder


def test_errors_and_covariance_are_those_of_the_answer(answer: Path, tmp_path: Path) -> None:
    posterior = lw.estimates.read_posterior(answer)
    errors = np.sqrt(np.diag(posterior.covariance))
    content = runpy.run_path(str(lw.export_answer(answer, tmp_path / "forces.py")))
    assert content["COVARIANCE_NAMES"] == list(posterior.names)
    assert np.array_equal(content["COVARIANCE"], posterior.covariance)
    assert list(content["STANDARD_ERRORS"].values()) == errors.tolist()
    read = scipy.io.loadmat(lw.export_answer(answer, tmp_path / "answer.mat"), squeeze_me=True)
    assert list(read["covariance_names"]) == list(posterior.names)
    assert np.array_equal(read["covariance"], posterior.covariance)
    values = dict(zip(read["names"], read["values"], strict=True))
    assert values["nes1.alpha"] == posterior.values[0] and values["m2.mass"] == 0.01
    assert np.isnan(read["standard_errors"][0]) and read["standard_errors"][-1] == errors[-1]
    assert read["links"]["law"].tolist() == ["k*d + c*v", "alpha*d + beta*d**3 + c*v"]


def test_tables_hold_values_intervals_and_covariance(answer: Path, tmp_path: Path) -> None:
    posterior = lw.estimates.read_posterior(answer)
    with lw.export_answer(answer, tmp_path / "table.csv").open(encoding="utf-8-sig", newline="") as file:
        rows = list(csv.DictReader(file))
    alpha = next(row for row in rows if row["coefficient"] == "alpha")
    assert float(alpha["value"]) == posterior.values[0] and alpha["unit"] == "N/m"
    error = float(np.sqrt(posterior.covariance[0, 0]))
    # 95 % of a normal distribution
    assert float(alpha["upper"]) - float(alpha["value"]) == pytest.approx(1.959964 * error, rel=1e-6)
    book = openpyxl.load_workbook(lw.export_answer(answer, tmp_path / "table.xlsx"))
    assert book.sheetnames == ["coefficients", "covariance"]
    # openpyxl writes 16 digits
    assert book["covariance"]["B2"].value == pytest.approx(posterior.covariance[0, 0], rel=1e-15)


@pytest.mark.parametrize(
    ("file", "said"),
    [
        ("forces.doc", "answers cannot be exported to .doc; choose from .py, .m, .mat, .csv, .xlsx"),
        ("forces", "answers cannot be exported to a file without suffix"),
        ("2 forces.m", "a function of MATLAB has the name of its file"),
        ("end.m", "'end' is not the name of a function"),
        ("forces.py", "nes1.alpha is unknown"),
    ],
)
def test_what_cannot_be_exported_is_refused(tmp_path: Path, file: str, said: str) -> None:
    chain = lw.bnes_chain(2)
    with pytest.raises(lw.StructureError if "unknown" in said else lw.OutputError) as caught:
        lw.export_answer(chain.unknown("nes") if "unknown" in said else chain, tmp_path / file)
    assert said in str(caught.value) and not any(tmp_path.iterdir())


def test_rotations_are_exported_in_their_units(tmp_path: Path) -> None:
    carrier = host("beam", CANTILEVER, 0.01, {**CANTILEVER_SHAPES, "r": (2.3, -8.0, 1.0)}, rotations=["r"])
    chain = torsion_chain()
    spring = link("spring", "beam.r-disc1", "k*d", k=5.0)
    answer = replace(chain, links=(*chain.links, spring), hosts=(carrier,))
    module, function, variables, table, sheet = (
        lw.export_answer(answer, tmp_path / f"answer.{suffix}")
        for suffix in ("py", "m", "mat", "csv", "xlsx")
    )
    for path in (module, function):
        text = " ".join(path.read_text(encoding="utf-8").replace("\n%", "").split())
        assert "in N or N m" in text and "in m or rad" in text
        assert "Rotations in rad: beam.r, disc1, disc2; masses there are moments of inertia in kg m^2" in text
    assert runpy.run_path(str(module))["force_spring"].__doc__ == "k*d, in N m."
    content = scipy.io.loadmat(variables, simplify_cells=True)
    units = dict(zip(content["names"], content["units"], strict=True))
    assert units["disc2.mass"] == "kg m^2" and units["spring.k"] == "N m/rad"
    assert "moments in N m" in content["note"]
    for rows in (
        list(csv.reader(table.read_text(encoding="utf-8-sig").splitlines())),
        [[cell.value for cell in row] for row in openpyxl.load_workbook(sheet)["coefficients"]],
    ):
        units = {(row[0], row[1]): row[3] for row in rows}
        assert units["disc1", "mass"] == "kg m^2"
        assert units["beam.mode1", "shape at beam.r"] == "rad/(m sqrt(kg))"
        assert units["beam.mode1", "shape at beam.tip"] == "1/sqrt(kg)"
