"""Options for random forces, which `identify` and `discover` share: ambient ones, and noise of the channels of inputs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import click

import linkwise as lw
from linkwise.cli.options import split
from linkwise.records.channel import Channel
from linkwise.registry import lazy_module

if TYPE_CHECKING:
    from linkwise.likelihood import random_forces
else:
    random_forces = lazy_module("linkwise.likelihood.random_forces")  # for those who state one


def refuse_foreign_forces(
    ambient: Mapping[str, float | None],
    input_noise: Mapping[str, float | None],
    record: lw.Record,
    structure: lw.Structure,
) -> None:
    """Raise UsageError for a random force on a mass, or noise of an input, that there is not."""
    if not ambient and not input_noise:
        return
    try:
        random_forces.random_forces(ambient, input_noise, record, structure)
    except lw.IdentificationError as error:
        raise click.UsageError(f"{error}.") from error


def _random_forces(
    unit_of: Callable[[str], str], example: str
) -> Callable[..., dict[str, float | None] | None]:
    """A callback that reads names with or without a deviation in their unit: those without one are to be found."""

    def read(
        context: click.Context, option: click.Parameter, texts: tuple[str, ...]
    ) -> dict[str, float | None] | None:
        stated: dict[str, float | None] = {}
        for text in texts:
            if "=" in text:
                name, value = split(text, option.opts[0], example)
                values: dict[str, float | None] = {
                    name: _in_unit(value, unit_of(name), option.opts[0], example)
                }
            else:
                values = dict.fromkeys(part.strip() for part in text.split(","))
            twice = [name for name in values if name in stated]
            if twice:
                raise click.UsageError(f"{option.opts[0]} is given twice for {twice[0]!r}.")
            stated |= values
        return stated or None

    return read


def _in_unit(text: str, unit: str, option: str, example: str) -> float:
    """A number in `unit`, or with a unit of its own where that is a plain one."""
    try:
        return float(text)
    except ValueError:
        pass
    if "sqrt" in unit:
        raise click.UsageError(f"{option} takes a number in {unit}, as in {example}, got {text!r}.")
    try:
        return lw.to_si(text, unit)
    except lw.LinkwiseError as error:
        raise click.UsageError(f"{option} {text!r}: {error}") from error


def _unit_of_channel(name: str) -> str:
    """The SI unit of an input; N if the name is not a channel, which the estimator reports."""
    try:
        return Channel.parse(name).unit
    except lw.LinkwiseError:
        return "N"


def random_force_options(remark: str = "") -> tuple[Callable[[Any], Any], ...]:
    """The options, with a `remark` at the end of what each does."""
    return (
        click.option(
            "--ambient",
            metavar="MASS[=DENSITY]",
            multiple=True,
            callback=_random_forces(lambda _: "N/sqrt(Hz)", "m1=0.5"),
            help="Masses on which an unrecorded random force acts, as in m1,m2 or all; its one-sided amplitude "
            f"spectral density in N/sqrt(Hz) is estimated if none is given{remark}. Repeatable.",
        ),
        click.option(
            "--input-noise",
            metavar="CHANNEL[=SIGMA]",
            multiple=True,
            callback=_random_forces(_unit_of_channel, "force:m1=0.5"),
            help="Inputs whose channel has noise, as in force:m1, a:base, x:base or all; its standard deviation, in the "
            f"channel's SI unit or with a unit, is estimated if none is given{remark}. Repeatable.",
        ),
    )
