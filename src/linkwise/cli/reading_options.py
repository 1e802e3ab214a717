"""Where a record comes from and how it is read: options that every command with records has."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from math import isinf
from pathlib import Path
from typing import Any

import click
from click import UsageError

import linkwise as lw
from linkwise.cli.console import note
from linkwise.cli.options import (
    FILE,
    POSITIVE,
    comma_separated,
    file_and_column,
    grouped,
    header_line,
    pairs,
    quantity,
    typed,
)
from linkwise.display import near_miss
from linkwise.files.mapping import channel_of
from linkwise.files.table_to_record import IGNORED
from linkwise.model import link
from linkwise.signals.force_window import with_force_windows
from linkwise.verdict import Basis

_BY_WIDTH = -1.0  # of --force-window without a time, which none below 0 is
_FITTED = {"drift": ("drifts", "s"), "hum": ("hums", "Hz"), "corner": ("corners", "Hz")}
"""Errors of sensors that a fit alone knows: fields of its options, and the units of what is typed of them."""
_ERRORS = ("offset", "gain", "delay", "noise", *_FITTED)


@dataclass(frozen=True)
class ReadingOptions:
    """How to read the file of a record.

    Parameters
    ----------
    channel : tuple[str, ...]
        The column that holds a channel, as in x:m1=Laser1 or x:m1[mm]=Laser1; it may be in another file that was
        started at the same time, as in a:base=ground.csv:AccX, and times in one with a time for each row, as in
        time=clock.csv:Time. Repeatable.
    by_time : bool
        Join the files of --channel NAME=FILE:COLUMN by their times instead of by their first samples.
    then : tuple[Path, ...]
        A file that continues the record, read with the same options. Repeatable.
    mapping : Path | None
        A file that states columns, units, masses, calibration, noise, offsets and delays once, for all records of a
        test; other options take precedence over it. inspect --write-mapping FILE writes a first one.
    header : str | int | None
        The header line of a text file, if it is not found: its number, or text that it contains.
    rate : float | None
        Sampling rate of a file without a time column.
    resample : float | None
        Resample unevenly spaced samples to this rate.
    decimate : int | None
        Keep every N-th sample, after an anti-alias filter.
    start : float | None
        Use the record from this time on.
    stop : float | None
        Use the record up to this time.
    period : float | None
        Average a periodic test over periods of this length; their scatter gives the noise.
    mark_missing : tuple[str, ...]
        Treat samples with these faults as missing: clipped, spikes.
    force_window : float | None
        Take each force of a hammer as 0 but from S before to S behind its hits (default: a quarter of their width). Forces
        that are quiet between hits, beside white noise, get such a window by themselves.
    sensor : tuple[str, ...]
        Errors of a channel's sensor, as in x:m1:offset=+-0.1mm,gain=1%,noise=0.1mm. An offset, gain or delay with a
        size is known and removed; one to within +- a standard deviation, as a gain of 1%, is estimated by identify and
        discover, as is one without a size, drift[=LENGTH OF PIECES], hum=HZ and corner[=HZ] of a high pass. Repeatable.
    delay : tuple[str, ...]
        Short for --sensor CHANNEL:delay[=TIME], the time by which a channel is late. Repeatable.
    interpolation : tuple[str, ...]
        How an input behaves between its samples: held, linear or band-limited (default). Repeatable.
    """

    channel: tuple[str, ...] = typed("NAME=COLUMN", multiple=True)
    by_time: bool = typed(is_flag=True)
    then: tuple[Path, ...] = typed("FILE", type=FILE, multiple=True)
    mapping: Path | None = typed("FILE", type=FILE)
    header: str | int | None = typed("LINE", callback=header_line)
    rate: float | None = typed("HZ", type=POSITIVE)
    resample: float | None = typed("HZ", type=POSITIVE)
    decimate: int | None = typed("N", type=click.IntRange(min=1))
    start: float | None = typed("S", "--from", type=float)
    stop: float | None = typed("S", "--to", type=float)
    period: float | None = typed("S", type=POSITIVE)
    mark_missing: tuple[str, ...] = typed("KINDS", multiple=True, callback=comma_separated)
    force_window: float | None = typed("[S]", type=float, is_flag=False, flag_value=_BY_WIDTH)
    sensor: tuple[str, ...] = typed("CHANNEL:ERROR[=SIZE],...", multiple=True)
    delay: tuple[str, ...] = typed("CHANNEL[=TIME]", multiple=True)
    interpolation: tuple[str, ...] = typed("CHANNEL=KIND", multiple=True)

    def read_file(self, path: Path, masses: tuple[str, ...] | None, *, informative: bool = True) -> lw.Record:
        """The record in `path`, cut to the asked time; RecordError names file, line and channel.

        `masses` are those there are, if that is known. Without `informative` dead and duplicated channels are read.
        """
        whole = self.record_mapping()
        late = {name: one.delay.value for name, one in whole.sensors.items() if one.delay is not None}
        mappings = self._mappings_by_file(whole)
        times = {key: column for key, column in mappings[None].channels.items() if channel_of(key) == "time"}

        def read(file: Path | None, mapping: lw.files.RecordMapping) -> lw.Record:
            return lw.read_record(file or path, known_masses=masses, informative=informative, mapping=mapping)

        def read_other(file: Path | None, mapping: lw.files.RecordMapping) -> lw.Record:
            try:  # instruments that were started together name their columns alike
                return read(file, replace(mapping, channels={**times, **mapping.channels}))
            except lw.RecordError:
                separate = read(file, mapping)
                for column in list(times.values())[:1]:
                    note(f"{file} has no times in the column {column}: its own times are used.")
                return separate

        record = read(None, mappings[None])
        others = [read_other(file, mapping) for file, mapping in mappings.items() if file is not None]
        if self.by_time and not others:
            raise UsageError("--by-time joins the files of --channel NAME=FILE:COLUMN, but none is given.")
        for part in self.then:
            record = lw.records.continued(record, read(part, mappings[None]))
        join = lw.records.joined_by_time if self.by_time else lw.records.beside
        record = lw.inspection.mark_missing(reduce(join, others, record), self.mark_missing)
        record = lw.records.without_delays(record, {name: delay for name, delay in late.items() if delay})
        if whole.decimate is not None:
            record = record.decimate(whole.decimate)
        if self.start is not None or self.stop is not None:
            start = record.start if self.start is None else self.start
            stop = record.start + record.duration if self.stop is None else self.stop
            record = record.between(start, stop)
        if self.force_window is not None:
            margin = None if self.force_window == _BY_WIDTH else self.force_window
            record = with_force_windows(record, margin, required=True)
        return record if self.period is None else lw.records.average_periods(record, self.period)

    def record_mapping(self) -> lw.files.RecordMapping:
        """What the options state, and the mapping file beside them."""
        channels = {name: column for name, (file, column) in self._columns().items() if file is None}
        stated = {name: getattr(self, name) for name in ("rate", "resample", "decimate", "header")}
        own = lw.files.RecordMapping(channels, self._sensors(), **stated)
        return own if self.mapping is None else own.over(lw.files.read_mapping(self.mapping))

    def masses_beside(self, structure: lw.Structure) -> list[str]:
        """Sentences on masses that the mapping file states and the structure has otherwise or not; the structure counts."""
        sentences = []
        for name, mass in self.record_mapping().masses.items():
            if name not in structure.mass_names:
                without = "which the structure does not have; it is not used"
                sentences.append(f"The mapping file states a mass {name}, {without}.")
            elif mass != "unknown":
                own, stated = structure.mass(name), lw.Mass(name, *link.mass_in_si(mass))
                if own.mass.known and (own.mass.value, own.unit) != (stated.mass.value, stated.unit):
                    there, here = (f"{mass.mass.value} {mass.mass_unit}" for mass in (stated, own))
                    sentences.append(
                        f"{name} weighs {there} in the mapping file and {here} in the structure, which counts."
                    )
        return sentences

    def beside_errors(self, options: Mapping[str, Any]) -> dict[str, Any]:
        """The `options` of a fit, and beside them the errors of sensors that a fit alone knows: sizes by channel, by field."""
        fitted: dict[str, Any] = {}
        for channel, kind, size in self._errors:
            if kind in _FITTED:
                field, unit = _FITTED[kind]
                known = quantity(size, unit, f"--sensor {channel}:{kind}") if size else None
                sizes = fitted.setdefault(field, {})
                sizes[channel] = (*sizes.get(channel, ()), known) if kind == "hum" else known
        merged = {name: {**sizes, **options.get(name, {})} for name, sizes in fitted.items()}
        return {**options, **merged}

    def removed_errors(self, record: lw.Record) -> dict[str, list[str]]:
        """The kinds of errors, by channel of `record`, that options state with a size, and that it is without."""
        removed: dict[str, list[str]] = {}
        sensors = self._sensors()
        for channel, kind, _ in self._errors:
            known = getattr(sensors[channel], kind) if kind != "noise" else None
            if known and channel in record.channels and (known.value != (kind == "gain") or not known.sigma):
                removed.setdefault(channel, []).append(kind)
        return removed

    def refuse_unknown_errors(self) -> None:
        """Raise UsageError for an error of a sensor of which nothing is known."""
        sensors = self._sensors()
        for channel, kind, size in self._errors:
            fitted = kind in _FITTED  # of which no statement of a sensor says anything
            if fitted or isinf(getattr(sensors[channel].uncertainty, kind, 0.0)):
                raise UsageError(
                    f"--sensor {channel}:{kind}{size and f'={size}'}: identify by maximum likelihood finds this {kind}; here "
                    "leave it out, or state a size that is known, as in --sensor x:m1:offset=0.3mm,gain=1.02,delay=2ms."
                )

    @cached_property
    def _errors(self) -> tuple[tuple[str, str, str], ...]:
        """Channel, kind and size as typed, empty for one to be found, of the errors of sensors that options state; UsageError
        for anything else, and for a kind, other than hums, that is stated twice of a channel.
        """
        late = [text.partition("=") for text in self.delay]
        texts = (*self.sensor, *(f"{channel}:delay{sign}{size}" for channel, sign, size in late))
        errors = [error for text in texts for error in _of_sensor(text)]
        places = [error[:2] for error in errors if error[1] != "hum"]
        for channel, kind in places:
            if places.count((channel, kind)) > 1:
                raise UsageError(f"--sensor {channel}:{kind}: the {kind} of {channel} is given twice.")
        return tuple(errors)

    def _mappings_by_file(self, whole: lw.files.RecordMapping) -> dict[Path | None, lw.files.RecordMapping]:
        """The mapping of the record's own file, and of each that was started with it; delays are taken out later."""
        elsewhere: dict[Path, dict[str, str | int]] = {}
        for name, (file, column) in self._columns().items():
            if file is not None:
                elsewhere.setdefault(file, {})[name] = column
        theirs = {channel_of(name) for columns in elsewhere.values() for name in columns}
        sensors = dict(whole.sensors)
        for name, sensor in whole.sensors.items():
            if sensor.delay is not None:
                sensors[name] = replace(sensor, delay=lw.records.StatedError(0.0, sensor.delay.sigma))
        columns = {key: column for key, column in whole.channels.items() if channel_of(key) not in theirs}
        own = {name: sensor for name, sensor in sensors.items() if name not in theirs}
        mapping = replace(whole, decimate=None, channels=columns, sensors=own)
        mappings: dict[Path | None, lw.files.RecordMapping] = {None: mapping}
        for file, named in elsewhere.items():
            own = {name: sensor for name, sensor in sensors.items() if name in map(channel_of, named)}
            mappings[file] = replace(mapping, channels=named, sensors=own)
        return mappings

    def _columns(self) -> dict[str, tuple[Path | None, str]]:
        columns = pairs(self.channel, "--channel", "x:m1=COLUMN").items()
        times = {name: (None, text) for name, text in columns if channel_of(name) == "time"}
        return {name: times.get(name) or file_and_column(text) for name, text in columns}

    def _sensors(self) -> dict[str, lw.records.SensorStatement]:
        """What the options state of sensors; UsageError for a text that does not say it."""
        sensors: dict[str, lw.records.SensorStatement] = {}
        nothing = lw.records.SensorStatement()
        for name, kind, size in self._errors:
            if kind not in _FITTED:
                try:
                    stated = lw.records.SensorStatement.of({kind: size or "unknown"}, name)
                except lw.RecordError as error:
                    reason = error.__cause__ or error  # without the key, which the option names
                    raise UsageError(f"--sensor {name}:{kind}={size}: {reason}") from error
                sensors[name] = stated.over(sensors.get(name, nothing))
        for name, run in pairs(self.interpolation, "--interpolation", "force:m1=held").items():
            sensors[name] = replace(sensors.get(name, nothing), interpolation=run)
        return sensors


def _of_sensor(text: str) -> Iterator[tuple[str, str, str]]:
    """Channel, kind and size of the errors in CHANNEL:ERROR[=SIZE],...; UsageError for anything else."""
    channel = re.split("[,=]", text, maxsplit=1)[0].rpartition(":")[0]
    for part in text[len(channel) + 1 :].split(",") if channel else [text]:
        kind, sign, size = (word.strip() for word in part.partition("="))
        if kind not in _ERRORS or not channel or (not size and (sign or kind in ("noise", "hum"))):
            raise UsageError(
                f"--sensor {text!r} is not CHANNEL:ERROR[=SIZE],..., as in x:m1:offset=+-0.1mm,gain=1%,hum=50Hz, with errors "
                f"that are {', '.join(_ERRORS)}, noise and hum with a size{near_miss(kind, _ERRORS)}"
            )
        yield channel.strip(), kind, size


@dataclass(frozen=True, kw_only=True)
class RecordOptions(ReadingOptions):
    """A record's file and how to read it: the answers to the options of `record_options`."""

    record: Path

    def read(self, masses: tuple[str, ...]) -> lw.Record:
        """The record, cut to the asked time; RecordError names file, line and channel. `masses` are those there are."""
        record = self.read_file(self.record, masses)
        note(*record.notes)
        return record

    def read_motion_of(self, structure: lw.Structure) -> lw.Record:
        """The record of what this structure has, its notes told; and unknown coefficients that have a column of their name."""
        record = self.read(tuple(dict.fromkeys((*structure.places, *structure.mass_names))))
        unread = next((told for told in record.notes if told.startswith(IGNORED)), "")
        columns = unread.removeprefix(IGNORED).rstrip(".").split(", ")
        for parameter in structure.parameters:
            if (name := parameter.name.rpartition(".")[2]) in columns:
                unit = parameter.unit.replace("?", "UNIT")
                note(
                    f"{parameter.name} is unknown, and a column is named {name}. If it was recorded, it is a signal: leave it "
                    f'out of the coefficients, write signals = {{ {name} = "{unit}" }} at the top of the structure file, and '
                    f"give --channel signal:{name}={name}."
                )
        return record


record_options = grouped(RecordOptions, "source", click.argument("record", type=FILE))
records_argument = click.argument("records", metavar="RECORD...", nargs=-1, required=True, type=FILE)


def read_told(path: Path) -> lw.Structure:
    """The structure of a file; notes on it and its hosts go to standard error."""
    subject = lw.read_structure(path)
    tell_grade(path)
    tell_of_hosts(subject.hosts)
    return subject


def tell_grade(path: Path) -> None:
    """Say what the answer is worth that a structure comes from."""
    if remark := Basis.stated_in(path).remark:
        note(f"{path}: {remark}")


def tell_of_hosts(hosts: Iterable[lw.Host]) -> None:
    """Print what there is to know of hosts, such as the error of a reduction, on standard error."""
    for host in hosts:
        note(*(f"{host.name}: {remark}" for remark in host.notes))
