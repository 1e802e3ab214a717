"""Named, possibly nested arrays to columns, for formats that hold arrays rather than cells: NumPy files and JSON here.

A NumPy file is one array (`.npy`) or several by name (`.npz`); nothing in them is unpickled. JSON holds columns by name, a
list of rows under a name, or a list of objects with the same keys; rows are named as in MATLAB, `data(:,2)`, unless `columns`
beside them says what they are, and null is a missing sample.

Names are those of channels, or as MATLAB spells them (`x_m1` for x:m1); `fs`, `rate` or `sampling freq` is the sampling rate,
`dt` the step; `sensors`, a JSON text, is what is known of sensors by channel. A channel of a periodic test may be an array of
periods by samples, or of realisations by periods by samples.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from math import prod
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from linkwise.errors import RecordError
from linkwise.files.mapping import as_statements
from linkwise.files.table import Column, ColumnHeader, Table
from linkwise.records.channel import KINDS, Channel

RATES = (
    "rate", "fs", "sampling_rate", "sampling_frequency", "sampling rate", "sampling freq", "sampling frequency",
)  # fmt: skip
_STEPS = ("dt", "step", "delta_t")
_SPELLED = re.compile(rf"^({'|'.join(key for key, kind in KINDS.items() if kind.of == 'mass')})_(\w+)$")


def columns_of(tree: Mapping[str, Any]) -> tuple[Column, ...]:
    """One column per vector and per column of each matrix in `tree`, nested groups as `group/name`.

    The samples of a matrix lie along its longer side, and its columns are named as in MATLAB, `data(:,2)`. What is not a
    row of numbers is a column without values, so that a channel is never lost without a note; single numbers and texts are
    left out unless they have the name of a channel.
    """
    return tuple(column for path, value in _leaves(tree, "") for column in _columns_of_leaf(path, value))


def stated_rate(tree: Mapping[str, Any]) -> float | None:
    """The sampling rate in Hz that a single number beside the arrays states, or a step in s; None without one."""
    numbers = {name.lower(): number for name, value in tree.items() if (number := scalar(value)) is not None}
    rates = [numbers[name] for name in RATES if name in numbers]
    return next(iter([*rates, *(1.0 / numbers[name] for name in _STEPS if numbers.get(name))]), None)


def scalar(value: Any) -> float | None:
    """The number in an array of size 1, or a number; None for anything else."""
    if isinstance(value, np.ndarray) and value.size == 1 and value.dtype.kind in "iuf":
        return float(value.flat[0])
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def spelled_as_channel(column: Column) -> Column:
    """The column with the channel that its name stands for where colons cannot be in names: `x_m1` for x:m1."""
    leaf = ColumnHeader.parse(column.header.rpartition("/")[2])
    spelled = _SPELLED.match(leaf.name)
    return replace(column, meaning=f"{spelled[1]}:{spelled[2]}") if spelled else column


@dataclass(frozen=True)
class Unread:
    """Stands for a value that cannot be read as numbers; `description` says what it is."""

    description: str


def _leaves(tree: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    for name, value in tree.items():
        path = f"{prefix}{name}"
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{path}/")
        else:
            yield path, value


def _columns_of_leaf(path: str, value: Any) -> Iterator[Column]:
    if isinstance(value, np.ndarray) and value.size > 1:
        yield from _columns_of_array(path, value)
        return
    if isinstance(value, Unread):
        instead = value.description
    elif value is None or (isinstance(value, np.ndarray) and value.size == 0):
        instead = "empty"
    elif isinstance(value, list | tuple):
        instead = "a cell array"
    elif ColumnHeader.parse(path).leaf.channel is None:
        return  # a setting or a remark
    else:
        instead = "a text" if isinstance(value, str | bytes) else "a single value"
    yield Column(path, None, instead=instead)


def _columns_of_array(path: str, array: np.ndarray[Any, Any]) -> Iterator[Column]:
    array = np.squeeze(array)
    if array.ndim == 1:
        yield Column.of(path, array)
    elif array.ndim == 2 and array.dtype.kind in "biuf":
        upright = array if array.shape[0] >= array.shape[1] else array.T
        for i in range(upright.shape[1]):
            yield Column.of(f"{path}(:,{i + 1})", upright[:, i])
    else:
        yield Column(path, None, instead=f"an array of {' x '.join(map(str, array.shape))}")


def with_joined_periods(arrays: Mapping[str, Any]) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Arrays by name with the periods of each channel joined, and a note on that; as they are where none has periods.

    The samples of a period are the axis as long as the time array, else the longest; the last of the others counts periods,
    and a third one realisations, which become groups `realisation 1/NAME`.
    Time goes on at its mean step, and an input that is given for one period is repeated.

    Raises
    ------
    RecordError
        If channels have different numbers of periods.
    """
    channels = {name: channel for name in arrays if (channel := _channel_named(name)) is not None}
    own = {name: np.squeeze(arrays[name]) for name in channels if isinstance(arrays[name], np.ndarray)}
    stacked = [name for name, array in own.items() if array.ndim in (2, 3)]
    if not stacked:
        return dict(arrays), ()
    time = next((name for name in arrays if ColumnHeader.parse(name).is_time), None)
    samples = None if time is None else int(np.size(arrays[time]))
    periods = {name: _periods(own[name], samples) for name in stacked}
    counts = {value.shape[1:] for value in periods.values()}
    if len(counts) > 1:
        shapes = ", ".join(f"{name} has {' x '.join(map(str, np.shape(arrays[name])))}" for name in stacked)
        raise RecordError(f"channels differ in the number of periods or of their samples: {shapes}")
    count, length = counts.pop()
    joined: dict[str, Any] = {}
    for name, value in arrays.items():
        if name in periods:
            several = len(periods[name]) > 1
            for number, realisation in enumerate(periods[name], start=1):
                joined[f"realisation {number}/{name}" if several else name] = realisation.ravel()
        elif name == time and np.size(value) == length:
            once = np.ravel(value)
            joined[name] = once[0] + (once[-1] - once[0]) / (length - 1) * np.arange(count * length)
        elif name in channels and channels[name].is_input and np.size(value) == length:
            joined[name] = np.tile(np.ravel(value), count)
        else:
            joined[name] = value
    note = (
        f"{', '.join(stacked)}: {count} periods of {length} samples were joined one after the other; averaged over that "
        "period, their scatter shows the noise."
    )
    return joined, (note,)


def _channel_named(name: str) -> Channel | None:
    """The channel that a name means."""
    column = spelled_as_channel(Column(name, None))
    return ColumnHeader.parse(column.meaning or name).leaf.channel


def _periods(array: np.ndarray[Any, Any], samples: int | None) -> np.ndarray[Any, Any]:
    """An array (realisations, periods, samples) of one with its axes in any order, of which `samples` has that length."""
    shape = array.shape
    if samples is None or samples == prod(shape[-2:]):  # the last of the longest
        samples = max(shape)
    if samples not in shape:
        sides = f"an array of a channel is {' x '.join(map(str, shape))}"
        raise RecordError(f"time has {samples} samples, and {sides}: no side is as long")
    axis = max(number for number, side in enumerate(shape) if side == samples)
    last = np.moveaxis(array, axis, -1)
    return last if last.ndim == 3 else last[np.newaxis]


_NAMES = ("columns", "names", "channels", "header")
_SAMPLES = ("buffer", "data", "values", "samples")  # as apps of phones name the list of a sensor
_DEEPEST = 20  # levels of objects within objects


def read_json(path: Path) -> Table:
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
    tree = {name: _json_array(value, 1) for name, value in content.items()}
    columns = tuple(spelled_as_channel(column) for column in columns_of(tree))
    return Table(_relabelled(columns, content), rate=stated_rate(tree), sensors=as_statements(sensors, path))


def _by_key(rows: list[Any]) -> dict[str, Any]:
    """Columns of a list of objects: a list under the name that each states, or their members, each sensor's by itself.

    A key that an object lacks is a missing sample.
    """
    objects = [row if isinstance(row, dict) else {} for row in rows]
    listed = ((row, key) for row in objects for key in _SAMPLES if isinstance(row.get(key), list))
    lists = {str(row.get("name")): row[key] for row, key in listed}
    if len(lists) == len(objects):
        return lists
    if all(isinstance(row.get("sensor"), str) for row in objects):
        of_sensors: dict[str, list[Any]] = {}
        for row in objects:
            members = {name: value for name, value in row.items() if name != "sensor"}
            of_sensors.setdefault(row["sensor"], []).append(members)
        return {sensor: _by_key(own) for sensor, own in of_sensors.items()}
    names = dict.fromkeys(name for row in objects for name in row)
    return {name: [row.get(name) for row in objects] for name in names}


def _json_array(value: Any, depth: int) -> Any:
    """Lists of numbers, or of rows of them, as arrays; null is NaN, and a buffer, a list with its settings, is the list."""
    if isinstance(value, list) and value and isinstance(value[0], dict):
        value = _by_key(value)
    if isinstance(value, dict):
        if depth == _DEEPEST:
            return Unread("an object deep within others")
        lists = [name for name, member in value.items() if isinstance(member, list | dict)]
        if depth and len(lists) == 1 and lists[0] in _SAMPLES and len(value) > 1:
            return _json_array(value[lists[0]], depth + 1)
        return {name: _json_array(member, depth + 1) for name, member in value.items()}
    if not isinstance(value, list):
        return value
    if not value:
        return np.empty(0)
    try:
        has_null = any(entry is None or (isinstance(entry, list) and None in entry) for entry in value)
        array = np.array(value, dtype=float if has_null else None)
    except (TypeError, ValueError, OverflowError):
        return Unread("a list of rows of unequal length, or of texts")
    try:
        return array.astype(float) if array.dtype.kind == "U" else array  # phones write numbers as texts
    except ValueError:
        return array


def _relabelled(columns: tuple[Column, ...], content: Mapping[str, Any]) -> tuple[Column, ...]:
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


def read_numpy(path: Path) -> Table:
    """The columns of an array or of several; see `files.read_record`."""
    content = np.load(path, allow_pickle=False)
    if not isinstance(content, np.ndarray):
        with content:
            arrays = {name: content[name] for name in content.files}
        arrays, notes = with_joined_periods(arrays)
        columns = tuple(spelled_as_channel(column) for column in columns_of(arrays))
        sensors = as_statements(arrays.get("sensors"), path)
        return Table(columns, rate=stated_rate(arrays), notes=notes, sensors=sensors)
    if content.dtype.names:
        named = {name: content[name] for name in content.dtype.names}
        return Table(tuple(spelled_as_channel(column) for column in columns_of(named)))
    array = np.squeeze(content)
    if array.ndim not in (1, 2) or not array.size:
        message = f"holds an array of {' x '.join(map(str, content.shape))} numbers: expected one of samples by channels"
        raise RecordError(message, path)
    upright = np.atleast_2d(array.T).T if array.ndim == 1 else max(array, array.T, key=len)
    columns = tuple(Column.of(str(i + 1), upright[:, i]) for i in range(upright.shape[1]))
    return Table(columns, named=False, opening=" ".join(map(str, upright[0])))
