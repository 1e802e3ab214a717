"""`linkwise study`: a Monte Carlo study, from its definition to its tables, over as many runs as it takes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import click
from click import UsageError

import linkwise as lw
from linkwise.cli.console import progress, tell
from linkwise.cli.options import FOLDER, grouped, typed
from linkwise.output import to_json


@dataclass(frozen=True)
class RunOptions:
    """How a study is run.

    Parameters
    ----------
    quick : bool
        Run only the few cycles that the study defines as quick.
    workers : int | None
        Processes on this machine. [default: one for each processor]
    scheduler : str | None
        Run on the dask cluster with this scheduler, such as tcp://host:8786.
    shard : str | None
        Run the I-th of N parts of the cases, for array jobs of batch systems; the same command without it gathers all.
    output : Path
        Folder of the study; an interrupted study is resumed.
    export : bool
        Run nothing; write tables and report of the cases run so far.
    """

    quick: bool = typed(is_flag=True)
    workers: int | None = typed("N", type=click.IntRange(min=1))
    scheduler: str | None = typed("ADDRESS")
    shard: str | None = typed("I/N")
    output: Path = typed("DIR", "-o", "--output", type=FOLDER, required=True)
    export: bool = typed(is_flag=True)


@click.command()
@click.argument("name", metavar="NAME|FILE.toml")
@grouped(RunOptions, "options")
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON and nothing else.")
def study(name: str, options: RunOptions, as_json: bool) -> int:
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
      linkwise study mine.toml --shard 3/16 --workers 1 -o results/mine
    """
    if options.workers is not None and options.scheduler is not None:
        message = "--workers runs the study on this machine, --scheduler on a cluster; give only one of them."
        raise UsageError(message)
    definition = lw.study.read_study(name)
    definition = definition.quickly() if options.quick else definition
    if options.export:
        _require_stored(definition, options.output)
    else:
        _run(definition, options)
    if options.shard is not None:
        tell(f"part {options.shard} is done; without --shard the same command gathers all parts")
        return 0
    summary = lw.study.study_summary(options.output)
    if not as_json:  # before the files, which may fail
        click.echo(f"{summary}\n")
    files = [str(path) for path in lw.study.export_study(options.output)]
    with progress("report") as step:
        page = lw.report.write_study_report(options.output, progress=step)
    files.append(str(page))
    click.echo(to_json({**summary.to_dict(), "files": files}) if as_json else f"written: {', '.join(files)}")
    return (lw.Grade.REFUSED if summary.failed_cells else lw.Grade.EXPLAINED).exit_code


def _require_stored(study: lw.study.Study, output: Path) -> None:
    """UsageError where what is to be exported is not what the folder holds."""
    stored = lw.study.stored_study(output)
    if stored.name != study.name:
        message = f'{output} holds the study "{stored.name}", not "{study.name}"; give that name, or another folder.'
        raise UsageError(message)
    if not lw.study.read_rows(output):
        message = f"{output}: no case of the study has been run yet, so there is nothing to export"
        raise lw.LinkwiseError(message)


def _run(study: lw.study.Study, options: RunOptions) -> None:
    """Run what is left of the study; where it is interrupted, say how far it came."""
    last: list[lw.estimates.ProgressReport] = []
    try:
        with progress(f"{study.name}: starting workers") as step:

            def show(report: lw.estimates.ProgressReport) -> None:
                last[:] = [report]
                step(report)

            how = {key: getattr(options, key) for key in ("workers", "scheduler", "shard")}
            lw.study.run_study(study, options.output, progress=show, **how)
    except KeyboardInterrupt:
        done = f"{last[0].activity.partition(',')[0]} are" if last else "What was finished is"
        tell(f"{done} in {options.output}; the same command resumes it.")
        raise
