"""MATLAB files: read v4 to v7 through SciPy and v7.3 through HDF5, written as v5.

A MATLAB variable cannot be named x:m1, so it is named x_m1. Files written by linkwise hold `time`, one column vector per
channel, `start`, `rate`, `source`, the cells `channels` and `variables` (which channel is which variable) and `notes`, and
`noise` (NaN where unknown) and `interpolation`; `sensors`, a JSON text, is what is known of sensors.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray
from scipy.io import savemat
from scipy.sparse import csc_array, issparse

from linkwise.files.arrays import Unread, columns_of, scalar, spelled_as_channel, stated_rate
from linkwise.files.hdf5 import open_file
from linkwise.files.mapping import as_statements, sensors_of
from linkwise.files.table import Column, Table
from linkwise.files.testlab import named_signals
from linkwise.mat_file import load_mat, sound_sparse
from linkwise.records.channel import STORED
from linkwise.records.record import Record

_NAME_LENGTH = 63  # longest name of a MATLAB variable
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
    columns = tuple(_named(column, names) for column in columns_of(samples))
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


def _named(column: Column, names: Mapping[str, str]) -> Column:
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
    variables = _identifiers(record.channels)
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
    return np.array(values, dtype=object if STORED[kind].is_text else np.float64)


def _by_channel(value: Any, kind: str, channels: Iterable[str]) -> dict[str, Any]:
    """What `_for_each_channel` wrote, by channel, without those that are absent."""
    if STORED[kind].is_text:
        values: Iterable[float | str] = _texts(value)
    else:
        values = map(float, np.atleast_1d(() if value is None else value))
    pairs = zip(channels, values, strict=False)
    return {name: stored for name, stored in pairs if not STORED[kind].is_absent(stored)}


def _identifiers(channels: tuple[str, ...]) -> tuple[str, ...]:
    """A unique variable name of letters, digits and underscores for each channel."""
    identifiers: list[str] = []
    for i, name in enumerate(channels):
        plain = re.sub(r"[^A-Za-z0-9_]", "_", name)[:_NAME_LENGTH]
        tail = f"_{i + 1}"
        identifiers.append(plain if plain not in identifiers else plain[: _NAME_LENGTH - len(tail)] + tail)
    return tuple(identifiers)
