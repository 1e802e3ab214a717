"""Named, possibly nested arrays to columns, for formats that hold arrays rather than cells."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from linkwise.files.header import ColumnHeader
from linkwise.files.table import Column


def columns_of(tree: Mapping[str, Any]) -> tuple[Column, ...]:
    """One column per vector and per column of each matrix in `tree`, nested groups as `group/name`.

    The samples of a matrix lie along its longer side, and its columns are named as in MATLAB, `data(:,2)`. What is not a
    row of numbers is a column without values, so that a channel is never lost without a note; single numbers and texts are
    left out unless they have the name of a channel.
    """
    return tuple(column for path, value in _leaves(tree, "") for column in _columns_of_leaf(path, value))


@dataclass(frozen=True)
class Unread:
    """Stands for a value that cannot be read as numbers; `what` says what it is."""

    what: str


def _leaves(tree: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    for name, value in tree.items():
        path = f"{prefix}{name}"
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{path}/")
        else:
            yield path, value


def _columns_of_leaf(path: str, value: Any) -> Iterator[Column]:
    if isinstance(value, np.ndarray) and value.size > 1:
        yield from _columns(path, value)
        return
    if isinstance(value, Unread):
        instead = value.what
    elif value is None or (isinstance(value, np.ndarray) and value.size == 0):
        instead = "empty"
    elif isinstance(value, list | tuple):
        instead = "a cell array"
    elif ColumnHeader.parse(path).leaf.channel is None:
        return  # a setting or a remark
    else:
        instead = "a text" if isinstance(value, str | bytes) else "a single value"
    yield Column(path, None, instead=instead)


def _columns(path: str, array: np.ndarray[Any, Any]) -> Iterator[Column]:
    array = np.squeeze(array)
    if array.ndim == 1:
        yield Column.of(path, array)
    elif array.ndim == 2 and array.dtype.kind in "biuf":
        upright = array if array.shape[0] >= array.shape[1] else array.T
        for i in range(upright.shape[1]):
            yield Column.of(f"{path}(:,{i + 1})", upright[:, i])
    else:
        yield Column(path, None, instead=f"an array of {' x '.join(map(str, array.shape))}")
