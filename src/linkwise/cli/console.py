"""How commands talk: results on standard output, everything else on standard error, a bar on a terminal only."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn


def fail(message: str) -> None:
    """One paragraph on standard error that begins with the command's name."""
    click.echo(f"linkwise: {message}", err=True)


def tell(message: str) -> None:
    """A remark for the reader, on standard error, so that standard output holds the result and nothing else."""
    click.echo(message, err=True)


@contextmanager
def progress(title: str) -> Iterator[Callable[[float, str], None]]:
    """A bar for work that may take long; yields a function to call with the fraction done and what is done now.

    Nothing is written where standard error is no terminal. Until the first call the bar only shows that
    there is life.
    """
    if not sys.stderr.isatty():
        yield lambda fraction, now: None
        return
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bars:
        task = bars.add_task(title, total=None)
        yield lambda fraction, now: bars.update(task, total=1.0, completed=fraction, description=now)
