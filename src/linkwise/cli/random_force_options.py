"""Options for random forces: ambient ones, which no channel shows, and noise of the channels of applied forces."""

from __future__ import annotations

from collections.abc import Callable

import click

import linkwise as lw
from linkwise.cli.options import split


def _random_forces(unit: str, example: str) -> Callable[..., dict[str, float | None] | None]:
    """A callback that reads names with or without a deviation in `unit`: those without one are to be found."""

    def read(
        context: click.Context, option: click.Parameter, texts: tuple[str, ...]
    ) -> dict[str, float | None] | None:
        stated: dict[str, float | None] = {}
        for text in texts:
            if "=" in text:
                name, value = split(text, option.opts[0], example)
                found: dict[str, float | None] = {name: _in_unit(value, unit, option.opts[0], example)}
            else:
                found = dict.fromkeys(part.strip() for part in text.split(","))
            twice = [name for name in found if name in stated]
            if twice:
                raise click.UsageError(f"{option.opts[0]} is given twice for {twice[0]!r}.")
            stated |= found
        return stated or None

    return read


def _in_unit(text: str, unit: str, option: str, example: str) -> float:
    """A number in `unit`, or with a unit of its own where that is a plain one."""
    try:
        return float(text)
    except ValueError:
        pass
    if unit != "N":
        raise click.UsageError(f"{option} takes a number in {unit}, as in {example}, got {text!r}.")
    try:
        return lw.to_si(text, unit)
    except lw.LinkwiseError as error:
        raise click.UsageError(f"{option} {text!r}: {error}") from error


RANDOM_FORCE_OPTIONS = (
    click.option(
        "--ambient",
        metavar="MASS[=DENSITY]",
        multiple=True,
        callback=_random_forces("N/sqrt(Hz)", "m1=0.5"),
        help="Masses that a random force acts on which no channel shows, as m1,m2 or all; its one-sided amplitude spectral "
        "density in N/sqrt(Hz) is found where none is given (ml). Repeatable.",
    ),
    click.option(
        "--input-noise",
        metavar="CHANNEL[=SIGMA]",
        multiple=True,
        callback=_random_forces("N", "force:m1=0.5"),
        help="Applied forces whose channel has noise, as force:m1 or all; its standard deviation, in N or with a unit, is "
        "found where none is given (ml). Repeatable.",
    ),
)
