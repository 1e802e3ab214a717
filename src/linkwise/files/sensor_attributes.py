"""What record files state of their sensors: attributes of columns, or a text of JSON by channel."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from linkwise.errors import RecordError
from linkwise.files.header import ColumnHeader
from linkwise.files.table import Column
from linkwise.records.record import Record
from linkwise.records.sensor_statement import SensorStatement, attributes_of
from linkwise.records.sensor_uncertainty import COMMON

_KEYS = ("calibration", "gain", "offset", "delay")  # "noise" of a column is read with the noise of others
_EXAMPLES = {"calibration": "1 %", "gain": "1.02 +- 1 %", "offset": "+- 0.1 mm", "delay": "+- 1 ms"}
_SHOWN = 40  # characters of an attribute that a note quotes


def stated_in(attributes: Mapping[str, Any]) -> dict[str, object]:
    """The attributes that state an error of a sensor, as numbers and texts."""
    return {name: _plain(attributes[name]) for name in _KEYS if name in attributes}


def _plain(value: Any) -> object:
    """A number or a text; what is neither as the text of it, which a message quotes."""
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    array = np.asarray(value)
    if array.size == 1 and array.dtype.kind in "iuf":
        return float(array.flat[0])
    if array.size == 1 and array.dtype.kind in "SUO":
        scalar = array.flat[0]
        return scalar.decode("utf-8", "replace") if isinstance(scalar, bytes) else str(scalar)
    return str(value)


def statement_of(attributes: Mapping[str, object], channel: str) -> tuple[SensorStatement, tuple[str, ...]]:
    """What the attributes of a column state of its sensor, and a sentence on each that does not say it.

    Programs write attributes of these names for other ends, such as the date of a calibration or the gain of an amplifier:
    texts that can be read are taken, and numbers without a unit are not.
    """
    statement, remarks = SensorStatement(), []
    for key, value in attributes.items():
        try:
            if not isinstance(value, str):
                raise RecordError("a number without a unit")
            statement = SensorStatement.of({key: value}, channel).over(statement)
        except RecordError:
            remarks.append(
                f"The attribute {key} of {channel}, {str(value)[:_SHOWN]!r}, was not used: write what is known of the "
                f"sensor as a text, such as {_EXAMPLES[key]!r}."
            )
    return statement, tuple(remarks)


def with_attributes(
    columns: tuple[Column, ...], attributes: Mapping[str, Mapping[str, object]]
) -> tuple[Column, ...]:
    """The columns with the `attributes` of the arrays that they are from, by the name of the array without its unit."""
    if not any(attributes.values()):
        return columns
    annotated = []
    for column in columns:
        name = ColumnHeader.parse(column.header.partition("(:,")[0]).name
        annotated.append(replace(column, attributes=attributes.get(name, {})))
    return tuple(annotated)


def as_statements(stated: object, file: Path) -> dict[str, dict[str, object]]:
    """What a JSON text, or the objects in it, states by channel; none where it is no such text.

    Raises RecordError for an object that does not hold objects.
    """
    text = msgspec.json.encode(stated).decode() if isinstance(stated, dict) else str(_plain(stated)).strip()
    if not text.startswith("{"):
        return {}  # an array or a setting of that name
    try:
        return msgspec.json.decode(text, type=dict[str, dict[str, object]])
    except msgspec.MsgspecError as error:
        raise RecordError(
            f'`sensors` is not what is known of sensors by channel, as in {{"x:m1": {{"calibration": "1 %"}}}}: {error}',
            file,
        ) from error


def sensors_of(record: Record) -> dict[str, dict[str, str]]:
    """What `as_statements` reads back as the uncertainty of the sensors of a record."""
    return {
        name: attributes_of(known, "" if name == COMMON else record.unit(name))
        for name, known in record.uncertainty.items()
    }
