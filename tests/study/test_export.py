"""What other programs read of a study: rows.csv, summary.csv, and the summary to read."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from paper_rows import stored
from present import some
from reach_rows import reach_rows, reach_study
from small_study import DIVERGING, small

import linkwise as lw
from linkwise.study.executor import CaseBatch, run_batch
from linkwise.study.store import open_store


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study of two cycles, one of them run, with a structure that fails."""
    folder = tmp_path_factory.mktemp("export")
    study = lw.study.read_study(small(folder, cycles=2, more=DIVERGING))
    with open_store(folder / "out", study) as store:
        done = run_batch(CaseBatch(study.text(), tuple(study.cases())[: len(study) // 2]))
        store.add(result.row for result in done)
    return folder / "out"


def read(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
def test_rows_are_written_in_the_order_of_the_study(folder: Path, tmp_path: Path) -> None:
    written = lw.study.export_study(folder)
    assert [path.name for path in written] == ["rows.csv", "summary.csv"]
    rows, table = lw.study.read_rows(folder), read(folder / "rows.csv")
    assert len(table) == len(rows) == 18
    for row, line in zip(some(rows), table, strict=True):
        assert (line["structure"], line["method"], int(line["seed"])) == (row.structure, row.method, row.seed)
        assert float(line["snr_db"]) == row.snr_db and int(line["masses"]) == row.masses
        assert float(line["seconds"]) == row.seconds and line["reason"] == row.reason
        assert (float(line["nmse"]) if line["nmse"] else None) == row.nmse
        assert json.loads(line["links"]) == row.links and json.loads(line["coefficients"]) == row.coefficients
        assert json.loads(line["standard_errors"]) == row.standard_errors
    with open_store(tmp_path / "out", lw.study.read_study(small(tmp_path))):
        pass  # not begun
    lw.study.export_study(tmp_path / "out")
    assert read(tmp_path / "out" / "rows.csv") == [] and len(read(tmp_path / "out" / "summary.csv")) == 12
    assert "small: 0 of 24 cases done, 0 failed" in str(lw.study.study_summary(tmp_path / "out"))


def test_the_summary_is_that_of_the_rows(folder: Path) -> None:
    lw.study.export_study(folder)
    rows, table = lw.study.read_rows(folder), read(folder / "summary.csv")
    assert len(table) == 3 * 2 * 3
    for line in some(table):
        key = line["structure"], float(line["snr_db"]), line["method"]
        mine = [row for row in rows if (row.structure, row.snr_db, row.method) == key]
        assert (int(line["cases"]), int(line["done"])) == (2, len(mine) or 1)
        assert int(line["failed"]) == sum(row.failed for row in mine)
        errors = [row.nmse for row in mine if row.nmse is not None]
        if errors:
            assert float(line["median"]) == np.median(errors) and float(line["worst"]) == max(errors)
            assert float(line["seconds"]) == np.median([row.seconds for row in mine])
        else:
            assert line["median"] == line["worst"] == line["seconds"] == ""


def test_the_summary_prints_itself(folder: Path) -> None:
    summary = lw.study.study_summary(folder)
    text = str(summary)
    head, *lacks = text.partition("\n\n")[0].splitlines()
    assert head == "small: 18 of 36 cases done, 6 failed"
    assert lacks == [lw.Verdict.STUDY_INCOMPLETE.value, lw.Verdict.CELLS_WITHOUT_ANSWER.value]
    assert "\n\nbnes2, 40 dB\n  method" in text
    assert not summary.complete and {cell.structure for cell in summary.failed_cells} == {"pushed away"}
    line = next(line for line in text.partition("pushed away, 20 dB")[2].splitlines() if "weak" in line)
    assert line.split() == ["weak", "-", "-", "1", "0", "1", "-", "-"]
    assert "! pushed away, 20 dB, weak failed 1 times: " in text
    assert summary.to_dict()["done"] == 18 and len(summary.to_dict()["cells"]) == 18


def test_methods_that_look_for_terms_have_columns_of_their_own(tmp_path: Path, folder: Path) -> None:
    study = reach_study()
    home = stored(tmp_path / "reach", study, reach_rows(study))
    lw.study.export_study(home)
    rows, cells = read(home / "rows.csv"), read(home / "summary.csv")
    assert [json.loads(line["terms"]) for line in rows] == [row.terms for row in lw.study.read_rows(home)]
    assert {line["exact"] for line in rows} == {"True", "False"}
    cell = next(c for c in cells if (c["structure"], c["snr_db"]) == ("chain, 1 s, 500 Hz", "20.0"))
    assert (cell["method"], cell["exact"], cell["wrong_trusted"], cell["extra_trusted"]) == (
        "discover", "3", "1", "0",
    )  # fmt: skip
    part = str(lw.study.study_summary(home)).partition("chain, 1 s, 500 Hz, 20 dB\n")[2].splitlines()
    assert part[0].split()[-5:] == ["exact", "wrong,", "trusted", "extra,", "trusted"]
    assert [line.split()[-3:] for line in part[1:3]] == [["3", "1", "0"], ["0", "4", "4"]]
    assert "exact" not in str(lw.study.study_summary(folder))
    lw.study.export_study(folder)
    assert {line["exact"] for line in read(folder / "summary.csv")} == {""}
