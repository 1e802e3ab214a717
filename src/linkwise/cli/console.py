"""How commands talk: results on standard output, everything else on standard error, a bar for long work on a terminal
only.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.console import Console
from rich.progress import BarColumn, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as ProgressBars

from linkwise.display import shortened
from linkwise.errors import OutputError
from linkwise.output import RESULT, check_result_folder
from linkwise.progress import Progress, silent
from linkwise.registry import lazy_module
from linkwise.report.drawing_process import DrawingProcess, drawing_process
from linkwise.verdict import Verdict, is_trusted

if TYPE_CHECKING:
    from linkwise.cli import console as bar
else:
    bar = lazy_module("linkwise.cli.console")  # rich is for terminals


UNTRUSTED = 3  # exit code: finished, but the answer is not to be trusted


def exit_code(verdicts: Iterable[Verdict]) -> int:
    """0, or `UNTRUSTED` where a verdict forbids trust."""
    return 0 if is_trusted(verdicts) else UNTRUSTED


def fail(message: str) -> None:
    """One paragraph on standard error that begins with the command's name."""
    with suppress(OSError):  # nobody is left to hear it
        click.echo(f"linkwise: {shortened(message)}", err=True)


def tell(message: str) -> None:
    """A remark for the reader, on standard error, so that standard output holds the result and nothing else."""
    with suppress(OSError):
        click.echo(shortened(message), err=True)


def deliver(
    answer: str,
    folder: Path | None,
    write: Callable[[Path, Progress], object],
    write_numbers: Callable[[Path], object] | None = None,
    *,
    quiet: bool = False,
) -> None:
    """Print an answer, then `write` its folder where one was asked for; each is done even where the other fails.

    Where the folder cannot be written, the result is kept in a temporary folder; where drawing fails, its numbers alone, by
    `write_numbers` where that is given. It is said where. Unless `quiet` it is said where the folder is.
    """
    unheard: OSError | None = None
    try:
        click.echo(answer)
        sys.stdout.flush()
    except OSError as error:
        unheard = error
    if folder is not None:
        try:
            with progress("writing") as step:
                write(folder, step)
        except Exception as error:
            whole = [lambda place: write(place, silent)] if isinstance(error, OutputError) else []
            _keep(folder, [*whole, *([write_numbers] if write_numbers else [])])
            raise
        if not quiet:
            tell(f"written to {folder}; open {folder / 'report.html'}")
    if unheard is not None:
        raise unheard


def _keep(folder: Path, writers: Iterable[Callable[[Path], object]]) -> None:
    """Keep what should have been in `folder` in a temporary one, by the first of the writers that succeeds, and say so."""
    try:
        home = Path(tempfile.mkdtemp(prefix="linkwise-"))
    except OSError:
        home = None
    if home is not None:
        place = home / (folder.resolve().name or "result")
        for write in writers:
            with suppress(Exception):  # that of the folder that was asked for is the one to tell
                write(place)
                lacking = "" if (place / "report.html").exists() else ", without figures and page"
                tell(f"note: the result was kept in {place}{lacking}")
                return
        shutil.rmtree(home, ignore_errors=True)
    tell("note: the result was not saved; only the printed text is left")


def drawing_beside(folder: Path | None, kind: str, mark: str = RESULT) -> DrawingProcess | None:
    """A process that gets ready to draw for `folder`, of the kind "module:name", until the command ends; None without one.

    Raises OutputError where the folder cannot be written: before the work, so that nobody waits for a refusal.
    """
    if folder is None:
        return None
    check_result_folder(folder, mark)
    return click.get_current_context().with_resource(drawing_process(kind))


def progress(title: str) -> AbstractContextManager[Progress]:
    """A bar for work that may take long; gives what the keyword `progress` of all long work takes.

    Nothing is written where standard error is no terminal.
    """
    return bar.progress_bar(title) if sys.stderr.isatty() else nullcontext(silent)


@contextmanager
def progress_bar(title: str) -> Iterator[Progress]:
    """A bar on standard error; yields what the keyword `progress` of all long work takes.

    Until the first call the bar only shows that there is life.
    """
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with ProgressBars(*columns, console=Console(stderr=True), transient=True) as bars:
        task = bars.add_task(title, total=None)
        yield lambda report: bars.update(
            task, total=1.0, completed=report.fraction, description=report.activity
        )
