"""`linkwise identify --method ml`, the default: what its options reach, what it prints, how it is interrupted."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from present import present, some
from problems import chain_record

import linkwise as lw
from linkwise.cli import run
from linkwise.likelihood.options import errors_to_find
from linkwise.likelihood.shooting import steps as stepping

command = import_module("linkwise.cli.identify")  # the package holds the command under that name
OFFSET = 5e-4

PROFILE = "linkwise.likelihood.optima.profiles.profile_interval"


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory, chain: lw.Structure) -> Path:
    """A folder with the chain, two records of it, one with an offset, one with outliers."""
    folder = tmp_path_factory.mktemp("ml")
    lw.write_structure(chain, folder / "chain.toml")
    lw.write_structure(chain.unknown("nes"), folder / "unknown.toml")
    for name, speed, seed in (("run", 1.0, 1), ("run2", 0.7, 2)):
        clean = chain_record(2, duration=1.0, speed=speed)
        lw.write_record(clean.with_noise(30.0, seed=seed), folder / f"{name}.csv")
    record = lw.read_record(folder / "run.csv")
    lw.write_record(replace(record, values=record.values + np.array([OFFSET, 0.0])), folder / "offset.csv")
    lw.write_record(replace(record, values=record.values * np.array([1.2, 1.0])), folder / "gain.csv")
    spoilt = record.values.copy()
    spoilt[::50] += 0.01
    lw.write_record(replace(record, values=spoilt), folder / "outliers.csv")
    return folder


def arguments(files: Path, *options: str, record: str = "run.csv") -> list[str]:
    return ["identify", str(files / record), str(files / "unknown.toml"), *options]


def answer(files: Path, *options: str, record: str = "run.csv", code: int = 0) -> dict[str, Any]:
    """What --json prints."""
    out = io.StringIO()
    with redirect_stdout(out):
        assert run(arguments(files, *options, "--json", record=record)) == code
    document: dict[str, Any] = json.loads(out.getvalue())
    return document


def alpha(result: dict[str, Any]) -> Any:
    sink = next(link for link in result["links"] if link["name"] == "nes1")
    return sink["coefficients"]["alpha"]


def library(files: Path, *records: str, **keywords: Any) -> float:
    """The same coefficient from the library."""
    fit = lw.identify(
        [lw.read_record(files / name) for name in records],
        lw.read_structure(files / "unknown.toml"),
        **keywords,
    )
    return fit.coefficient("nes1.alpha").value


def test_it_is_the_default(files: Path) -> None:
    result = answer(files)
    assert result["method"] == "ml" and result["status"] == "converged"
    assert alpha(result)["value"] == pytest.approx(library(files, "run.csv"), rel=1e-8)


def test_several_records_are_fitted_together(files: Path) -> None:
    both = answer(files, "--with", str(files / "run2.csv"))
    assert alpha(both)["value"] == pytest.approx(library(files, "run.csv", "run2.csv"), rel=1e-8)
    assert both["fit"]["samples"] == 2 * answer(files)["fit"]["samples"]


def test_an_offset_is_found_where_it_is_asked_for(files: Path) -> None:
    document = answer(files, "--offset", "x:m1", record="offset.csv")
    assert alpha(document)["value"] == pytest.approx(
        library(files, "offset.csv", offsets=("x:m1",)), rel=1e-8
    )
    # 2000 samples scatter by sqrt(2/2000) = 0.03, three of them
    assert document["fit"]["chi_square_per_sample"] == pytest.approx(1.0, abs=0.1)
    low, high = alpha(document)["interval"]
    # the truth
    assert low < -100.0 < high


def test_a_gain_is_found_where_it_is_asked_for(files: Path) -> None:
    document = answer(files, "--gain", "x:m1", record="gain.csv")
    assert alpha(document)["value"] == pytest.approx(library(files, "gain.csv", gains=("x:m1",)), rel=1e-8)
    findings = [re.match(r"x:m1 shows (\S+) of its motion", line) for line in document["findings"]]
    [factor] = [float(match[1]) for match in findings if match]
    assert factor == pytest.approx(
        1.2, rel=0.005
    )  # 1000 samples at 30 dB: five deviations of 3 %, over their root


def test_a_calibration_is_counted_where_it_is_stated(files: Path) -> None:
    document = answer(files, "--calibration", "all=1%", "--calibration", "x:m1=0.5 %")
    by_library = library(files, "run.csv", calibration={"all": 0.01, "x:m1": 0.005})
    assert alpha(document)["value"] == pytest.approx(by_library, rel=1e-8)
    assert sum(" of its motion (estimated" in line for line in document["findings"]) == 2


def test_an_error_of_a_sensor_is_let_into_the_model(files: Path) -> None:
    assert not answer(files, record="gain.csv", code=3)["trusted"]
    document = answer(files, "--let", "offset,gain", record="gain.csv")
    assert alpha(document)["value"] == pytest.approx(library(files, "gain.csv", admit=("gain",)), rel=1e-8)


def test_a_delay_is_found_or_taken_out(files: Path) -> None:
    record = lw.read_record(files / "run.csv")
    values = record.values.copy()
    values[2:, 1] = values[:-2, 1]
    lw.write_record(replace(record, values=values)[2:], files / "late.csv")
    document = answer(files, "--delay", "x:m2", record="late.csv")
    assert alpha(document)["value"] == pytest.approx(library(files, "late.csv", delays=("x:m2",)), rel=1e-8)
    assert any(line.startswith("x:m2 is late by ") for line in document["findings"])
    known = answer(files, "--delay", "x:m2=2 ms", record="late.csv")
    deviation = alpha(known)["standard_error"]
    assert alpha(known)["value"] == pytest.approx(
        alpha(document)["value"], abs=deviation
    )  # the same record, less two samples


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--delay", "x:m2", "--method", "weak"), "--delay x:m2 is for --method ml, not for weak"),
        (("--delay", "x:m2=2 kg"), "--delay x:m2=2 kg: '2 kg' is in kg"),
        (("--calibration", "x:m1=often"), "--calibration takes a percentage"),
        (("--calibration", "all=1"), "such as x:m1=1%, got '1': is it 1% or 100%?"),
        (("--calibration", "all=1%%"), "--calibration takes a percentage"),
        (("--calibration", "x:m1"), "--calibration"),
        (("--calibration", "x:m9=1%"), "no calibration of x:m9 can be stated"),
        (
            ("--calibration", "x:m1=-1%"),
            "up to 0.5, got -0.01. On the command line: --calibration CHANNEL=PERCENT%.",
        ),
        (("--let", "gain", "--method", "weak"), "--let is for --method ml"),
    ],
)
def test_wrong_calibrations_are_wrong_usage(
    files: Path, options: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(arguments(files, *options)) == 2
    assert said in capsys.readouterr().err


def test_the_help_says_what_a_calibration_of_all_stands_for(capsys: pytest.CaptureFixture[str]) -> None:
    """It said sensors of motion, and gave the load cell of a link a gain as well."""
    channels = {"x:m1": np.arange(64.0), "f:spring": np.arange(64.0) ** 2, "force:m1": np.arange(64.0) ** 3}
    record = lw.Record.from_arrays(np.arange(64) / 100.0, channels)
    assert set(errors_to_find([record], calibration={"all": 0.01})["calibration"]) == {"x:m1", "f:spring"}
    assert run(["identify", "--help"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert '"all" stands for every response channel that is not named' in shown


@pytest.mark.parametrize(
    ("word", "loss"), [("huber", lw.likelihood.Huber()), ("student", lw.likelihood.Student())]
)
def test_a_robust_loss_is_chosen_by_name(
    files: Path, word: str, loss: lw.likelihood.Huber | lw.likelihood.Student, monkeypatch: pytest.MonkeyPatch
) -> None:
    losses: list[object] = []
    identify = lw.identify

    def watched(*nouns: Any, **options: Any) -> lw.Estimate:
        losses.append(options["method"].loss)
        return identify(*nouns, **options)

    monkeypatch.setattr(lw, "identify", watched)
    run(arguments(files, "--robust", word, record="outliers.csv"))
    assert losses == [loss]


@pytest.mark.parametrize("exact", [False, True])
def test_exact_laws_leave_no_model_error(files: Path, chain: lw.Structure, exact: bool) -> None:
    """A sink whose spring gets a quintic term that the law lacks: a model error stands for it, or chi-square tells it."""
    sink = chain.link("nes1")
    law = lw.Law.parse(f"{sink.law.text} + q*d**5")
    bent = replace(sink, law=law, coefficients={**sink.coefficients, "q": lw.Coefficient.number(1e9)})
    links = tuple(bent if link.name == "nes1" else link for link in chain.links)
    clean = lw.simulate(replace(chain, links=links), release={"v:m1": 1.0}, duration=2.0, rate=1000.0)
    lw.write_record(clean.with_noise(40.0, seed=1), files / "bent.csv")
    document = answer(files, *(["--exact"] if exact else []), record="bent.csv", code=3)
    assert (document["model_error_percent"] == 0.0) == exact
    assert (document["fit"]["chi_square_per_sample"] > 1.2) == exact


def test_known_noise_reaches_the_fit(
    files: Path, chain: lw.Structure, capsys: pytest.CaptureFixture[str]
) -> None:
    """The true noise is believed; noise stated a hundred times too small cannot explain what is left."""
    clean = chain_record(2, duration=1.0)
    noise = present(clean.with_noise(30.0, seed=1).simulated).noise
    known = [f"--noise-of={name}={sigma}" for name, sigma in noise.items()]
    chi_square = answer(files, *known)["fit"]["chi_square_per_sample"]
    # 2000 samples: five deviations of chi-square
    assert chi_square == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / 2000.0))
    too_small = [f"--noise-of={name}={sigma / 100.0}" for name, sigma in noise.items()]
    assert run(arguments(files, *too_small)) == 3
    assert "NOT to be trusted" in capsys.readouterr().out


def test_profiles_are_printed(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(arguments(files, "--profile")) == 0
    out, err = capsys.readouterr()
    assert err == "" and "95 % intervals that follow the likelihood (profiles)" in out
    row = re.search(r"^  nes1\.alpha  (\S+) to (\S+) N/m", out, flags=re.MULTILINE)
    # the truth
    assert row is not None and float(row[1]) < -100.0 < float(row[2])
    document = answer(files, "--profile")["profile_intervals"]
    assert list(document) == ["nes1.alpha", "nes1.beta", "nes1.c"]
    assert document["nes1.alpha"] == pytest.approx([float(row[1]), float(row[2])], rel=1e-5)  # six digits


def test_a_profile_that_differs_is_marked(
    files: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(PROFILE, lambda estimate, name: (-200.0, np.inf))
    assert run(arguments(files, "--profile")) == 0
    assert "-200 to inf N/m  differs from the table: trust this one" in capsys.readouterr().out


def test_an_interrupted_profile_leaves_the_rest_out(
    files: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(estimate: lw.Estimate, name: str) -> tuple[float, float]:
        if name == "nes1.beta":
            raise KeyboardInterrupt
        return estimate.coefficient(name).interval or (0.0, 0.0)

    monkeypatch.setattr(PROFILE, interrupted)
    assert run(arguments(files, "--profile")) == 0
    out = capsys.readouterr().out
    assert "! No profile interval of nes1.beta, nes1.c: interrupted." in out
    assert "nes1.alpha  -" in out.partition("(profiles)")[2] and "differs" not in out


def test_a_profile_that_cannot_be_followed_is_told(
    files: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def lost(estimate: lw.Estimate, name: str) -> tuple[float, float]:
        raise lw.IdentificationError(f"the profile of {name} cannot be followed")

    monkeypatch.setattr(PROFILE, lost)
    assert run(arguments(files, "--profile")) == 0
    out = capsys.readouterr().out
    assert "of nes1.beta: the profile of nes1.beta cannot be followed." in out and "(profiles)" not in out


def test_ctrl_c_returns_the_best_so_far(
    files: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The third step is never taken; what the first two found is told, without intervals."""
    steps = iter(range(100))
    step = stepping.damped_step

    def interrupted(*nouns: Any) -> object:
        if next(steps) == 2:
            raise KeyboardInterrupt
        return step(*nouns)

    monkeypatch.setattr(stepping, "damped_step", interrupted)
    assert run(arguments(files)) == 3
    out = capsys.readouterr().out
    assert "not converged, NOT to be trusted" in out and "interrupted" in out and "alpha" in out


def test_the_bar_shows_stage_cost_and_chi_square(files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reports: list[tuple[float, str]] = []

    @contextmanager
    def bar(_: str) -> Iterator[lw.estimates.Progress]:
        yield lambda report: reports.append((report.fraction, report.activity))

    monkeypatch.setattr(command, "progress", bar)
    assert run(arguments(files)) == 0
    stages = [(fraction, stage) for fraction, stage in reports if stage.startswith("q ")]
    assert len(stages) >= 3
    assert all(
        re.fullmatch(r"q \de[+-]\d\d, cost [\d.e+]+, chi-square \d+\.\d{3}", stage)
        for _, stage in some(stages)
    )
    fractions = [fraction for fraction, _ in stages]
    assert (
        fractions == sorted(fractions)
        and fractions[-1] == 1.0
        and all(0.0 <= part <= 1.0 for part in some(fractions))
    )


def test_classical_choices_reach_the_fit(files: Path) -> None:
    document = answer(files, "--method", "sindy", "--derivative", "savgol", "--regressor", "l1", code=3)
    expected = lw.identify(
        lw.read_record(files / "run.csv"),
        lw.read_structure(files / "unknown.toml"),
        method=lw.PhysicsInformedSindy("savgol", "l1"),
    )
    assert alpha(document)["value"] == pytest.approx(expected.coefficient("nes1.alpha").value, rel=1e-8)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--method", "weak", "--with", "run2.csv"], "--with is for --method ml, not for weak."),
        (["--method", "sindy", "--profile"], "--profile is for --method ml, not for sindy."),
        (["--derivative", "spline"], "--derivative is for --method sindy, not for ml."),
        (["--exact", "--method", "weak"], "--exact is for --method ml, not for weak."),
        (["--robust", "brave"], "'brave' is not one of"),
        (["--with", "nowhere.csv"], "nowhere.csv"),
        (["second.csv"], "argument (second.csv). State each further record with --with."),
        (["--noise-of", "x:m1"], "--noise-of 'x:m1' is not NAME=VALUE"),
        (["--noise-of", "x:m1=loud"], "--noise-of x:m1=loud: 'loud' cannot be read as a quantity"),
        (["--offset", "x:m1=plenty"], "--offset x:m1=plenty: 'plenty' cannot be read as a quantity"),
        (
            ["--offset", "x:m1=3 mm+-"],
            "write '0.3 m' for a known offset, '0.3 m +- 0.3 m' for one that is known to within",
        ),
        (["--gain", "x:m1="], "--gain 'x:m1=' is not CHANNEL or CHANNEL=SIZE"),
        (["--gain", "x:m1", "--gain", "x:m1=2"], "--gain is given twice for 'x:m1'"),
        (["--noise-of", "x:m7=1e-4"], "x:m7"),
        (["--calibration", "x:m7=1%"], "no calibration of x:m7 can be stated"),
        (["--drift", "x:m7"], "no drift or hum of x:m7 can be estimated"),
        (["--drift", "x:m1=1us"], "the pieces of the drift of x:m1 must be"),
        (["--hum", "x:m7=50"], "no drift or hum of x:m7 can be estimated"),
        (["--ambient", "m7"], "no ambient force can act on m7"),
        (["--input-noise", "force:m7"], "no noise of an input can be estimated"),
    ],
)
def test_wrong_usage_is_one_paragraph_and_exit_code_2(
    files: Path, options: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(arguments(files, *options)) == 2
    out, err = capsys.readouterr()
    assert out == "" and message in err
    assert err.startswith("linkwise: ") and "Traceback" not in err and "\n\n" not in err


def test_an_offset_of_a_channel_that_is_not_there_fails_with_a_reason(
    files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(arguments(files, "--offset", "x:m9")) == 2
    assert "channel x:m9: is not in the record, and something is stated of it" in capsys.readouterr().err


def test_help_has_examples(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["identify", "--help"]) == 0
    out = capsys.readouterr().out
    assert out.count("linkwise identify run.csv unknown.toml") == 12 and "--profile" in out
