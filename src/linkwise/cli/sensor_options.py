"""Options for errors of sensors that are found with the laws, which `identify` and `discover` share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import click

import linkwise as lw
from linkwise.cli.options import comma_separated, pairs
from linkwise.registry import lazy_module

if TYPE_CHECKING:
    from linkwise.likelihood import sensor_priors as priors
else:
    priors = lazy_module("linkwise.likelihood.sensor_priors")  # for those who state a calibration

_KINDS = ("gain", "offset", "delay")


def _calibration(
    context: click.Context, option: click.Parameter, texts: tuple[str, ...]
) -> dict[str, float] | None:
    """Relative standard deviations by channel."""
    percentages = pairs(texts, "--calibration", "x:m1=1%")
    return {name: 0.01 * _percentage(value) for name, value in percentages.items()} or None


def _percentage(text: str) -> float:
    number, sign, rest = text.strip().partition("%")
    try:
        value = float(number)
    except ValueError:
        value, rest = 0.0, text
    if rest:
        raise click.UsageError(f"--calibration takes a percentage, such as x:m1=1%, got {text!r}.")
    if not sign:
        raise click.UsageError(
            f"--calibration takes a percentage with its sign, such as x:m1=1%, got {text!r}: is it {number}% or "
            f"{100.0 * value:g}%?"
        )
    return value


def _admitted(context: click.Context, option: click.Parameter, texts: tuple[str, ...]) -> tuple[str, ...]:
    """Errors of sensors, of the kinds that are listed in the help."""
    kinds = comma_separated(context, option, texts)
    for kind in kinds:
        if kind not in _KINDS:
            raise click.UsageError(f'unknown error of a sensor "{kind}"; choose from {", ".join(_KINDS)}.')
    return kinds


def refuse_foreign_calibration(calibration: Mapping[str, float], record: lw.Record) -> None:
    """Raise UsageError for a calibration of a channel that `record` lacks, or of a size that none has."""
    if not calibration:
        return
    try:
        priors.require_calibration(record, calibration)
    except lw.IdentificationError as error:
        raise click.UsageError(f"--calibration: {error}.") from error


def sensor_options(remark: str = "") -> tuple[Callable[[Any], Any], ...]:
    """The options, with a `remark` at the end of what each does."""
    return (
        click.option(
            "--calibration",
            metavar="CHANNEL=PERCENT%",
            multiple=True,
            callback=_calibration,
            help="Uncertainty of the gain of a sensor or an applied force; all= for each sensor of a response, also of the "
            "force in a link, common= for a factor that these share"
            f"{remark}. Repeatable.",
        ),
        click.option(
            "--let",
            "admit",
            metavar=",".join(_KINDS),
            multiple=True,
            callback=_admitted,
            help=f"Errors of sensors that are added to the model if the diagnosis names them{remark}.",
        ),
    )
