"""TDMS, the format of LabVIEW: channels in groups, time often as a start and a step."""

from __future__ import annotations

import logging
import re
import struct
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import nptdms
import numpy as np
from nptdms.log import log_manager
from nptdms.scaling import get_scaling

from linkwise.errors import RecordError
from linkwise.files.table import Column, Table

_TAG = b"TDSm"
_LEAD_IN = struct.Struct("<12xQ8x")
"""Tag, contents, version; length of the segment behind the lead-in, and of its metadata."""
_UNKNOWN = 2**64 - 1
_SCALE = re.compile(r"NI_Scale\[\d+\]_Scale_Type")
_GIVES = {"Strain": "a strain"} | dict.fromkeys(("RTD", "Thermistor", "Thermocouple"), "a temperature")
_SHOWN = 200  # characters of what nptdms tells
_UNITS = ("unit_string", "NI_UnitDescription", "unit")


def read_table(path: Path) -> Table:
    """All channels as `group/channel`; see `files.read_record`.

    The rate follows from the sampling interval of the channels (`wf_increment`) if it is the same for all; otherwise the file
    needs a time channel.
    """
    notes = _check_segments(path)
    columns, rates, starts = [], [], []
    with _told() as remarks:
        content = nptdms.TdmsFile.read(path)
        for group in content.groups():
            for channel in group.channels():
                properties = channel.properties, group.properties, content.properties
                notes += _check_scales(channel.name, properties, path)
                header = f"{group.name}/{channel.name}{_unit(channel)}"
                columns.append(Column.of(header, np.asarray(channel[:])))
                increment = channel.properties.get("wf_increment")
                if increment:
                    rates.append(1.0 / float(increment))
                    starts.append(float(channel.properties.get("wf_start_offset", 0.0)))
    stated = len(set(zip(rates, starts, strict=True))) == 1
    start = starts[0] if stated else 0.0
    return Table(tuple(columns), start=start, rate=rates[0] if stated else None, notes=(*notes, *remarks))


class _Remarks(logging.Handler):
    """Keeps what a library logs, once each; of a text that cannot be decoded nptdms writes all that follows it."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.texts: dict[str, None] = {}

    def emit(self, record: logging.LogRecord) -> None:
        self.texts[f"nptdms: {' '.join(record.getMessage().split())[:_SHOWN]}"] = None


@contextmanager
def _told() -> Iterator[Iterable[str]]:
    """What nptdms logs within, in place of its own lines on standard error."""
    remarks = _Remarks()
    loggers = {logger: logger.handlers for logger in log_manager.loggers.values()}
    for logger in loggers:
        logger.handlers, logger.propagate = [remarks], False
    try:
        yield remarks.texts
    finally:
        for logger, handlers in loggers.items():
            logger.handlers, logger.propagate = handlers, True


def _check_scales(name: str, properties: tuple[Mapping[str, Any], ...], path: Path) -> tuple[str, ...]:
    """Notes on scales of a channel that give neither a motion nor a force.

    Raises RecordError for a scale that nptdms does not know, of which it gives the counts. `properties` are those of the
    channel, its group and the file: the first that state scales count.
    """
    for stated in properties:
        kinds = [str(kind) for key, kind in stated.items() if _SCALE.fullmatch(key)]
        if not kinds or stated.get("NI_Scaling_Status") == "scaled":
            continue
        if get_scaling(stated, {}, {}) is None:
            raise RecordError(
                f"the samples of {name!r} are counts, which a scale of the kind {', '.join(kinds)} turns into its unit, and "
                "such scales cannot be read here: let LabVIEW store scaled values, or export them from there as LVM or CSV",
                path,
            )
        return tuple(
            f"{name} holds {_GIVES[kind]}, as its scale of the kind {kind} gives it, whatever its unit says: it is neither a "
            "motion nor a force."
            for kind in kinds
            if kind in _GIVES
        )
    return ()


def _check_segments(path: Path) -> tuple[str, ...]:
    """A note on a last segment that the program that wrote it could not end; nptdms reads what there is of it.

    Raises RecordError for a segment that ends behind the file or not where the next one begins: nptdms would stop there.
    """
    size, start = path.stat().st_size, 0
    with path.open("rb") as file:
        while start < size:
            file.seek(start)
            lead_in = file.read(_LEAD_IN.size)
            if len(lead_in) < _LEAD_IN.size or not lead_in.startswith(_TAG):
                if not start:
                    return ()  # nptdms says what it expects of a file
                raise RecordError(f"is not a TDMS file from byte {start} on; the file is damaged", path)
            (length,) = _LEAD_IN.unpack(lead_in)
            if length == _UNKNOWN:
                return ("The last segment of the file has no end: the program that wrote it has crashed.",)
            start += _LEAD_IN.size + length
    if start > size:
        lacking = f"{start - size} bytes are missing at its end"
        raise RecordError(f"{lacking}; the file was cut off or is damaged", path)
    return ()


def _unit(channel: nptdms.TdmsChannel) -> str:
    """The unit of a channel in brackets, as in a column header, unless its name ends with it."""
    unit = next((str(channel.properties[name]) for name in _UNITS if channel.properties.get(name)), "")
    return f"[{unit}]" if unit and not channel.name.rstrip().endswith((")", "]")) else ""
