"""One record or several, as a list."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from linkwise.argument_types import check_type
from linkwise.records.record import Record


def record_list(call: str, records: Record | Sequence[Record], argument: str = "record") -> list[Record]:
    """The records of a public function that takes one or several; TypeError for what is no record."""
    if isinstance(records, Record):
        return [records]
    if isinstance(records, str | Mapping) or not isinstance(records, Iterable):
        check_type(call, argument, records, Record)
    listed = list(records)
    for record in listed:
        check_type(call, argument, record, Record)
    return listed
