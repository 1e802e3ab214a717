"""The result of `absorption_intervals` as rows of text, for print and for the page."""

from __future__ import annotations

from linkwise.absorption.intervals import AbsorptionIntervals, QuantityInterval
from linkwise.absorption.sweep_text import value_text
from linkwise.display import align_columns, as_text

Rows = list[tuple[str, ...]]


@as_text.register
def intervals_text(intervals: AbsorptionIntervals) -> str:
    """The whole result as text."""
    rows: Rows = [(*row, "") for row in interval_rows(intervals)]
    table = "\n".join([interval_headline(intervals), *align_columns(rows)])
    return f"{intervals.absorption}\n\n{table}"


def interval_headline(intervals: AbsorptionIntervals) -> str:
    """What the intervals are, in a sentence."""
    diverged = f", of which {intervals.diverged} diverged" if intervals.diverged else ""
    return f"95 % of {intervals.draws} draws of the identified structure (seed {intervals.seed}){diverged} lie within:"


def interval_rows(intervals: AbsorptionIntervals) -> Rows:
    """Each quantity at the identified values, and its interval."""
    return [
        ("quantity", "identified", "95 % interval"),
        *(
            (interval.quantity.title, _text(interval, interval.value), _range(interval))
            for interval in intervals.quantities
        ),
    ]


def _range(interval: QuantityInterval) -> str:
    if interval.lower is None:
        return _text(interval, None)
    return f"{_text(interval, interval.lower)} to {_text(interval, interval.upper)}"


def _text(interval: QuantityInterval, value: float | None) -> str:
    if value is None:
        return "never" if interval.quantity.name.startswith("settled") else "-"
    return value_text(interval.quantity, value)
