"""Options of commands that run a test on a structure: what drives it, and what is recorded."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

import linkwise as lw
from linkwise import files
from linkwise.cli.options import (
    POSITIVE,
    file_and_column,
    grouped,
    is_file,
    number,
    numbers,
    pairs,
    split,
    typed,
)
from linkwise.records.sample_checks import require_complete


@dataclass(frozen=True)
class ExcitationOptions:
    """What sets a structure in motion.

    Parameters
    ----------
    release : tuple[str, ...]
        Start with this displacement (x:m1=0.01, in m, of what turns in rad) or velocity (v:m1=1.0, in m/s or rad/s).
        Repeatable.
    impulse : tuple[str, ...]
        Impulse on a mass: momentum in N s, of what turns in N m s, at a time in s (default 0). Repeatable.
    force : tuple[str, ...]
        Force in N, on what turns in N m: an expression of t ("0.5*sin(2*pi*3*t)") or FILE:COLUMN. Repeatable.
    base : str | None
        Base displacement in m: an expression of t, FILE:COLUMN, or a FILE with x:base, or with v:base or a:base,
        which are integrated from rest.
    signal : tuple[str, ...]
        A signal that laws name, in its SI unit: an expression of t or FILE:COLUMN. Repeatable.
    """

    release: tuple[str, ...] = typed("CHANNEL=VALUE", multiple=True)
    impulse: tuple[str, ...] = typed("MASS=NS[@S]", multiple=True)
    force: tuple[str, ...] = typed("MASS=FORCE", multiple=True)
    base: str | None = typed("MOTION")
    signal: tuple[str, ...] = typed("NAME=SIGNAL", multiple=True)

    def keywords(self) -> dict[str, Any]:
        """Keyword arguments of `linkwise.simulate`; raises UsageError and the errors of reading a drive's file."""
        forces = pairs(self.force, "--force", 'm1="sin(2*pi*3*t)"')
        signals = pairs(self.signal, "--signal", 'u="2*sin(2*pi*3*t)"')
        return {
            "release": numbers(self.release, "--release", "v:m1=1.0"),
            "impulses": tuple(_impulse(text) for text in self.impulse),
            "forces": {mass: _time_function(value, f"force:{mass}") for mass, value in forces.items()},
            "base": None if self.base is None else _base_motion(self.base),
            "signals": {name: _time_function(value, f"signal:{name}") for name, value in signals.items()},
        }


def harmonic_excitation(force: Iterable[str], base: Iterable[str], hz: tuple[float, float]) -> dict[str, Any]:
    """Keyword arguments of `ResponseOptions` for amplitudes of forces, MASS=N, and of the base, x|v|a=SIZE."""
    sizes = {"force": numbers(force, "--force", "m1=0.5"), "base": numbers(base, "--base", "a=9.81")}
    return {"hz": hz, **{name: own or None for name, own in sizes.items()}}


def _impulse(text: str) -> lw.model.Impulse:
    """`MASS=MOMENTUM` or `MASS=MOMENTUM@TIME`, in N s and s."""
    usage = "--impulse", "m1=0.3@0.5"
    mass, value = split(text, *usage)
    momentum, _, time = value.partition("@")
    return lw.model.Impulse(mass, number(momentum, *usage), number(time or "0", *usage))


def _time_function(text: str, channel: str) -> lw.model.TimeFunction | lw.model.Sampled:
    """An expression of t, or samples: `FILE` with that channel, or `FILE:COLUMN`."""
    path, column = file_and_column(text)
    if path is None and not is_file(Path(text)):
        if file := _meant_file(text):
            lw.read_record(file)  # which says that it is not there, and what is
        return lw.model.TimeFunction(text)
    record = _drive(path or Path(text), {channel: column} if path is not None else {})
    return _sampled(record, channel, path or Path(text))


def _meant_file(text: str) -> str:
    """The file that was meant by a text that names none there is: no expression has a colon, or ends as a file does."""
    file, colon, _ = text.partition(":")
    return file if colon or Path(file).suffix.lower() in files.FORMATS else ""


def _drive(file: Path, channels: Mapping[str, str]) -> lw.Record:
    """The record of a drive; UsageError, which says how its columns are stated, where they are not recognised."""
    try:
        return lw.read_record(file, channels=channels)
    except lw.RecordError as error:
        if not error.arguments:
            raise
        raise click.UsageError(
            f"{error}. In the file of a drive the time is the column `time` (or `time[ms]`); its values are named as in "
            f"{file}:COLUMN."
        ) from error


def _sampled(record: lw.Record, channel: str, file: Path) -> lw.model.Sampled:
    """The samples of a channel; RecordError where the record of a drive lacks it, IdentificationError where it has gaps."""
    if channel not in record.channels:
        message = f"has no channel {channel}, but {', '.join(record.channels)}; name the column of it, as in {file}:COLUMN"
        raise lw.RecordError(message, file)
    require_complete(channel, record.channel(channel), record.start, record.rate)
    return lw.model.Sampled(record.start, record.rate, record.channel(channel))


def _base_motion(text: str) -> lw.model.TimeFunction | lw.model.Sampled:
    """As `_time_function`; from a file with the velocity or the acceleration alone, its integral from rest."""
    if not is_file(Path(text)):
        return _time_function(text, "x:base")
    record = _drive(Path(text), {})
    channel = next(iter(record.motions_of("base")), lw.records.Channel("x", "base"))
    signal = _sampled(record, channel, Path(text))
    for _ in range(channel.order):
        signal = lw.model.Sampled(signal.start, signal.rate, signal.integral(record.time))
    return signal


drive_options = grouped(ExcitationOptions, "drive")


@dataclass(frozen=True)
class SamplingOptions:
    """Length, rate and sensors of a record.

    Parameters
    ----------
    duration : float
        Length of the record in s.
    rate : float
        Samples per second.
    sensors : str
        Kinds (x,v,a,rel:x) or channels (x:m1,a:m2,a:base).
    """

    duration: float = typed("S", type=POSITIVE, required=True)
    rate: float = typed("HZ", type=POSITIVE, required=True)
    sensors: str = typed("LIST", default="x", show_default=True)

    def keywords(self) -> dict[str, Any]:
        """Keyword arguments of `linkwise.simulate`."""
        sensors = tuple(kind.strip() for kind in self.sensors.split(","))
        return {"duration": self.duration, "rate": self.rate, "sensors": sensors}
