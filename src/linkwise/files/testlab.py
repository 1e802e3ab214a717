"""Exports of Testlab to MATLAB: each measured function a struct of its values, its even axis, its unit and its name."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from linkwise.errors import LinkwiseError
from linkwise.files.arrays import scalar
from linkwise.files.table import Column, ColumnHeader, Table
from linkwise.records.channel import KINDS
from linkwise.units import factor_to_si

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
    found = [_signal(column.header, variables) for column in columns]
    signals = {number: signal for number, signal in enumerate(found) if signal is not None}
    if not signals:
        return table
    for number, signal in signals.items():
        unit = f"[{signal.unit}]" if signal.unit else ""
        path = columns[number].header
        header = f"{_unique(signal, signals) or path}{unit}"
        columns[number] = replace(columns[number], header=header, path=path)
    named = replace(table, columns=tuple(columns), notes=(*table.notes, *_notes(columns, signals)))
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
    label = _nth(quantity.get("label"), number)
    factor = scalar(_struct(quantity, "unit_transformation").get("factor")) or 1.0
    return _Signal(tuple(_names(function, number)), label, _unit(label, factor), (start or 0.0, step))


def _names(function: Mapping[str, Any], number: int) -> Iterator[str]:
    """What the record of a function calls its column `number` (from 0): its name, then its point, with the direction."""
    record = _struct(function, "function_record")
    channel = _struct(record, "primary_channel")
    point, direction = (_nth(channel.get(key), number) for key in ("point_id", "direction"))
    for name in (_nth(record.get("name"), number), point, f"{point} {direction}" if point else ""):
        if name and not ColumnHeader.parse(name).is_time:
            yield name


def _unit(label: str, factor: float) -> str:
    """The unit of values beside the `label` of a display: they are in SI where a `factor` turns what is displayed into SI."""
    if factor == 1.0:
        return label
    for unit in dict.fromkeys(kind.unit for kind in KINDS.values()):
        try:
            if abs(factor_to_si(label, unit) / factor - 1.0) < _AGREES:
                return unit
        except LinkwiseError:
            continue
    return ""


def _unique(signal: _Signal, signals: Mapping[int, _Signal]) -> str:
    """The first name of a signal that no other may have; empty where there is none."""
    taken = {name for other in signals.values() if other is not signal for name in other.names}
    return next((name for name in signal.names if name not in taken), "")


def _notes(columns: list[Column], signals: Mapping[int, _Signal]) -> Iterator[str]:
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


def _nth(value: Any, number: int) -> str:
    """A text, or that of a column among several."""
    if isinstance(value, str):
        return value.strip()
    if value is None or isinstance(value, Mapping) or not hasattr(value, "__len__"):
        return ""
    return str(value[number]).strip() if number < len(value) else ""
