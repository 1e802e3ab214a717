"""The text that a comparison of levels prints."""

from __future__ import annotations

import numpy as np

from linkwise.display import align_columns, as_text, format_error, format_value, paragraph
from linkwise.inspection.levels.bridged_gaps import BridgedGaps
from linkwise.inspection.levels.result import LevelComparison
from linkwise.inspection.levels.ring_down import RingDown

_ROWS = 5  # of a ring-down


@as_text.register
def levels_text(comparison: LevelComparison) -> str:
    """The verdict, then a table of modes over level, distortion, and what modes do as they ring down."""
    blocks = [
        "\n".join(map(paragraph, headline(comparison))),
        "\n".join(align_columns(mode_rows(comparison))),
    ]
    distorted = distortion_rows(comparison)
    if len(distorted) > 1:
        blocks.append("\n".join(align_columns(distorted)))
    rings = ring_down_rows(comparison)
    if len(rings) > 1:
        blocks.append("\n".join(align_columns(rings)))
    gaps = gaps_text(comparison)
    if gaps:
        blocks.append(paragraph(gaps))
    return "\n\n".join(blocks)


def headline(comparison: LevelComparison) -> list[str]:
    """Whether the structure moved linearly, in a sentence, and the verdicts that forbid trust in it."""
    return [_claim(comparison), *(verdict.value for verdict in comparison.verdicts if verdict.forbids)]


def _claim(comparison: LevelComparison) -> str:
    first = comparison.first_nonlinear
    moving = [ring for ring in comparison.ring_downs if ring.moves]
    if first is None and moving:
        return f"Not linear: as it rings down, {'; '.join(map(_moved, moving))}."
    if first is None:
        claim = "Linear" if comparison.trusted else "Perhaps linear"
        by = "with the level" if len(comparison.levels) > 1 else "as it rings down"
        return f"{claim} up to {_level(comparison, -1)}: no mode moves {by} by more than its errors."
    moved = comparison.moved(first)
    modes = f"mode{'s' if len(moved) > 1 else ''} {', '.join(map(str, moved))}"
    lowest = f"{comparison.levels[0]:.3g} {comparison.unit}"
    return (
        f"Not linear from {_level(comparison, first)} on ({comparison.labels[first]}): {modes} "
        f"differ{'s' if len(moved) == 1 else ''} from {lowest} by more than errors."
    )


def _level(comparison: LevelComparison, number: int) -> str:
    """A level in words."""
    of = "force" if comparison.channel is None else comparison.channel
    return f"a peak {of} of {comparison.levels[number]:.3g} {comparison.unit}"


def _moved(ring: RingDown) -> str:
    """From where to where a mode moves."""
    (f0, d0), (f1, d1) = ring.ends[0]
    return (
        f"a mode moves from {f0:.5g} Hz and {100.0 * d0:.3g} % of damping, near an amplitude of {ring.amplitude[0]:.2g} "
        f"{ring.unit}, to {f1:.5g} Hz and {100.0 * d1:.3g} %"
    )


def mode_rows(comparison: LevelComparison) -> list[tuple[str, ...]]:
    """A row for each level and mode."""
    rows: list[tuple[str, ...]] = [
        (
            "level",
            comparison.level_name,
            "mode",
            "frequency, Hz",
            "std. error",
            "damping, %",
            "std. error",
            "moved",
        )
    ]
    for level, label in enumerate(comparison.labels):
        moved = comparison.moved(level)
        for mode in range(comparison.frequencies.shape[1]):
            f, df = comparison.frequencies[level, mode], comparison.frequency_errors[level, mode]
            d, dd = 100.0 * comparison.damping[level, mode], 100.0 * comparison.damping_errors[level, mode]
            record = (label, f"{comparison.levels[level]:.3g}") if mode == 0 else ("", "")
            if comparison.lost[level, mode]:
                rows.append((*record, str(mode + 1), *[""] * 4, "lost"))
                continue
            rows.append(
                (
                    *record,
                    str(mode + 1),
                    format_value(float(f), float(df)),
                    format_error(float(df)),
                    format_value(float(d), float(dd)),
                    format_error(float(dd)),
                    "yes" if mode + 1 in moved else "",
                )
            )
    return rows


def distortion_rows(comparison: LevelComparison) -> list[tuple[str, ...]]:
    """A row for each level with a periodic force."""
    rows: list[tuple[str, ...]] = [
        ("distortion of", comparison.level_name, "period, s", "odd, dB", "even, dB", "scatter, dB")
    ]
    for level, distortion in zip(comparison.levels, comparison.distortions, strict=True):
        if distortion is not None:
            sizes = (
                "" if size is None else f"{size:.1f}"
                for size in (distortion.odd, distortion.even, distortion.noise)
            )
            rows.append((distortion.channel, f"{level:.3g}", f"{distortion.period:.4g}", *sizes))
    return rows


def ring_down_rows(comparison: LevelComparison) -> list[tuple[str, ...]]:
    """Rows for each mode that rings down, from its largest to its smallest amplitude."""
    rows: list[tuple[str, ...]] = [
        (
            "ring-down",
            "channel",
            "amplitude",
            "frequency, Hz",
            "std. error",
            "damping, %",
            "std. error",
            "unit",
        )
    ]
    for ring in comparison.ring_downs:
        places = np.unique(np.linspace(0, len(ring.amplitude) - 1, _ROWS).round().astype(int))
        for place in places.tolist():
            f, df = float(ring.frequency[place]), float(ring.frequency_error[place])
            d, dd = 100.0 * float(ring.damping[place]), 100.0 * float(ring.damping_error[place])
            rows.append(
                (
                    ring_name(ring) if place == 0 else "",
                    ring.channel if place == 0 else "",
                    f"{ring.amplitude[place]:.3g}",
                    format_value(f, df),
                    format_error(df),
                    format_value(d, dd),
                    format_error(dd),
                    ring.unit,
                )
            )
    return rows


def gaps_text(comparison: LevelComparison) -> str:
    """What of gaps was bridged, and which channels ring-downs leave out for longer ones; empty where nothing is missing."""
    sentences = []
    if comparison.bridged:
        counts = ", ".join(_bridged(gaps) for gaps in comparison.bridged)
        sentences.append(f"Missing samples, at most six in a row, are interpolated: {counts}.")
    names = comparison.with_gaps
    if names:
        sentences.append(
            f"{', '.join(names)} {'lacks' if len(names) == 1 else 'lack'} samples at the highest level, more than six in a "
            "row, and no mode is followed there as it rings down."
        )
    return " ".join(sentences)


def _bridged(gaps: BridgedGaps) -> str:
    return f"{gaps.samples} of {gaps.channel} ({gaps.record})"


def ring_name(ring: RingDown) -> str:
    """A mode that rings down, by its frequency at the smallest amplitude."""
    return f"mode near {ring.frequency[-1]:.4g} Hz"
