"""Parquet: one column per channel; rate, noise, notes and the like in the metadata of the schema.

The metadata `calibration`, `gain`, `offset` and `delay` of a column of any other file say what is known of its sensor.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow
from numpy.typing import NDArray
from pyarrow import parquet

from linkwise.errors import RecordError
from linkwise.files.mapping import sensors_of, stated_in
from linkwise.files.table import Column, Table, headers
from linkwise.records.channel import STORED
from linkwise.records.record import Record

_KEY = b"linkwise record"


def read_table(path: Path) -> Table:
    """All columns of the file; see `files.read_record`."""
    content = parquet.read_table(path)
    stated, stored = _Stated(), dict[str, dict[str, Any]]()
    if _KEY in (content.schema.metadata or {}):
        try:
            metadata = msgspec.json.decode(content.schema.metadata[_KEY], type=dict[str, Any])
            stated = msgspec.convert(metadata, type=_Stated)
            for kind, attribute in STORED.items():
                of_kind = dict[str, float] if attribute.stored is float else dict[str, str]
                stored[kind] = msgspec.convert(metadata.get(kind, {}), type=of_kind)
        except (msgspec.MsgspecError, UnicodeDecodeError) as error:
            raise RecordError(f"its metadata is not that of a record: {error}", path) from error
    columns = tuple(
        replace(Column.of(field.name, _column_values(content.column(i))), attributes=_stated_in(field))
        for i, field in enumerate(content.schema)
    )
    return Table(columns, stored=stored, **msgspec.structs.asdict(stated))


def _stated_in(column: pyarrow.Field) -> dict[str, object]:
    """What the metadata of a column state of its sensor."""
    metadata = (column.metadata or {}).items()
    return stated_in({key.decode("utf-8", "replace"): value for key, value in metadata})


class _Stated(msgspec.Struct):
    """What the metadata of our own files state, as JSON."""

    start: float = 0.0
    rate: float | None = None
    notes: tuple[str, ...] = ()
    source: str = ""
    sensors: dict[str, dict[str, object]] = {}


def _column_values(column: pyarrow.ChunkedArray) -> NDArray[Any]:
    """The values of one column, NaN for null."""
    number = pyarrow.types.is_integer(column.type) or pyarrow.types.is_decimal(column.type)
    if number and (column.null_count or pyarrow.types.is_decimal(column.type)):
        column = column.cast(pyarrow.float64())
    return np.asarray(column.to_numpy())


def write(record: Record, path: Path) -> None:
    """Write the columns `time` and one per channel, in SI units."""
    stated = {
        "start": record.start,
        "rate": record.rate,
        **{kind: dict(getattr(record, kind)) for kind in STORED},
        "notes": record.notes,
        "source": record.source,
        "sensors": sensors_of(record),
    }
    names = ("time", *headers(record))
    arrays = [pyarrow.array(record.time), *(pyarrow.array(record.channel(name)) for name in record.channels)]
    metadata = {_KEY: json.dumps(stated).encode()}
    schema = pyarrow.schema([(name, pyarrow.float64()) for name in names], metadata=metadata)
    parquet.write_table(pyarrow.Table.from_arrays(arrays, schema=schema), path)
