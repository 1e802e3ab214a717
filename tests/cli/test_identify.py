"""`linkwise identify`: from files to the answer, to the folder, and to the exit code; and how it is interrupted."""

import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import document, said
from present import some
from structures import asked_oscillator

import linkwise as lw
from linkwise.cli.reading_options import RecordOptions
from linkwise.likelihood.options import AskedFor, errors_to_find
from linkwise.likelihood.shooting import minimise as stepping

pytestmark = pytest.mark.usefixtures("unrendered", "inside")

command = import_module("linkwise.cli.identify")  # the package holds the command under that name
IDENTIFY = "identify run.csv unknown.toml"
PROFILE = "linkwise.likelihood.optima.profiles.profile_interval"


def alpha(result: dict[str, Any]) -> Any:
    sink = next(link for link in result["links"] if link["name"] == "nes1")
    return sink["coefficients"]["alpha"]


def library(*records: str, **keywords: Any) -> Any:
    """The same coefficient from the library, with the same numerics."""
    given = [lw.read_record(f"{name}.csv") for name in records]
    fit = lw.identify(given, lw.read_structure("unknown.toml"), **keywords)
    return pytest.approx(fit.coefficient("nes1.alpha").value, rel=1e-8)


@pytest.mark.slow
def test_maximum_likelihood_is_the_default() -> None:
    result = document(IDENTIFY)
    assert result["method"] == "ml" and result["status"] == "converged" and "nmse_percent" not in result
    assert alpha(result)["value"] == library("run")
    both = document(f"{IDENTIFY} --with run2.csv")
    assert alpha(both)["value"] == library("run", "run2")
    assert both["fit"]["samples"] == 2 * result["fit"]["samples"]


def test_other_methods_are_chosen_by_name() -> None:
    assert alpha(document(f"{IDENTIFY} --method weak"))["value"] == library("run", method="weak")
    classical = f"{IDENTIFY} --method sindy --derivative savgol --regressor l1"
    expected = library("run", method=lw.PhysicsInformedSindy("savgol", "l1"))
    assert alpha(document(classical, 3))["value"] == expected


def test_prints_the_table_and_compares_with_the_truth() -> None:
    out, err = said(f"{IDENTIFY} --method weak --truth chain.toml")
    assert "nes1" in out and "alpha" in out and "N/m" in out and err == ""
    assert "against the truth: NMSE of the force (paper Eq. 8)" in out
    result = document(f"{IDENTIFY} --method weak --truth chain.toml")
    assert set(result["nmse_percent"]) == {"spring1", "nes1"}


def test_writes_the_folder_and_its_structure_is_the_next_input(tmp_path: Path) -> None:
    answer = tmp_path / "answer"
    assert str(answer / "report.html") in said(f"{IDENTIFY} --method weak -o {answer}").err
    assert "profile_intervals" not in (answer / "result.json").read_text(encoding="utf-8")
    assert "by the likelihood" not in (answer / "report.html").read_text(encoding="utf-8")
    again = f"simulate {answer}/structure.toml --duration 0.1 --rate 500 --release v:m1=1"
    said(f"{again} -o {tmp_path}/run.csv")


def test_errors_of_sensors_have_one_spelling() -> None:
    """CHANNEL:ERROR[=SIZE],...; --delay is short for one of them."""
    typed = (
        "x:wing.tip:offset=+-0.1mm,gain=1%,hum=50,hum=0.1kHz,noise=0.2mm",
        "a:m1:drift,corner=300mHz",
        "x:m2:drift=2s",
    )
    nothing = dict.fromkeys((option.name for option in fields(RecordOptions)), None)
    given: dict[str, Any] = {**nothing, "channel": (), "interpolation": (), "record": Path("run.csv")}
    options = RecordOptions(**{**given, "sensor": typed, "delay": ("rel:x:m2=2ms", "f:leaf")})
    assert options.beside_errors({"drifts": {"a:m1": 4.0}, "exact": True}) == {
        "exact": True,
        "hums": {"x:wing.tip": (50.0, 100.0)},
        "drifts": {"a:m1": 4.0, "x:m2": 2.0},
        "corners": {"a:m1": 0.3},
    }
    sensors = dict(options.record_mapping().sensors)
    tip = sensors.pop("x:wing.tip")
    assert (tip.offset, tip.gain, tip.noise) == ((0.0, 1e-4), (1.0, 0.01), 2e-4)
    assert {name: sensor.delay for name, sensor in sensors.items()} == {
        "rel:x:m2": (2e-3, 0.0),
        "f:leaf": (0.0, np.inf),
    }


def test_a_calibration_is_counted_where_it_is_stated() -> None:
    printed = document(f"{IDENTIFY} --calibration all=1% --calibration 'x:m1=0.5 %'")
    assert alpha(printed)["value"] == library("run", calibration={"all": 0.01, "x:m1": 0.005})
    assert sum(" of its motion (estimated" in line for line in printed["findings"]) == 2


def test_the_help_says_what_a_calibration_of_all_stands_for() -> None:
    """It said sensors of motion, and gave the load cell of a link a gain as well."""
    channels = {"x:m1": np.arange(64.0), "f:spring": np.arange(64.0) ** 2, "force:m1": np.arange(64.0) ** 3}
    record = lw.Record.from_arrays(np.arange(64) / 100.0, channels)
    gains = errors_to_find([record], AskedFor(calibration={"all": 0.01}))
    assert {gain.channel for gain in gains} == {"x:m1", "f:spring"}
    out = said("identify --help-all").out
    assert '"all" stands for every response channel that is not named' in " ".join(out.split())
    assert out.count("linkwise identify run.csv unknown.toml") == 13 and "--profile" in out


@pytest.mark.parametrize(
    ("word", "loss"), [("huber", lw.likelihood.Huber()), ("student", lw.likelihood.Student())]
)
def test_a_robust_loss_is_chosen_by_name(word: str, loss: object, monkeypatch: pytest.MonkeyPatch) -> None:
    losses: list[object] = []

    def watched(*nouns: Any, **options: Any) -> None:
        losses.append(options["method"].loss)
        raise KeyboardInterrupt

    monkeypatch.setattr(lw, "identify", watched)
    said(f"{IDENTIFY} --robust {word}", 130)
    assert losses == [loss]


def test_profiles_are_printed_and_written(tmp_path: Path) -> None:
    """In the document of the folder and on its page, as they are printed."""
    folder = tmp_path / "answer"
    out = said(f"{IDENTIFY} --profile -o {folder}").out
    assert "95 % intervals that follow the likelihood (profiles)" in out
    row = re.search(r"^  nes1\.alpha  (\S+) to (\S+) N/m", out, flags=re.MULTILINE)
    # the truth
    assert row is not None and float(row[1]) < -100.0 < float(row[2])
    intervals = json.loads((folder / "result.json").read_text(encoding="utf-8"))["profile_intervals"]
    assert list(intervals) == ["nes1.alpha", "nes1.beta", "nes1.c"]
    assert intervals["nes1.alpha"] == pytest.approx([float(row[1]), float(row[2])], rel=1e-5)  # six digits
    assert "95 % by the likelihood" in (folder / "report.html").read_text(encoding="utf-8")


def test_profiles_that_differ_or_cannot_be_followed_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(PROFILE, lambda estimate, name: (-200.0, np.inf))
    out = said(f"{IDENTIFY} --profile").out
    assert "-200 to inf N/m  differs from the table: trust this one" in out

    def interrupted(estimate: lw.Estimate, name: str) -> tuple[float, float]:
        if name == "nes1.beta":
            raise KeyboardInterrupt
        return estimate.coefficient(name).interval or (0.0, 0.0)

    monkeypatch.setattr(PROFILE, interrupted)
    out = said(f"{IDENTIFY} --profile").out
    assert "! No profile interval of nes1.beta, nes1.c: interrupted." in out
    assert "nes1.alpha  -" in out.partition("(profiles)")[2] and "differs" not in out

    def lost(estimate: lw.Estimate, name: str) -> tuple[float, float]:
        raise lw.IdentificationError(f"the profile of {name} cannot be followed")

    monkeypatch.setattr(PROFILE, lost)
    out = said(f"{IDENTIFY} --profile").out
    assert "of nes1.beta: the profile of nes1.beta cannot be followed." in out and "(profiles)" not in out


def test_ctrl_c_returns_the_best_so_far(monkeypatch: pytest.MonkeyPatch) -> None:
    """The third step is never taken; what the first two found is told, without intervals."""
    steps = iter(range(100))
    step = stepping.damped_step

    def interrupted(*nouns: Any) -> object:
        if next(steps) == 2:
            raise KeyboardInterrupt
        return step(*nouns)

    monkeypatch.setattr(stepping, "damped_step", interrupted)
    out, err = said(IDENTIFY, 3)
    assert "not converged, NOT to be trusted" in out and "interrupted" in out and "alpha" in out
    assert "how-to/if-it-refuses" in err


def test_the_bar_shows_stage_cost_and_chi_square(monkeypatch: pytest.MonkeyPatch) -> None:
    reports: list[tuple[float, str]] = []

    @contextmanager
    def bar(_: str) -> Iterator[lw.estimates.Progress]:
        yield lambda report: reports.append((report.fraction, report.activity))

    monkeypatch.setattr(command, "progress", bar)
    said(IDENTIFY)
    fractions, stages = zip(*[report for report in reports if report[1].startswith("q ")], strict=True)
    assert len(stages) >= 3
    shown = r"q \de[+-]\d\d, cost [\d.e+]+, chi-square \d+\.\d{3}"
    assert all(re.fullmatch(shown, stage) for stage in some(stages))
    assert list(fractions) == sorted(fractions) and fractions[-1] == 1.0 and fractions[0] >= 0.0


@pytest.fixture
def pushed(tmp_path: Path) -> Path:
    """A record of a mass on a spring of 1000 N/m in a force that a load cell shows with noise, and its structure."""
    rng, rate, count = np.random.default_rng(5), 100.0, 1000
    force = rng.standard_normal(count)
    response = np.exp(-0.5 * np.arange(count) / rate) * np.sin(np.sqrt(1000.0) * np.arange(count) / rate)
    x = np.convolve(force, response)[:count] / (rate * np.sqrt(1000.0))
    noisy = [x + 1e-5 * rng.standard_normal(count), force + 0.1 * rng.standard_normal(count)]
    lw.write_record(lw.Record(0.0, rate, ("x:m1", "force:m1"), np.column_stack(noisy)), tmp_path / "run.csv")
    lw.write_structure(asked_oscillator("k*d + c*v", 1.0), tmp_path / "unknown.toml")
    return tmp_path


@pytest.mark.slow
def test_forces_that_are_counted_in_are_told(pushed: Path) -> None:
    for option, is_found in (("--ambient all", True), ("--ambient m1=0.014", False)):
        [force] = document(f"identify {pushed}/run.csv {pushed}/unknown.toml {option}")["random_forces"]
        assert (force["where"], force["kind"], force["found"]) == ("m1", "ambient", is_found)
    # 100 mN a sample at 100 Hz are 0.1 * sqrt(2 / 100) N/sqrt(Hz), and so is 0.014 but for its digits
    assert force["deviation"] == pytest.approx(0.1, rel=0.02)
