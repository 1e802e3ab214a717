"""`linkwise study`: a Monte Carlo study, from its definition to its tables, over as many runs as it takes."""

from __future__ import annotations

from pathlib import Path

import click

import linkwise as lw
from linkwise.cli.console import UNTRUSTED, progress, tell
from linkwise.cli.options import FOLDER
from linkwise.output import to_json


@click.command()
@click.argument("name", metavar="NAME|FILE.toml")
@click.option("--quick", is_flag=True, help="Run only the few cycles that the study defines as quick.")
@click.option(
    "--workers",
    metavar="N",
    type=click.IntRange(min=1),
    help="Processes on this machine.  [default: one for each processor]",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Run on the dask cluster with this scheduler, such as tcp://host:8786.",
)
@click.option(
    "-o",
    "--output",
    metavar="DIR",
    type=FOLDER,
    required=True,
    help="Folder of the study; an interrupted study is resumed.",
)
@click.option("--export", is_flag=True, help="Run nothing; write tables and report of the cases run so far.")
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON and nothing else.")
def study(
    name: str,
    quick: bool,
    workers: int | None,
    scheduler: str | None,
    output: Path,
    export: bool,
    as_json: bool,
) -> int:
    """Run the study NAME that ships with linkwise ("paper", "reach"), or the one in a TOML file.

    A study identifies every structure at every noise level by every method, once for each seed. It may be interrupted or
    killed at any time; the same command resumes it. At the end DIR holds tables, figures and report.html. Exit code 3 means
    that a method gave no answer at all for some structure and noise level.

    \b
    Examples:
      linkwise study paper --quick -o results/quick
      linkwise study reach -o results/reach
      linkwise study mine.toml --workers 4 -o results/mine
      linkwise study mine.toml --scheduler tcp://host:8786 -o results/mine
    """
    if workers is not None and scheduler is not None:
        raise click.UsageError(
            "--workers runs the study on this machine, --scheduler on a cluster; give only one of them."
        )
    definition = lw.read_study(name)
    definition = definition.quickly() if quick else definition
    if export:
        _require_stored(definition, output)
    else:
        _run(definition, output, workers, scheduler)
    summary = lw.study.study_summary(output)
    if not as_json:  # before the files, which may fail
        click.echo(f"{summary}\n")
    files = [str(path) for path in lw.study.export_study(output)]
    with progress("report") as step:
        page = lw.report.write_study_report(output, progress=step)
    files.append(str(page))
    click.echo(to_json({**summary.to_dict(), "files": files}) if as_json else f"written: {', '.join(files)}")
    return UNTRUSTED if summary.failed_cells else 0


def _require_stored(study: lw.Study, output: Path) -> None:
    """UsageError where what is to be exported is not what the folder holds."""
    stored = lw.study.stored_study(output)
    if stored.name != study.name:
        raise click.UsageError(
            f'{output} holds the study "{stored.name}", not "{study.name}"; give that name, or another folder.'
        )
    if not lw.study.read_rows(output):
        raise lw.LinkwiseError(
            f"{output}: no case of the study has been run yet, so there is nothing to export"
        )


def _run(study: lw.Study, output: Path, workers: int | None, scheduler: str | None) -> None:
    """Run what is left of the study; where it is interrupted, say how far it came."""
    last: list[lw.estimates.ProgressReport] = []
    try:
        with progress(f"{study.name}: starting workers") as step:

            def show(report: lw.estimates.ProgressReport) -> None:
                last[:] = [report]
                step(report)

            lw.run_study(study, output, workers=workers, scheduler=scheduler, progress=show)
    except KeyboardInterrupt:
        done = f"{last[0].activity.partition(',')[0]} are" if last else "What was finished is"
        tell(f"{done} in {output}; the same command resumes it.")
        raise
