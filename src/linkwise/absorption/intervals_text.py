"""Intervals of absorption as rows of text, for print and for the page."""

from __future__ import annotations

from linkwise.absorption.intervals import AbsorptionIntervals, QuantityInterval
from linkwise.absorption.sweep_text import value_text
from linkwise.text import align_columns, as_text

Rows = list[tuple[str, ...]]


@as_text.register
def intervals_text(told: AbsorptionIntervals) -> str:
    """The intervals as text."""
    rows: Rows = [(*row, "") for row in interval_rows(told)]
    intervals = "\n".join([interval_headline(told), *align_columns(rows)])
    return f"{told.found}\n\n{intervals}"


def interval_headline(told: AbsorptionIntervals) -> str:
    """What the intervals are, in a sentence."""
    lost = f", of which {told.diverged} diverged" if told.diverged else ""
    return f"95 % of {told.draws} draws of the identified structure (seed {told.seed}){lost} lie within:"


def interval_rows(told: AbsorptionIntervals) -> Rows:
    """Each quantity at the identified numbers, and its interval."""
    rows: Rows = [("quantity", "identified", "95 % interval")]
    return [
        *rows,
        *((each.quantity.title, _text(each, each.value), _range(each)) for each in told.quantities),
    ]


def _range(each: QuantityInterval) -> str:
    if each.lower is None:
        return _text(each, None)
    return f"{_text(each, each.lower)} to {_text(each, each.upper)}"


def _text(each: QuantityInterval, value: float | None) -> str:
    if value is None:
        return "never" if each.quantity.name.startswith("settled") else "-"
    return value_text(each.quantity, value)
