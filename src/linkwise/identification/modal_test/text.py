"""The printed modal test: trust, and the modes with their standard errors."""

from __future__ import annotations

from linkwise.display import (
    align_columns,
    as_text,
    format_duration,
    format_error,
    format_value,
    paragraph,
    remark_lines,
)
from linkwise.identification.modal_test.result import HostEstimate

_POINTS = 6  # whose shapes are printed
_SHOWN = 3.0  # standard errors from which damping between modes is printed


@as_text.register
def modal_test_text(estimate: HostEstimate) -> str:
    """The whole result as text."""
    host = estimate.host
    trust = "can be trusted" if estimate.trusted else "NOT to be trusted"
    status = " ".join(verdict.value for verdict in estimate.verdicts)
    head = f"{host.name}: {len(host.modes)} modes at {len(host.points)} points, {trust}"
    numbers = f"{estimate.samples} samples, chi-square {estimate.chi_square_per_sample:.3f}"
    summary = f"{status} ({numbers}, {format_duration(estimate.seconds)})"
    points = tuple(host.modes[0].shape)[:_POINTS]
    rows: list[tuple[str, ...]] = [
        ("", "frequency [Hz]", "std. error", "damping [%]", "std. error", *points, "std. error")
    ]
    for name, mode in zip(host.coordinates, host.modes, strict=True):
        frequency, damping = mode.frequency, mode.damping
        errors = [mode.shape_sigma[point] for point in points]
        rows.append(
            (
                name,
                format_value(frequency.value or 0.0, frequency.sigma),
                format_error(frequency.sigma),
                format_value(100.0 * (damping.value or 0.0), 100.0 * damping.sigma),
                format_error(100.0 * damping.sigma),
                *(format_value(mode.shape[point], mode.shape_sigma[point]) for point in points),
                f"up to {format_error(max(errors))}",
            )
        )
    between = [
        (
            name,
            format_value(entry.value or 0.0, entry.sigma),
            format_error(entry.sigma),
        )
        for name, entry in zip(host.damping_links.values(), host.entries.values(), strict=True)
        if abs(entry.value or 0.0) > _SHOWN * entry.sigma
    ]
    blocks = [f"{head}\n{paragraph(summary)}", "\n".join(align_columns(rows))]
    if host.damping:
        title = f"damping between modes: {len(host.damping)} pairs are free, {len(between)} of them stand out"
        table = align_columns([("", "damping [N s/m]", "std. error"), *between]) if between else []
        blocks.append("\n".join([title, *table]))
    blocks += [remark_lines(remark) for remark in estimate.remarks]
    return "\n\n".join(blocks)
