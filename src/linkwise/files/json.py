"""JSON: columns by name, a list of rows under a name, or a list of objects with the same keys.

Rows are named as in MATLAB, `data(:,2)`, unless `columns` beside them says what they are; `rate`, `fs` or `sampling freq` is
the sampling rate, `dt` the step, and `sensors` what is known of sensors, by channel. null is a missing sample.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from linkwise.errors import RecordError
from linkwise.files.arrays import Unread, columns_of, spelled_as_channel, stated_rate
from linkwise.files.sensor_attributes import as_statements
from linkwise.files.table import Column, Table

_NAMES = ("columns", "names", "channels", "header")
_DEEPEST = 20  # levels of objects within objects


def read_table(path: Path) -> Table:
    """The columns of the file; see `files.read_record`."""
    try:
        content = msgspec.json.decode(path.read_bytes())
    except msgspec.DecodeError as error:
        raise RecordError(f"is not valid JSON: {error}", path) from error
    except RecursionError:
        raise RecordError("holds objects within objects without end; the file is damaged", path) from None
    if isinstance(content, list):
        content = _by_key(content) if content and isinstance(content[0], dict) else {"data": content}
    if not isinstance(content, dict):
        raise RecordError("holds a single value: expected columns by name, or rows of numbers", path)
    sensors = content.pop("sensors", None)
    tree = {name: _array(value, 0) for name, value in content.items()}
    columns = tuple(spelled_as_channel(column) for column in columns_of(tree))
    return Table(_renamed(columns, content), rate=stated_rate(tree), sensors=as_statements(sensors, path))


def _by_key(rows: list[Any]) -> dict[str, Any]:
    """Columns of a list of objects; a key that an object lacks is a missing sample."""
    objects = [row if isinstance(row, dict) else {} for row in rows]
    names = dict.fromkeys(name for row in objects for name in row)
    return {name: [row.get(name) for row in objects] for name in names}


def _array(value: Any, depth: int) -> Any:
    """Lists of numbers, or of rows of them, as arrays; null is NaN."""
    if isinstance(value, dict):
        if depth == _DEEPEST:
            return Unread("an object deep within others")
        return {name: _array(member, depth + 1) for name, member in value.items()}
    if not isinstance(value, list):
        return value
    if not value:
        return np.empty(0)
    try:
        return np.array(value, dtype=float if _has_null(value) else None)
    except (TypeError, ValueError, OverflowError):
        return Unread("a list of rows of unequal length, or of texts")


def _has_null(value: list[Any]) -> bool:
    return any(entry is None or (isinstance(entry, list) and None in entry) for entry in value)


def _renamed(columns: tuple[Column, ...], content: Mapping[str, Any]) -> tuple[Column, ...]:
    """The columns of the only list of rows under the names that the file lists for them."""
    rows = [number for number, column in enumerate(columns) if "(:," in column.header]
    lists = (content[name] for name in _NAMES if isinstance(content.get(name), list))
    names: list[str] = next((names for names in lists if all(isinstance(name, str) for name in names)), [])
    if not rows or len(names) != len(rows):
        return columns
    renamed = list(columns)
    for number, name in zip(rows, names, strict=True):
        renamed[number] = replace(columns[number], header=name, meaning="")
    return tuple(column for column in renamed if column.header not in _NAMES)
