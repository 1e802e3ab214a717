"""The examples in docstrings run and print what they say."""

import doctest
import pickle
from collections.abc import Callable
from functools import cache, partial
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from here import studies_here
from structures import beam_of_one_mode

import linkwise as lw

pytestmark = pytest.mark.usefixtures("unrendered", "each_once")

PACKAGE = Path(lw.__file__).parent
TEXTS = {
    ".".join(("linkwise", *path.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__"): text
    for path in sorted(PACKAGE.rglob("*.py"))
    if ">>> " in (text := path.read_text(encoding="utf-8"))
}
LONG = (
    "simulate", "identify", "discover", "validate", "absorb", "limit", "modal.identify_host", "inspection.compare_levels",
)  # fmt: skip
ANSWERS: dict[bytes, Any] = {}
STUDY = "results/mine"  # what examples of studies call theirs, the result of mine.toml
DEFINITION = """
snr_db = [40]
first_seed = 1000
cycles = 2

[[structure]]
bnes = 2
release = { "v:m1" = 1.0 }
duration = 0.5
rate = 1000.0

[[method]]
kind = "weak"
"""
LEVELS = {  # files of one test of a beam at two levels that examples read, and their forces in N
    "soft_tap.csv": "exp(-((t - 0.1)/0.01)**2)",
    "hard_tap.csv": "2*exp(-((t - 0.1)/0.01)**2)",
    "soft_sine.csv": "sin(2*pi*16*t)",
    "hard_sine.csv": "2*sin(2*pi*16*t)",
}


@cache
def level(file: str) -> lw.Record:
    """What an accelerometer at the tip of the beam shows."""
    sensors, rate = ["a:beam.tip"], 320.0
    record = lw.simulate(
        beam_of_one_mode(), forces={"beam.tip": LEVELS[file]}, duration=2.0, rate=rate, sensors=sensors
    )
    return record.with_noise(40.0, seed=1)


@pytest.fixture
def each_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """What several examples ask is answered once: a call gives the same each time, which tests of each function hold."""
    for name in LONG:
        monkeypatch.setattr(f"linkwise.{name}", partial(answered, attrgetter(name)(lw)))


def answered(function: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
    """What the function returns, from an earlier call with the same arguments where there was one."""
    try:
        question = pickle.dumps((function.__name__, arguments, options))
    except (AttributeError, TypeError, pickle.PicklingError):  # a function of the example is an argument
        return function(*arguments, **options)
    if question not in ANSWERS:
        ANSWERS[question] = function(*arguments, **options)
    return ANSWERS[question]


@pytest.fixture(scope="module")
def folder_with_study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the study that examples read."""
    folder = tmp_path_factory.mktemp("study")
    (folder / "mine.toml").write_text(DEFINITION, encoding="utf-8")
    with studies_here():
        lw.study.run_study(folder / "mine.toml", folder / STUDY, workers=1)
    return folder


@pytest.mark.parametrize("name", TEXTS)
def test_examples_run(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    needs_study = STUDY in TEXTS[name]
    for file in LEVELS:
        if file in TEXTS[name]:
            lw.write_record(level(file), tmp_path / file)
    monkeypatch.chdir(request.getfixturevalue("folder_with_study") if needs_study else tmp_path)
    with np.printoptions():  # which a library changes that the search for examples loads
        results = doctest.testmod(import_module(name), optionflags=doctest.ELLIPSIS)
    stated = sum(line.lstrip().startswith(">>> ") for line in TEXTS[name].splitlines())
    assert results.failed == 0 and results.attempted == stated > 0


def test_no_example_is_skipped() -> None:
    assert [name for name, text in TEXTS.items() if "doctest: +SKIP" in text] == []
