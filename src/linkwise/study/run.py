"""Run a study from its definition to its tables."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from linkwise.errors import StudyError
from linkwise.progress import Progress, silent
from linkwise.runtime import processors
from linkwise.study.definition import Study
from linkwise.study.executor import Executor, ProcessExecutor
from linkwise.study.export import export_study
from linkwise.study.row import Row
from linkwise.study.runner import run
from linkwise.study.store import open_store, read_rows
from linkwise.study.toml_file import read_study

MOST_CASES = 1_000_000  # kept in memory and in one file: years of one processor


def run_study(
    which: Study | str | Path,
    folder: str | Path,
    *,
    quick: bool = False,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Progress = silent,
) -> tuple[Row, ...]:
    """Run a study, "paper" or a TOML file, in `folder`, or go on with it there; write its tables and return its rows.

    `quick` takes the few cycles that the study calls quick. It runs on `workers` processes of this machine (default: as many
    as there are processors), or on the dask cluster whose `scheduler` is at this address. Killed at any moment it loses only
    what was being computed; a row never depends on who computed it. `progress` is told how far it is, with a `StudyProgress`
    as `detail`.

    Raises StudyError for a study that cannot be read, for a folder that holds another one or in which another process runs
    one, for more than `MOST_CASES` cases, and where workers cannot be had.
    """
    study = which if isinstance(which, Study) else read_study(which)
    study = study.quickly() if quick else study
    if workers is not None and scheduler is not None:
        raise StudyError(
            "workers are processes of this machine, a scheduler has workers of its own; give one of the two"
        )
    if study.count > MOST_CASES:
        raise StudyError(
            f"a study has at most {MOST_CASES} cases, and this one has more; take fewer cycles, or make several studies of it",
            "cycles",
        )
    with open_store(Path(folder), study) as store:
        if len(store.done()) < len(study):
            with _crew(workers, scheduler) as executor:
                run(study, store, executor, progress)
        export_study(folder)
    return read_rows(folder)


def _crew(workers: int | None, scheduler: str | None) -> Executor:
    if scheduler is None:
        return ProcessExecutor(workers if workers is not None else processors())
    try:
        cluster = import_module("linkwise.study.dask_executor")
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in ("dask", "distributed"):
            raise
        raise StudyError(
            "a scheduler needs the library distributed, which comes with the extra 'cluster': pip install 'linkwise[cluster]'"
        ) from error
    executor: Executor = cluster.DaskExecutor(scheduler)
    return executor
