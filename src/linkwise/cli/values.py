"""What is typed on the command line as values: `NAME=VALUE`, numbers, quantities with units, ranges, files with columns."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

import click
from click import UsageError

import linkwise as lw
from linkwise.errors import LinkwiseError


def split(text: str, option: str, example: str) -> tuple[str, str]:
    """`NAME=VALUE` in its two halves; what lacks one of them is wrong usage."""
    name, sign, value = (part.strip() for part in text.partition("="))
    if not (name and sign and value):
        raise UsageError(f"{option} {text!r} is not NAME=VALUE, as in {option} {example}.")
    return name, value


def number(text: str, option: str, example: str) -> float:
    """A plain SI number; anything else is wrong usage."""
    try:
        return float(text)
    except ValueError:
        message = f"{option}: {text!r} is not a plain number in SI units, as in {option} {example}."
        raise UsageError(message) from None


def quantity(text: str, unit: str, option: str) -> float:
    """A plain number, which is in the SI `unit`, or one with a unit of its own; anything else is wrong usage."""
    given: float | str = text
    with suppress(ValueError):  # of a text with a unit
        given = float(text)
    try:
        return lw.files.to_si(given, unit)
    except LinkwiseError as error:
        raise UsageError(f"{option}: {error}") from error


def percentage(text: str, flag: str, example: str) -> float:
    """The per cent that a text such as "2%" says; anything else is wrong usage."""
    number, sign, rest = text.strip().partition("%")
    try:
        value = float(number)
    except ValueError:
        value, rest = 0.0, text
    if rest:
        raise UsageError(f"{flag} takes a percentage, such as {example}, got {text!r}.")
    if not sign:
        meant = f"is it {number}% or {100.0 * value:g}%?"
        raise UsageError(f"{flag} takes a percentage with its sign, such as {example}, got {text!r}: {meant}")
    return value


def pairs(texts: Iterable[str], option: str, example: str) -> dict[str, str]:
    """Repeated `NAME=VALUE`; a name given twice is wrong usage."""
    values: dict[str, str] = {}
    for text in texts:
        name, value = split(text, option, example)
        if name in values:
            raise UsageError(f"{option} is given twice for {name!r}: {values[name]} and {value}.")
        values[name] = value
    return values


def numbers(texts: Iterable[str], option: str, example: str) -> dict[str, float]:
    """Repeated `NAME=NUMBER`, in SI units."""
    return {name: number(text, option, example) for name, text in pairs(texts, option, example).items()}


def ranges(
    texts: Iterable[str], option: str, example: str, form: str = "FROM:TO"
) -> dict[str, tuple[float, float]]:
    """Repeated `NAME=FROM:TO`, or with the ends called otherwise in `form`; anything else is wrong usage."""
    found = {}
    for name, text in pairs(texts, option, example).items():
        if text.count(":") != 1:
            raise UsageError(f"{option}: {text!r} is not {form}, as in {option} {example}.")
        low, high = (number(end, option, example) for end in text.split(":"))
        found[name] = (low, high)
    return found


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


def comma_separated(
    context: click.Context, option: click.Parameter, texts: tuple[str, ...]
) -> tuple[str, ...]:
    """The parts of lists with commas, all of an option that may be repeated."""
    return tuple(part.strip() for text in texts for part in text.split(","))


def header_line(context: click.Context, option: click.Parameter, text: str | None) -> str | int | None:
    """The number of a header line, or text that it contains."""
    return int(text) if text is not None and text.isdecimal() else text


def unit_of_channel(name: str) -> str:
    """The SI unit of an input; N if the name is not a channel, which the estimator reports."""
    try:
        return lw.records.Channel.parse(name).unit
    except lw.LinkwiseError:
        return "N"
