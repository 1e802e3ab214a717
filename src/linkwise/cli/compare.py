"""`linkwise compare`: a record and a structure to the answers of every method, side by side."""

from __future__ import annotations

from pathlib import Path

import click

from linkwise.cli.console import deliver, note, progress
from linkwise.cli.options import FILE, folder_option, json_option
from linkwise.cli.reading_options import RecordOptions, read_told, record_options
from linkwise.identification import compare as comparisons
from linkwise.output import COMPARISON


@click.command()
@record_options
@click.argument("structure", type=FILE)
@folder_option(COMPARISON)
@json_option(COMPARISON)
def compare(source: RecordOptions, structure: Path, output: Path | None, as_json: bool) -> int:
    """Identify the unknown coefficients of STRUCTURE from RECORD by maximum likelihood, the weak form and the sparse
    regression of the paper, and by maximum likelihood with the term or link that its diagnosis misses first.

    Shows coefficients with standard errors, grades, chi-square, the errors of free runs and times. A method that does not take
    the record, as sindy where the motion of a mass is not measured, says why. The exit code is that of the answer of maximum
    likelihood, as of identify.

    \b
    Examples:
      linkwise compare run.csv unknown.toml -o compared
      linkwise compare run.csv unknown.toml --mapping sensors.toml --json
    """
    source.refuse_unknown_errors()
    subject = read_told(structure)
    note(*source.masses_beside(subject))
    with progress("reading") as step:
        record = source.read_motion_of(subject)
        comparison = comparisons.compare(record, subject, progress=step)
    return deliver(comparison, output, as_json=as_json)
