"""Answers: what all of them can say, and what Python and a notebook show of the objects that a user holds."""

import html
import inspect
import json
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, Literal, get_args, get_origin, get_type_hints

import numpy as np
import pytest
from here import studies_here
from matplotlib.figure import Figure
from present import some
from problems import chain_record
from public import public
from record_faults import changed
from small_study import small
from structures import oscillator
from tapped_beam import tapped

import linkwise as lw
from linkwise.display import FIGURES, JudgedView
from linkwise.output import to_json
from linkwise.progress import silent

NO_ANSWERS = {  # what public functions give that is not an answer of its own, and why
    "DenseSystem": "the equations that a regression solves",
    "Equilibria": "a property of a structure whose numbers are given",
    "Equivalent": "a property of a law whose numbers are given",
    "FreeRun": "a simulation beside a record; `Validation` judges one",
    "HostMatrices": "what files say",
    "HostMode": "what a file says",
    "Modes": "a property of a structure whose numbers are given",
    "NamedLaw": "a law by its name",
    "OrbitEnvelope": "statistics of simulations of a structure whose numbers are given",
    "PartialStructure": "what a file says",
    "Posterior": "refused for estimates that are not trusted",
    "Record": "what sensors show; `inspect` judges it",
    "RecordMapping": "what a file says",
    "Row": "a line of a study, with the status of its estimate; `StudySummary` judges all",
    "States": "arrays",
    "StreamedSystem": "the equations that a regression solves",
    "Structure": "what is given or identified; `Estimate` judges it",
    "Study": "what is asked for",
    "SuccessMap": "counts of comparisons with a truth that is given",
    "Term": "what is asked for",
    "TermScore": "a comparison with a truth that is given",
}

# for type checkers
LATE = {
    k.__name__: k for k in (lw.Structure, lw.inspection.LevelComparison, lw.analysis.OrbitEnvelope, Figure)
}


def classes(annotation: object) -> Iterator[type]:
    """All classes in a type: `list[Unlisted | None]` has three."""
    parts = annotation if isinstance(annotation, list | tuple) else get_args(annotation)
    if get_origin(annotation) is not Literal:
        for part in (get_origin(annotation), getattr(annotation, "__bound__", None), *parts):
            yield from classes(part) if part is not None else ()
    if isinstance(annotation, type):
        yield annotation


def returned(function: Any) -> Iterator[type]:
    """The classes in what a function returns."""
    yield from classes(get_type_hints(inspect.unwrap(function), localns=LATE).get("return"))


RELEASE = {"v:m1": 1.0}


def answers() -> dict[str, type[Any]]:
    """The types of linkwise that public functions return, but for those that are no answers."""
    return {name: kind for name, kind in results().items() if name not in NO_ANSWERS}


def results() -> dict[str, type[Any]]:
    """The types of linkwise that public functions return."""
    names = dict(public())
    kinds = {value: name.rpartition(".")[2] for name, value in names.items() if isinstance(value, type)}
    return {
        kinds[kind]: kind
        for value in names.values()
        if inspect.isroutine(value)
        for kind in returned(value)
        if kind in kinds
    }


def finished(folder: Path) -> lw.study.StudySummary:
    """The summary of a study of two structures by three methods."""
    with studies_here():
        lw.study.run_study(lw.study.read_study(small(folder, cycles=1)), folder / "out", workers=1)
    return lw.study.study_summary(folder / "out")


def taps() -> list[lw.Record]:
    spring = oscillator("k*d + c*v", mass=1.0, name="spring", k=4e3, c=1.0)
    forces = [{"m1": f"{size}*exp(-((t - 0.1)/0.01)**2)"} for size in (1.0, 2.0)]
    clean = (
        lw.simulate(spring, forces=force, duration=2.0, rate=200.0, sensors=["a:m1"]) for force in forces
    )
    return [record.with_noise(40.0, seed=1) for record in clean]


def absorbed(over: dict[str, list[float]] | None = None) -> Any:
    chain = lw.bnes_chain(2)
    if over is not None:
        return lw.absorption.absorption_map(chain, over, duration=0.5, release=RELEASE)
    return lw.absorb(chain, duration=0.5, release=RELEASE)


@pytest.fixture(scope="module")
def makers(
    fitted: lw.Estimate, discovered: lw.Discovery, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, Callable[[], Any]]:
    """How an answer of each type comes about."""
    chain, record = lw.bnes_chain(2), chain_record(2, duration=3.0).with_noise(30.0, seed=1)
    return {
        "Absorption": absorbed,
        "AbsorptionIntervals": lambda: lw.absorption.absorption_intervals(
            lw.estimates.Posterior.of(fitted), draws=20, duration=0.5, release=RELEASE
        ),
        "AbsorptionMap": lambda: absorbed({"nes1.alpha": [-150.0, -100.0]}),
        "Design": lambda: lw.design(
            chain, {"nes1.alpha": (-150.0, -50.0)}, "rms", lw.absorption.DesignOptions(evaluations=8),
            duration=0.5, release=RELEASE,
        ),
        "Backbone": lambda: lw.backbone(chain, 1, to_energy=1e-5),
        "Basins": lambda: lw.response.basins(chain, {"x:m2": (-0.01, 0.01), "v:m2": (0.0, 0.1)}, points=2),
        "Discovery": lambda: discovered,
        "Estimate": lambda: fitted,
        "HostEstimate": lambda: lw.modal.identify_host(tapped().with_noise(40.0, seed=1)),
        "Inspection": lambda: lw.inspect(record),
        "LevelComparison": lambda: lw.inspection.compare_levels(taps()),
        "BestTest": lambda: lw.best_test(
            oscillator("k*d + c*v", name="spring", k=400.0, c=0.5), "spring.k", duration=0.4, rate=60.0, noise={"x:m1": 1e-5},
            within={"force": 5.0}, unknown=["spring"],
        ),
        "Limit": lambda: lw.limit(chain, duration=0.1, rate=500.0, noise=40.0, release=RELEASE),
        "Response": lambda: lw.respond(chain, force={"m1": 0.1}, hz=(29.0, 31.0), starts=0),
        "StudySummary": lambda: finished(tmp_path_factory.mktemp("study")),
        "Validation": lambda: lw.validate(record, fitted),
    }  # fmt: skip


def test_the_walk_finds_every_answer(makers: dict[str, Callable[[], Any]]) -> None:
    assert answers().keys() == makers.keys() and NO_ANSWERS.keys() < results().keys()


@pytest.mark.slow
@pytest.mark.parametrize("name", answers())
def test_an_answer_says_whether_it_can_be_trusted(name: str, makers: dict[str, Callable[[], Any]]) -> None:
    answer: Any = makers[name]()
    assert type(answer) is answers()[name]
    assert answer.verdicts and all(isinstance(verdict, lw.Verdict) for verdict in some(answer.verdicts))
    assert answer.trusted and answer.grade is lw.Grade.EXPLAINED
    document = json.loads(to_json(answer.to_dict()))
    assert document["verdicts"] == [verdict.name for verdict in answer.verdicts]
    assert document["trusted"] is True
    markup = answer._repr_html_()
    assert "#1a7f37" in markup and "<script" not in markup  # green
    heading = html.unescape(markup.partition("<strong>")[2].partition("</strong>")[0])
    assert heading == str(answer).splitlines()[0] or name == "Estimate"


def test_no_answer_shows_all_that_it_holds() -> None:
    generated = {name for name, kind in some(answers().items()) if hasattr(kind.__repr__, "__wrapped__")}
    assert generated == set()  # by `dataclass`, which wraps what it makes


def test_an_inspection_with_an_alert_says_so() -> None:
    record = chain_record(2, duration=3.0).with_noise(30.0, seed=1)
    clipped = changed(record, x_m1=lambda x: np.clip(x, -0.7 * np.abs(x).max(), 0.7 * np.abs(x).max()))
    inspection = lw.inspect(clipped)
    assert [alert.kind for alert in inspection.alerts] == ["clipped"]
    assert inspection.verdicts == (lw.Verdict.CHANNELS_IN_DOUBT,) and not inspection.trusted
    assert inspection.to_dict()["verdicts"] == ["CHANNELS_IN_DOUBT"]


def test_a_summary_says_what_was_not_run_and_what_failed() -> None:
    row = lw.study.Row("two", 2, 20.0, "ml", 1, status="converged", links={"nes1": 0.1})
    full = lw.study.Cell("four", 4, 20.0, "ml", 2, (row, row), ())

    def with_first(answers: int, failures: int) -> lw.study.StudySummary:
        cell = lw.study.Cell("two", 2, 20.0, "ml", 2, (row,) * answers, (row,) * failures)
        return lw.study.StudySummary("small", (cell, full))

    verdicts = lw.Verdict
    assert with_first(2, 0).verdicts == (verdicts.STUDY_COMPLETE,)
    assert with_first(1, 1).verdicts == (verdicts.CASES_WITHOUT_ANSWER,) and with_first(1, 1).trusted
    assert with_first(0, 2).verdicts == (verdicts.CELLS_WITHOUT_ANSWER,) and not with_first(0, 2).trusted
    assert with_first(1, 0).verdicts == (verdicts.STUDY_INCOMPLETE,) and not with_first(1, 0).trusted


def attribute_types(owner: type) -> Iterator[tuple[str, type]]:
    """The public attributes of a class, inherited ones included, and the classes in what they give."""
    for name, annotation in get_type_hints(owner, localns=LATE).items():
        yield from ((name, kind) for kind in classes(annotation) if not name.startswith("_"))
    for base in owner.__mro__:
        for name, value in vars(base).items():
            getter = next(
                (part for key in ("fget", "func", "__func__") if (part := getattr(value, key, None))), value
            )
            if (
                not name.startswith("_")
                and inspect.isfunction(getter)
                and base.__module__.partition(".")[0] in ("linkwise", owner.__module__.partition(".")[0])
            ):
                yield from ((name, kind) for kind in returned(getter))


def given(name: str, value: Any) -> Iterator[tuple[str, type]]:
    """Where a public name hands out classes, and which."""
    if isinstance(value, type):
        yield from ((f"{name}.{attribute}", kind) for attribute, kind in attribute_types(value))
    elif inspect.isroutine(value):
        yield from ((name, kind) for kind in returned(value))


def unlisted(names: dict[str, Any], package: str) -> dict[str, set[str]]:
    """The classes of `package` that `names` hand out and do not hold, and where."""
    listed = {value for value in names.values() if isinstance(value, type)}
    leaks: dict[str, set[str]] = {}
    for name, value in names.items():
        for where, kind in given(name, value):
            if kind.__module__.partition(".")[0] == package and kind not in listed:
                leaks.setdefault(f"{kind.__module__}.{kind.__qualname__}", set()).add(where)
    return leaks


@pytest.mark.slow
def test_every_type_that_public_names_hand_out_is_public() -> None:
    names = dict(public())
    assert sum(len(list(given(name, value))) for name, value in names.items()) > 500
    assert unlisted(names, "linkwise") == {}


def _parameters(thing: object) -> list[str]:
    return list(inspect.signature(thing).parameters) if inspect.isfunction(thing) else []


LONG = {name: value for name, value in public() if "progress" in _parameters(value)}


def test_all_long_work_takes_the_same_and_is_silent_without() -> None:
    known = {"absorb", "discover", "identify", "limit", "study.run_study", "simulate", "report.write_result"}
    assert known <= set(LONG)
    for name, function in LONG.items():
        parameter = inspect.signature(function).parameters["progress"]
        stated = parameter.annotation, parameter.default, parameter.kind
        assert stated == ("Progress", silent, inspect.Parameter.KEYWORD_ONLY), name


def test_objects_show_themselves_in_a_line(fitted: lw.Estimate, discovered: lw.Discovery) -> None:
    shown = {
        "<Structure: bistable chain of 2 masses: 2 masses, 2 links>": fitted.structure,
        "<Estimate: bistable chain of 2 masses: weak, converged, can be trusted>": fitted,
        "<LinkEstimate: nes1 (m2 - m1): alpha*d + beta*d**3 + c*v>": fitted.link("nes1"),
        "<CoefficientEstimate: m1.mass = 1 kg, given>": fitted.coefficient("m1.mass"),
        "<Posterior of 3 coefficients: nes1.alpha, nes1.beta, nes1.c>": lw.estimates.Posterior.of(fitted),
    }
    assert {text: repr(thing) for text, thing in shown.items()} == {text: text for text in shown}
    assert re.fullmatch(
        r"nes1.alpha = -[\d.]+ N/m, standard error [\d.]+", str(fitted.coefficient("nes1.alpha"))
    )
    assert repr(discovered).startswith("<Discovery: 2 masses") and "\n" not in repr(discovered)
    assert str(fitted.structure).splitlines()[-1].endswith("m2 - m1  alpha*d + beta*d**3 + c*v")
    for thing in (fitted.motion, fitted.record.simulated, lw.study.read_study("paper")):
        assert len(repr(thing)) < 200


def test_an_estimate_is_a_table_of_pandas(fitted: lw.Estimate, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pandas")
    table = fitted.to_dataframe()
    alpha = fitted.coefficient("nes1.alpha")
    assert alpha.interval is not None
    assert tuple(table.loc["nes1.alpha"]) == (
        alpha.value,
        alpha.standard_error,
        *alpha.interval,
        "N/m",
        False,
    )
    assert np.isnan(table.loc["m1.mass", "lower"]) and list(table.index)[-1] == "m2.mass"
    monkeypatch.setitem(sys.modules, "pandas", None)
    message = "to_dataframe\\(\\) needs pandas, which is not installed: pip install"
    with pytest.raises(lw.IdentificationError, match=message):
        fitted.to_dataframe()


def test_results_draw_themselves(chain: lw.Structure, fitted: lw.Estimate, discovered: lw.Discovery) -> None:
    absorbed = lw.absorb(chain, duration=0.1, release={"v:m1": 1.0})
    for result in (fitted, discovered, absorbed, lw.inspect(fitted.record)):
        assert result.plot().axes

    class Table(JudgedView):
        verdicts = ()

    with pytest.raises(TypeError, match="Table has no figure of its own: print it"):
        Table().plot()
    assert all(callable(resolve_name(home)) for home in FIGURES.values())


def heading(markup: str) -> str:
    return markup.partition("<strong>")[2].partition("</strong>")[0]


def test_an_estimate_shows_its_trust_first(fitted: lw.Estimate) -> None:
    good = fitted._repr_html_()
    bad = replace(fitted, fit_verdicts=(lw.Verdict.NOT_CONVERGED,))._repr_html_()
    assert heading(good).endswith("can be trusted") and "#1a7f37" in good and "alpha" in good
    assert heading(bad).endswith("NOT to be trusted") and "#b42318" in bad


def test_names_are_escaped(chain: lw.Structure) -> None:
    hostile = replace(chain, name="<script>alert(1)</script>")
    markup = hostile._repr_html_()
    assert "<script" not in markup and "&lt;script&gt;" in markup
    assert "alpha*d + beta*d**3 + c*v" in markup and "0.01 kg" in markup
