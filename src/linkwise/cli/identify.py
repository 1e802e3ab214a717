"""`linkwise identify`: a record and a structure with unknowns, to the force of every link."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import click

import linkwise as lw
from linkwise.cli.console import progress, tell
from linkwise.cli.options import FILE, FOLDER, RecordSource, record_options
from linkwise.output import check_result_folder, to_json

UNTRUSTED = 3  # exit code: finished, but the answer is not to be trusted


@click.command()
@record_options
@click.argument("structure", type=FILE)
@click.option(
    "--method",
    type=click.Choice(["weak", "sindy"]),
    default="weak",
    show_default=True,
    help="How to estimate.",
)
@click.option(
    "-o", "--output", metavar="DIR", type=FOLDER, help="Folder for the result: numbers, figures, report."
)
@click.option(
    "--truth", metavar="STRUCTURE", type=FILE, help="The true structure, to compare the answer with."
)
@click.option(
    "--json", "as_json", is_flag=True, help="Print result.json on standard output and nothing else."
)
def identify(
    source: RecordSource,
    structure: Path,
    method: Literal["weak", "sindy"],
    output: Path | None,
    truth: Path | None,
    as_json: bool,
) -> int:
    """Identify the unknown coefficients of STRUCTURE from RECORD.

    Exit code 3 means that it finished but the answer is not to be trusted; the table says why.

    \b
    Example:
      linkwise identify run.csv unknown.toml -o answer
    """
    if output is not None:
        check_result_folder(output)  # before the work, so that nobody waits for a refusal
    subject = lw.read_structure(structure)
    true = None if truth is None else lw.read_structure(truth)
    with progress("reading") as step:
        record = source.read(subject.mass_names)
        for note in record.notes:
            tell(f"note: {note}")
        step(0.0, "identifying")
        estimate = lw.identify(record, subject, method=method)
        if output is not None:
            lw.write_result(estimate, output, truth=true, progress=step)
    result = lw.result_of(estimate, true)
    click.echo(to_json(result) if as_json else str(estimate))
    if not as_json:
        _compare(result)
        if output is not None:
            tell(f"written to {output}; open {output / 'report.html'}")
    return 0 if estimate.trusted else UNTRUSTED


def _compare(result: dict[str, Any]) -> None:
    """Print how far each identified force is from the true one, where a truth was given."""
    if "nmse_percent" not in result:
        return
    click.echo("\nagainst the truth: NMSE of the force (paper Eq. 8)")
    for name, error in result["nmse_percent"].items():
        click.echo(f"  {name:10} {'cannot be told' if error is None else f'{error:.3g} %'}")
