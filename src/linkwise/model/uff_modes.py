"""Modes of a modal test from a universal file: its data sets of type 55, one for each real normal mode."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from linkwise.errors import StructureError
from linkwise.model.host_mode import HostMode
from linkwise.model.row_weights import turns_throughout

_DATA_AT_NODES, _NORMAL_MODE = 55, 2
_DIRECTIONS = {"r1": "x", "r2": "y", "r3": "z", "r4": "rx", "r5": "ry", "r6": "rz"}


def modes_of_uff(path: str | Path) -> tuple[HostMode, ...]:
    """Modes from a universal file; points are named by node and direction, such as "12z".

    Raises StructureError for a file without real normal modes, or modes without a modal mass.
    """
    source = str(path)
    try:
        pyuff = import_module("pyuff")
    except ImportError:
        raise StructureError(
            "reading modes from universal files needs the library pyuff: install linkwise[files]", source
        ) from None
    if not Path(path).is_file():
        raise StructureError("there is no such file", source)
    try:
        sets = pyuff.UFF(source).read_sets()
    except Exception as error:  # the library raises all kinds of errors on a damaged file
        reason = " ".join(str(error).split()) or type(error).__name__
        raise StructureError(f"cannot be read as a universal file: {reason[:200]}", source) from None
    data_sets = [
        data_set
        for data_set in (sets if isinstance(sets, list) else [sets])
        if data_set.get("type") == _DATA_AT_NODES
    ]
    normal = [data_set for data_set in data_sets if data_set.get("analysis_type") == _NORMAL_MODE]
    if not normal:
        problem = "holds no real normal modes, only other data at nodes" if data_sets else "holds no modes"
        raise StructureError(
            f"{problem}; write those of the test as normal modes (data set 55, analysis type 2)", source
        )
    moving = [
        (key, name)
        for key, name in _DIRECTIONS.items()
        if any(np.any(np.asarray(data_set.get(key, 0.0)) != 0.0) for data_set in normal)
    ]
    return tuple(
        _mode(data_set, moving, f"{source}, mode {number}") for number, data_set in enumerate(normal, start=1)
    )


def _mode(data: dict[str, Any], moving: list[tuple[str, str]], where: str) -> HostMode:
    mass = float(data.get("modal_m", 0.0))
    if not mass > 0.0:
        raise StructureError(
            f"has the modal mass {mass:g}, which does not scale its shape; it must be positive", where
        )
    nodes = [int(node) for node in np.atleast_1d(data["node_nums"])]
    shape = {
        f"{node}{name}": float(value) / np.sqrt(mass)
        for key, name in moving
        for node, value in zip(
            nodes, np.atleast_1d(np.real(data.get(key, np.zeros(len(nodes))))), strict=True
        )
    }
    rotations = [point for point in shape if turns_throughout(point)]
    try:
        return HostMode(float(data["freq"]), float(data["modal_damp_vis"]), shape, rotations=rotations)
    except StructureError as error:
        raise StructureError(error.message, where) from None
