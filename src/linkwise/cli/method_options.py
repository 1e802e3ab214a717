"""Options of commands, made from the fields of the options objects of the library.

A field whose metadata say what is "typed" behind its flag is an option; its help is what the docstring of the object says of
it, and what is typed decides how it is read: nothing, NAME=VALUE, NAME[=VALUE], or a value like the default. Further metadata:
the "unit" of a value, the "choices", an "example".
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, fields
from typing import Any

import click
from click import UsageError

import linkwise as lw
from linkwise.cli.options import (
    METHOD_FLAGS,
    Decorator,
    RegisteredChoice,
    comma_separated,
    described,
    gathered,
    percentage,
    quantity,
    split,
    stated,
)
from linkwise.records import channel as channels
from linkwise.registry import Registry

_SPELLED = {"admit": "let", "loss": "robust", "tested": "test"}
"""The names of options that are not those of their fields."""


def method_options(kind: type, keyword: str, *further: Callable[[Any], Any], remark: str = "") -> Decorator:
    """A decorator that gives a command the options of `kind` as one argument `keyword`: a dict of those that were given.

    `further` options stand before those of the fields; `remark` stands at the end of what each does. The names are those of
    keywords of the library, so that a command hands the dict on and no other line names an option. Options that were not
    given and have no default are left out.
    """
    texts = described(kind)
    typed = [field for field in fields(kind) if "typed" in field.metadata]
    options = [_option(field, f"{texts.get(field.name, '').rstrip('.')}{remark}.") for field in typed]
    return gathered(keyword, stated, *further, *options)


def _option(field: Field[Any], text: str) -> Callable[[Any], Any]:
    """The option of a field, which says `text` in help."""
    about = field.metadata
    name = _SPELLED.get(field.name, field.name)
    repeatable = "=" in about["typed"] or field.default == ()
    flag = "--" + (name.removesuffix("s") if repeatable else name).replace("_", "-")
    METHOD_FLAGS[field.name] = f"{flag} {'|'.join(about.get('choices', ())) or about['typed']}".rstrip()
    keywords: dict[str, Any] = {"help": f"{text}{' Repeatable.' if repeatable else ''}"}
    if field.default is MISSING and field.default_factory is MISSING:
        keywords |= {"required": True}
    if not about["typed"]:
        keywords |= {"is_flag": True, "default": None}
    elif "choices" in about:
        keywords |= _choice(about["choices"])
    elif "=" in about["typed"]:
        keywords |= {"callback": _pairs(about), "multiple": True}
    elif repeatable:
        keywords |= {"callback": comma_separated, "multiple": True}
    elif "float" in str(field.type):
        keywords |= {"type": float}
    elif str(field.type).startswith("int"):
        keywords |= {"type": int}
    if about["typed"] and "choices" not in about:
        keywords |= {"metavar": about["typed"]}
    return click.option(flag, field.name, **keywords)


def _choice(choices: Registry[Any] | Mapping[str, Any]) -> dict[str, Any]:
    """One of the names; a table that is no registry says what each stands for."""
    if isinstance(choices, Registry):
        return {"type": RegisteredChoice(choices)}
    return {
        "type": click.Choice(list(choices)),
        "callback": lambda context, option, name: None if name is None else choices[name],
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
                values: dict[str, Any] = {name: _value(text, name, value, about, option.opts[0])}
            else:
                values = dict.fromkeys(part.strip() for part in text.split(","))
            for name, one in values.items():
                if name in stated:
                    raise UsageError(f"{option.opts[0]} is given twice for {name!r}.")
                stated[name] = one
        return stated or None

    return read


def _value(text: str, name: str, value: str, about: Mapping[str, Any], flag: str) -> float | str:
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


def unit_of_channel(name: str) -> str:
    """The SI unit of an input; N if the name is not a channel, which the estimator reports."""
    try:
        return channels.Channel.parse(name).unit
    except lw.LinkwiseError:
        return "N"
