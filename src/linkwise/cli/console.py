"""How commands talk: results on standard output, everything else on standard error, a bar on a terminal only."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, nullcontext, suppress
from typing import TYPE_CHECKING

import click

from linkwise.lazy import lazy_module
from linkwise.text import shortened
from linkwise.verdict import Verdict, is_trusted

if TYPE_CHECKING:
    from linkwise.cli import progress_bar as bar
else:
    bar = lazy_module("linkwise.cli.progress_bar")  # rich is for terminals

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


def progress(title: str) -> AbstractContextManager[Callable[[float, str], None]]:
    """A bar for work that may take long; gives a function to call with the fraction done and what is done now.

    Nothing is written where standard error is no terminal.
    """
    return bar.progress_bar(title) if sys.stderr.isatty() else nullcontext(_ignore)


def _ignore(fraction: float, now: str) -> None:
    """Take a report of progress that nobody looks at."""
