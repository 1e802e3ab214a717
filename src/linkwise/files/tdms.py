"""TDMS, the format of LabVIEW: channels in groups, time often as a start and a step."""

from __future__ import annotations

from pathlib import Path

import nptdms
import numpy as np

from linkwise.files.table import Column, Table

_UNITS = ("unit_string", "NI_UnitDescription", "unit")


def read_table(path: Path) -> Table:
    """All channels as `group/channel`; see `files.read_record`.

    The rate follows from the sampling interval of the channels (`wf_increment`) if it is the same for all; otherwise the file
    needs a time channel.
    """
    content = nptdms.TdmsFile.read(path)
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
    return Table(tuple(columns), start=starts[0] if stated else 0.0, rate=rates[0] if stated else None)


def _unit(channel: nptdms.TdmsChannel) -> str:
    """The unit of a channel in brackets, as in a column header, unless its name ends with it."""
    unit = next((str(channel.properties[name]) for name in _UNITS if channel.properties.get(name)), "")
    return f"[{unit}]" if unit and not channel.name.rstrip().endswith((")", "]")) else ""
