"""HDF5: one data set per column, called by its channel, with its unit as an attribute.

Our own files hold `time` and one data set per channel at the root, each with the attribute `unit` and, where it is known,
`noise`; the root has the attributes `format`, `version`, `start`, `rate`, `source` and `notes`. Read is any file whose data
sets, in whatever groups, bear such names or are mapped to them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np

from linkwise.errors import RecordError
from linkwise.files.arrays import columns_of
from linkwise.files.table import Table
from linkwise.records.record import Record

FORMAT = "linkwise record"
VERSION = 1
_UNITS = ("unit", "units", "Unit", "Units")


def read_table(path: Path) -> Table:
    """All data sets of numbers in the file; see `files.read_record`."""
    if not h5py.is_hdf5(path):
        raise RecordError("is no HDF5 file, whatever its suffix says", path)
    with h5py.File(path, "r") as file:
        if file.attrs.get("format") == FORMAT and int(file.attrs.get("version", 0)) > VERSION:
            raise RecordError(
                f"was written by a later linkwise (layout {file.attrs['version']}, known is {VERSION})", path
            )
        tree: dict[str, Any] = {}
        noise: dict[str, float] = {}

        def collect(name: str, item: h5py.HLObject) -> None:
            if isinstance(item, h5py.Dataset) and item.dtype.kind in "biufSO" and item.shape:
                tree[f"{name}{_unit(item)}"] = item[()]
                if "noise" in item.attrs:
                    noise[name] = float(item.attrs["noise"])

        file.visititems(collect)
        rate = file.attrs.get("rate")
        order = [f"{name}{_unit(file[name])}" for name in file.attrs.get("channels", ()) if name in file]
        return Table(
            columns_of({**{name: tree[name] for name in order}, **tree}),
            start=float(file.attrs.get("start", 0.0)),
            rate=None if rate is None else float(rate),
            noise=noise,
            notes=tuple(str(note) for note in np.atleast_1d(file.attrs.get("notes", ()))),
            source=str(file.attrs.get("source", "")),
        )


def _unit(item: h5py.Dataset) -> str:
    """The unit of a data set in brackets, as it would stand in a header."""
    unit = next((item.attrs[name] for name in _UNITS if name in item.attrs), "")
    unit = unit.decode() if isinstance(unit, bytes) else str(unit)
    return f"[{unit}]" if unit else ""


def write(record: Record, path: Path) -> None:
    """The layout at the top of this module."""
    with h5py.File(path, "w") as file:
        file.attrs["format"] = FORMAT
        file.attrs["version"] = VERSION
        file.attrs["start"] = record.start
        file.attrs["rate"] = record.rate
        file.attrs["source"] = record.source
        file.attrs["channels"] = list(record.channels)
        file.attrs["notes"] = np.array(record.notes, dtype=h5py.string_dtype())
        file.create_dataset("time", data=record.time).attrs["unit"] = "s"
        for name in record.channels:
            item = file.create_dataset(name, data=record.channel(name))
            item.attrs["unit"] = record.unit(name)
            if name in record.noise:
                item.attrs["noise"] = record.noise[name]
