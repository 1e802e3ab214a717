"""The printed estimate: its trust, noise and coefficients as plain text."""

from __future__ import annotations

from math import isfinite

from linkwise.display import (
    align_columns,
    as_text,
    format_chi_square,
    format_duration,
    format_error,
    format_value,
    paragraph,
    remark_lines,
)
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.link_estimate import CoefficientEstimate, DerivedQuantity, LinkEstimate

_MANY = 12  # channels or links that are shown
_RATES = 3  # states of a link whose rates are printed; the result folder has all
_SHAPES = 6  # of modes at points, that are shown
_CAUSES = 4  # of what is left, that are shown
_DIFFERS = (
    0.1  # of an interval's half: from here a profile interval says something that a standard error does not
)
_HEAD = ("", "value", "std. error", "95 % interval", "unit")


@as_text.register
def text_table(estimate: Estimate) -> str:
    """The whole estimate as `print` shows it: trust, noise, coefficients and findings."""
    blocks = [_verdict(estimate), _noise(estimate)]
    unknown = [mass for mass in estimate.masses if not mass.known]
    if unknown:
        rows = [_row(mass, mass.name.removesuffix(".mass")) for mass in unknown]
        blocks.append("\n".join(["masses", *align_columns([_HEAD, *rows])]))
    of_modes = [c for mode in estimate.modes if mode.free for c in mode.coefficients]
    if of_modes:
        rows = [_row(coefficient, coefficient.name) for coefficient in of_modes]
        blocks.append("\n".join(["modes", *align_columns([_HEAD, *rows])]))
    if estimate.shapes:
        blocks.append(_shapes(estimate))
    shown = [link for link in estimate.links if link.free]
    blocks += [_link(link) for link in shown[:_MANY]]
    if len(shown) > _MANY:
        blocks.append(f"... and {len(shown) - _MANY} more links; the result folder lists all of them")
    if estimate.profile_intervals:
        blocks.append(_profiles(estimate))
    if len(estimate.diagnosis) > 1:
        blocks.append(_diagnosis(estimate))
    if estimate.findings:
        blocks.append("\n".join(remark_lines(finding) for finding in estimate.findings))
    return "\n\n".join(blocks)


def _verdict(estimate: Estimate) -> str:
    trust = "can be trusted" if estimate.trusted else "NOT to be trusted"
    value = estimate.chi_square_per_sample
    chi = "" if value is None else f", chi-square {format_chi_square(value)}"
    head = f"{estimate.structure.name or 'structure'}: {estimate.method}, {estimate.status}, {trust}"
    summary = f"{estimate.explanation} ({estimate.samples} samples{chi}, {format_duration(estimate.seconds)})"
    return f"{head}\n{paragraph(summary)}"


def _shapes(estimate: Estimate) -> str:
    """The shapes that moved farthest from what was known of them, in its standard deviations."""
    known = {p.name: (p.start or 0.0, p.sigma) for p in estimate.parameters}
    moved = sorted(
        (
            (abs(shape.value - known[shape.name][0]) / known[shape.name][1], shape)
            for shape in estimate.shapes
        ),
        key=lambda pair: -pair[0],
    )
    lines = ["shapes", *align_columns([_HEAD, *(_row(shape, shape.name) for _, shape in moved[:_SHAPES])])]
    if len(moved) > _SHAPES:
        lines.append(
            f"  ... and {len(moved) - _SHAPES} more, which moved by {moved[_SHAPES][0]:.2g} of their standard deviation "
            "beforehand or less; the result folder lists all of them"
        )
    return "\n".join(lines)


def _diagnosis(estimate: Estimate) -> str:
    rows = [(cause.description, f"{cause.gain:.3g}") for cause in estimate.diagnosis[:_CAUSES]]
    return "\n".join(align_columns([("what is left would be explained by", "gain"), *rows]))


def _profiles(estimate: Estimate) -> str:
    """Profile intervals, with a mark on those that differ from the intervals of the standard errors."""
    rows = []
    for name, ends in estimate.profile_intervals.items():
        coefficient = estimate.coefficient(name)
        differs = coefficient.interval is not None and any(
            abs(end - standard) > _DIFFERS * (coefficient.interval[1] - coefficient.value)
            for end, standard in zip(ends, coefficient.interval, strict=True)
        )
        mark = "  differs from the table: trust this one" if differs else ""
        rows.append((name, f"{ends[0]:.6g} to {ends[1]:.6g} {coefficient.unit}{mark}"))
    return "\n".join(["95 % intervals that follow the likelihood (profiles)", *align_columns(rows)])


def _noise(estimate: Estimate) -> str:
    channels = list(estimate.noise.items())
    rows = [
        (
            name,
            f"{noise.sigma:.3g} {noise.unit}",
            f"{noise.snr_db:.1f} dB" if isfinite(noise.snr_db) else "no noise",
        )
        for name, noise in channels[:_MANY]
    ]
    lines = align_columns([("noise", "deviation", "signal/noise"), *rows])
    if len(channels) > _MANY:
        lines.append(f"... and {len(channels) - _MANY} more channels")
    return "\n".join(lines)


def _link(link: LinkEstimate) -> str:
    rows = [_row(coefficient, coefficient.name.key) for coefficient in link.coefficients]
    rows += [_derived(well, f"well {i}") for i, well in enumerate(link.wells, start=1)]
    if link.barrier is not None:
        rows.append(_derived(link.barrier, "barrier"))
    rows += [_derived(frequency, f"frequency {i}") for i, frequency in enumerate(link.frequencies, start=1)]
    head = f"{link.link.name} ({' - '.join(link.link.between)}): {link.link.law.text}"
    d_low, d_high, v_low, v_high = (f"{end:.4g}" for end in (*link.d_range, *link.v_range))
    of_d, of_v = link.link.law.motion_units
    visited = f"range: d {d_low} to {d_high} {of_d}, v {v_low} to {v_high} {of_v}"
    rates = [f"  {rate}" for rate in link.link.rate_texts[:_RATES]]
    if len(link.link.rate_texts) > _RATES:
        rates.append(f"  ... and {len(link.link.rate_texts) - _RATES} more states")
    return "\n".join([head, *rates, *align_columns([_HEAD, *rows]), f"  {visited}"])


def _row(coefficient: CoefficientEstimate, label: str) -> tuple[str, ...]:
    if coefficient.known:
        return label, format_value(coefficient.value), "given", "", coefficient.unit
    if coefficient.standard_error is None:
        return label, format_value(coefficient.value), "none", "", coefficient.unit
    if coefficient.interval is None:
        return (
            label,
            format_value(coefficient.value, coefficient.standard_error),
            format_error(coefficient.standard_error),
            "none",
            coefficient.unit,
        )
    low, high = (format_value(end, coefficient.standard_error) for end in coefficient.interval)
    return (
        label,
        format_value(coefficient.value, coefficient.standard_error),
        format_error(coefficient.standard_error),
        f"{low} to {high}",
        coefficient.unit,
    )


def _derived(quantity: DerivedQuantity, label: str) -> tuple[str, ...]:
    if quantity.interval is None:
        return label, format_value(quantity.value), "", "", quantity.unit
    error = 0.25 * (quantity.interval[1] - quantity.interval[0])
    low, high = (format_value(end, error) for end in quantity.interval)
    return label, format_value(quantity.value, error), "", f"{low} to {high}", quantity.unit
