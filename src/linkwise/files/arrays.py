"""Named, possibly nested arrays to columns, for formats that hold arrays rather than cells."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from linkwise.files.table import Column


def columns_of(tree: Mapping[str, Any]) -> tuple[Column, ...]:
    """One column per vector and per column of each matrix in `tree`, nested groups as `group/name`.

    The samples of a matrix lie along its longer side, and its columns are named as in MATLAB, `data(:,2)`. Scalars and arrays
    that are not numeric are left out.
    """
    return tuple(column for path, array in _leaves(tree, "") for column in _columns(path, array))


def _leaves(tree: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, np.ndarray[Any, Any]]]:
    for name, value in tree.items():
        path = f"{prefix}{name}"
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{path}/")
        elif isinstance(value, np.ndarray) and value.size > 1:
            yield path, value


def _columns(path: str, array: np.ndarray[Any, Any]) -> Iterator[Column]:
    array = np.squeeze(array)
    if array.ndim == 1:
        yield Column.of(path, array)
    elif array.ndim == 2 and array.dtype.kind in "biuf":
        upright = array if array.shape[0] >= array.shape[1] else array.T
        for i in range(upright.shape[1]):
            yield Column.of(f"{path}(:,{i + 1})", upright[:, i])
