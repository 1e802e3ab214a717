"""TDMS, the format of LabVIEW: channels in groups, time often as a start and a step."""

from __future__ import annotations

import logging
import struct
from pathlib import Path

import nptdms
import numpy as np
from nptdms.log import log_manager

from linkwise.errors import RecordError
from linkwise.files.table import Column, Table

_TAG = b"TDSm"
_LEAD_IN = struct.Struct("<12xQ8x")
"""Tag, contents, version; length of the segment behind the lead-in, and of its metadata."""
_UNKNOWN = 2**64 - 1
_UNITS = ("unit_string", "NI_UnitDescription", "unit")


def read_table(path: Path) -> Table:
    """All channels as `group/channel`; see `files.read_record`.

    The rate follows from the sampling interval of the channels (`wf_increment`) if it is the same for all; otherwise the file
    needs a time channel.
    """
    notes = _check_segments(path)
    level = log_manager.log_level
    log_manager.set_level(logging.ERROR)  # of texts that cannot be decoded it writes all that follows them
    try:
        content = nptdms.TdmsFile.read(path)
    finally:
        log_manager.set_level(level)
    columns, rates, starts = [], [], []
    for group in content.groups():
        for channel in group.channels():
            header = f"{group.name}/{channel.name}{_unit(channel)}"
            columns.append(Column.of(header, np.asarray(channel[:])))
            increment = channel.properties.get("wf_increment")
            if increment:
                rates.append(1.0 / float(increment))
                starts.append(float(channel.properties.get("wf_start_offset", 0.0)))
    stated = len(set(zip(rates, starts, strict=True))) == 1
    return Table(
        tuple(columns), start=starts[0] if stated else 0.0, rate=rates[0] if stated else None, notes=notes
    )


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
        raise RecordError(
            f"{start - size} bytes are missing at its end; the file was cut off or is damaged", path
        )
    return ()


def _unit(channel: nptdms.TdmsChannel) -> str:
    """The unit of a channel in brackets, as in a column header, unless its name ends with it."""
    unit = next((str(channel.properties[name]) for name in _UNITS if channel.properties.get(name)), "")
    return f"[{unit}]" if unit and not channel.name.rstrip().endswith((")", "]")) else ""
