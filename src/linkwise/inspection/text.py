"""The text that an inspection prints."""

from __future__ import annotations

from linkwise.display import align_columns, as_text, remark_lines
from linkwise.inspection.alert import Alert
from linkwise.inspection.result import ChannelSummary, Inspection, labels

HEAD = (
    "channel", "samples", "missing", "minimum", "maximum", "rms", "noise", "SNR dB", "bits", "up to Hz", "per period", "unit",
)  # fmt: skip


@as_text.register
def inspection_text(inspection: Inspection) -> str:
    """The comparison of levels, alerts, then a table of the channels of each record."""
    compared = [] if inspection.levels is None else [str(inspection.levels), ""]
    return "\n".join([*compared, *alert_lines(inspection), *_tables(inspection)])


def headline(inspection: Inspection) -> str:
    """How much is wrong, in one sentence."""
    count = len(inspection.alerts)
    if not count:
        return "Nothing wrong was seen."
    return f"{count} alert{'s' if count > 1 else ''}, worst first."


def alert_lines(inspection: Inspection) -> list[str]:
    """The headline, and a paragraph for each alert."""
    return [
        headline(inspection),
        *(remark_lines(alert_text(inspection, alert)) for alert in inspection.alerts),
    ]


def alert_text(inspection: Inspection, alert: Alert) -> str:
    """An alert in one line, with the record where there are several."""
    return f"{alert.record}: {alert}" if len(inspection.records) > 1 else str(alert)


def channel_row(channel: ChannelSummary) -> tuple[str, ...]:
    """The cells of a channel below `HEAD`."""
    return (
        channel.name,
        str(channel.samples),
        str(channel.missing) if channel.missing else "",
        *(_number(value) for value in (channel.minimum, channel.maximum, channel.rms, channel.noise)),
        "" if channel.snr_db is None else f"{channel.snr_db:.1f}",
        "" if channel.bits is None else f"{channel.bits:.1f}",
        _number(channel.highest_frequency),
        "" if channel.samples_per_period is None else f"{channel.samples_per_period:.3g}",
        channel.unit,
    )


def _tables(inspection: Inspection) -> list[str]:
    lines: list[str] = []
    for label, record in zip(labels(inspection.records), inspection.records, strict=True):
        end = record.start + record.duration
        span = f"{len(record)} samples at {record.rate:g} Hz, {record.start:g} to {end:g} s"
        rows = [channel_row(summary) for summary in inspection.channels if summary.record == label]
        lines += ["", f"{label}: {span}", *align_columns([HEAD, *rows])]
    return lines


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}"
