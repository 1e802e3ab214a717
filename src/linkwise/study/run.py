"""Run a study from its definition to its tables."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from linkwise.argument_types import checked
from linkwise.deprecation import Deprecated, deprecated_keyword
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

MOST_CASES = 1_000_000  # kept in memory and in one file: years of computing time


@deprecated_keyword("which", Deprecated("study", since="0.2.0", until="0.4.0"))
@checked
def run_study(
    study: Study | str | Path,
    folder: str | Path,
    *,
    quick: bool = False,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Progress = silent,
) -> tuple[Row, ...]:
    """Run a study, or continue one, and write its tables.

    A process that is killed loses only the cases that were running; a row does not depend on the worker that computed it.

    Parameters
    ----------
    study : Study, str or path
        A study, the name of one that ships with linkwise ("paper", "reach"), or a TOML file.
    folder : str or path
        The folder of the study; it is created, or holds the same study already.
    quick : bool
        Whether to run the quick number of cycles only.
    workers : int, optional
        The number of processes on this machine; by default one for each processor.
    scheduler : str, optional
        The address of the scheduler of a dask cluster to run on ("tcp://host:8786"), in place of `workers`.
    progress : Progress
        Called with reports whose `detail` is a `StudyProgress`.

    Returns
    -------
    tuple of Row
        In the order of the study.

    Raises
    ------
    StudyError
        If the study cannot be read, the folder holds another one, another process runs one there, it has more than a million
        cases, or there are no workers.

    Examples
    --------
    >>> import linkwise as lw
    >>> rows = lw.run_study("mine.toml", "results/mine", workers=1)
    >>> [(row.case.method, row.status) for row in rows]
    [('weak', 'converged'), ('weak', 'converged')]
    """
    definition = study if isinstance(study, Study) else read_study(study)
    definition = definition.quickly() if quick else definition
    if workers is not None and scheduler is not None:
        raise StudyError(
            "workers are processes of this machine, and a scheduler has workers of its own; give one of the two"
        )
    if definition.count > MOST_CASES:
        raise StudyError(
            f"a study has at most {MOST_CASES} cases, got {definition.count}; take fewer cycles, or make several "
            "studies of it",
            "cycles",
        )
    with open_store(Path(folder), definition) as store:
        if len(store.done()) < len(definition):
            with _executor(workers, scheduler) as executor:
                run(definition, store, executor, progress)
        export_study(folder)
    return read_rows(folder)


def _executor(workers: int | None, scheduler: str | None) -> Executor:
    if scheduler is None:
        return ProcessExecutor(workers if workers is not None else processors())
    try:
        cluster = import_module("linkwise.study.dask_executor")
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in ("dask", "distributed"):
            raise
        raise StudyError(
            "a scheduler needs the library distributed; install it with pip install 'linkwise[cluster]'"
        ) from error
    executor: Executor = cluster.DaskExecutor(scheduler)
    return executor
