"""Errors of the library name arguments; the command line adds the flags that set them."""

from __future__ import annotations

from pathlib import Path

import click
import pytest

from linkwise.cli import linkwise, run
from linkwise.cli.options import FLAGS, with_flags
from linkwise.errors import RecordError


def test_flags_of_the_arguments_are_appended() -> None:
    error = RecordError("uneven time", "run.csv", arguments=("resample", "rate"))
    assert with_flags(error) == "run.csv: uneven time. On the command line: --resample HZ, --rate HZ."
    assert with_flags(RecordError("dead.", "run.csv")) == "run.csv: dead."


def test_a_question_ends_no_second_time() -> None:
    error = RecordError(
        "2 cells where the header has 3; is another line the header?", "a.csv", arguments=("header",)
    )
    assert with_flags(error) == f"{error} On the command line: --header LINE."


def test_every_flag_is_an_option_of_a_command() -> None:
    options = {
        name
        for command in linkwise.commands.values()
        for parameter in command.params
        for name in (parameter.opts if isinstance(parameter, click.Option) else [])
    }
    assert FLAGS and {flag.split()[0] for flag in FLAGS.values()} <= options


def test_a_record_that_cannot_be_read_names_the_flags(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record, structure = tmp_path / "run.csv", tmp_path / "chain.toml"
    record.write_text("left\n" + "0.0\n" * 40)
    assert run(["structure", "bnes", "--dof", "2", "--unknown", "nes", "-o", str(structure)]) == 0
    assert run(["identify", str(record), str(structure)]) == 2
    assert (
        capsys.readouterr()
        .err.rstrip()
        .endswith(
            "On the command line: --channel NAME=COLUMN, --mapping FILE (inspect --write-mapping FILE writes a first one)."
        )
    )
