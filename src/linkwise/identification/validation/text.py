"""A validation as text."""

from __future__ import annotations

from linkwise.display import align_columns, as_text, format_error, format_value, paragraph, remark_lines
from linkwise.identification.validation.result import Validation

CHANNEL_HEAD = ("channel", "RMSE", "allowed", "one step", "noise", "NMSE, %", "fit, %", "unit")
COEFFICIENT_HEAD = ("coefficient", "answer", "this record", "apart", "unit")


@as_text.register
def validation_text(validation: Validation) -> str:
    """The whole result as text."""
    blocks = ["\n".join(paragraph(line) for line in headline(validation))]
    blocks.append("\n".join(align_columns([CHANNEL_HEAD, *channel_rows(validation)])))
    if validation.coefficients:
        blocks.append("\n".join(align_columns([COEFFICIENT_HEAD, *coefficient_rows(validation)])))
    if validation.findings:
        blocks.append("\n".join(remark_lines(entry) for entry in validation.findings))
    return "\n\n".join(blocks)


def headline(validation: Validation) -> tuple[str, ...]:
    """The verdict and what was run, in sentences."""
    record = validation.record
    scored = record.duration - validation.burn
    if validation.free_run:
        run = f"One free run of {scored:.4g} s"
    else:
        run = (
            f"The motion is chaotic: an error of the state hides it after {validation.horizon:.3g} s. {validation.windows} "
            f"runs of {validation.window:.3g} s each"
        )
    return (
        validation.verdicts[0].value,
        f"{run}, after {validation.burn:.4g} s that determine the state and are not scored.",
    )


def channel_rows(validation: Validation) -> list[tuple[str, ...]]:
    """A row for each channel."""
    return [
        (
            entry.name,
            f"{entry.rmse:.4g}",
            f"{entry.limit:.4g}",
            f"{entry.one_step_rmse:.4g}",
            f"{entry.noise:.4g}",
            f"{entry.nmse_percent:.3g}",
            f"{entry.fit_percent:.2f}",
            entry.unit,
        )
        for entry in validation.channels.values()
    ]


def coefficient_rows(validation: Validation) -> list[tuple[str, ...]]:
    """A row for each coefficient that the answer gives with an interval."""
    return [
        (
            entry.name,
            f"{format_value(entry.value, entry.standard_error)} ± {format_error(entry.standard_error)}",
            f"{format_value(entry.record_value, entry.record_error)} ± {format_error(entry.record_error)}",
            f"{entry.z:+.1f}",
            entry.unit,
        )
        for entry in validation.coefficients
    ]
