"""How commands talk: results on standard output, everything else on standard error, a bar on a terminal only."""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import click

import linkwise as lw
from linkwise.cli.options import FOLDER, STRUCTURE, Decorator, gathered
from linkwise.display import shortened
from linkwise.errors import OutputError
from linkwise.output import check_result_folder, to_json
from linkwise.progress import Progress, silent
from linkwise.registry import lazy_module
from linkwise.verdict import Basis, Grade

if TYPE_CHECKING:
    from rich import console as terminal
    from rich import progress as bars

    from linkwise.model import structure_file
    from linkwise.model.structure import Structure
    from linkwise.report import result_folder as folders
else:  # rich is for terminals
    folders = lazy_module("linkwise.report.result_folder")
    structure_file = lazy_module("linkwise.model.structure_file")
    terminal = lazy_module("rich.console")
    bars = lazy_module("rich.progress")


_TOLD: ContextVar[set[str] | None] = ContextVar("_TOLD", default=None)  # notes, where they are told once


def fail(message: str) -> None:
    """One paragraph on standard error that begins with the command's name."""
    tell(f"linkwise: {message}")


def tell(message: str) -> None:
    """A remark for the reader, on standard error, so that standard output holds the result and nothing else."""
    with suppress(OSError):  # nobody is left to hear it
        click.echo(shortened(message), err=True)


def note(*remarks: str) -> None:
    """Tell what there is to know beside a result, each remark as a note."""
    noted = _TOLD.get()
    for remark in remarks:
        if noted is None or remark not in noted:
            tell(f"note: {remark}")
    if noted is not None:
        noted.update(remarks)


@contextmanager
def noting_once() -> Iterator[None]:
    """Within it notes are told once: several commands read the same records."""
    token = _TOLD.set(set())
    try:
        yield
    finally:
        _TOLD.reset(token)


def answer_options(mark: str, *further: Callable[[Any], Any]) -> Decorator:
    """The options of a command whose result is a folder that `mark` marks, handed over as `delivery`: the folder, `further`
    ones, and the document. A folder that cannot be written is refused before the work.
    """

    def checked(context: click.Context, option: click.Parameter, folder: Path | None) -> Path | None:
        if folder is not None:
            check_result_folder(folder, mark)
        return folder

    text = "Folder for the result: numbers, figures, report."
    folder = click.option("-o", "--output", metavar="DIR", type=FOLDER, callback=checked, help=text)
    said = f"Print {mark} on standard output and nothing else."
    document = click.option("--json", "as_json", is_flag=True, help=said)
    return gathered("delivery", lambda own: Delivery(**own), folder, *further, document)


truth_option = click.option(
    "--truth", metavar="STRUCTURE", type=STRUCTURE, help="The true structure, to compare the answer with."
)


@dataclass(frozen=True)
class Delivery:
    """How a result is handed over: into a folder, if one was asked for, as JSON or as text, and the file of the truth."""

    output: Path | None
    as_json: bool
    truth: Path | None = None

    def of(
        self,
        result: Any,
        *,
        more: Sequence[str] = (),
        truth: Structure | None = None,
        answer: Path | None = None,
    ) -> int:
        """Print a result with `more` lines, or as JSON, then write its folder, even where printing fails; the exit code.

        Where the folder cannot be written, the result is kept in a temporary folder; where drawing fails, its numbers alone.
        It is said where. Beside a document it is not said where the folder is. The grade counts the `answer` that it is of.
        """
        result = result if answer is None else replace(result, basis=Basis.stated_in(answer))
        unheard: OSError | None = None
        try:
            document = lw.report.result_of(result, truth) if self.as_json else {}
            click.echo(to_json(document) if self.as_json else "\n".join([str(result), *more]))
            sys.stdout.flush()
        except OSError as error:
            unheard = error
        if self.output is not None:
            try:
                with progress("writing") as step:
                    lw.report.write_result(result, self.output, truth=truth, progress=step)
            except Exception as error:
                _keep(result, self.output, truth, whole=isinstance(error, OutputError))
                raise
            if not self.as_json:
                tell(f"written to {self.output}; open {self.output / 'report.html'}")
        if result.grade is Grade.REFUSED and isinstance(result, lw.Estimate | lw.Discovery):
            page = 'the page "If it refuses" of the documentation (how-to/if-it-refuses)'
            note(f"what to do, by cause, stands on {page}")
        if unheard is not None:
            raise unheard
        code: int = result.grade.exit_code
        return code


def deliver_structure(
    written: Structure, file: Path | None, *, as_json: bool, further: Mapping[str, Any] = MappingProxyType({})
) -> None:
    """Write a structure to a file, or print it; as JSON, with what is `further` known of it."""
    if file is not None:
        lw.write_structure(written, file)
    if as_json:
        click.echo(to_json({**structure_file.structure_tables(written), **further}))
    elif file is None:
        click.echo(lw.model.format_structure(written).rstrip())


def _keep(result: object, folder: Path, truth: Structure | None, *, whole: bool) -> None:
    """Keep what should have been in `folder` in a temporary one, without figures and page unless `whole`, and say where."""
    try:
        home = Path(tempfile.mkdtemp(prefix="linkwise-"))
    except OSError:
        home = None
    if home is not None:
        place = home / (folder.resolve().name or "result")
        for pictured in [True, False] if whole else [False]:
            with suppress(Exception):  # that of the folder that was asked for is the one to tell
                folders.FOLDERS[type(result).__name__].write(result, place, truth=truth, pictured=pictured)
                lacking = "" if (place / "report.html").exists() else ", without figures and page"
                note(f"the result was kept in {place}{lacking}")
                return
        shutil.rmtree(home, ignore_errors=True)
    note("the result was not saved; only the printed text is left")


@contextmanager
def progress(title: str) -> Iterator[Progress]:
    """A bar on standard error for work that may take long; gives what the keyword `progress` of all long work takes.

    Until the first call the bar only shows that there is life. Nothing is written where standard error is no terminal.
    """
    if not sys.stderr.isatty():
        yield silent
        return
    text = bars.TextColumn("{task.description}")
    columns = bars.SpinnerColumn(), text, bars.BarColumn(), bars.TimeElapsedColumn()
    with bars.Progress(*columns, console=terminal.Console(stderr=True), transient=True) as bar:
        show = partial(bar.update, bar.add_task(title, total=None), total=1.0)
        yield lambda report: show(completed=report.fraction, description=report.activity)


def nmse_lines(result: Mapping[str, Any], title: str, indent: str = "  ") -> list[str]:
    """The errors of forces of a document, in lines under a title; none where it was not compared with a truth."""
    if "nmse_percent" not in result:
        return []
    errors = result["nmse_percent"].items()
    texts = ((name, "undefined" if error is None else f"{error:.3g} %") for name, error in errors)
    return [title, *(f"{indent}{name:{8 + len(indent)}} {text}" for name, text in texts)]
