"""The printed limit: noise, the errors of coefficients and forces, wells, and what is not identifiable."""

from __future__ import annotations

import numpy as np

from linkwise.display import align_columns, as_text, format_value
from linkwise.estimates.link_estimate import CoefficientEstimate, DerivedQuantity
from linkwise.identification.limit.result import DETECTION, Limit, LinkLimit
from linkwise.records.channel_units import channel_unit

Rows = list[tuple[str, ...]]

_MOST_ROWS = 40  # of a table that are printed
_MOST_NAMES = 6  # of channels that are listed in full


@as_text.register
def limit_text(limit: Limit) -> str:
    """The whole result as text."""
    head = (
        f"{limit.structure.name or 'structure'}: the accuracy that this test allows\n"
        f"{limit.verdicts[0].value}\n"
        f"{len(limit.record)} samples each of {_listed(list(limit.noise))} at {limit.record.rate:g} Hz, {_segments(limit)}"
    )
    noise: Rows = [
        ("noise", "deviation"),
        *((name, _noise_text(limit, name)) for name in limit.noise),
    ]
    title = ("coefficient", "value", "std. error", "relative", "detectable", "unit")
    forces = [(link.name, _percent(link.nmse), _detectable(link), "") for link in limit.links]
    blocks = [
        head,
        _table(noise),
        _table([title, *(_coefficient_row(coefficient) for coefficient in limit.coefficients)]),
        _table([("force of", "expected NMSE", "detectable", ""), *forces]),
    ]
    wells = [row for link in limit.links for row in _well_rows(link)]
    if wells:
        blocks.append(_table([("", "value", "95 % interval", "unit"), *wells]))
    if limit.findings:
        blocks.append("\n".join(f"! {finding}" for finding in limit.findings))
    return "\n\n".join(blocks)


def _segments(limit: Limit) -> str:
    """What a free start of each segment leaves of the record, in words."""
    if limit.segment * limit.record.rate >= len(limit.record) - 0.5:
        return "in one segment with a\nfree start, as a fit of the whole record has it."
    return (
        f"in segments of {limit.segment:g} s with free starts;\na fit that links segments, as identify does, comes out "
        "better, in chaotic motion several times."
    )


def _table(rows: Rows) -> str:
    """A title and rows in aligned columns; of a long table the first rows and the number of the others."""
    lines = align_columns(rows)
    left_out = len(lines) - 1 - _MOST_ROWS
    if left_out > 0:
        lines = [*lines[: 1 + _MOST_ROWS], f"  ... and {left_out} more"]
    return "\n".join(lines)


def _listed(names: list[str]) -> str:
    return ", ".join(names) if len(names) <= _MOST_NAMES else f"{', '.join(names[:4])}, ..., {names[-1]}"


def _noise_text(limit: Limit, name: str) -> str:
    return f"{limit.noise[name]:.3g} {channel_unit(limit.record, name, limit.structure)}".strip()


def _coefficient_row(coefficient: CoefficientEstimate) -> tuple[str, ...]:
    error, value = coefficient.standard_error, format_value(coefficient.value)
    assert error is not None
    if not np.isfinite(error):
        return coefficient.name, value, "not identifiable", "", "", coefficient.unit
    relative = _percent(100.0 * error / abs(coefficient.value)) if coefficient.value else ""
    detectable = f"{DETECTION * error:.2g}"
    return coefficient.name, value, f"{error:.2g}", relative, detectable, coefficient.unit


def _percent(share: float) -> str:
    return f"{share:.2g} %" if np.isfinite(share) else "not identifiable"


def _detectable(link: LinkLimit) -> str:
    unit = link.estimate.link.law.force_unit
    return f"{link.detectable:.2g} {unit}" if np.isfinite(link.detectable) else "not identifiable"


def _well_rows(link: LinkLimit) -> Rows:
    """Rows of the wells and the barrier of a link that has them."""
    estimate = link.estimate
    named = [(f"{link.name} well {number}", well) for number, well in enumerate(estimate.wells, start=1)]
    named += [(f"{link.name} barrier", estimate.barrier)] if estimate.barrier is not None else []
    return [_derived_row(label, quantity) for label, quantity in named]


def _derived_row(label: str, quantity: DerivedQuantity) -> tuple[str, ...]:
    if quantity.interval is None:
        return label, format_value(quantity.value), "not identifiable", quantity.unit
    error = 0.25 * (quantity.interval[1] - quantity.interval[0])
    low, high = (format_value(end, error) for end in quantity.interval)
    return label, format_value(quantity.value, error), f"{low} to {high}", quantity.unit
