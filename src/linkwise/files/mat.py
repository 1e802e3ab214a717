"""MATLAB files: read v4 to v7 through SciPy and v7.3 through HDF5, written as v5.

A MATLAB variable cannot be named x:m1, so it is named x_m1. Files written by linkwise hold `time`, one column vector per
channel, `start`, `rate`, `source`, the cells `channels` and `variables` (which channel is which variable) and `notes`, and
`noise` (NaN where unknown) and `interpolation`; `sensors`, a JSON text, is what is known of sensors.

In exports of Testlab each measured function is a struct of its values, its even axis, its unit and its name.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray
from scipy.io import savemat
from scipy.sparse import csc_array, issparse

from linkwise.display import identifiers
from linkwise.files.arrays import Unread, columns_of, scalar, spelled_as_channel, stated_rate
from linkwise.files.hdf5 import open_file
from linkwise.files.mapping import as_statements, sensors_of
from linkwise.files.table import Column, ColumnHeader, Table
from linkwise.model.mat_file import load_mat, sound_sparse
from linkwise.records.channel import KINDS, STORED
from linkwise.records.record import Record
from linkwise.units import converts, factor_to_si

_LARGEST = 10_000_000  # numbers of a sparse matrix that is read
_OWN = frozenset({"sensors", "channels", "variables", "notes", "start", "rate", "source", *STORED})


def read_table(path: Path) -> Table:
    """All numeric variables, those in structs as `struct/field`; see `files.read_record`."""
    if h5py.is_hdf5(path):
        with open_file(path) as file:
            tree = {name: _from_hdf5(item, file) for name, item in file.items() if not name.startswith("#")}
    else:
        variables = load_mat(path, squeeze_me=True, simplify_cells=True)
        tree = {name: _dense(value) for name, value in variables.items()}
    names = dict(zip(_texts(tree.get("variables")), _texts(tree.get("channels")), strict=False))
    samples = {name: value for name, value in tree.items() if not (names and name in _OWN)}
    samples |= {name: Unread("missing") for name in names if name not in tree}
    columns = tuple(_channel_column(column, names) for column in columns_of(samples))
    table = Table(
        columns,
        start=scalar(tree.get("start")) or 0.0,
        rate=stated_rate(tree),
        notes=_texts(tree.get("notes")),
        source=next(iter(_texts(tree.get("source"))), ""),
        stored={kind: _by_channel(tree.get(kind), kind, names.values()) for kind in STORED},
        sensors=as_statements(next(iter(_texts(tree.get("sensors"))), None), path),
    )
    return named_signals(table, tree)


def _channel_column(column: Column, names: Mapping[str, str]) -> Column:
    """The column under the name of the channel of its variable."""
    if column.header in names:
        return replace(column, header=names[column.header])
    return spelled_as_channel(column)


def _texts(value: Any) -> tuple[str, ...]:
    """The strings in a cell or char array."""
    if value is None:
        return ()
    if isinstance(value, str):
        return (value,) if value else ()
    texts = np.ravel(np.asarray(value, dtype=object))  # an empty text is read as an array of no characters
    return tuple("" if isinstance(text, np.ndarray) and not text.size else str(text) for text in texts)


def _dense(value: Any) -> Any:
    """A sparse matrix as an array, in structs too; one that is too large to be a set of channels is left unread."""
    if isinstance(value, dict):
        return {name: _dense(member) for name, member in value.items()}
    if not issparse(value):
        return value
    rows, columns = value.shape
    if rows * columns > _LARGEST:
        return Unread(f"a sparse matrix of {rows} x {columns}")
    return np.squeeze(sound_sparse(value).toarray())


def _from_hdf5(item: h5py.Group | h5py.Dataset, file: h5py.File) -> Any:
    """One MATLAB value: structs are groups, arrays are transposed, text is numbers, cells are references."""
    if isinstance(item, h5py.Group) and "MATLAB_sparse" not in item.attrs:
        return {name: _from_hdf5(member, file) for name, member in item.items()}
    if "MATLAB_sparse" in item.attrs:
        columns = len(item["jc"]) - 1
        parts = [item[name][()] if name in item else () for name in ("data", "ir", "jc")]
        return _dense(csc_array(tuple(parts), shape=(int(item.attrs["MATLAB_sparse"]), columns)))
    if "MATLAB_empty" in item.attrs:
        return None
    kind = item.attrs.get("MATLAB_class", b"")
    if kind == b"char":
        return "".join(map(chr, np.ravel(item[()].T, order="F")))
    if item.dtype == h5py.ref_dtype:
        return [_from_hdf5(file[reference], file) for reference in np.ravel(item[()].T, order="F")]
    return np.squeeze(item[()].T)


def write(record: Record, path: Path) -> None:
    """Write the variables described at the top of this module as MAT v5."""
    variables = list(identifiers(record.channels, ()).values())
    content: dict[str, Any] = {
        "time": record.time,
        **{variable: record.channel(name) for variable, name in zip(variables, record.channels, strict=True)},
        "start": record.start,
        "rate": record.rate,
        "channels": np.array(record.channels, dtype=object),
        "variables": np.array(variables, dtype=object),
        **{kind: _for_each_channel(record, kind) for kind in STORED},
        "notes": np.array(record.notes, dtype=object),
        "source": record.source,
    }
    if record.uncertainty:
        content["sensors"] = json.dumps(sensors_of(record))
    savemat(path, content, format="5", oned_as="column", long_field_names=True)


def _for_each_channel(record: Record, kind: str) -> NDArray[Any]:
    """An attribute of every channel: an array of numbers, or a cell of texts."""
    values = [getattr(record, kind).get(name, STORED[kind].absent) for name in record.channels]
    return np.array(values, dtype=object if STORED[kind].stored is str else np.float64)


def _by_channel(value: Any, kind: str, channels: Iterable[str]) -> dict[str, Any]:
    """What `_for_each_channel` wrote, by channel, without those that are absent."""
    absent = STORED[kind].absent
    values = (
        _texts(value) if isinstance(absent, str) else np.atleast_1d(() if value is None else value).tolist()
    )
    pairs = zip(channels, values, strict=False)
    return {name: stored for name, stored in pairs if stored != absent and stored == stored}


_VALUES = "/y_values/values"
_AGREES = 1e-3  # of a factor: printed values of standard gravity, and of units of other systems


@dataclass(frozen=True)
class _Signal:
    """A function over time: the names it may have, the best first, its unit, and the start and the step in s of its axis."""

    names: tuple[str, ...]
    label: str
    unit: str
    axis: tuple[float, float]


def named_signals(table: Table, variables: Mapping[str, Any]) -> Table:
    """The table with the names and the units of its signals, and the rate that they share; columns keep their paths.

    `variables` are those of the file. Signals that are not over time, such as spectra, stay as they are.
    """
    columns = [column for column in table.columns if column.values is not None or _VALUES in column.header]
    of_columns = [_signal(column.header, variables) for column in columns]
    signals = {number: signal for number, signal in enumerate(of_columns) if signal is not None}
    if not signals:
        return table
    for number, signal in signals.items():
        unit = f"[{signal.unit}]" if signal.unit else ""
        path = columns[number].header
        header = f"{_unique_name(signal, signals) or path}{unit}"
        columns[number] = replace(columns[number], header=header, path=path)
    named = replace(table, columns=tuple(columns), notes=(*table.notes, *_unit_notes(columns, signals)))
    axes = {signal.axis for signal in signals.values()}
    if len(axes) > 1:
        steps = ", ".join(f"{step:.9g} s from {start:.9g} s" for start, step in sorted(axes))
        note = f"The signals of the file have axes of their own ({steps}), of which none was taken."
        return replace(named, notes=(*named.notes, note))
    start, step = axes.pop()
    return replace(named, start=start, rate=1.0 / step)


def _signal(path: str, variables: Mapping[str, Any]) -> _Signal | None:
    """The signal whose values are the column of this path, `NAME/y_values/values` or `NAME/y_values/values(:,2)`."""
    variable, values, rest = path.partition(_VALUES)
    function = variables.get(variable) if values else None
    if not isinstance(function, Mapping):
        return None
    axis = _struct(function, "x_values")
    start, step = scalar(axis.get("start_value")), scalar(axis.get("increment"))
    if not step or step < 0.0 or str(_struct(axis, "quantity").get("label") or "s") != "s":
        return None
    number = int(rest.strip("(:,)")) - 1 if rest else 0
    quantity = _struct(_struct(function, "y_values"), "quantity")
    label = _nth_text(quantity.get("label"), number)
    factor = scalar(_struct(quantity, "unit_transformation").get("factor")) or 1.0
    return _Signal(tuple(_names(function, number)), label, _unit(label, factor), (start or 0.0, step))


def _names(function: Mapping[str, Any], number: int) -> Iterator[str]:
    """What the record of a function calls its column `number` (from 0): its name, then its point, with the direction."""
    record = _struct(function, "function_record")
    channel = _struct(record, "primary_channel")
    point, direction = (_nth_text(channel.get(key), number) for key in ("point_id", "direction"))
    for name in (_nth_text(record.get("name"), number), point, f"{point} {direction}" if point else ""):
        if name and not ColumnHeader.parse(name).is_time:
            yield name


def _unit(label: str, factor: float) -> str:
    """The unit of values beside the `label` of a display: they are in SI where a `factor` turns what is displayed into SI."""
    if factor == 1.0:
        return label
    units = (kind.unit for kind in KINDS.values() if converts(label, kind.unit))
    return next((unit for unit in units if abs(factor_to_si(label, unit) / factor - 1.0) < _AGREES), "")


def _unique_name(signal: _Signal, signals: Mapping[int, _Signal]) -> str:
    """The first name of a signal that no other may have; empty where there is none."""
    taken = {name for other in signals.values() if other is not signal for name in other.names}
    return next((name for name in signal.names if name not in taken), "")


def _unit_notes(columns: list[Column], signals: Mapping[int, _Signal]) -> Iterator[str]:
    """A sentence on each signal whose label is not the unit of its values."""
    for number, signal in signals.items():
        if signal.unit != signal.label:
            name = columns[number].header.partition("[")[0]
            yield (
                f"{name} is taken to be in {signal.unit or 'SI units'}, in which Testlab stores values; {signal.label} beside "
                f"them is the unit of its display. Where they were exported in it, state it, as in a:m1[{signal.label}]."
            )


def _struct(parent: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    child = parent.get(name)
    return child if isinstance(child, Mapping) else {}


def _nth_text(value: Any, number: int) -> str:
    """A text, or that of a column among several."""
    if isinstance(value, str):
        return value.strip()
    if value is None or isinstance(value, Mapping) or not hasattr(value, "__len__"):
        return ""
    return str(value[number]).strip() if number < len(value) else ""
