"""Options that several commands share: where a record comes from, and what `NAME=VALUE` means."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields, replace
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TypeVar

import click

import linkwise as lw
from linkwise.registry import Registry

F = TypeVar("F", bound=Callable[..., Any])
R = TypeVar("R")

FILE = click.Path(dir_okay=False, path_type=Path)
FOLDER = click.Path(file_okay=False, path_type=Path)
POSITIVE = click.FloatRange(min=0, min_open=True)

folder_option = click.option(
    "-o", "--output", metavar="DIR", type=FOLDER, help="Folder for the result: numbers, figures, report."
)
truth_option = click.option(
    "--truth", metavar="STRUCTURE", type=FILE, help="The true structure, to compare the answer with."
)


def json_option(name: str) -> Callable[[F], F]:
    """The option of a command to print the document that its result folder has under this name."""
    return click.option(
        "--json", "as_json", is_flag=True, help=f"Print {name} on standard output and nothing else."
    )


if TYPE_CHECKING:
    _NameType = click.ParamType[str]
else:  # which takes no argument in click 8.1
    _NameType = click.ParamType


class RegisteredChoice(_NameType):
    """One of the names that a registry has when the command runs; nothing is loaded for it."""

    name = "choice"

    def __init__(self, registry: Registry[Any]) -> None:
        self.registry = registry

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:
        return f"[{'|'.join(self.registry)}]"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """The name as typed; any other is wrong usage."""
        return click.Choice(list(self.registry)).convert(value, param, ctx)


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
    values: dict[str, str] = {}
    for text in texts:
        name, value = split(text, option, example)
        if name in values:
            raise click.UsageError(f"{option} is given twice for {name!r}: {values[name]} and {value}.")
        values[name] = value
    return values


def grouped(
    kind: type, keyword: str, *options: Callable[[Any], Any]
) -> Callable[[Callable[..., R]], Callable[..., R]]:
    """A decorator that gives a command these click options, as one argument `keyword` of the dataclass `kind`.

    Each option is a field of `kind`; `--help` shows them in the order given here.
    """

    def decorate(command: Callable[..., R]) -> Callable[..., R]:
        @wraps(command)
        def wrapped(**values: Any) -> R:
            own = {field.name: values.pop(field.name) for field in fields(kind)}
            return command(**{keyword: kind(**own)}, **values)

        for option in reversed(options):
            wrapped = option(wrapped)
        return wrapped

    return decorate


def keyword_group(
    keyword: str, *options: Callable[[Any], Any]
) -> Callable[[Callable[..., R]], Callable[..., R]]:
    """A decorator that gives a command these click options, as one argument `keyword`: a dict by the names of the options.

    The names are those of keywords of the library, so that a command hands the dict on and no other line names an option.
    Options that were not given and have no default are left out.
    """

    def decorate(command: Callable[..., R]) -> Callable[..., R]:
        names = [each.name for option in options for each in option(click.Command(None)).params]

        @wraps(command)
        def wrapped(**values: Any) -> R:
            own = {name: values.pop(name) for name in names}
            given = {name: value for name, value in own.items() if value is not None and value != ()}
            return command(**{keyword: given}, **values)

        for option in reversed(options):
            wrapped = option(wrapped)
        return wrapped

    return decorate


def option_name(parameter: str) -> str:
    """How an option of the running command is typed, "--offset" for the parameter "offsets"."""
    command = click.get_current_context().command
    return next(each.opts[0] for each in command.params if each.name == parameter)


@dataclass(frozen=True)
class ReadingOptions:
    """How to read the file of a record: the answers to the options of `READING`."""

    channel: tuple[str, ...]
    rate: float | None
    resample: float | None
    start: float | None
    stop: float | None
    mark_missing: tuple[str, ...]
    delay: tuple[str, ...]
    interpolation: tuple[str, ...]
    noise_of: tuple[str, ...]

    def read_file(self, path: Path, masses: tuple[str, ...] | None, *, informative: bool = True) -> lw.Record:
        """The record in `path`, cut to the asked time; RecordError names file, line and channel.

        `masses` are those there are, if that is known. Without `informative` dead and duplicated channels are read.
        """
        mapping = {name: file_and_column(text) for name, text in self._mapping.items()}
        files = dict.fromkeys(file for file, _ in mapping.values() if file is not None)
        record, *others = (
            lw.read_record(
                path if file is None else file,
                channels={name: column for name, (other, column) in mapping.items() if other == file},
                rate=self.rate,
                resample=self.resample,
                known_masses=masses,
                informative=informative,
            )
            for file in (None, *files)
        )
        for other in others:
            record = lw.beside(record, other)
        record = lw.mark_missing(record, self.mark_missing)
        record = lw.without_delays(record, self._known_delays)
        runs = pairs(self.interpolation, "--interpolation", "force:m1=held")
        record = replace(record, interpolation={**record.interpolation, **runs})
        sigmas = pairs(self.noise_of, "--noise-of", "x:m1=1e-4")
        if sigmas:
            known = {name: number(value, "--noise-of", "x:m1=1e-4") for name, value in sigmas.items()}
            record = replace(record, noise={**record.noise, **known})
        if self.start is None and self.stop is None:
            return record
        start = record.start if self.start is None else self.start
        stop = record.start + record.duration if self.stop is None else self.stop
        return record.between(start, stop)

    @property
    def unknown_delays(self) -> tuple[str, ...]:
        """The channels whose delay is to be found: those that are named without one."""
        return tuple(text for text in self.delay if "=" not in text)

    def with_known_delays(self) -> Self:
        """The options without the delays that are to be found."""
        return replace(self, delay=tuple(text for text in self.delay if "=" in text))

    @property
    def _known_delays(self) -> dict[str, float]:
        """Delays in s by channel; UsageError for one without a time, which `identify` and `discover` find."""
        if self.unknown_delays:
            name = self.unknown_delays[0]
            raise click.UsageError(
                f"--delay {name} has no time, which identify and discover find; here write it, as in "
                f"--delay {name}=2ms."
            )
        stated = pairs([text for text in self.delay if "=" in text], "--delay", "a:base=2ms")
        return {name: _seconds(value, name) for name, value in stated.items()}

    @property
    def _mapping(self) -> dict[str, str]:
        return pairs(self.channel, "--channel", "x:m1=COLUMN")


def _seconds(text: str, channel: str) -> float:
    """A time in s, with or without a unit."""
    try:
        return float(text)
    except ValueError:
        pass
    try:
        return lw.to_si(text, "s")
    except lw.LinkwiseError as error:
        raise click.UsageError(f"--delay {channel}={text}: {error}") from error


def file_and_column(text: str) -> tuple[Path | None, str]:
    """`COLUMN`, or `FILE:COLUMN` with a file that exists."""
    for end in (place for place, character in enumerate(text) if character == ":"):
        if is_file(Path(text[:end])):
            return Path(text[:end]), text[end + 1 :]
    return None, text


def is_file(path: Path) -> bool:
    """Whether there is such a file; no text that is too long or too odd for a name is one."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


@dataclass(frozen=True)
class RecordOptions(ReadingOptions):
    """A record's file and how to read it: the answers to the options of `record_options`."""

    record: Path

    def read(self, masses: tuple[str, ...]) -> lw.Record:
        """The record, cut to the asked time; RecordError names file, line and channel. `masses` are those there are."""
        return self.read_file(self.record, masses)


def comma_separated(
    context: click.Context, option: click.Parameter, texts: tuple[str, ...]
) -> tuple[str, ...]:
    """The parts of lists with commas, all of an option that may be repeated."""
    return tuple(part.strip() for text in texts for part in text.split(","))


READING = (
    click.option(
        "--channel",
        metavar="NAME=COLUMN",
        multiple=True,
        help="The column of the file that a channel is, as in x:m1=Laser1 or x:m1[mm]=Laser1, or of another file that was "
        "started with it, as in a:base=ground.csv:AccX. Repeatable.",
    ),
    click.option(
        "--rate", metavar="HZ", type=POSITIVE, help="Sampling rate of a file without a time column."
    ),
    click.option("--resample", metavar="HZ", type=POSITIVE, help="Resample uneven time to this rate."),
    click.option("--from", "start", metavar="S", type=float, help="Use the record from this time on."),
    click.option("--to", "stop", metavar="S", type=float, help="Use the record up to this time."),
    click.option(
        "--mark-missing",
        metavar="KINDS",
        multiple=True,
        callback=comma_separated,
        help="Take samples with these faults as missing: clipped, spikes.",
    ),
    click.option(
        "--delay",
        metavar="CHANNEL[=TIME]",
        multiple=True,
        help="A channel that is late, and by how much, in s or as in 2ms; without a time identify and discover find "
        "it. Repeatable.",
    ),
    click.option(
        "--interpolation",
        metavar="CHANNEL=KIND",
        multiple=True,
        help="How an input runs between its samples: held, linear or band-limited (default). Repeatable.",
    ),
    click.option(
        "--noise-of",
        metavar="CHANNEL=SIGMA",
        multiple=True,
        help="Standard deviation of a channel's noise in SI units, where it is known. Repeatable.",
    ),
)

record_options = grouped(RecordOptions, "source", click.argument("record", type=FILE), *READING)
