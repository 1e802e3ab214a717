"""Named, possibly nested arrays to columns, for formats that hold arrays rather than cells."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from linkwise.files.header import ColumnHeader
from linkwise.files.table import Column
from linkwise.records.channel import KINDS

RATES = (
    "rate",
    "fs",
    "sampling_rate",
    "sampling_frequency",
    "sampling rate",
    "sampling freq",
    "sampling frequency",
)
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
    by_name = {name.lower(): _scalar(value) for name, value in tree.items()}
    rate = next((by_name[name] for name in RATES if by_name.get(name) is not None), None)
    step = next((by_name[name] for name in _STEPS if by_name.get(name)), None)
    return rate if rate is not None or step is None else 1.0 / step


def _scalar(value: Any) -> float | None:
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
        yield from _columns(path, value)
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
