"""`linkwise export`: an answer, to functions and tables of other programs."""

from __future__ import annotations

from pathlib import Path

import click

import linkwise as lw
from linkwise.cli.console import tell
from linkwise.cli.options import FILE, listing
from linkwise.export import answer as exports
from linkwise.output import to_json


@click.command(cls=listing("FORMATS", lambda: exports.listed_formats()))
@click.argument("answer", type=click.Path(path_type=Path))
@click.argument("files", metavar="FILE...", nargs=-1, required=True, type=FILE)
@click.option("--json", "as_json", is_flag=True, help="Print the files written as JSON and nothing else.")
def export(answer: Path, files: tuple[Path, ...], as_json: bool) -> int:
    """Write an answer for other programs, each FILE in the format of its suffix.

    ANSWER is the folder that identify or discover wrote, or a structure file in which every coefficient is a number.
    What is written of an answer that is not to be trusted says so, and the exit code is 3.

    \b
      FORMATS

    \b
    Examples:
      linkwise export answer forces.py
      linkwise export answer forces.m coefficients.xlsx
      linkwise export answer/structure.toml structure.mat
    """
    for file in files:
        exports.export_writer(file)
    content = exports.ExportedAnswer.of(answer)
    if content.note:
        tell(f"note: {content.note}")
    for file in files:
        lw.export_answer(answer, file)
        if not as_json:
            click.echo(f"written to {file}")
    if as_json:
        click.echo(to_json({"files": [str(file) for file in files]}))
    return content.grade.exit_code
