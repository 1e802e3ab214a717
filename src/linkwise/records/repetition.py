"""Several records taken together: each must be a measurement of its own."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from linkwise.errors import RecordError
from linkwise.records.record import Record


def check_distinct(records: Sequence[Record]) -> None:
    """Raise RecordError if two records are the same measurement, which would halve the variance of every estimate.

    Two are the same if they hold the same samples in all responses that both have, and have as many samples.
    """
    for (first, first_record), (second, second_record) in combinations(enumerate(records, start=1), 2):
        shared = [name for name in first_record.responses if name in second_record.responses]
        if (
            shared
            and len(first_record) == len(second_record)
            and all(_equal(first_record, second_record, name) for name in shared)
        ):
            names = f"records {first} and {second}" + (
                f" ({first_record.source})" if first_record.source else ""
            )
            raise RecordError(f"{names} hold the same samples; give each record once")


def _equal(first: Record, second: Record, name: str) -> bool:
    return np.array_equal(first.channel(name), second.channel(name), equal_nan=True)


def joined_notes(records: Sequence[Record]) -> tuple[str, ...]:
    """The notes of all records, each once."""
    return tuple(dict.fromkeys(note for record in records for note in record.notes))
