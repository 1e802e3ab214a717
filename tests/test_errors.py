"""Errors and verdicts, and the doors where values of users enter: what has another type is refused with the next step."""

import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import NoneType
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from problems import chain_record

import linkwise as lw
from linkwise.errors import expect
from linkwise.registry import Registry
from linkwise.verdict import admit_intervals, status_of


def test_law_error_puts_the_caret_under_the_place() -> None:
    error = lw.LawError("'foo' is not a function.", "k*d + foo(v)", 6, "Use one of abs, sign.")
    assert str(error) == "'foo' is not a function.\n  k*d + foo(v)\n        ^\nUse one of abs, sign."
    lines = str(lw.LawError("no", "k*d +\n\tfoo(d)", 7)).splitlines()
    assert lines[1:] == ["   foo(d)", "   ^"]  # the line of the place only
    assert "^" not in str(lw.LawError("no", "k*d"))


@pytest.mark.parametrize(
    "error",
    [
        lw.LawError("no", "k*d", 2, "do"),
        lw.StructureError("no", where="a"),
        lw.RecordError("no", "a", 1, "c"),
        lw.SimulationError("no", 1.0, "m1"),
    ],
)
def test_errors_cross_process_borders(error: lw.LinkwiseError) -> None:
    """Campaign workers send them back: a pickled error is equal in text and in what it carries."""
    copy = pickle.loads(pickle.dumps(error))
    assert type(copy) is type(error) and str(copy) == str(error) and vars(copy) == vars(error)


def test_exit_codes() -> None:
    codes = {kind: kind.exit_code for kind in (lw.LawError, lw.StructureError, lw.RecordError)}
    assert set(codes.values()) == {2}
    assert {lw.SimulationError.exit_code, lw.IdentificationError.exit_code, lw.LinkwiseError.exit_code} == {1}


def test_an_unknown_name_lists_those_there_are() -> None:
    registry: Registry[int] = Registry("window", {"hann": 1, "hamming": 2}, lw.IdentificationError)
    with pytest.raises(lw.IdentificationError) as error:
        registry.lookup("haming")
    expected = "unknown window 'haming'; did you mean \"hamming\"?; choose from 'hann', 'hamming'"
    assert str(error.value) == expected
    with pytest.raises(KeyError):
        registry["haming"]


ADMISSIBLE = {
    lw.Verdict.CONVERGED,
    lw.Verdict.NO_INTERVALS,
    lw.Verdict.MODEL_ERROR_NEEDED,
    lw.Verdict.ENERGY_BALANCE_CLOSED,
    lw.Verdict.MOTIONS_FOLLOWED,
    lw.Verdict.MOTIONS_CUT_SHORT,
    lw.Verdict.PREDICTION_AGREES,
    lw.Verdict.UNKNOWNS_DETERMINED,
    lw.Verdict.NOTHING_WRONG_SEEN,
    lw.Verdict.LINEAR_IN_RANGE,
    lw.Verdict.MODES_MOVE,
    lw.Verdict.STUDY_COMPLETE,
    lw.Verdict.CASES_WITHOUT_ANSWER,
}
GOOD = {
    "converged",
    *(v.status for v in ADMISSIBLE if v not in (lw.Verdict.NO_INTERVALS, lw.Verdict.MODEL_ERROR_NEEDED)),
}


@pytest.mark.parametrize("verdict", lw.Verdict)
def test_every_verdict_advises_and_forbids_or_not(verdict: lw.Verdict) -> None:
    assert verdict.value.endswith(".") and len(verdict.value) > 40
    assert verdict.forbids is (verdict not in ADMISSIBLE)
    assert verdict.status == verdict.status.lower() and verdict.forbids is (verdict.status not in GOOD)


def test_one_verdict_that_forbids_is_enough() -> None:
    assert admit_intervals((lw.Verdict.CONVERGED, lw.Verdict.MODEL_ERROR_NEEDED)) and admit_intervals(())
    assert not admit_intervals((lw.Verdict.CONVERGED, lw.Verdict.SEARCH_UNSETTLED))
    assert status_of((lw.Verdict.CONVERGED, lw.Verdict.UNEXPLAINED_FORCES)) == "forces unexplained"
    assert status_of((lw.Verdict.MODEL_ERROR_NEEDED,)) == "converged"


@pytest.mark.parametrize("verdict", lw.Verdict)
def test_all_of_an_estimate_follows_its_verdicts(verdict: lw.Verdict, fitted: lw.Estimate) -> None:
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


CHAIN = lw.bnes_chain(2)
LAW = lw.Law.parse("k*d")
RECORD = chain_record(2, duration=0.5, rate=500.0)
ENDS = ("m1", "ground")

READ = "; read_record(path) reads one from a file"
STRUCTURE = "must be of type Structure, got Record; read_structure(path) reads one from a file"
DOORS: list[tuple[Callable[..., Any], tuple[Any, ...], dict[str, Any], str]] = [
    (lw.simulate, (RECORD,), {"duration": 1.0, "rate": 9.0}, f"simulate(structure): structure {STRUCTURE}"),
    (lw.simulate, (CHAIN,), {"duration": "1", "rate": 9.0}, "duration must be of type float or None, got '1'"),
    (lw.simulate, (CHAIN,), {"duration": 1.0, "rate": 9.0, "release": {"v:m1": "1"}}, "release['v:m1'] must be of type"),
    (lw.identify, ("run.csv", CHAIN), {}, f"identify(record, structure): record must be of type Record, got 'run.csv'{READ}"),
    (lw.identify, (CHAIN, RECORD), {}, f"record must be of type Record, got Structure{READ}"),
    (lw.identify, ([RECORD, Path("b.csv")], CHAIN), {}, "record[1] must be of type Record, got PosixPath('b.csv')"),
    (lw.identify, (RECORD, CHAIN), {"method": lw.WeakForm}, "method must be of type str or Estimator, got WeakForm"),
    (lw.discover, ({"m1": 1.0}, RECORD), {}, f"discover(record, masses): record must be of type Record, got dict{READ}"),
    (lw.discover, (RECORD, ["m1"]), {}, "masses must be of type Mapping, Structure or PartialStructure, got list"),
    (lw.absorb, (RECORD,), {"duration": 1.0}, f"absorb(structure): structure {STRUCTURE}"),
    (lw.absorb, (CHAIN,), {"duration": "1"}, "AbsorptionOptions: duration must be of type float or None, got '1'"),
    (lw.respond, (RECORD,), {"hz": (1.0, 2.0)}, "respond(answer): answer must be of type Structure, Estimate, Posterior"),
    (lw.response.basins, (RECORD, {}), {}, f"basins(structure, plane): structure {STRUCTURE}"),
    (lw.identify, (RECORD, CHAIN), {"ofsets": ()}, "unexpected keyword argument 'ofsets'; did you mean \"offsets\"?"),
    (lw.validate, (CHAIN, RECORD), {}, "validate(record, answer): record must be of type Record"),
    (lw.limit, (RECORD,), {"duration": 1.0, "rate": 9.0, "noise": 20.0}, f"limit(structure): structure {STRUCTURE}"),
    (lw.best_test, (RECORD, "nes1.c"), {"duration": 1.0, "rate": 9.0, "noise": {}, "within": {}}, "best_test(structure)"),
    (lw.inspect, ("run.csv",), {}, f"inspect(records): records must be of type Record, got 'run.csv'{READ}"),
    (lw.read_record, (RECORD,), {}, "read_record(path): path must be of type str or Path, got Record"),
    (lw.write_record, ("run.csv", RECORD), {}, "write_record(record, path): record must be of type Record, got 'run.csv'"),
    (lw.read_structure, (CHAIN,), {}, "read_structure(path): path must be of type str or Path, got Structure"),
    (lw.write_structure, ("a.toml", CHAIN), {}, "write_structure(structure, path): structure must be of type Structure"),
    (lw.study.read_study, (CHAIN,), {}, "read_study(study): study must be of type str or Path, got Structure"),
    (lw.nmse, (CHAIN, CHAIN, RECORD), {}, "nmse(true, estimated, record): true must be of type Link, got Structure"),
    (lw.report.write_result, (Path("answer"), "fit"), {}, "result must be of type Absorption, "),
    (lw.Mass, ("m1", None), {}, 'mass "m1" must be of type Coefficient, float or str, got NoneType; Coefficient.unknown()'),
    (lw.Link, ("leaf", ENDS, b"k*d", {"k": 1.0}), {}, 'link "leaf": law must be of type Law or str, got bytes; Law.parse'),
    (lw.Link, ("leaf", ENDS, LAW, {"k": None}), {}, 'link "leaf", coefficient k must be of type Coefficient, float or str'),
    (lw.rig, ({"m1": 1.0}, ["m1 - ground: k*d"]), {}, "rig(masses, links, known): links must be of type Mapping, got list"),
    (lw.Link, ("leaf", "m1", LAW, {"k": 1.0}), {}, 'link "leaf": between must be of type tuple or list, got \'m1\''),
    (lw.Structure, ("one", CHAIN.links, CHAIN.masses), {}, 'structure "one": masses[0] must be of type Mass, got Link'),
    (lw.Coefficient, (1.0, 1), {}, "coefficient: known must be of type bool, got 1"),
    (lw.Record, (0.0, "9", ("x:m1",), np.zeros((40, 1))), {}, "Record: rate must be of type float, got '9'; write"),
    (lw.Record.from_arrays, (RECORD.time, RECORD.values), {}, "channels must be of type Mapping, got ndarray"),
    (lw.model.Excitation, (), {"impulses": (1.0,)}, "Excitation: impulses[0] must be of type Impulse, got 1.0"),
    (lw.model.HostMode, ("5 Hz", 0.01, {"tip": 1.0}), {}, "the frequency of a mode must be of type Coefficient or float"),
    (lw.Host, ("wing", (5.2,)), {}, 'host "wing": modes[0] must be of type HostMode, got 5.2'),
    (lw.MaximumLikelihood, (), {"delays": "x:m1"}, "MaximumLikelihood: delays must be of type tuple or list, got 'x:m1'"),
    (lw.discovery.DiscoveryOptions, (), {"delays": {"x:m1": 1.0}}, "delays must be of type str, tuple or list, got dict"),
    (lw.plot.histories, (RECORD,), {"ax": Figure().subplots(1, 2)}, "ax must be of type Axes or None, got ndarray"),
]  # fmt: skip


@pytest.mark.parametrize(("door", "arguments", "keywords", "message"), DOORS)
def test_what_has_another_type_is_refused(
    door: Callable[..., Any], arguments: tuple[Any, ...], keywords: dict[str, Any], message: str
) -> None:
    with pytest.raises(lw.ArgumentTypeError) as error:
        door(*arguments, **keywords)
    assert message in str(error.value)


@pytest.mark.parametrize(
    ("value", "kinds"),
    [(np.float64(2.0), (float,)), (2, (float,)), (np.int64(2), (int,)), (None, (float, NoneType)), (True, (bool,))],
)  # fmt: skip
def test_what_fits_passes(value: object, kinds: tuple[type, ...]) -> None:
    expect("value", value, *kinds)


@pytest.mark.parametrize(("value", "kind"), [(True, float), (True, int), (2.0, int), ("2", float)])
def test_neither_a_bool_nor_a_text_is_a_number(value: object, kind: type) -> None:
    with pytest.raises(lw.ArgumentTypeError, match=rf"value must be of type {kind.__name__}, got {value!r}"):
        expect("value", value, kind)
