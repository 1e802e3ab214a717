"""The printed estimate: one plain table that tells whether to trust it, readable in a terminal, a log or a doctest."""

from __future__ import annotations

from math import isfinite
from textwrap import fill

from linkwise.estimates.estimate import Estimate
from linkwise.estimates.link_estimate import CoefficientEstimate, DerivedQuantity, LinkEstimate
from linkwise.text import align_columns, as_text, format_error, format_value

_MANY = 12  # channels or links that are shown
_WIDTH = 100  # at which sentences are broken
_HEAD = ("", "value", "std. error", "95 % interval", "unit")


@as_text.register
def text_table(estimate: Estimate) -> str:
    """The whole answer as text."""
    blocks = [_verdict(estimate), _noise(estimate)]
    unknown = [mass for mass in estimate.masses if not mass.known]
    if unknown:
        rows = [_row(mass, mass.name.removesuffix(".mass")) for mass in unknown]
        blocks.append("\n".join(["masses", *align_columns([_HEAD, *rows])]))
    shown = [link for link in estimate.links if link.free]
    blocks += [_link(link) for link in shown[:_MANY]]
    if len(shown) > _MANY:
        blocks.append(f"... and {len(shown) - _MANY} more links; every one stands in the result folder")
    if estimate.findings:
        blocks.append(
            "\n".join(fill(f"! {each}", _WIDTH, subsequent_indent="  ") for each in estimate.findings)
        )
    return "\n\n".join(blocks)


def _verdict(estimate: Estimate) -> str:
    trust = "can be trusted" if estimate.trusted else "NOT to be trusted"
    chi = (
        "" if estimate.chi_square_per_sample is None else f", chi-square {estimate.chi_square_per_sample:.3f}"
    )
    head = f"{estimate.structure.name or 'structure'}: {estimate.method}, {estimate.status}, {trust}"
    told = f"{estimate.explanation} ({estimate.samples} samples{chi}, {estimate.seconds:.2g} s)"
    return f"{head}\n{fill(told, _WIDTH)}"


def _noise(estimate: Estimate) -> str:
    found = list(estimate.noise.items())
    rows = [
        (
            name,
            f"{each.sigma:.3g} {each.unit}",
            f"{each.snr_db:.1f} dB" if isfinite(each.snr_db) else "no noise",
        )
        for name, each in found[:_MANY]
    ]
    lines = align_columns([("noise", "deviation", "signal/noise"), *rows])
    if len(found) > _MANY:
        lines.append(f"... and {len(found) - _MANY} more channels")
    return "\n".join(lines)


def _link(link: LinkEstimate) -> str:
    rows = [_row(each, each.name.rpartition(".")[2]) for each in link.coefficients]
    rows += [_derived(each, f"well {i}") for i, each in enumerate(link.wells, start=1)]
    if link.barrier is not None:
        rows.append(_derived(link.barrier, "barrier"))
    rows += [_derived(each, f"frequency {i}") for i, each in enumerate(link.frequencies, start=1)]
    head = f"{link.link.name} ({' - '.join(link.link.between)}): {link.link.law.text}"
    seen = f"seen: d {link.d_range[0]:.4g} to {link.d_range[1]:.4g} m, v {link.v_range[0]:.4g} to {link.v_range[1]:.4g} m/s"
    return "\n".join([head, *align_columns([_HEAD, *rows]), f"  {seen}"])


def _row(each: CoefficientEstimate, label: str) -> tuple[str, ...]:
    if each.known:
        return label, format_value(each.value), "given", "", each.unit
    if each.standard_error is None:
        return label, format_value(each.value), "none", "", each.unit
    if each.interval is None:
        return (
            label,
            format_value(each.value, each.standard_error),
            format_error(each.standard_error),
            "none",
            each.unit,
        )
    low, high = (format_value(end, each.standard_error) for end in each.interval)
    return (
        label,
        format_value(each.value, each.standard_error),
        format_error(each.standard_error),
        f"{low} to {high}",
        each.unit,
    )


def _derived(each: DerivedQuantity, label: str) -> tuple[str, ...]:
    if each.interval is None:
        return label, format_value(each.value), "", "", each.unit
    error = 0.25 * (each.interval[1] - each.interval[0])
    low, high = (format_value(end, error) for end in each.interval)
    return label, format_value(each.value, error), "", f"{low} to {high}", each.unit
