"""`linkwise discover`: from a record and masses to the structure, to the folder, to the exit code; and messy input."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from present import some
from problems import chain_record, parsed

import linkwise as lw
from linkwise.cli import run
from linkwise.discovery.terms import FAMILIES
from linkwise.likelihood.shooting import steps as stepping

pytestmark = pytest.mark.usefixtures("unrendered")

command = import_module("linkwise.cli.discover")  # the package holds the command under that name
MASSES = ["--mass", "m1=1.0", "--mass", "m2=10 g"]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory, chain: lw.Structure) -> Path:
    """A folder with the true chain, its record at 30 dB, and that of a quicker hit."""
    folder = tmp_path_factory.mktemp("discover")
    lw.write_structure(chain, folder / "chain.toml")
    for name, hit, seed in (("run", 1.0, 1011), ("run2", 0.7, 1012)):
        record = chain_record(2, duration=2.0, speed=hit).with_noise(30.0, seed=seed)
        lw.write_record(record, folder / f"{name}.csv")
    return folder


def arguments(files: Path, *options: str, masses: list[str] = MASSES) -> list[str]:
    return ["discover", str(files / "run.csv"), *masses, *options]


def answer(capsys: pytest.CaptureFixture[str], *arguments: str, code: int = 0) -> dict[str, Any]:
    """What --json prints, and nothing else."""
    assert run([*arguments, "--json"]) == code
    out, err = capsys.readouterr()
    assert err == ""
    document: dict[str, Any] = json.loads(out)
    return document


def selected_terms(result: dict[str, Any]) -> set[str]:
    return {term["name"] for term in result["terms"] if term["kept"]}


TRUE = {"m1-ground.k", "m1-ground.c", "m2-m1.k", "m2-m1.k3", "m2-m1.c"}


def test_prints_the_table_and_the_comparison(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(arguments(files, "--truth", str(files / "chain.toml"))) == 0
    out, err = capsys.readouterr()
    assert out.startswith("2 masses, 2 links with 5 terms: can be trusted\n") and err == ""
    comparison = out.partition("against the truth: ")[2]
    assert (
        comparison.startswith("5 terms right\n  missing  none\n  false    none\n")
        and comparison.count(" %\n") == 2
    )


def test_a_calibration_of_no_channel_is_wrong_usage(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(arguments(files, "--calibration", "force:m1=1%")) == 2
    assert "no calibration of force:m1 can be stated" in capsys.readouterr().err


def test_a_calibration_stands_in_the_intervals(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = answer(capsys, *arguments(files, "--calibration", "all=1%"))
    (beta,) = (term for term in result["terms"] if term["name"] == "m2-m1.k3")
    assert beta["standard_error"] > 0.01 * beta["value"]  # a gain of 1 % changes it by 2 %


def test_a_delay_without_a_time_is_found(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = answer(capsys, *arguments(files, "--delay", "x:m2"))
    (sentence,) = (finding for finding in result["findings"] if finding.startswith("x:m2 is late by"))
    assert abs(float(sentence.split()[4])) < 0.1  # ms, of a record whose channels are together


def test_an_error_that_cannot_be_admitted_is_wrong_usage(
    files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(arguments(files, "--let", "drift")) == 2
    assert 'unknown error of a sensor "drift"' in capsys.readouterr().err


def test_json_is_the_answer_of_the_library(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = answer(capsys, *arguments(files))
    discovery = lw.discover(lw.read_record(files / "run.csv"), {"m1": 1.0, "m2": 0.01})
    assert selected_terms(result) == TRUE and "truth" not in result
    values = [term["value"] for term in result["terms"]]
    assert values == pytest.approx([term.value for term in discovery.terms], rel=1e-8)  # same numerics


def test_several_records_terms_and_parts_reach_the_search(
    files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    more = ["--with", str(files / "run2.csv"), "--terms", "bistable, friction(0.01)", "--to", "1.5"]
    result = answer(capsys, *arguments(files, *more))
    assert selected_terms(result) == TRUE and {term["term"] for term in result["terms"]} == {
        "v",
        "d",
        "d**3",
        "tanh(v/0.01)",
    }
    assert result["fit"]["samples"] == 2 * 2 * 1501


def test_folder_and_its_structure_are_the_next_input(
    files: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What was discovered is simulated, and identified again with its numbers taken away: to the same answer."""
    folder = tmp_path / "found"
    assert run(arguments(files, "-o", str(folder))) == 0
    assert f"open {folder / 'report.html'}" in capsys.readouterr().err
    drive = ["--duration", "0.1", "--rate", "500", "--release", "v:m1=1", "-o", str(tmp_path / "again.csv")]
    assert run(["simulate", str(folder / "structure.toml"), *drive]) == 0
    structure = lw.read_structure(folder / "structure.toml")
    lw.write_structure(structure.unknown("all"), tmp_path / "unknown.toml")
    capsys.readouterr()
    result = answer(capsys, "identify", str(files / "run.csv"), str(tmp_path / "unknown.toml"))
    for link in some(result["links"]):
        for name, coefficient in some(link["coefficients"].items()):
            before = structure.link(link["name"]).values[name]
            assert (
                abs(coefficient["value"] - before) < 0.5 * coefficient["standard_error"]
            )  # one optimum, within its tolerance


def test_what_is_known_stays_and_what_is_known_not_to_be_stays_out(
    files: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    known = tmp_path / "known.toml"
    masses = '[[mass]]\nname = "m1"\nmass = 1.0\n[[mass]]\nname = "m2"\nmass = "10 g"\n'
    known.write_text(masses)
    assert (
        selected_terms(answer(capsys, "discover", str(files / "run.csv"), "--structure", str(known))) == TRUE
    )
    link = '[[link]]\nname = "{}"\nbetween = {}\nlaw = "{}"\ncoefficients = {}\n'
    spring = link.format("spring", '["m1", "ground"]', "k*d + q*d**2", '{ k = "unknown", q = 0 }')
    none = link.format("none", '["m2", "ground"]', "0", "{}")
    known.write_text(masses + spring + none)
    beside = ["--structure", str(known), "--truth", str(files / "chain.toml")]
    result = answer(capsys, "discover", str(files / "run.csv"), *beside)
    assert selected_terms(result) == {"spring.c", *(name for name in TRUE if name.startswith("m2-m1"))}
    tested = {term["name"] for term in result["terms"]}
    assert "spring.k2" not in tested and not any(name.startswith("m2-ground") for name in tested)
    assert result["truth"]["missing"] == result["truth"]["extra"] == []


def test_a_mass_at_rest_is_told_before_the_work_and_left_out(
    files: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record = lw.read_record(files / "run.csv")
    still = np.random.default_rng(1013).normal(0.0, 1e-4, len(record))
    lw.write_record(
        replace(
            record, channels=parsed(*record.channels, "x:m3"), values=np.column_stack([record.values, still])
        ),
        tmp_path / "rest.csv",
    )
    assert run(["discover", str(tmp_path / "rest.csv"), *MASSES, "--mass", "m3=1"]) == 0
    out, err = capsys.readouterr()
    assert err.startswith("note: m3 did not move above the noise") and "! m3 did not move" in out
    assert out.startswith("2 masses, 2 links with 5 terms")


def test_an_answer_not_to_be_trusted_has_exit_code_3(
    files: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    real = lw.discover

    def unsettled(*nouns: Any, **named: Any) -> lw.Discovery:
        discovery = real(*nouns, **named)
        return replace(discovery, verdicts=(*discovery.verdicts, lw.Verdict.SEARCH_UNSETTLED))

    monkeypatch.setattr(lw, "discover", unsettled)
    assert run(arguments(files)) == 3
    assert "NOT to be trusted" in capsys.readouterr().out


def test_ctrl_c_ends_with_the_best_so_far(
    files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The third step is never taken."""
    steps, step = iter(range(100)), stepping.damped_step

    def interrupted(*nouns: Any) -> object:
        if next(steps) == 2:
            raise KeyboardInterrupt
        return step(*nouns)

    monkeypatch.setattr(stepping, "damped_step", interrupted)
    assert run(arguments(files, "-o", str(tmp_path / "found"))) == 3
    out = capsys.readouterr().out
    assert "NOT to be trusted" in out and "Not converged: interrupted." in out and "m2-m1" in out
    assert json.loads((tmp_path / "found" / "result.json").read_text())["status"] == "not converged"


def test_ctrl_c_before_there_is_anything_leaves_nothing(
    files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*nouns: object, **named: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(lw, "discover", interrupted)
    assert run(arguments(files, "-o", str(tmp_path / "found"))) == 130
    assert "nothing was left half written" in capsys.readouterr().err and list(tmp_path.iterdir()) == []


def test_the_bar_shows_stages_and_never_goes_back(files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reports: list[tuple[float, str]] = []

    @contextmanager
    def bar(_: str) -> Iterator[lw.estimates.Progress]:
        yield lambda report: reports.append((report.fraction, report.activity))

    monkeypatch.setattr(command, "progress", bar)
    assert run(arguments(files)) == 0
    fractions, stages = zip(*reports, strict=True)
    assert any("screening 12 candidates" in stage for stage in stages) and any(
        stage.startswith("round 1") for stage in stages
    )
    assert list(fractions) == sorted(fractions) and fractions[0] >= 0.0 and fractions[-1] <= 1.0


def test_a_folder_that_is_no_result_is_refused_before_the_work(
    files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    monkeypatch.setattr(lw, "discover", lambda *_, **__: pytest.fail("the work was begun"))
    assert run(arguments(files, "-o", str(tmp_path))) == 2
    assert "is not a result of linkwise" in capsys.readouterr().err


def test_help_names_every_family(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["discover", "--help"]) == 0
    out = capsys.readouterr().out
    assert [name for name in FAMILIES if name not in out] == [] and "Examples:" in out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], 'Give every mass by name, as in --mass m1=1.0 --mass "m2=10 g"'),
        (
            ["--mass", "m1=1"],
            "the structure has no mass 'm2'; did you mean m1? it has m1. Add --mass m2=... for it",
        ),
        (["--mass", "m1"], "--mass 'm1' is not NAME=VALUE"),
        ([*MASSES, "--mass", "m1=2"], "--mass is given twice for 'm1': 1.0 and 2"),
        (
            ["--mass", "m1=1", "--mass", "m2=ten"],
            "--mass m2: 'ten' cannot be read as a quantity: expected a number in kg",
        ),
        (["--mass", "m1=1", "--mass", "m2=10 nm"], "--mass m2: '10 nm' is in nm: expected a number in kg"),
        (["--mass", "m1=1", "--mass", "m2=nan"], "--mass m2: nan is not finite."),
        (["--mass", "m1=1", "--mass", "m2=-1"], 'mass "m2": the mass must be positive, got -1.0 kg'),
        ([*MASSES, "--structure", "chain.toml"], "The file of --structure states the masses"),
        (["--structure", "nowhere.toml"], "nowhere.toml: there is no such file"),
        ([*MASSES, "--terms", "magic"], "--terms: the term 'magic' contains the name 'magic'"),
        (
            [*MASSES, "--terms", "friction()"],
            "the family friction takes the rate in m/s at which it saturates",
        ),
        ([*MASSES, "--test", "m1-m7"], '"m1-m7" is not a link that is looked for'),
        ([*MASSES, "--terms", "d**"], "Something is missing after '**'."),
        ([*MASSES, "--with", "nowhere.csv"], "nowhere.csv: there is no such file"),
        ([*MASSES, "second.csv"], "argument (second.csv). State each further record with --with."),
        ([*MASSES, "--truth", "nowhere.toml"], "nowhere.toml: there is no such file"),
        ([*MASSES, "--channel", "x:m1[N]=x:m1"], "x:m1"),
    ],
)
def test_wrong_usage_is_one_paragraph_and_exit_code_2(
    options: list[str], message: str, files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(arguments(files, *options, masses=[])) == 2
    out, err = capsys.readouterr()
    assert out == "" and message in err
    assert err.startswith("linkwise: ") and "Traceback" not in err and "\n\n" not in err


@pytest.mark.parametrize(
    ("masses", "message"),
    [
        ("m1=1 m1=1 m2=0.01", 'mass "m1": the name is used 2 times; each mass needs its own'),
        (
            'm1="unknown" m2="unknown"',
            'mass "m1": the mass is unknown, and neither an applied force nor another mass sets the scale',
        ),
        ("m1=1", "it has m1. Add --mass m2=... for it"),
        ("", "known.toml: the key `mass` is missing"),
    ],
)
def test_a_file_that_does_not_say_the_masses(
    masses: str, message: str, files: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    entries = [entry.split("=") for entry in masses.split()]
    text = "".join(f'[[mass]]\nname = "{name}"\nmass = {value}\n' for name, value in entries)
    (tmp_path / "known.toml").write_text(text)
    assert run(["discover", str(files / "run.csv"), "--structure", str(tmp_path / "known.toml")]) == 2
    assert message in capsys.readouterr().err


def changed(files: Path, name: str, change: Callable[[np.ndarray], object]) -> str:
    """The path of a copy of the record with changed samples."""
    record = lw.read_record(files / "run.csv")
    values = record.values.copy()
    change(values)
    lw.write_record(replace(record, values=values), files / f"{name}.csv")
    return str(files / f"{name}.csv")


def test_a_record_of_noise_gives_no_structure(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(1014)
    noise = changed(files, "noise", lambda x: x.__setitem__(slice(None), rng.normal(0.0, 1e-4, x.shape)))
    assert run(["discover", noise, *MASSES]) == 1
    assert "no motion above the noise in any channel, so no structure can be found" in capsys.readouterr().err


def test_a_unit_that_is_wrong_is_not_trusted(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With one channel a thousand times too large no structure explains both, and false links would mend it."""
    assert run(arguments(files, "--channel", "x:m1[km]=x:m1", "--to", "0.5")) == 3
    out = " ".join(capsys.readouterr().out.split())
    assert "NOT to be trusted" in out and "No decision is certain." in out and "check the units" in out


def test_gaps_are_told_and_do_not_hinder(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    gaps = changed(files, "gaps", lambda x: x.__setitem__((slice(300, 360), 0), np.nan))
    assert run(["discover", gaps, *MASSES, "--truth", str(files / "chain.toml")]) == 0
    out, err = capsys.readouterr()
    assert (
        err == "note: x:m1: 60 of 2001 samples are missing.\n"
        and "5 terms right\n  missing  none\n  false    none" in out
    )


def test_a_mass_without_a_sensor_and_a_record_that_is_too_short(
    files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(arguments(files, "--mass", "m3=1")) == 1
    err = capsys.readouterr().err
    assert "no channel measures the motion of m3" in err
    assert err.endswith("On the command line: --channel NAME=COLUMN.\n")
    assert (
        run(arguments(files, "--to", "0.035", "--terms", "quintic, friction(1), quadratic-damping, gap(0.1)"))
        == 1
    )
    assert "the record is too short: 72 samples over 2 masses for 27 candidates" in capsys.readouterr().err


def test_a_truth_of_other_masses_or_without_numbers_is_refused_before_the_work(
    files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(lw, "discover", lambda *_, **__: pytest.fail("the work was begun"))
    text = lw.model.format_structure(lw.bnes_chain(2)).replace('"m2"', '"sink"')
    (tmp_path / "other.toml").write_text(text)
    assert run(arguments(files, "--truth", str(tmp_path / "other.toml"))) == 2
    assert 'other.toml: unknown mass "m2"' in capsys.readouterr().err
    lw.write_structure(lw.bnes_chain(2).unknown("nes"), tmp_path / "other.toml")
    assert run(arguments(files, "--truth", str(tmp_path / "other.toml"))) == 2
    assert "other.toml: nes1.alpha is unknown, and the truth" in capsys.readouterr().err
