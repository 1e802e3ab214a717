"""The header of a column: `time`, `x:m1`, or either with a unit, `time[ms]`, `x:m1 (mm)`."""

from __future__ import annotations

import re
from dataclasses import dataclass

from linkwise.errors import LinkwiseError, RecordError
from linkwise.records.channel import KINDS, Channel, is_angular
from linkwise.records.record import Record
from linkwise.units import factor_to_si

_UNIT = re.compile(r"^(.*?)\s*(?:\[([^\[\]]*)\]|\(([^():,]*)\))$", re.DOTALL)
_TIME = frozenset({"time", "t"})


@dataclass(frozen=True)
class ColumnHeader:
    """A column header: `name` without its unit, and `unit` as written ("" without one)."""

    name: str
    unit: str = ""

    @classmethod
    def parse(cls, text: str) -> ColumnHeader:
        """Split a header; a text that does not end with a unit is all name."""
        text = text.strip().strip("\"'").strip()
        match = _UNIT.match(text)
        if match is None or not match[1]:
            return cls(text)
        return cls(match[1].strip(), (match[2] if match[2] is not None else match[3]).strip())

    @property
    def is_time(self) -> bool:
        """Whether the name is `time` or `t`, in upper or lower case."""
        return self.name.lower() in _TIME

    @property
    def channel(self) -> Channel | None:
        """The channel of this name; None if it is not the name of a channel."""
        parts = (part.strip() for part in self.name.split(":"))
        try:
            return Channel.parse(":".join(parts))
        except RecordError:
            return None

    @property
    def leaf(self) -> ColumnHeader:
        """The header without the groups above it: `run1/x:m1[mm]` is x:m1 in mm."""
        return ColumnHeader(self.name.rpartition("/")[2], self.unit)


def si_factor(unit: str, kind: str, *, file: str, line: int | None, channel: str) -> float:
    """Factor from `unit` to the SI unit of `kind` (a kind of channel, or "time"); that of a rotation for an angular unit.

    For an acceleration, `g` is standard gravity. Raises RecordError for a unit that is unknown or of another quantity.
    """
    dimension, quantity = ("s", "time") if kind == "time" else (KINDS[kind].unit, KINDS[kind].quantity)
    if not unit or (unit == dimension and kind != "time"):
        return 1.0
    if is_angular(unit, kind):
        return factor_to_si(unit, KINDS[kind].angular_unit)
    try:
        return factor_to_si(unit, dimension)
    except LinkwiseError as error:
        message = (
            f"{unit!r} is not a unit of {quantity}; expected {dimension} or a unit that converts to it. Correct the header, "
            f"or map the column with its unit, as in channels={{'{channel}[{dimension}]': 'NAME'}}"
        )
        raise RecordError(message, file, line, channel, arguments=("channels",)) from error


def headers(record: Record) -> tuple[str, ...]:
    """The headers under which a file holds the channels in SI units: those of places that turn state their unit."""
    return tuple(
        name if record.unit(name) == name.unit else f"{name}[{record.unit(name)}]" for name in record.channels
    )
