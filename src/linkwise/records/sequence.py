"""One record or several, as a list."""

from __future__ import annotations

from collections.abc import Sequence

from linkwise.argument_types import check_type
from linkwise.records.record import Record


def record_list(records: Record | Sequence[Record], argument: str = "record") -> list[Record]:
    """The records of a public function that takes one or several; raises `ArgumentTypeError` for what is no record."""
    if isinstance(records, Record):
        return [records]
    listed = list(records)
    for number, record in enumerate(listed):
        check_type(f"{argument}[{number}]", record, Record)
    return listed
