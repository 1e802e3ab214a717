"""`linkwise discover`: from a record and masses to the structure, to the folder, to the exit code; and messy input."""

import json
import re
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import document, said
from problems import chain_record, parsed
from record_faults import without

import linkwise as lw
from linkwise.discovery.terms import FAMILIES
from linkwise.likelihood.shooting import minimise as stepping

pytestmark = pytest.mark.usefixtures("unrendered", "inside")

command = import_module("linkwise.cli.discover")  # the package holds the command under that name
MASSES = "--mass m1=1.0 --mass 'm2=10 g'"
DISCOVER = f"discover run.csv {MASSES}"
TRUE = {"m1-ground.k", "m1-ground.c", "m2-m1.k", "m2-m1.k3", "m2-m1.c"}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory, chain: lw.Structure) -> Path:
    """A folder with the true chain, its record at 30 dB, and that of a quicker hit."""
    folder = tmp_path_factory.mktemp("discover")
    lw.write_structure(chain, folder / "chain.toml")
    for name, hit, seed in (("run", 1.0, 1011), ("run2", 0.7, 1012)):
        record = chain_record(2, duration=1.0, speed=hit).with_noise(30.0, seed=seed)
        lw.write_record(record, folder / f"{name}.csv")
    return folder


@pytest.fixture
def inside(files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(files)


def selected_terms(result: dict[str, Any]) -> set[str]:
    return {term["name"] for term in result["terms"] if term["kept"]}


@pytest.mark.slow
def test_the_answer_is_that_of_the_library() -> None:
    out, err = said(f"{DISCOVER} --truth chain.toml")
    assert out.startswith("2 masses, 2 links with 5 terms: can be trusted\n") and err == ""
    comparison = out.partition("against the truth: ")[2]
    assert comparison.startswith("5 terms right\n  missing  none\n  false    none\n")
    assert comparison.count(" %\n") == 2
    result = document(DISCOVER)
    discovery = lw.discover(lw.read_record("run.csv"), {"m1": 1.0, "m2": 0.01})
    assert selected_terms(result) == TRUE and "truth" not in result
    values = [term["value"] for term in result["terms"]]
    assert values == pytest.approx([term.value for term in discovery.terms], rel=1e-8)  # same numerics


@pytest.mark.slow
def test_what_is_stated_of_sensors_counts() -> None:
    result = document(f"{DISCOVER} --calibration all=1% --delay x:m2 --corner x:m1 --sensor x:m2:hum=50")
    (beta,) = (term for term in result["terms"] if term["name"] == "m2-m1.k3")
    assert beta["standard_error"] > 0.01 * beta["value"]  # a gain of 1 % changes it by 2 %
    (sentence,) = (finding for finding in result["findings"] if finding.startswith("x:m2 is late by"))
    assert abs(float(sentence.split()[4])) < 0.1  # ms, of a record whose channels are together
    told = "\n".join(result["findings"])
    assert "\nx:m1 is behind a high pass with" in told and "\nx:m2 has a hum of" in told


def test_several_records_terms_and_parts_reach_the_search() -> None:
    result = document(f"{DISCOVER} --with run2.csv --terms 'bistable, friction(0.01)' --to 0.8")
    assert selected_terms(result) == TRUE
    assert {term["term"] for term in result["terms"]} == {"v", "d", "d**3", "tanh(v/0.01)"}
    assert result["fit"]["samples"] == 2 * 2 * 801


def test_a_mass_at_rest_is_told_before_the_work_and_left_out(tmp_path: Path) -> None:
    record = lw.read_record("run.csv")
    still = np.random.default_rng(1013).normal(0.0, 1e-4, len(record))
    values = np.column_stack([record.values, still])
    lw.write_record(
        replace(record, channels=parsed(*record.channels, "x:m3"), values=values), tmp_path / "rest.csv"
    )
    out, err = said(f"discover {tmp_path}/rest.csv {MASSES} --mass m3=1")
    assert err.startswith("note: m3 did not move above the noise") and "! m3 did not move" in out
    assert out.startswith("2 masses, 2 links with 5 terms")


def test_gaps_are_told_and_do_not_hinder(tmp_path: Path) -> None:
    lw.write_record(without(lw.read_record("run.csv"), x_m1=slice(300, 360)), tmp_path / "gaps.csv")
    out, err = said(f"discover {tmp_path}/gaps.csv {MASSES} --truth chain.toml")
    assert err == "note: x:m1: 60 of 1001 samples are missing.\n"
    assert "5 terms right\n  missing  none\n  false    none" in out


@pytest.mark.slow
@pytest.mark.usefixtures("memory_not_sought")
def test_an_answer_not_to_be_trusted_has_exit_code_3() -> None:
    """With one channel a thousand times too large no structure explains both, and false links would mend it."""
    out = " ".join(said(f"{DISCOVER} --channel x:m1[km]=x:m1 --to 0.5", 3).out.split())
    assert "NOT to be trusted" in out and "No decision is certain." in out and "check the units" in out


@pytest.mark.slow
def test_ctrl_c_ends_with_the_best_so_far(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The third step is never taken."""
    steps, step = iter(range(100)), stepping.damped_step

    def interrupted(*nouns: Any) -> object:
        if next(steps) == 2:
            raise KeyboardInterrupt
        return step(*nouns)

    monkeypatch.setattr(stepping, "damped_step", interrupted)
    out = said(f"{DISCOVER} -o {tmp_path}/found", 3).out
    assert "NOT to be trusted" in out and "Not converged: interrupted." in out and "m2-m1" in out
    assert json.loads((tmp_path / "found" / "result.json").read_text())["status"] == "not converged"


@pytest.mark.parametrize("command", ["identify", "discover"])
def test_help_fits_a_screen_and_says_where_the_rest_is(command: str) -> None:
    short, whole, reading = (
        said(f"{command} --help").out,
        said(f"help {command}").out,
        said("help reading").out,
    )
    assert short.count("\n") <= 60 and whole == said(f"{command} --help-all").out
    assert f"Others: linkwise {command} --help-all;" in short
    assert "--output DIR" in short and "Examples:" in short
    options = set(re.findall(r"^  (?:-o, )?(--[a-z-]+)", whole, re.MULTILINE))
    shared = set(re.findall(r"^  (--[a-z-]+)", reading, re.MULTILINE)) - {"--help"}
    assert {"--channel", "--delay", "--sensor"} < shared < options and len(options) > 25
    assert "no help on 'readin'; choose reading" in said("help readin", 2).err
    assert said("help").out == said("--help").out


def test_help_names_every_family() -> None:
    out = said("discover --help-all").out
    assert [name for name in FAMILIES if name not in out] == [] and "Examples:" in out
