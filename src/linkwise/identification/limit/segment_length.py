"""How long the segments of the bound are: as long as the sensitivities in them are resolved."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from linkwise.errors import IdentificationError
from linkwise.likelihood.fisher_information import Precision
from linkwise.records.record import Record

SHORTEST = 0.25  # s, over which sensitivities of the paper's chaotic chains stay finite (METHODS section 5)
_MOST_STEPS = 50_000  # of the sensitivities, one after the other, in a segment that is not asked for
_NUMBERS = 10_000_000  # in the sensitivities of such a segment
_WORSE = (
    1.02  # ratio of standard errors; those of longer segments are smaller, but for what is lost of digits
)

Bound = Callable[[int], Precision | None]
"""The bound with segments of so many samples; None where sensitivities grow beyond all numbers."""


def longest_resolved(record: Record, least: int, refinement: int, bound: Bound) -> tuple[Precision, int]:
    """The bound with the longest segments that keep its digits, and their samples, no fewer than `least`.

    In chaotic motion sensitivities grow until the start of a segment cannot be told from a coefficient; a longer segment then
    seems to determine less than its two halves do.
    """
    lengths = _lengths(record, least)
    length, precision = lengths[0], _of_the_shortest(record, lengths[0], bound)
    unknowns = len(precision.scale) + least * len(record.responses)
    for longer in lengths[1:]:
        steps = longer * refinement
        if steps > _MOST_STEPS or longer * len(record.responses) * unknowns > _NUMBERS:
            break
        attempt = bound(longer)
        if attempt is None or _has_lost(attempt, precision):
            break
        length, precision = longer, attempt
    return precision, length


def as_asked(record: Record, samples: int, least: int, bound: Bound) -> Precision:
    """The bound with segments of so many samples; IdentificationError if they determine less than the shortest do."""
    precision, shortest = bound(samples), _lengths(record, least)[0]
    if precision is not None and (samples <= shortest or not precision.null_directions.shape[1]):
        return precision
    before = _of_the_shortest(record, min(samples, shortest), bound)
    if precision is None or _has_lost(precision, before):
        raise IdentificationError(
            f"segments of {samples * record.step:g} s are too long: in chaotic motion sensitivities grow beyond the digits "
            f"of a computer, and what segments of {shortest * record.step:g} s determine would not be identifiable; take "
            "shorter segments, or none, for the longest that are resolved",
            arguments=("segment",),
        )
    return precision


def _of_the_shortest(record: Record, samples: int, bound: Bound) -> Precision:
    """The bound with the shortest segments there are; IdentificationError where sensitivities overflow even there."""
    precision = bound(samples)
    if precision is None:
        raise IdentificationError(
            f"sensitivities grow beyond all numbers within {samples * record.step:g} s: {record.rate:g} Hz are too few for "
            "the fastest motion of this structure; sample faster",
            arguments=("rate",),
        )
    return precision


def _lengths(record: Record, least: int) -> list[int]:
    """Samples of segments: 0.25 s, but at least `least`, then twice as many and so on, and at last the whole record."""
    lengths = [max(least, round(SHORTEST / record.step))]
    while lengths[-1] < len(record):
        lengths.append(2 * lengths[-1])
    return [*lengths[:-1], len(record)]


def _has_lost(longer: Precision, shorter: Precision) -> bool:
    """Whether longer segments determine fewer combinations, or anything less precisely."""
    if longer.null_directions.shape[1] > shorter.null_directions.shape[1]:
        return True
    unit = np.eye(len(longer.scale))
    errors, before = (np.sqrt(precision.variance(unit)) for precision in (longer, shorter))
    return bool((errors > _WORSE * before).any())
