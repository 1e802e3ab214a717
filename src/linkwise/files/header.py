"""The header of a column: `time`, `x:m1`, or either with a unit, `time[ms]`, `x:m1 (mm)`."""

from __future__ import annotations

import re
from dataclasses import dataclass

from linkwise.errors import LinkwiseError, RecordError
from linkwise.records.channel import QUANTITIES, UNITS, Channel
from linkwise.units import factor_to_si

_UNIT = re.compile(r"^(.*?)\s*(?:\[([^\[\]]*)\]|\(([^():,]*)\))$", re.DOTALL)
_TIME = frozenset({"time", "t"})


@dataclass(frozen=True)
class ColumnHeader:
    """A header taken apart: `name` without its unit, `unit` as written ("" where none is)."""

    name: str
    unit: str = ""

    @classmethod
    def parse(cls, text: str) -> ColumnHeader:
        """Never fails: text without a unit at its end is all name."""
        text = text.strip().strip("\"'").strip()
        match = _UNIT.match(text)
        if match is None or not match[1]:
            return cls(text)
        return cls(match[1].strip(), (match[2] if match[2] is not None else match[3]).strip())

    @property
    def is_time(self) -> bool:
        """True for `time` and `t`, whatever their case."""
        return self.name.lower() in _TIME

    @property
    def channel(self) -> Channel | None:
        """The channel that the name spells, None where it spells none."""
        kind, _, mass = (part.strip() for part in self.name.partition(":"))
        try:
            return Channel.parse(f"{kind}:{mass}")
        except RecordError:
            return None

    @property
    def leaf(self) -> ColumnHeader:
        """The heading without the groups above it: `run1/x:m1[mm]` is x:m1 in mm."""
        return ColumnHeader(self.name.rpartition("/")[2], self.unit)


def si_factor(unit: str, kind: str, *, file: str, line: int | None, channel: str) -> float:
    """What a value in `unit` is multiplied by to be in the SI unit of `kind` (a kind of channel, or "time").

    `g` is the standard gravity for an acceleration, not the gram. Raises RecordError for a unit that is unknown or measures
    something else.
    """
    if not unit:
        return 1.0
    dimension, quantity = ("s", "time") if kind == "time" else (UNITS[kind], QUANTITIES[kind])
    try:
        return factor_to_si(unit, dimension)
    except LinkwiseError as error:
        message = (
            f"{unit!r} is no unit of {quantity}; expected {dimension} or what converts to it. Correct the header, "
            f"or name unit and column with --channel '{channel}[{dimension}]=COLUMN'"
        )
        raise RecordError(message, file, line, channel) from error
