"""Options that several commands share: where a record comes from, and what `NAME=VALUE` means."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import TypeVar

import click

import linkwise as lw

R = TypeVar("R")

FILE = click.Path(dir_okay=False, path_type=Path)
FOLDER = click.Path(file_okay=False, path_type=Path)
POSITIVE = click.FloatRange(min=0, min_open=True)


def split(text: str, option: str, example: str) -> tuple[str, str]:
    """`NAME=VALUE` in its two halves; what lacks one of them is wrong usage."""
    name, sign, value = (part.strip() for part in text.partition("="))
    if not (name and sign and value):
        raise click.UsageError(f"{option} {text!r} is not NAME=VALUE, as in {option} {example}.")
    return name, value


def number(text: str, option: str, example: str) -> float:
    """A plain SI number; what is none is wrong usage."""
    try:
        return float(text)
    except ValueError:
        raise click.UsageError(f"{option}: {text!r} is not a number, as in {option} {example}.") from None


def pairs(texts: Iterable[str], option: str, example: str) -> dict[str, str]:
    """Repeated `NAME=VALUE`; a name given twice is wrong usage."""
    found: dict[str, str] = {}
    for text in texts:
        name, value = split(text, option, example)
        if name in found:
            raise click.UsageError(f"{option} is given twice for {name!r}: {found[name]} and {value}.")
        found[name] = value
    return found


@dataclass(frozen=True)
class RecordSource:
    """A record's file and how to read it: the answers to the options of `record_options`."""

    path: Path
    channel: tuple[str, ...]
    resample: float | None
    start: float | None
    stop: float | None

    def read(self, masses: tuple[str, ...]) -> lw.Record:
        """The record, cut to the asked time; RecordError names file, line and channel. `masses` are those there are."""
        mapping = pairs(self.channel, "--channel", "x:m1=COLUMN")
        record = lw.read_record(self.path, channels=mapping, resample=self.resample, known_masses=masses)
        if self.start is None and self.stop is None:
            return record
        start = record.start if self.start is None else self.start
        stop = record.start + record.duration if self.stop is None else self.stop
        return record.between(start, stop)


def record_options(command: Callable[..., R]) -> Callable[..., R]:
    """Argument RECORD and the options of reading it; the command gets one `source: RecordSource`."""

    @wraps(command)
    def wrapped(
        *, record: Path, channel: tuple[str, ...], resample: float | None, start: float | None, stop: float | None,
        **others: object,
    ) -> R:  # fmt: skip
        return command(source=RecordSource(record, channel, resample, start, stop), **others)

    return stacked(
        wrapped,
        click.argument("record", type=FILE),
        click.option(
            "--channel",
            metavar="NAME=COLUMN",
            multiple=True,
            help="The column of the file that a channel is, as in x:m1=Laser1 or x:m1[mm]=Laser1. Repeatable.",
        ),
        click.option("--resample", metavar="HZ", type=POSITIVE, help="Resample uneven time to this rate."),
        click.option("--from", "start", metavar="S", type=float, help="Use the record from this time on."),
        click.option("--to", "stop", metavar="S", type=float, help="Use the record up to this time."),
    )


def stacked(
    command: Callable[..., R], *options: Callable[[Callable[..., R]], Callable[..., R]]
) -> Callable[..., R]:
    """`command` with click's decorators applied, shown by `--help` in the order given here."""
    for option in reversed(options):
        command = option(command)
    return command
