"""What it takes to add one of each kind of thing that reads, shows and repeats; see test_places_to_touch.py."""

from __future__ import annotations

import json
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from places import Places, command
from problems import chain_record

import linkwise as lw
from linkwise.cli import COMMANDS, run
from linkwise.export.formats import EXPORTS, ExportFormat
from linkwise.files import FORMATS, Format
from linkwise.report.estimate_page import SECTIONS
from linkwise.report.section import Reported, Section, figure_section
from linkwise.study.toml_file import METHOD_TABLES

pytestmark = pytest.mark.usefixtures("unrendered")


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
    ran = command("simulate", str(tmp_path / "chain.toml"), *drive, "-o", str(tmp_path / "typed.jsonl"))
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

    assert "energy     Tell what energy a release puts into STRUCTURE." in command("--help").output
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


PHASE_FIGURE = """
from matplotlib.axes import Axes

from linkwise.plot.style import axes_for


def phase(estimate, link, *, ax: Axes | None = None) -> Axes:
    motion = estimate.link(link)
    with axes_for(ax, width=3.0, height=3.0) as axes:
        axes.plot(motion.d_range, motion.v_range)
    return axes


def phase_figure(estimate):
    return phase(estimate, "nes1").figure
"""


def test_a_figure_of_a_page_is_a_function_and_a_line(
    places: Places, fitted: lw.Estimate, tmp_path: Path
) -> None:
    """Drawn on the Axes of a caller, saved in two formats, and to zoom into on the page."""
    places.file("extra_phase", PHASE_FIGURE)
    drawn = import_module("extra_phase")
    places.line(
        SECTIONS,
        "phase",
        figure_section("Phase plane", lambda estimate: drawn.phase_figure(estimate), interactive=True),
    )
    assert (places.files, places.lines) == (1, 1)

    folder = lw.write_result(fitted, tmp_path / "answer")
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert {"phase.png", "phase.svg"} <= {path.name for path in folder.iterdir()}
    assert "<h2>Phase plane</h2>" in page and 'id="phase"' in page


CELLS = """
from pathlib import Path

from linkwise.export.answer import ExportedAnswer


def write(answer: ExportedAnswer, path: Path, name: str) -> None:
    path.write_text("".join(f"{cell.owner}.{cell.name}\\t{cell.value}\\n" for cell in answer.coefficients))
"""


def test_a_format_of_exported_answers_is_a_file_and_a_line(places: Places, tmp_path: Path) -> None:
    places.file("extra_tsv", CELLS)
    places.line(EXPORTS, ".tsv", ExportFormat("a table separated by tabs", "extra_tsv:write"))
    assert (places.files, places.lines) == (1, 1)

    lw.export_answer(lw.bnes_chain(2), tmp_path / "chain.tsv")
    assert "nes1.alpha\t-100.0\n" in (tmp_path / "chain.tsv").read_text(encoding="utf-8")
    assert ".tsv   a table separated by tabs" in command("export", "--help").output


NAIVE = """
from dataclasses import dataclass
from typing import Any, Literal

from linkwise.study.method import MethodResult, MethodTable, StudyMethod


@dataclass(frozen=True)
class Naive(StudyMethod):
    name: str
    factor: float

    def evaluate(self, subject, clean, snr_db, seed):
        links = {name: self.factor * 100.0 for name in subject.judged_links}
        return MethodResult("converged", 0.0, links)

    def document(self) -> dict[str, Any]:
        return {"name": self.name, "kind": "naive", "factor": self.factor}


class NaiveTable(MethodTable):
    kind: Literal["naive"]
    name: str = "naive"
    factor: float = 1.0

    def build(self) -> StudyMethod:
        return Naive(self.name, self.factor)
"""

NAIVE_STUDY = """
snr_db = [40]
cycles = 2

[[structure]]
bnes = 2
release = { "v:m1" = 1.0 }
duration = 0.5
rate = 1000.0

[[method]]
kind = "naive"
factor = 0.5
"""

NAIVE_SCRIPT = """
import linkwise as lw
from linkwise.study.toml_file import METHOD_TABLES

METHOD_TABLES.register("naive", "extra_naive:NaiveTable")  # the workers of the study come by here too

if __name__ == "__main__":
    lw.run_study(lw.read_study("naive.toml"), "study", workers=1)
    for row in lw.read_rows("study"):
        print(row.method, row.status, row.links)
"""


def test_a_method_of_a_study_is_a_file_and_a_line(places: Places, tmp_path: Path) -> None:
    places.file("extra_naive", NAIVE)
    places.line(METHOD_TABLES, "naive", "extra_naive:NaiveTable")
    assert (places.files, places.lines) == (1, 1)

    (tmp_path / "naive.toml").write_text(NAIVE_STUDY, encoding="utf-8")
    assert lw.read_study(tmp_path / "naive.toml").methods[0].document()["factor"] == 0.5
    printed = places.script(NAIVE_SCRIPT, tmp_path).splitlines()
    assert printed == 2 * ["naive converged {'nes1': 50.0}"]
    wrong = NAIVE_STUDY.replace("factor", "faktor")
    (tmp_path / "naive.toml").write_text(wrong, encoding="utf-8")
    with pytest.raises(lw.StudyError, match=r'unknown key "faktor"; did you mean "factor"\?'):
        lw.read_study(tmp_path / "naive.toml")


CABLES = """
import linkwise as lw

chain = lw.bnes_chain(2)
record = lw.simulate(chain, release={"v:m1": 1.0}, duration=0.1, rate=1000.0)
record = lw.Record(0.0, 1000.0, record.channels, record.values, cables={"x:m2": "A7"}, lengths={"x:m1": 2.5})
for suffix in ("h5", "mat", "parquet"):
    lw.write_record(record, f"run.{suffix}")
    again = lw.read_record(f"run.{suffix}")
    print(suffix, dict(again.cables), dict(again.lengths))
print("selected", dict(record.select(["x:m1"]).cables), dict(record.select(["x:m1"]).lengths))
print("beside", dict(lw.beside(record.select(["x:m1"]), record.select(["x:m2"])).cables))
"""


def test_an_attribute_of_channels_is_a_field_and_a_line(places: Places, tmp_path: Path) -> None:
    """In a copy of the package; two are added, one of numbers and one of texts, and every format of our own stores both."""
    records = places.copy() / "records"
    field = "    uncertainty: Mapping[str, SensorUncertainty] = field(default_factory=dict)\n"
    places.insert(
        records / "record.py", field, "    cables: Mapping[str, str] = field(default_factory=dict)\n"
    )
    places.insert(
        records / "record.py", field, "    lengths: Mapping[str, float] = field(default_factory=dict)\n"
    )
    line = "OF_CHANNELS = {\n"
    cables = '    "cables": ChannelAttribute("cable", stored=dict[str, str]),\n'
    lengths = '    "lengths": ChannelAttribute("length", stored=dict[str, float], absent=math.nan),\n'
    places.insert(records / "channel_attributes.py", line, cables)
    places.insert(records / "channel_attributes.py", line, lengths)
    assert (places.files, places.lines) == (0, 2 * 2)

    both = "{'x:m2': 'A7'} {'x:m1': 2.5}"
    printed = places.script(CABLES, tmp_path).splitlines()
    assert printed[:3] == [f"h5 {both}", f"mat {both}", f"parquet {both}"]
    assert printed[3:] == ["selected {} {'x:m1': 2.5}", "beside {'x:m2': 'A7'}"]
