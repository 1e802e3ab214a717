"""A bar on a terminal for work that may take long."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as ProgressBars

from linkwise.progress import Progress


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
