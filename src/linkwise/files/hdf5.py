"""HDF5: one data set per column, named by its channel, with its unit as an attribute.

Files written by linkwise hold `time` and one data set per channel at the root, each with the attribute `unit` and, where
stated, `noise` and `interpolation`; the root has the attributes `format`, `version`, `start`, `rate`, `source`, `notes` and,
where errors of sensors are known to within, `sensors`, a JSON text. Any other file can be read whose data sets, in any group,
have such names or are mapped to them; texts in their attributes `calibration`, `gain`, `offset` and `delay` say what is known
of the sensor.
"""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Iterator
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from linkwise.errors import RecordError
from linkwise.files.arrays import Unread, columns_of
from linkwise.files.mapping import as_statements, sensors_of, stated_in, with_attributes
from linkwise.files.table import Table
from linkwise.records.channel import STORED
from linkwise.records.record import Record

FORMAT = "linkwise record"
VERSION = 1
_ENTRY = struct.Struct("<H6xQ")  # of a global heap: index, and bytes that follow
_UNITS = ("unit", "units", "Unit", "Units")


def read_table(path: Path) -> Table:
    """All numeric data sets of the file; see `files.read_record`."""
    if not h5py.is_hdf5(path):
        raise RecordError("is not an HDF5 file, despite its suffix", path)
    with open_file(path) as file:
        if file.attrs.get("format") == FORMAT and int(file.attrs.get("version", 0)) > VERSION:
            version = file.attrs["version"]
            message = f"was written by a later version of linkwise (layout {version}; this version reads up to {VERSION})"
            raise RecordError(message, path)
        tree: dict[str, Any] = {}
        stored: dict[str, dict[str, Any]] = {kind: {} for kind in STORED}
        attributes: dict[str, dict[str, object]] = {}
        for name, item in _data_sets(file):
            if isinstance(item, Unread):
                tree[name] = item
                continue
            tree[f"{name}{_bracketed_unit(item)}"] = None if item.shape is None else np.asarray(item[()])
            for kind in STORED.keys() & item.attrs.keys():
                stored[kind][name] = STORED[kind].stored(item.attrs[kind])
            attributes[name] = stated_in(item.attrs)
        rate = file.attrs.get("rate")
        stated = {name: file.get(name) for name in file.attrs.get("channels", ())}
        order = [name if item is None else f"{name}{_bracketed_unit(item)}" for name, item in stated.items()]
        columns = columns_of({**{name: tree.get(name, Unread("missing")) for name in order}, **tree})
        return Table(
            with_attributes(columns, attributes),
            start=float(file.attrs.get("start", 0.0)),
            rate=None if rate is None else float(rate),
            notes=tuple(str(note) for note in np.atleast_1d(file.attrs.get("notes", ()))),
            source=str(file.attrs.get("source", "")),
            stored=stored,
            sensors=as_statements(file.attrs.get("sensors"), path),
        )


def open_file(path: Path) -> h5py.File:
    """The file for reading; ValueError for one in which libhdf5, as of 2.0, would go on without end.

    It does where an entry of a global heap, in which texts stand, is free space (index 0) of no bytes.
    """
    with path.open("rb") as file, mmap(file.fileno(), 0, access=ACCESS_READ) as content:
        for heap in re.finditer(rb"GCOL\x01\0\0\0(.{8})", content, re.DOTALL):
            position, end = heap.end(), min(heap.start() + int.from_bytes(heap[1], "little"), len(content))
            while position + _ENTRY.size <= end:
                index, size = _ENTRY.unpack_from(content, position)
                if index == size == 0:
                    where = f"the texts that begin at byte {heap.start()}"
                    raise ValueError(f"{where} have no end; the file is damaged")
                position += _ENTRY.size + -(-size // 8) * 8 if index else size
    return h5py.File(path, "r")


def _data_sets(file: h5py.File) -> Iterator[tuple[str, h5py.Dataset | Unread]]:
    """All data sets with their paths, in the order of names, groups where they stand; links that lead to none as unread."""
    pending: list[tuple[str, Any]] = [("", file)]
    entered = set()
    while pending:
        path, item = pending.pop()
        if not isinstance(item, h5py.Group):
            yield path, item
            continue
        address = h5py.h5o.get_info(item.id).addr
        if address in entered:  # a group that contains itself, or stands in two places
            continue
        entered.add(address)
        prefix = f"{path}/" if path else ""
        members = [(f"{prefix}{name}", _member(item, name)) for name in item]
        pending += [(name, member) for name, member in reversed(members) if member is not None]


def _member(group: h5py.Group, name: str) -> h5py.Group | h5py.Dataset | Unread | None:
    """What stands under a name of a group; None for what holds no data."""
    if isinstance(group.get(name, getlink=True), h5py.ExternalLink):
        return Unread("a link into another file")
    item = group.get(name)
    if item is None:
        return Unread("a link to nothing")
    return item if isinstance(item, h5py.Group | h5py.Dataset) else None


def _bracketed_unit(item: h5py.Dataset) -> str:
    """The unit of a data set in brackets, as in a column header."""
    unit = next((item.attrs[name] for name in _UNITS if name in item.attrs), "")
    unit = unit.decode() if isinstance(unit, bytes) else str(unit)
    return f"[{unit}]" if unit not in ("", "?") else ""


def write(record: Record, path: Path) -> None:
    """Write the layout described at the top of this module."""
    with h5py.File(path, "w") as file:
        file.attrs.update(format=FORMAT, version=VERSION, start=record.start, rate=record.rate)
        file.attrs["source"] = record.source
        file.attrs["channels"] = np.array(record.channels, dtype=h5py.string_dtype())
        file.attrs["notes"] = np.array(record.notes, dtype=h5py.string_dtype())
        file.create_dataset("time", data=record.time).attrs["unit"] = "s"
        for name in record.channels:
            item = file.create_dataset(name, data=record.channel(name))
            if record.unit(name) != "?":  # of a state, which is in the unit that its law gives it
                item.attrs["unit"] = record.unit(name)
            for kind in STORED:
                if name in getattr(record, kind):
                    item.attrs[kind] = getattr(record, kind)[name]
        if record.uncertainty:
            file.attrs["sensors"] = json.dumps(sensors_of(record))
