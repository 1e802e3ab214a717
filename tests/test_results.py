"""Every answer of a public function says whether it can be trusted; its types are public, and long work takes a progress."""

import inspect
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

import numpy as np
import pytest
from here import studies_here
from matplotlib.figure import Figure
from present import some
from problems import chain_record
from public import public
from small_study import small
from structures import oscillator
from tapped_beam import tapped

import linkwise as lw
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


def test_no_answer_shows_all_that_it_holds() -> None:
    generated = {name for name, kind in some(answers().items()) if hasattr(kind.__repr__, "__wrapped__")}
    assert generated == set()  # by `dataclass`, which wraps what it makes


def test_an_inspection_with_an_alert_says_so() -> None:
    record = chain_record(2, duration=3.0).with_noise(30.0, seed=1)
    x = record.channel("x:m1")
    faulty = {
        "x:m1": np.clip(x, -0.7 * np.abs(x).max(), 0.7 * np.abs(x).max()),
        "x:m2": record.channel("x:m2"),
    }
    inspection = lw.inspect(lw.Record.from_arrays(record.time, faulty))
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
