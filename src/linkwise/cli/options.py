"""Options of commands: made of the fields of classes, their flags in the messages of errors, paths that several share, and
what is typed as values: `NAME=VALUE`, numbers, quantities with units, ranges, files with columns.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import MISSING, Field, field, fields
from functools import wraps
from inspect import cleandoc
from pathlib import Path
from typing import Any, Protocol, TypeVar

import click
from click import UsageError

import linkwise as lw
from linkwise.errors import LinkwiseError, SimulationError
from linkwise.output import answer_folder
from linkwise.registry import Registry

R = TypeVar("R")

FILE = click.Path(dir_okay=False, path_type=Path)
FOLDER = click.Path(file_okay=False, path_type=Path)
STRUCTURE = click.Path(path_type=Path)  # a file, or the folder of an answer


class _AnswerPath(click.Path):
    """The same where every coefficient must be a number: of a folder of `start` it is the answer inside."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        given: Any = super().convert(value, param, ctx)
        if (folder := answer_folder(given)) != given:
            click.echo(f"note: the answer in {given} is taken, {folder}", err=True)
        return folder


ANSWER = _AnswerPath(path_type=Path)
POSITIVE = click.FloatRange(min=0, min_open=True)


def stated(values: Mapping[str, Any]) -> dict[str, Any]:
    """What was given on the command line, of options by name."""
    return {name: value for name, value in values.items() if value is not None and value != ()}


def described(kind: type) -> dict[str, str]:
    """What the docstrings of a class and its bases say of each parameter, as plain text."""
    texts: dict[str, str] = {}
    for part in reversed(kind.__mro__):
        text = cleandoc(part.__doc__ or "")
        section = re.search(r"Parameters\n-+\n(.*?)(?:\n\n\w+\n-+\n|\Z)", text, re.DOTALL)
        entries = re.findall(r"^(\S.*?) : .*\n((?:    .*\n?)+)", section[1] if section else "", re.MULTILINE)
        for names, text in entries:
            plain = " ".join(text.split()).replace("`", "").replace("()", "")
            texts |= dict.fromkeys(names.split(", "), plain)
    return texts


def typed(metavar: str | None = None, *flags: str, **keywords: Any) -> Any:
    """A field that is an option of commands: what stands behind its flag, the flags where they are not the field's name, and
    arguments of `click.option`. Its help is what the docstring of its class says of it.
    """
    return field(metadata={"flags": flags, "metavar": metavar, **keywords})


class Decorator(Protocol):
    """What adds options to a command, whatever that returns."""

    def __call__(self, command: Callable[..., R], /) -> Callable[..., R]: ...


def grouped(kind: type, keyword: str, *arguments: Callable[[Any], Any]) -> Decorator:
    """A decorator that gives a command the options that the fields of `kind` are, and `arguments` for the others, and hands
    their values over as one `kind`, by this keyword.
    """
    texts = described(kind)
    options = [_option(one, texts[one.name]) for one in fields(kind) if one.metadata]
    return gathered(keyword, lambda own: kind(**own), *arguments, *options)


def _option(typed_field: Field[Any], text: str) -> Callable[[Any], Any]:
    about = dict(typed_field.metadata)
    flags = about.pop("flags") or [f"--{typed_field.name.replace('_', '-')}"]
    return click.option(*flags, typed_field.name, help=text, **about)


def gathered(
    keyword: str, make: Callable[[dict[str, Any]], object], *options: Callable[[Any], Any]
) -> Decorator:
    """A decorator that adds options and hands their values over as one argument, made of them by their names."""
    names = [parameter.name or "" for option in options for parameter in option(click.Command(None)).params]

    def decorate(command: Callable[..., R]) -> Callable[..., R]:
        @wraps(command)
        def wrapped(**values: Any) -> R:
            group_values = {name: values.pop(name) for name in names}
            return command(**{keyword: make(group_values)}, **values)

        for option in reversed(options):
            wrapped = option(wrapped)
        return wrapped

    return decorate


def option_name(parameter: str) -> str:
    """How an option of the running command is typed, "--calibration" for the parameter "calibration"."""
    command = click.get_current_context().command
    return next(option.opts[0] for option in command.params if option.name == parameter)


FLAGS = {
    "channels": "--channel NAME=COLUMN",
    "mapping": "--mapping FILE (linkwise start asks what columns hold; inspect --write-mapping FILE writes a first mapping)",
    "header": "--header LINE",
    "rate": "--rate HZ",
    "resample": "--resample HZ",
    "earliest": "--from S",
    "latest": "--to S",
    "period": "--period S",
    "mark_missing": "--mark-missing clipped,spikes",
    "burn": "--burn S",
    "segment": "--segment S",
    "draws": "--draws N",
    "hz": "--from HZ --to HZ",
    "harmonic": "--from HZ --to HZ",
    "excitation": "--force MASS=N or --base x|v|a=SIZE",
    "levels": "--levels SIZE,SIZE",
    "plane": "--plane x:m2=-0.02:0.02,v:m2=-2:2",
    "end": "--to-amplitude x:m1=0.01 or --to-energy J",
    "within": "--within force=20 --within stroke=0.01",
}
"""Flag by name of the argument of a public function (`LinkwiseError.arguments`)."""

METHOD_FLAGS = {"drifts": "--sensor CHANNEL:drift[=TIME]", "hums": "--sensor CHANNEL:hum=HZ"}
"""The same of options made from fields, as far as they are loaded; an error that names one is wrong usage."""


_SPELLED = {"admit": "let", "loss": "robust", "tested": "test"}
"""The names of options that are not those of their fields."""


def method_options(kind: type, keyword: str, *, remark: str = "") -> Decorator:
    """A decorator that gives a command the options of `kind` as one argument `keyword`: a dict of those that were given.

    `remark` stands at the end of what each does. The names are those of keywords of the library, so that a command hands the
    dict on and no other line names an option. Options that were not given and have no default are left out.
    """
    texts = described(kind)
    typed = [field for field in fields(kind) if "typed" in field.metadata]
    options = [_method_option(field, f"{texts.get(field.name, '').rstrip('.')}{remark}.") for field in typed]
    return gathered(keyword, stated, *options)


def _method_option(field: Field[Any], text: str) -> Callable[[Any], Any]:
    """The option of a field, which says `text` in help."""
    about = field.metadata
    name = _SPELLED.get(field.name, field.name)
    repeatable = "=" in about["typed"] or field.default == ()
    flag = "--" + (name.removesuffix("s") if repeatable else name).replace("_", "-")
    METHOD_FLAGS[field.name] = f"{flag} {'|'.join(about.get('choices', ())) or about['typed']}".rstrip()
    keywords: dict[str, Any] = {"help": f"{text}{' Repeatable.' if repeatable else ''}"}
    if field.default is MISSING and field.default_factory is MISSING:
        keywords["required"] = True
    if not about["typed"]:
        return click.option(flag, field.name, is_flag=True, default=None, **keywords)
    if "choices" in about:
        return click.option(flag, field.name, **_choice(about["choices"]), **keywords)
    if "=" in about["typed"]:
        keywords |= {"callback": _pairs(about), "multiple": True}
    elif repeatable:
        keywords |= {"callback": comma_separated, "multiple": True}
    elif "float" in str(field.type):
        keywords["type"] = float
    elif str(field.type).startswith("int"):
        keywords["type"] = int
    return click.option(flag, field.name, metavar=about["typed"], **keywords)


def _choice(choices: Registry[Any] | Mapping[str, Any]) -> dict[str, Any]:
    """One of the names; a table that is no registry says what each stands for."""
    meaning: Any = {} if isinstance(choices, Registry) else choices
    return {
        "type": click.Choice(list(choices)),
        "callback": lambda context, option, name: meaning.get(name, name),
    }


def _pairs(about: Mapping[str, Any]) -> Callable[..., dict[str, Any] | None]:
    """A callback that reads NAME=VALUE, or names alone where the value may be left out; None where nothing was given."""

    def read(
        context: click.Context, option: click.Parameter, texts: tuple[str, ...]
    ) -> dict[str, Any] | None:
        stated: dict[str, Any] = {}
        for text in texts:
            if "=" in text or "[=" not in about["typed"]:
                name, value = split(text, option.opts[0], about["example"])
                values: dict[str, Any] = {name: _stated_value(text, name, value, about, option.opts[0])}
            else:
                values = dict.fromkeys(part.strip() for part in text.split(","))
            for name, one in values.items():
                if name in stated:
                    raise UsageError(f"{option.opts[0]} is given twice for {name!r}.")
                stated[name] = one
        return stated or None

    return read


def _stated_value(text: str, name: str, value: str, about: Mapping[str, Any], flag: str) -> float | str:
    """A plain number, or one with a unit of its own; without a unit in the metadata any other text as it is."""
    unit = about.get("unit")
    if unit == "%":
        return 0.01 * percentage(value, flag, about["example"])
    try:
        return float(value)
    except ValueError:
        if unit is None:
            return value
        unit = unit_of_channel(name) if unit == "channel" else unit
    if "sqrt" in unit:
        raise UsageError(f"{flag} takes a number in {unit}, as in {about['example']}, got {value!r}.")
    return quantity(value, unit, f"{flag} {text}")


_OF_MAPPING = {"rate": 'rate = "... Hz"', "resample": 'resample = "... Hz"', "header": 'header = "..."'}
"""Lines of a mapping file that stand for flags, of commands that read a record by --mapping alone."""


def with_flags(error: LinkwiseError, command: click.Command | None = None) -> str:
    """The message of an error, and how the arguments it names are set: by flags that the `command` has, any without one."""
    known = {**FLAGS, **METHOD_FLAGS}
    if command is not None and not isinstance(command, click.Group):
        has = {flag for option in command.params for flag in option.opts}
        mapping = FLAGS["mapping"].partition(" (")[0]
        lines = {name: f"{mapping} with the line {line}" for name, line in _OF_MAPPING.items()}
        known = {name: flag for name, flag in known.items() if flag.partition(" ")[0] in has}
        known = (lines if "--mapping" in has else {}) | known
    flags = [known[name] for name in error.arguments if name in known]
    if not flags:
        return str(error)
    message = str(error).rstrip(".")
    return f"{message}{'' if message.endswith('?') else '.'} On the command line: {', '.join(flags)}."


@contextmanager
def unstarted_is_usage() -> Iterator[None]:
    """Raise UsageError for a simulation that could not start, since it was not set up right by the options."""
    try:
        yield
    except SimulationError as error:
        if error.time is None:
            raise UsageError(with_flags(error, click.get_current_context().command)) from error
        raise


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
    limits = {}
    for name, text in pairs(texts, option, example).items():
        if text.count(":") != 1:
            raise UsageError(f"{option}: {text!r} is not {form}, as in {option} {example}.")
        low, high = (number(end, option, example) for end in text.split(":"))
        limits[name] = (low, high)
    return limits


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
