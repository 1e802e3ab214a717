"""Rows told as cells: medians, spreads, what failed, what is missing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from present import present

from linkwise.study.definition import Study, parse_study
from linkwise.study.row import FAILED, Case, Row
from linkwise.study.summary import StudyTable

TEXT = """
snr_db = [20, 40]
cycles = 4
structure = [
  { name = "four", bnes = 4, duration = 1.0, rate = 1000.0, release = { "v:m1" = 3.0 } },
  { name = "two", bnes = 2, duration = 1.0, rate = 1000.0, release = { "v:m1" = 1.0 } },
]
method = [{ kind = "weak" }, { kind = "ml" }]
"""


@pytest.fixture(scope="module")
def study() -> Study:
    """Two structures, two noise levels, two methods, four seeds from 1000 on."""
    return parse_study(TEXT, "study.toml", None)  # type: ignore[arg-type]


def row(case: Case, error: float, *, seconds: float = 0.1) -> Row:
    """An answer to `case` with one sink, whose error is `error` in %."""
    return Row(
        case.structure,
        2,
        case.snr_db,
        case.method,
        case.seed,
        status="converged",
        links={"nes1": error},
        seconds=seconds,
    )


def rows(study: Study, errors: list[float]) -> list[Row]:
    """Every case answered; seed by seed the error is that of the list."""
    return [row(case, errors[case.seed - 1000], seconds=case.seed - 999.0) for case in study.cases()]


def test_cells_stand_in_order_and_carry_medians(study: Study) -> None:
    table = StudyTable.of(study, rows(study, [4.0, 1.0, 2.0, 9.0]))
    assert (table.structures, table.decibels, table.methods) == (
        ("two", "four"),
        (40.0, 20.0),
        ("weak", "ml"),
    )
    assert table.masses == {"two": 2, "four": 4}
    assert (table.expected, table.missing, table.failed) == (32, 0, 0)
    cell = present(table.cell("two", 20.0, "ml"))
    assert (cell.nmse, cell.low, cell.high, cell.seconds) == (3.0, 1.0, 9.0, 2.5)
    assert present(cell.median_row).seed == 1000  # 4 and 2 are as close to 3: the first seed
    assert cell.share_above(3.0) == 0.5
    assert table.cell("two", 30.0, "ml") is None


def test_a_failed_case_counts_as_worse_than_any_answer(study: Study) -> None:
    given = [
        replace(study_row, status=FAILED, links={}, reason="it diverged")
        if study_row.seed > 1000 + 1
        else study_row
        for study_row in rows(study, [4.0, 1.0, 0.0, 0.0])
    ]
    cell = present(StudyTable.of(study, given).cell("two", 20.0, "ml"))
    assert (cell.nmse, cell.low, cell.high) == (None, 1.0, None)  # half of them failed
    assert cell.done == 4 and cell.reasons == (("it diverged", 2),)
    assert cell.median_row is None and cell.share_above(100.0) == 0.5
    one_failed = present(StudyTable.of(study, given[:-8]).cell("two", 20.0, "ml"))
    assert (one_failed.done, one_failed.nmse) == (3, 4.0)


def test_an_error_that_is_no_number_is_a_failure(study: Study) -> None:
    table = StudyTable.of(study, [row(case, np.nan) for case in study.cases()])
    assert table.failed == 32 and present(table.cell("two", 20.0, "ml")).nmse is None


def test_missing_cells_are_counted_and_strangers_left_out(study: Study) -> None:
    given = [study_row for study_row in rows(study, [1.0] * 4) if study_row.structure == "two"]
    stranger = row(Case("two", 20.0, "ml", 7), 1e9)
    table = StudyTable.of(study, [*given, stranger])
    assert table.missing == 16 and present(table.cell("two", 20.0, "ml")).nmse == 1.0
    empty = present(table.cell("four", 20.0, "ml"))
    assert (empty.done, empty.expected, empty.masses) == (0, 4, 4)
    assert (empty.nmse, empty.low, empty.seconds, empty.median_row) == (None, None, None, None)
    assert np.isnan(empty.share_above(1.0))


def test_answers_are_counted_by_their_terms(study: Study) -> None:
    """Of four: exact, a term missing, one extra in doubt, and none at all."""
    case = next(
        case for case in study.cases() if (case.structure, case.snr_db, case.method) == ("two", 20.0, "ml")
    )
    judged = [("converged", 0, 0), ("converged", 1, 0), ("not converged", 0, 1)]
    answers = [
        Row(
            "two",
            2,
            20.0,
            "ml",
            1000 + number,
            status=status,
            terms={"right": 4, "missing": missing, "extra": extra},
        )
        for number, (status, missing, extra) in enumerate(judged)
    ]
    failed = Row("two", 2, 20.0, "ml", 1003, status=FAILED, reason="too short")
    table = StudyTable.of(study, [*answers, failed])
    cell = present(table.cell("two", 20.0, "ml"))
    assert [answer.exact for answer in cell.answers] == [True, False, False]
    assert cell.failures == (failed,) and failed.exact is None
    assert (cell.exact, cell.exact_share, cell.untrusted) == (1, 0.25, 1)
    assert (cell.wrong_trusted, cell.extra_trusted) == (1, 0)
    assert cell.nmse is None and cell.median_row is None  # terms of monomials are no forces
    sure = replace(answers[2], status="converged")
    assert present(StudyTable.of(study, [sure]).cell("two", 20.0, "ml")).extra_trusted == 1
    told = present(StudyTable.of(study, [row(case, 1.0)]).cell("two", 20.0, "ml"))
    assert (told.exact, told.exact_share, told.wrong_trusted, told.extra_trusted) == (None, None, None, None)


def test_intervals_that_hold_the_true_value_are_counted(study: Study) -> None:
    """Those of trusted answers alone have standard errors; the chain's alpha is -100."""
    case = next(
        case for case in study.cases() if (case.structure, case.snr_db, case.method) == ("two", 20.0, "ml")
    )
    spread = 1.0
    answers = [
        replace(
            row(replace(case, seed=1000 + number), 1.0),
            coefficients={"nes1.alpha": -100.0 + off},
            standard_errors={"nes1.alpha": spread} if trusted else {},
        )
        for number, (off, trusted) in enumerate([(1.9, True), (-1.9, True), (2.1, True), (50.0, False)])
    ]
    cell = present(StudyTable.of(study, answers).cell("two", 20.0, "ml"))
    assert cell.truth["nes1.alpha"] == -100.0
    assert cell.intervals == 3 and cell.coverage == pytest.approx(2 / 3)
    assert (
        present(StudyTable.of_rows(answers).cell("two", 20.0, "ml")).coverage is None
    )  # nobody knows the truth
