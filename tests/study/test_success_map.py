"""Success maps: counts of exact answers over noise and samples a period, panel by panel."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from paper_rows import stored
from reach_rows import EXACT, reach_rows, reach_study

import linkwise as lw
from linkwise.study.row import FAILED, Row
from linkwise.study.summary import StudySummary, SuccessMap, maps_of


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
