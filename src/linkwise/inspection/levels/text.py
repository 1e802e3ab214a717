"""The text that a comparison of levels prints."""

from __future__ import annotations

from linkwise.inspection.levels.result import LevelComparison
from linkwise.text import align_columns, as_text, format_error, format_value, paragraph


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
    return "\n\n".join(blocks)


def headline(comparison: LevelComparison) -> list[str]:
    """Whether the structure moved linearly, in a sentence, and the verdicts that forbid trust in it."""
    return [_claim(comparison), *(verdict.value for verdict in comparison.verdicts if verdict.forbids)]


def _claim(comparison: LevelComparison) -> str:
    first = comparison.first_nonlinear
    top = comparison.levels[-1]
    if first is None:
        claim = "Linear" if comparison.trusted else "Perhaps linear"
        return f"{claim} up to a peak force of {top:.3g} N: no mode moves with the level by more than its errors."
    moved = comparison.moved(first)
    modes = f"mode{'s' if len(moved) > 1 else ''} {', '.join(map(str, moved))}"
    return (
        f"Not linear from a peak force of {comparison.levels[first]:.3g} N on ({comparison.labels[first]}): {modes} "
        f"differ{'s' if len(moved) == 1 else ''} from {comparison.levels[0]:.3g} N by more than errors."
    )


def mode_rows(comparison: LevelComparison) -> list[tuple[str, ...]]:
    """A row for each level and mode."""
    rows: list[tuple[str, ...]] = [
        ("level", "peak force, N", "mode", "frequency, Hz", "std. error", "damping, %", "std. error", "moved")
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
        ("distortion of", "peak force, N", "period, s", "odd, dB", "even, dB", "scatter, dB")
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
    """A row for each mode that rings down: its largest and its smallest amplitude."""
    rows: list[tuple[str, ...]] = [
        ("ring-down", "channel", "amplitude", "frequency, Hz", "damping, %", "unit")
    ]
    for ring in comparison.ring_downs:
        for place, name in ((0, f"mode {ring.mode}"), (-1, "")):
            rows.append(
                (
                    name,
                    ring.channel if place == 0 else "",
                    f"{ring.amplitude[place]:.3g}",
                    f"{ring.frequency[place]:.5g}",
                    f"{100.0 * ring.damping[place]:.3g}",
                    ring.unit,
                )
            )
    return rows
