"""The one notion of trust: what forbids it, and what results print of it."""

from dataclasses import replace

import pytest

import linkwise as lw
from linkwise.verdict import Verdict, admit_intervals, status_of

ADMISSIBLE = {
    Verdict.CONVERGED,
    Verdict.NO_INTERVALS,
    Verdict.MODEL_ERROR_NEEDED,
    Verdict.ENERGY_BALANCE_CLOSED,
    Verdict.MOTIONS_FOLLOWED,
    Verdict.MOTIONS_CUT_SHORT,
    Verdict.PREDICTION_AGREES,
    Verdict.UNKNOWNS_DETERMINED,
    Verdict.NOTHING_WRONG_SEEN,
    Verdict.LINEAR_IN_RANGE,
    Verdict.MODES_MOVE,
    Verdict.STUDY_COMPLETE,
    Verdict.CASES_WITHOUT_ANSWER,
}
GOOD = {
    "converged",
    *(v.status for v in ADMISSIBLE if v not in (Verdict.NO_INTERVALS, Verdict.MODEL_ERROR_NEEDED)),
}


@pytest.mark.parametrize("verdict", Verdict)
def test_every_verdict_advises_and_forbids_or_not(verdict: Verdict) -> None:
    assert verdict.value.endswith(".") and len(verdict.value) > 40
    assert verdict.forbids is (verdict not in ADMISSIBLE)
    assert verdict.status == verdict.status.lower() and verdict.forbids is (verdict.status not in GOOD)


def test_one_verdict_that_forbids_is_enough() -> None:
    assert admit_intervals((Verdict.CONVERGED, Verdict.MODEL_ERROR_NEEDED)) and admit_intervals(())
    assert not admit_intervals((Verdict.CONVERGED, Verdict.SEARCH_UNSETTLED))
    assert status_of((Verdict.CONVERGED, Verdict.UNEXPLAINED_FORCES)) == "forces unexplained"
    assert status_of((Verdict.MODEL_ERROR_NEEDED,)) == "converged"


@pytest.mark.parametrize("verdict", Verdict)
def test_all_of_an_estimate_follows_its_verdicts(verdict: Verdict, fitted: lw.Estimate) -> None:
    estimate = replace(fitted, fit_verdicts=(verdict,))
    document = estimate.to_dict()
    assert document["verdicts"] == [verdict.name] and document["trusted"] is (
        verdict.grade is lw.Grade.EXPLAINED
    )
    assert document["status"] == estimate.status
    first = str(estimate).splitlines()[0]
    assert first.endswith(f", {estimate.grade.trust}") and document["grade"] == estimate.grade.value
    assert (estimate.coefficient("nes1.alpha").interval is None) is verdict.forbids
    told = replace(estimate, approximate=True)  # by the scatter between parts of the record
    assert told.grade is verdict.grade and ("Intervals are approximate" in str(told).replace("\n", " ")) is (
        verdict.grade is lw.Grade.APPROXIMATE
    )
