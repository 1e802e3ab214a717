"""Cells of a study: medians, counts, the tables that are written of them, and maps of success over noise and sampling."""

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from paper_rows import stored
from present import present, some
from reach_rows import EXACT, reach_rows, reach_study
from small_study import DIVERGING, small

import linkwise as lw
from linkwise.study.definition import Study, parse_study
from linkwise.study.store import open_store
from linkwise.study.subject import FAILED, Case, Row
from linkwise.study.summary import Cell, StudySummary, SuccessMap, maps_of
from linkwise.study.workers import CaseBatch, run_batch

TEXT = """
snr_db = [20, 40]
cycles = 4
structure = [
  { name = "four", bnes = 4, duration = 1.0, rate = 1000.0, release = { "v:m1" = 3.0 } },
  { name = "two", bnes = 2, duration = 1.0, rate = 1000.0, release = { "v:m1" = 1.0 } },
]
method = [{ kind = "weak" }, { kind = "ml" }]
"""
CASE = Case("two", 20.0, "ml", 1000)


@pytest.fixture(scope="module")
def study() -> Study:
    """Two structures, two noise levels, two methods, four seeds from 1000 on."""
    return parse_study(TEXT, "study.toml", None)  # type: ignore[arg-type]


def row(case: Case, error: float | None = None, **changes: Any) -> Row:
    """An answer to `case` with one sink, whose error is `error` in %, or with none."""
    links = {} if error is None else {"nes1": error}
    made = Row(case.structure, 2, case.snr_db, case.method, case.seed, status="converged", links=links)
    return replace(made, **{"seconds": 0.1, **changes})


def told(study: Study, rows: list[Row], structure: str = "two") -> Cell:
    """The cell at 20 dB of maximum likelihood."""
    return present(StudySummary.of(study, rows).cell(structure, 20.0, "ml"))


def rows(study: Study, errors: list[float]) -> list[Row]:
    """Every case answered; seed by seed the error is that of the list."""
    return [row(case, errors[case.seed - 1000], seconds=case.seed - 999.0) for case in study.cases()]


def test_cells_stand_in_order_and_carry_medians(study: Study) -> None:
    given = rows(study, [4.0, 1.0, 2.0, 9.0])
    table = StudySummary.of(study, given)
    assert table.structures == ("two", "four") and table.masses == {"two": 2, "four": 4}
    assert table.decibels == (40.0, 20.0) and table.methods == ("weak", "ml")
    assert (table.expected, table.missing, table.failed) == (32, 0, 0)
    cell = told(study, given)
    assert (cell.nmse, cell.low, cell.high, cell.seconds) == (3.0, 1.0, 9.0, 2.5)
    assert present(cell.median_row).seed == 1000  # 4 and 2 are as close to 3: the first seed
    assert cell.share_above(3.0) == 0.5
    assert table.cell("two", 30.0, "ml") is None


def test_a_failed_case_counts_as_worse_than_any_answer(study: Study) -> None:
    lost: dict[str, Any] = {"status": FAILED, "links": {}, "reason": "it diverged"}
    given = [
        replace(each, **lost) if each.seed > 1001 else each for each in rows(study, [4.0, 1.0, 0.0, 0.0])
    ]
    cell = told(study, given)
    assert (cell.nmse, cell.low, cell.high) == (None, 1.0, None)  # half of them failed
    assert cell.done == 4 and cell.reasons == (("it diverged", 2),)
    assert cell.median_row is None and cell.share_above(100.0) == 0.5
    one_failed = told(study, given[:-8])
    assert (one_failed.done, one_failed.nmse) == (3, 4.0)
    no_numbers = [row(case, np.nan) for case in study.cases()]
    assert StudySummary.of(study, no_numbers).failed == 32 and told(study, no_numbers).nmse is None


def test_missing_cells_are_counted_and_strangers_left_out(study: Study) -> None:
    given = [each for each in rows(study, [1.0] * 4) if each.structure == "two"]
    given.append(row(Case("two", 20.0, "ml", 7), 1e9))
    assert StudySummary.of(study, given).missing == 16 and told(study, given).nmse == 1.0
    empty = told(study, given, "four")
    assert (empty.done, empty.expected, empty.masses) == (0, 4, 4)
    assert (empty.nmse, empty.low, empty.seconds, empty.median_row) == (None, None, None, None)
    assert np.isnan(empty.share_above(1.0))


def test_answers_are_counted_by_their_terms(study: Study) -> None:
    """Of four: exact, a term missing, one extra in doubt, and none at all."""
    judged = [("converged", 0, 0), ("converged", 1, 0), ("not converged", 0, 1)]
    answers = [
        row(replace(CASE, seed=seed), status=status, terms={"right": 4, "missing": missing, "extra": extra})
        for seed, (status, missing, extra) in enumerate(judged, 1000)
    ]
    failed = row(replace(CASE, seed=1003), status=FAILED, reason="too short")
    cell = told(study, [*answers, failed])
    assert [answer.exact for answer in cell.answers] == [True, False, False]
    assert cell.failures == (failed,) and failed.exact is None
    assert (cell.exact, cell.exact_share, cell.untrusted) == (1, 0.25, 1)
    assert (cell.wrong_trusted, cell.extra_trusted) == (1, 0)
    assert cell.nmse is None and cell.median_row is None  # terms of monomials are no forces
    assert told(study, [replace(answers[2], status="converged")]).extra_trusted == 1
    plain = told(study, [row(CASE, 1.0)])
    assert (plain.exact, plain.exact_share, plain.wrong_trusted, plain.extra_trusted) == (None,) * 4


def test_intervals_that_hold_the_true_value_are_counted(study: Study) -> None:
    """Those of trusted answers alone have standard errors; the chain's alpha is -100."""
    answers = [
        row(
            replace(CASE, seed=seed),
            1.0,
            coefficients={"nes1.alpha": -100.0 + off},
            standard_errors={"nes1.alpha": 1.0} if trusted else {},
        )
        for seed, (off, trusted) in enumerate([(1.9, True), (-1.9, True), (2.1, True), (50.0, False)], 1000)
    ]
    cell = told(study, answers)
    assert cell.truth["nes1.alpha"] == -100.0
    assert cell.intervals == 3 and cell.coverage == pytest.approx(2 / 3)
    unknown = present(StudySummary.of_rows(answers).cell("two", 20.0, "ml"))
    assert unknown.coverage is None  # nobody knows the truth


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


def maps_from(rows: list[Row]) -> tuple[SuccessMap, ...]:
    """The maps of the study of the reach with these rows."""
    study = reach_study()
    return maps_of(study, StudySummary.of(study, rows))


def failed(row: Row) -> Row:
    return replace(row, status=FAILED, links={}, terms={}, reason="too short")


def test_the_maps_count_what_the_rows_say(tmp_path: Path) -> None:
    study = reach_study()
    maps = lw.study.success_maps(stored(tmp_path / "reach", study, reach_rows(study)))
    named = [(success.name, success.method) for success in maps]
    assert named == [(f"chain, {n} s", method) for n in (1, 2) for method in ("discover", "sindy, links")]
    first = maps[0]
    assert (first.snr_db == [8.0, 20.0, 40.0]).all() and (first.rates == [100.0, 500.0]).all()
    assert (first.samples == [5.0, 25.0]).all()  # of a motion of 20 Hz
    assert (first.cases == 4).all()
    assert (first.exact == EXACT).all()
    np.testing.assert_allclose(first.exact_share, np.array(EXACT) / 4.0, rtol=1e-12)
    wrong = 4 - np.array(EXACT)
    assert (first.wrong_trusted == np.where(wrong > 0, 1, 0)).all()  # the first of those that are wrong
    assert (first.extra_trusted == 0).all()
    never = maps[1]
    assert (never.exact == 0).all() and (never.wrong_trusted_share == 1.0).all()
    assert (never.extra_trusted == 4).all()


def test_a_case_without_an_answer_is_not_exact_and_a_missing_one_is_no_case() -> None:
    rows = reach_rows(reach_study())
    success = maps_from([failed(row) if row.snr_db == 40.0 else row for row in rows if row.snr_db > 8.0])[0]
    assert (success.cases == [[0, 4, 4], [0, 4, 4]]).all()
    assert (success.exact[:, 2] == 0).all() and (success.exact_share[:, 2] == 0.0).all()
    assert np.isnan(success.exact_share[:, 0]).all()
    maps = maps_from([failed(row) if row.method == "discover" else row for row in rows])
    assert [success.method for success in maps] == ["discover", "sindy, links"] * 2
    assert (maps[0].cases == 4).all() and (maps[0].exact_share == 0.0).all()
    assert (maps[0].wrong_trusted == 0).all()
    # methods that are told the terms have no map
    assert maps_from([replace(row, terms={}, links={"nes1": 0.1}) for row in rows]) == ()
