"""Options of `identify` and `discover` for what is found with the laws: errors of sensors, drift and hum, random forces."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import click

import linkwise as lw
from linkwise.cli.options import comma_separated, pairs, quantity, split
from linkwise.registry import lazy_module

if TYPE_CHECKING:
    from linkwise.likelihood import random_forces
    from linkwise.likelihood import sensor_priors as priors
    from linkwise.likelihood.shooting import waveforms
    from linkwise.records import channel as channels
else:
    priors = lazy_module("linkwise.likelihood.sensor_priors")  # for those who state a calibration
    waveforms = lazy_module("linkwise.likelihood.shooting.waveforms")  # for those who state a drift or a hum
    random_forces = lazy_module("linkwise.likelihood.random_forces")  # for those who state one
    channels = lazy_module("linkwise.records.channel")


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


def refuse_foreign_disturbances(
    drifts: Mapping[str, float | None], hums: Mapping[str, tuple[float, ...]], records: Sequence[lw.Record]
) -> None:
    """Raise UsageError for a drift or a hum of a channel that no record has, or that none can have."""
    if not drifts and not hums:
        return
    try:
        waveforms.Disturbance.of(drifts, hums, records)
    except lw.IdentificationError as error:
        raise click.UsageError(f"{error}.") from error


def _drifts(
    context: click.Context, option: click.Parameter, texts: tuple[str, ...]
) -> dict[str, float | None] | None:
    """Channels, and the time of a piece in s where one is stated."""
    drifts: dict[str, float | None] = {}
    for text in texts:
        name, value = split(text, "--drift", "x:m1=2s") if "=" in text else (text.strip(), None)
        if name in drifts:
            raise click.UsageError(f"--drift is given twice for {name!r}.")
        drifts[name] = None if value is None else _quantity("--drift", text, value, "s")
    return drifts or None


def _hums(
    context: click.Context, option: click.Parameter, texts: tuple[str, ...]
) -> dict[str, tuple[float, ...]] | None:
    """Frequencies in Hz by channel."""
    hums: dict[str, tuple[float, ...]] = {}
    for text in texts:
        name, value = split(text, "--hum", "x:m1=50Hz")
        hums[name] = (*hums.get(name, ()), _quantity("--hum", text, value, "Hz"))
    return hums or None


def _quantity(option: str, text: str, value: str, unit: str) -> float:
    try:
        return quantity(value, unit)
    except lw.LinkwiseError as error:
        raise click.UsageError(f"{option} {text}: {error}") from error


DISTURBANCE_OPTIONS = (
    click.option(
        "--drift",
        "drifts",
        metavar="CHANNEL[=TIME]",
        multiple=True,
        callback=_drifts,
        help="Estimate a slow drift of this channel with the laws, piecewise linear with pieces of this length; by "
        "default 8 pieces (ml). "
        "Repeatable.",
    ),
    click.option(
        "--hum",
        "hums",
        metavar="CHANNEL=HZ",
        multiple=True,
        callback=_hums,
        help="Estimate a hum of this frequency in the channel, its amplitude and phase, with the laws (ml). "
        "Repeatable.",
    ),
)


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
        return lw.files.to_si(text, unit)
    except lw.LinkwiseError as error:
        raise click.UsageError(f"{option} {text!r}: {error}") from error


def _unit_of_channel(name: str) -> str:
    """The SI unit of an input; N if the name is not a channel, which the estimator reports."""
    try:
        return channels.Channel.parse(name).unit
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
