"""What it takes to add one of each kind of thing: how many new files, and how many lines elsewhere.

Each test adds something from outside the package, in modules of its own and through the registry of its kind, counts both, and
then uses the new thing as any user would. Nothing else is patched, so nothing else needed touching.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from problems import chain_record

import linkwise as lw
from linkwise.cli import COMMANDS, linkwise, run
from linkwise.discovery.term_families import FAMILIES, TermFamily
from linkwise.estimates.cause import CAUSE_KINDS, CauseKind
from linkwise.expression.functions import FUNCTIONS, LawFunction
from linkwise.files import FORMATS, Format
from linkwise.inspection.checks import CHECKS
from linkwise.likelihood.shooting.sensor_errors import ADDED
from linkwise.registry import Registry
from linkwise.report.estimate_page import SECTIONS
from linkwise.report.section import Reported, Section
from linkwise.sindy.regression import REGRESSORS

pytestmark = pytest.mark.usefixtures("unrendered")


class Places:
    """What a test adds: `files` are new modules, `lines` are entries in registries."""

    def __init__(self, folder: Path, undo: ExitStack) -> None:
        self.files, self.lines = 0, 0
        self._folder, self._undo = folder, undo

    def file(self, name: str, text: str) -> None:
        """Write a module that can be imported as `name`."""
        (self._folder / f"{name}.py").write_text(text, encoding="utf-8")
        self._undo.callback(sys.modules.pop, name, None)
        self.files += 1

    def copy(self) -> Path:
        """A copy of the package, which `script` will import; returns its folder."""
        folder = self._folder / "linkwise"
        shutil.copytree(Path(lw.__file__).parent, folder, ignore=shutil.ignore_patterns("__pycache__"))
        return folder

    def insert(self, path: Path, after: str, line: str) -> None:
        """Add a line to a copied file, behind another that is there once."""
        text = path.read_text(encoding="utf-8")
        assert text.count(after) == 1 and line.count("\n") == 1
        path.write_text(text.replace(after, after + line), encoding="utf-8")
        self.lines += 1

    def script(self, text: str, where: Path) -> str:
        """What a program prints that can import the modules written so far; a study's workers import the program itself."""
        path = where / "program.py"
        path.write_text(text, encoding="utf-8")
        environment = {**os.environ, "PYTHONPATH": str(self._folder)}
        ran = subprocess.run(
            [sys.executable, path.name],
            cwd=where,
            env=environment,
            check=True,
            text=True,
            stdout=subprocess.PIPE,
        )
        return ran.stdout

    def line(self, registry: Registry[Any], name: str, entry: object) -> None:
        """Register something for the time of the test."""
        self._undo.enter_context(registry.temporarily(name, entry))
        self.lines += 1


@pytest.fixture
def places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Places]:
    folder = tmp_path / "added"
    folder.mkdir()
    monkeypatch.syspath_prepend(folder)
    with ExitStack() as undo:
        yield Places(folder, undo)


SPRING = """
[[mass]]
name = "m1"
mass = 1.0

[[link]]
name = "spring"
between = ["m1", "ground"]
law = "F*atan(d/s) + c*v"
coefficients = {coefficients}
"""


def test_a_function_of_laws_is_one_entry(places: Places) -> None:
    arctangent = LawFunction(
        value=np.arctan, derivatives=("1/(1 + x**2)",), antiderivative="x*atan(x) - 0.5*log(1 + x**2)"
    )
    places.line(FUNCTIONS, "atan", arctangent)
    assert (places.files, places.lines) == (0, 1)

    true = lw.parse_structure(SPRING.format(coefficients="{ F = 20.0, s = 0.02, c = 0.5 }"))
    assert true.link("spring").law.units == {"F": "N", "s": "m", "c": "N s/m"}
    record = lw.simulate(true, release={"v:m1": 1.0}, duration=2.0, rate=500.0)
    truth = record.simulated
    assert truth is not None
    put_in = truth.energy.supplied.max()
    assert abs(truth.energy.residual).max() < 1e-12 * put_in  # energies are those of the antiderivative
    subject = lw.parse_structure(
        SPRING.format(coefficients='{ F = { start = 10.0 }, s = 0.02, c = "unknown" }')
    )
    fit = lw.identify(record.with_noise(40.0, seed=1), subject)
    assert fit.trusted
    estimate = fit.coefficient("spring.F")
    assert estimate.standard_error is not None
    assert abs(estimate.value - 20.0) < 4.0 * estimate.standard_error  # 1 of 16 000 is further off


RIDGE = '''
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from linkwise.arrays import Floats
from linkwise.sindy.regression.gram import Gram
from linkwise.sindy.regression.regressor import SupportCandidate, Regressor


@final
@dataclass(frozen=True)
class Ridge(Regressor):
    """Least squares with an L2 penalty on contributions."""

    title: ClassVar[str] = "least squares with an L2 penalty"

    penalty: float = 1e-12

    def solve(self, gram: Gram, target: int) -> tuple[Floats, float, tuple[SupportCandidate, ...]]:
        shrunk = gram.matrix + self.penalty * np.eye(len(gram.names))
        return np.linalg.solve(shrunk, gram.moments[:, target]), self.penalty, ()
'''

RIDGE_STUDY = """
snr_db = [40]
cycles = 1

[[structure]]
bnes = 2
release = { "v:m1" = 1.0 }
duration = 6.0
rate = 1000.0

[[method]]
kind = "classical"
convention = "states"
regressor = "ridge"

[[method]]
kind = "physics-informed"
regressor = "ridge"
"""


RIDGE_SCRIPT = """
import linkwise as lw
from linkwise.sindy.regression import REGRESSORS

REGRESSORS.register("ridge", "extra_ridge:Ridge")  # the workers of the study come by here too

if __name__ == "__main__":
    lw.run_study(lw.read_study("ridge.toml"), "study", workers=1)
"""


def test_a_regressor_is_a_file_and_a_line(places: Places, tmp_path: Path) -> None:
    places.file("extra_ridge", RIDGE)
    places.line(REGRESSORS, "ridge", "extra_ridge:Ridge")
    assert (places.files, places.lines) == (1, 1)

    chain = lw.bnes_chain(2)
    record = chain_record(2, duration=2.0, sensors=("x", "v", "a"))
    unknown = chain.unknown("all")
    ridge = lw.identify(record, unknown, method=lw.PhysicsInformedSindy(regressor="ridge"))
    plain = lw.identify(record, unknown, method=lw.PhysicsInformedSindy(regressor="least-squares"))
    assert np.all(ridge.values != plain.values)
    assert ridge.values == pytest.approx(
        plain.values, rel=1e-6
    )  # the penalty times the condition of the Gram matrix

    lw.write_record(record, tmp_path / "run.csv")
    lw.write_structure(unknown, tmp_path / "unknown.toml")
    assert "stlsq|l1|least-squares|ridge" in _command("identify", "--help").output
    command = (
        "identify",
        str(tmp_path / "run.csv"),
        str(tmp_path / "unknown.toml"),
        "--method",
        "sindy",
        "--json",
    )
    document = json.loads(_command(*command, "--regressor", "ridge").output)
    assert document["links"][0]["coefficients"]["k"]["value"] == ridge.coefficient("spring1.k").value

    (tmp_path / "ridge.toml").write_text(RIDGE_STUDY, encoding="utf-8")
    places.script(RIDGE_SCRIPT, tmp_path)
    assert [row.status for row in lw.read_rows(tmp_path / "study")] == ["converged", "converged"]
    page = lw.write_study_report(tmp_path / "study").read_text(encoding="utf-8")
    assert "least squares with an L2 penalty" in page


LABEL = """
import linkwise as lw
from linkwise.absorption import absorb
from linkwise.cli import run

compare = absorb.compare
absorb.compare = lambda comparison, progress: (print("label:", comparison.options.label), compare(comparison, progress))[1]
lw.absorb(lw.bnes_chain(2), duration=0.5, release={"v:m1": 1.0}, label="by keyword")
lw.absorb(lw.bnes_chain(2), lw.AbsorptionOptions.of(duration=0.5, release={"v:m1": 1.0}, label="by object"))
lw.write_structure(lw.bnes_chain(2), "chain.toml")
run(["absorb", "chain.toml", "--duration", "0.5", "--release", "v:m1=1.0", "--label", "by command"])
"""


def test_an_option_of_absorb_is_a_field_and_a_line(places: Places, tmp_path: Path) -> None:
    """In a copy of the package, since a frozen object has all of its fields from the start."""
    options = places.copy() / "absorption" / "options.py"
    places.insert(options, "    settle: float = 0.05\n", '    label: str = ""\n')
    places.insert(options, "    settle: float\n", "    label: str\n")  # its type, for those who check them
    command = options.parents[1] / "cli" / "absorb.py"
    places.insert(
        command, '    "options",\n', '    click.option("--label", help="What the answer is called."),\n'
    )
    assert (places.files, places.lines) == (0, 3)
    printed = places.script(LABEL, tmp_path)
    labels = [line for line in printed.splitlines() if line.startswith("label:")]
    assert labels == ["label: by keyword", "label: by object", "label: by command"]


TOO_LOUD = """
from linkwise.inspection.alert import Alert


def too_loud(signals):
    for each in signals.responses:
        if each.rms > 1e-3:
            yield Alert("loud", each.name, "moves by more than a millimetre; excite less", each.rms)
"""


def test_a_check_of_records_is_a_file_and_a_line(places: Places) -> None:
    places.file("extra_loud", TOO_LOUD)
    places.line(CHECKS, "loud", "extra_loud:too_loud")
    assert (places.files, places.lines) == (1, 1)

    inspection = lw.inspect(chain_record(2, duration=2.0).with_noise(30.0, seed=1))
    assert [(alert.kind, alert.channel) for alert in inspection.alerts] == [
        ("loud", "x:m2"),
        ("loud", "x:m1"),
    ]


def test_a_cause_of_misfit_is_two_entries(places: Places) -> None:
    places.line(ADDED, "asymmetry", lambda shown, rate, ramp: shown**2)
    places.line(
        CAUSE_KINDS,
        "asymmetry",
        CauseKind(lambda cause: f"an asymmetry of {cause.where} of {cause.size:.2g} per unit", unit="1/m"),
    )
    assert (places.files, places.lines) == (0, 2)

    record = chain_record(2, duration=2.0).with_noise(50.0, seed=1)
    values = record.values.copy()
    values[:, 0] += 0.5 * values[:, 0] ** 2  # the first sensor reads more on one side
    cause = lw.identify(replace(record, values=values), lw.bnes_chain(2).unknown("nes")).diagnosis[0]
    assert (cause.kind, cause.where, cause.unit) == ("asymmetry", record.channels[0], "1/m")
    # to first order, beside which the states and the coefficients give way
    assert abs(cause.size - 0.5) < 0.1
    assert str(cause.to_dict()["message"]).startswith("an asymmetry of x:m1 of ")


def test_a_family_of_terms_is_an_entry(places: Places) -> None:
    arch = TermFamily("cos(d/{})", "a force that repeats", argument="a length in m", symbol="L")
    places.line(FAMILIES, "periodic", arch)
    assert (places.files, places.lines) == (0, 1)

    assert [term.text for term in lw.parse_terms("linear, periodic(0.1)")] == ["v", "d", "cos(d/0.1)"]
    assert "periodic(L)        cos(d/L), a force that repeats" in _command("discover", "--help").output
    with pytest.raises(
        lw.IdentificationError, match="the family periodic takes a length in m, a positive number"
    ):
        lw.parse_terms("periodic")


JSON_LINES = """
import json
from pathlib import Path

import numpy as np

from linkwise.files.table import Column, Table
from linkwise.records.record import Record


def read_table(path: Path) -> Table:
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    return Table(tuple(Column.of(name, np.array([row[name] for row in rows])) for name in rows[0]))


def write(record: Record, path: Path) -> None:
    columns = {"time": record.time, **{name: record.channel(name) for name in record.channels}}
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    path.write_text("".join(json.dumps(dict(zip(columns, row))) + "\\n" for row in rows))
"""


def test_a_file_format_is_a_file_and_a_line(places: Places, tmp_path: Path) -> None:
    places.file("extra_jsonl", JSON_LINES)
    places.line(FORMATS, ".jsonl", Format("extra_jsonl", writable=True))
    assert (places.files, places.lines) == (1, 1)

    record = chain_record(2, duration=0.1)
    lw.write_record(record, tmp_path / "run.jsonl")
    again = lw.read_record(tmp_path / "run.jsonl")
    assert again.channels == record.channels and np.array_equal(again.values, record.values)
    lw.write_structure(lw.bnes_chain(2), tmp_path / "chain.toml")
    drive = ("--duration", "0.1", "--rate", "1000", "--release", "v:m1=1.0")
    ran = _command("simulate", str(tmp_path / "chain.toml"), *drive, "-o", str(tmp_path / "typed.jsonl"))
    assert ran.exit_code == 0
    assert (tmp_path / "typed.jsonl").read_bytes() == (tmp_path / "run.jsonl").read_bytes()


ENERGY_FOLDER = '''
"""What `energy` hands over."""

import numpy as np
from problems import chain_record

from linkwise.records.record import Record
from linkwise.report.result_folder import ResultFolder
from linkwise.report.section import Section
from linkwise.report.section_page import section_page


def document(record, truth):
    return {"method": "energy", "joules": float(record.simulated.energy.supplied[-1])}


def data(reported, folder):
    np.savetxt(folder / "put_in.csv", reported.result.simulated.energy.supplied)


def sections(reported):
    return {"balance": Section("Balance", ["All of it."])}


def page(reported, pictures):
    structure = reported.result.simulated.structure
    return section_page(structure, sections(reported), pictures, verdict=["Energy was put in."], trusted=True)


FOLDER = ResultFolder[Record](mark="energy.json", document=document, data=data, figures=sections, page=page)
'''

ENERGY_COMMAND = '''
"""`linkwise energy`: a structure to the energy that a release puts in."""

from pathlib import Path

import click

import linkwise as lw
from extra_energy_folder import FOLDER
from linkwise.cli.console import deliver
from linkwise.cli.options import FOLDER as DIRECTORY


@click.command()
@click.argument("structure", type=click.Path(path_type=Path))
@click.option("-o", "--output", metavar="DIR", type=DIRECTORY)
def energy(structure: Path, output: Path | None) -> None:
    """Tell what energy a release puts into STRUCTURE."""
    if output is not None:
        FOLDER.check(output)
    record = lw.simulate(lw.read_structure(structure), release={"v:m1": 1.0}, duration=0.1, rate=1000.0)
    joules = FOLDER.document(record, None)["joules"]
    deliver(f"{joules:g} J", output, lambda folder, step: FOLDER.write(record, folder, progress=step))
'''


def test_a_command_with_a_result_folder_is_two_files_and_a_line(
    places: Places, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    places.file("extra_energy_folder", ENERGY_FOLDER)
    places.file("extra_energy", ENERGY_COMMAND)
    places.line(COMMANDS, "energy", "extra_energy:energy")
    assert (places.files, places.lines) == (2, 1)

    assert "energy     Tell what energy a release puts into STRUCTURE." in _command("--help").output
    chain, folder = str(tmp_path / "chain.toml"), tmp_path / "answer"
    lw.write_structure(lw.bnes_chain(2), chain)
    assert run(["energy", chain, "-o", str(folder)]) == 0
    assert capsys.readouterr().out == "0.5 J\n"
    document = json.loads((folder / "energy.json").read_text())
    assert document == {"method": "energy", "joules": 0.5, "files": ["put_in.csv", "report.html"]}
    assert "<h2>Balance</h2>" in (folder / "report.html").read_text()
    # an earlier result is replaced, and neither command takes the place of the other's
    (folder / "put_in.csv").unlink()
    assert run(["energy", chain, "-o", str(folder)]) == 0 and (folder / "put_in.csv").exists()
    drive = ["--duration", "0.5", "--release", "v:m1=1.0"]
    assert run(["absorb", chain, *drive, "-o", str(folder)]) == 2
    assert "holds the result of another command (energy.json)" in capsys.readouterr().err


def test_a_section_of_a_report_is_an_entry(places: Places, fitted: lw.Estimate, tmp_path: Path) -> None:
    def count(reported: Reported[lw.Estimate]) -> Section:
        return Section("Samples", [f"{reported.result.samples} were used."])

    places.line(SECTIONS, "samples", count)
    assert (places.files, places.lines) == (0, 1)

    page = (lw.write_result(fitted, tmp_path / "answer") / "report.html").read_text(encoding="utf-8")
    assert "<h2>Samples</h2>" in page and f"{fitted.samples} were used." in page


def _command(*arguments: str) -> Result:
    return CliRunner().invoke(linkwise, arguments)
