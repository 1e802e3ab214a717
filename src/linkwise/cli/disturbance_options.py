"""Options for what sensors add to their signals over time: slow drift, and hum of the mains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import click

import linkwise as lw
from linkwise.cli.options import quantity, split
from linkwise.registry import lazy_module

if TYPE_CHECKING:
    from linkwise.likelihood.shooting import waveforms
else:
    waveforms = lazy_module("linkwise.likelihood.shooting.waveforms")  # for those who state a drift or a hum


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
