"""Parquet: one column per channel; rate, noise and notes in the metadata of the schema."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow
from numpy.typing import NDArray
from pyarrow import parquet

from linkwise.errors import RecordError
from linkwise.files.table import Column, Table
from linkwise.records.record import Record

_KEY = b"linkwise record"


def read_table(path: Path) -> Table:
    """All columns of the file; see `files.read_record`."""
    content = parquet.read_table(path)
    stated = _Stated()
    if _KEY in (content.schema.metadata or {}):
        try:
            stated = msgspec.json.decode(content.schema.metadata[_KEY], type=_Stated, strict=True)
        except (msgspec.MsgspecError, UnicodeDecodeError) as error:
            raise RecordError(f"its metadata are not those of a record: {error}", path) from error
    return Table(
        tuple(Column.of(name, _values(content.column(i))) for i, name in enumerate(content.column_names)),
        start=stated.start,
        rate=stated.rate,
        noise=stated.noise,
        notes=stated.notes,
        source=stated.source,
        interpolation=stated.interpolation,
    )


class _Stated(msgspec.Struct):
    """What the metadata of our own files state, as JSON."""

    start: float = 0.0
    rate: float | None = None
    noise: dict[str, float] = {}
    notes: tuple[str, ...] = ()
    source: str = ""
    interpolation: dict[str, str] = {}


def _values(column: pyarrow.ChunkedArray) -> NDArray[Any]:
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
        "noise": dict(record.noise),
        "notes": record.notes,
        "source": record.source,
        "interpolation": dict(record.interpolation),
    }
    names = ("time", *record.channels)
    arrays = [pyarrow.array(record.time), *(pyarrow.array(record.channel(name)) for name in record.channels)]
    schema = pyarrow.schema(
        [(name, pyarrow.float64()) for name in names], metadata={_KEY: json.dumps(stated).encode()}
    )
    parquet.write_table(pyarrow.Table.from_arrays(arrays, schema=schema), path)
