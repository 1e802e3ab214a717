"""What errors say and carry, what a wrong name is told, and what a verdict forbids."""

import pickle
from dataclasses import replace

import pytest

import linkwise as lw
from linkwise.errors import (
    IdentificationError,
    LawError,
    LinkwiseError,
    RecordError,
    SimulationError,
    StructureError,
)
from linkwise.registry import Registry
from linkwise.verdict import Verdict, admit_intervals, status_of


def test_law_error_puts_the_caret_under_the_place() -> None:
    error = LawError("'foo' is not a function.", "k*d + foo(v)", 6, "Use one of abs, sign.")
    assert str(error) == "'foo' is not a function.\n  k*d + foo(v)\n        ^\nUse one of abs, sign."
    lines = str(LawError("no", "k*d +\n\tfoo(d)", 7)).splitlines()
    assert lines[1:] == ["   foo(d)", "   ^"]  # the line of the place only
    assert "^" not in str(LawError("no", "k*d"))


@pytest.mark.parametrize(
    "error",
    [
        LawError("no", "k*d", 2, "do"),
        StructureError("no", where="a"),
        RecordError("no", "a", 1, "c"),
        SimulationError("no", 1.0, "m1"),
    ],
)
def test_errors_cross_process_borders(error: LinkwiseError) -> None:
    """Campaign workers send them back: a pickled error is equal in text and in what it carries."""
    copy = pickle.loads(pickle.dumps(error))
    assert type(copy) is type(error) and str(copy) == str(error) and vars(copy) == vars(error)


def test_exit_codes() -> None:
    codes = {kind: kind.exit_code for kind in (LawError, StructureError, RecordError)}
    assert set(codes.values()) == {2}
    assert {SimulationError.exit_code, IdentificationError.exit_code, LinkwiseError.exit_code} == {1}


def test_an_unknown_name_lists_those_there_are() -> None:
    registry: Registry[int] = Registry("window", {"hann": 1, "hamming": 2}, IdentificationError)
    with pytest.raises(IdentificationError) as error:
        registry.lookup("haming")
    expected = "unknown window 'haming'; did you mean \"hamming\"?; choose from 'hann', 'hamming'"
    assert str(error.value) == expected
    with pytest.raises(KeyError):
        registry["haming"]


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
