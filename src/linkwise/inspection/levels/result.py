"""Linearity, from records of one test at several levels, and its text."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from linkwise.arrays import Bools, Floats
from linkwise.display import JudgedView, align_columns, format_both, paragraph
from linkwise.inspection.levels.quantities import (
    DAMPING,
    FREQUENCY,
    AccelerationSurface,
    BridgedGaps,
    Distortion,
    ResponseFunction,
    RingDown,
    differ,
)
from linkwise.verdict import Verdict

OF_BANDWIDTH, OF_DAMPING = 0.1, 0.05
"""Standard errors of the frequency, over half the bandwidth, and of the damping, relative, of a mode that can be followed."""
UNDAMPED = 2e-4
"""Damping of what is no mode, but a line of the force or its distortion."""
_OF_WINDOWS = ("amplitude", "frequency", "frequency_error", "damping", "damping_error")
_GROWTH = 2.0  # times what linear modes leave of the lowest level, noise allowed for: shares of taps scatter by less


@dataclass(frozen=True, eq=False, repr=False)
class LevelComparison(JudgedView):
    """Records of one test at several levels, from the lowest to the highest; of a single one, its modes as they ring down.

    Attributes
    ----------
    labels : tuple of str
        The records.
    levels : array of shape (R,)
        Peak of the forces of each in N, or of the motion in `channel` where no force was recorded.
    channel, unit : str or None, str
        The channel whose peaks are the levels, None for the forces, and its unit.
    frequencies, damping : array of shape (R, n)
        Of the linear modes that explain each record best, in Hz and as parts of the critical damping.
    frequency_errors, damping_errors : array of shape (R, n)
        Their standard errors.
    left, noise : array of shape (R,)
        The power of the responses that linear modes do not explain, and that of the noise, as parts of the whole.
    responses : tuple of ResponseFunction
        The response where most moves to the largest force, of each record; none where no force was recorded.
    distortions : tuple of Distortion or None
        Odd and even distortion of each record; None where its force is not periodic.
    ring_downs : tuple of RingDown
        Modes of the highest level as they ring down.
    surfaces : tuple of AccelerationSurface
        Restoring force per mass at the sensors that move most, at the highest level while no force acts.
    with_gaps : tuple of str
        Channels of the highest level that lack samples in long gaps, which ring-downs and surfaces leave out.
    bridged : tuple of BridgedGaps
        Channels with gaps of at most six samples, which are interpolated.

    See Also
    --------
    compare_levels : Makes one.

    Examples
    --------
    >>> import linkwise as lw
    >>> found = lw.inspection.compare_levels([lw.read_record("soft_tap.csv"), lw.read_record("hard_tap.csv")])
    >>> found.first_nonlinear is None, found.frequencies.shape
    (True, (2, 1))
    >>> [verdict.name for verdict in found.verdicts]
    ['LINEAR_IN_RANGE']
    """

    labels: tuple[str, ...]
    levels: Floats
    channel: str | None
    unit: str
    frequencies: Floats
    damping: Floats
    frequency_errors: Floats
    damping_errors: Floats
    left: Floats
    noise: Floats
    responses: tuple[ResponseFunction, ...]
    distortions: tuple[Distortion | None, ...]
    ring_downs: tuple[RingDown, ...]
    surfaces: tuple[AccelerationSurface, ...]
    with_gaps: tuple[str, ...]
    bridged: tuple[BridgedGaps, ...]

    @property
    def frequency_changes(self) -> Floats:
        """(R, n) changes of the frequencies from those at the lowest level, relative."""
        return np.asarray(self.frequencies / self.frequencies[0] - 1.0)

    @property
    def damping_changes(self) -> Floats:
        """(R, n) changes of the damping from that at the lowest level, relative."""
        return np.asarray(self.damping / self.damping[0] - 1.0)

    @property
    def lost(self) -> Bools:
        """(R, n) whether a mode could not be followed to a level, where what explains its record is no mode."""
        return np.asarray(self.damping <= UNDAMPED)

    def moved(self, level: int) -> tuple[int, ...]:
        """The modes whose frequency or damping differs from that at the lowest level by more than errors and what matters.

        Parameters
        ----------
        level : int
            Number of the record, from 0.

        Returns
        -------
        tuple of int
            Numbers of modes, from 1.
        """
        f, df, d, dd = self.frequencies, self.frequency_errors, self.damping, self.damping_errors
        has_moved = differ(f[level], df[level], f[0], df[0], FREQUENCY)
        has_moved |= differ(d[level], dd[level], d[0], dd[0], DAMPING)
        return tuple(int(mode) + 1 for mode in np.flatnonzero(has_moved & ~self.lost[level]))

    @property
    def level_name(self) -> str:
        """What the levels are, with their unit."""
        return f"peak {'force' if self.channel is None else self.channel}, {self.unit}"

    @property
    def first_nonlinear(self) -> int | None:
        """The number of the lowest level, from 0, at which a mode has moved; None if there is none."""
        return next((level for level in range(1, len(self.levels)) if self.moved(level)), None)

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Whether modes move, and what keeps the records from showing it."""
        first = self.first_nonlinear
        decays_move = any(ring.moves for ring in self.ring_downs)
        # from the first level on at which they move, errors are those of motion that is not linear
        below = slice(0 if decays_move and len(self.levels) == 1 else first)
        unclear = self.frequency_errors > OF_BANDWIDTH * self.damping * self.frequencies
        unclear |= (self.damping_errors > OF_DAMPING * self.damping) | self.lost
        excess = np.maximum(self.left - self.noise, 0.0)
        grown = excess > _GROWTH * excess[0] + self.noise + self.noise[0]
        holds = {
            Verdict.MODES_NOT_DETERMINED: bool(unclear[below].any()),
            Verdict.RESIDUALS_GROW_WITH_LEVEL: first is None and bool(grown.any()),
            Verdict.MODES_MOVE: first is not None or decays_move,
        }
        return tuple(verdict for verdict, applies in holds.items() if applies) or (Verdict.LINEAR_IN_RANGE,)

    def __str__(self) -> str:
        blocks = ["\n".join(map(paragraph, headline(self))), "\n".join(align_columns(mode_rows(self)))]
        for rows in (distortion_rows(self), ring_down_rows(self)):
            if len(rows) > 1:
                blocks.append("\n".join(align_columns(rows)))
        gaps = gaps_text(self)
        if gaps:
            blocks.append(paragraph(gaps))
        return "\n\n".join(blocks)

    def to_dict(self) -> dict[str, Any]:
        """The comparison as plain data.

        Returns
        -------
        dict
            "levels", lowest first, with "modes" each, "first_nonlinear", the label of a level or None, and verdicts.
        """
        first = self.first_nonlinear
        sizes = (self.frequencies, self.frequency_errors, self.damping, self.damping_errors)
        modes = np.stack(sizes, axis=-1)
        return {
            **self._judgement(),
            "levels": [
                {
                    "record": label,
                    "force_peak" if self.channel is None else "motion_peak": float(self.levels[number]),
                    "unexplained": float(self.left[number]),
                    "noise": float(self.noise[number]),
                    "moved": list(self.moved(number)),
                    "modes": [
                        {"frequency": f, "frequency_error": df, "damping": d, "damping_error": dd}
                        for f, df, d, dd in modes[number].tolist()
                    ],
                    "distortion": None if distortion is None else vars(distortion),
                }
                for number, (label, distortion) in enumerate(zip(self.labels, self.distortions, strict=True))
            ],
            "ring_down": [
                {
                    "mode": ring.mode,
                    "channel": ring.channel,
                    **{name: getattr(ring, name).tolist() for name in _OF_WINDOWS},
                    "moves": ring.moves,
                }
                for ring in self.ring_downs
            ],
            "without_ring_down": list(self.with_gaps),
            "bridged": [vars(gaps) for gaps in self.bridged],
            "first_nonlinear": None if first is None else self.labels[first],
        }


_ROWS = 5  # of a ring-down
_OF_MODES = ("frequency, Hz", "std. error", "damping, %", "std. error")


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
    rows: list[tuple[str, ...]] = [("level", comparison.level_name, "mode", *_OF_MODES, "moved")]
    for level, label in enumerate(comparison.labels):
        moved = comparison.moved(level)
        for mode in range(comparison.frequencies.shape[1]):
            f, df = comparison.frequencies[level, mode], comparison.frequency_errors[level, mode]
            d, dd = 100.0 * comparison.damping[level, mode], 100.0 * comparison.damping_errors[level, mode]
            record = (label, f"{comparison.levels[level]:.3g}") if mode == 0 else ("", "")
            if comparison.lost[level, mode]:
                rows.append((*record, str(mode + 1), *[""] * 4, "lost"))
                continue
            sizes = *format_both(float(f), float(df)), *format_both(float(d), float(dd))
            rows.append((*record, str(mode + 1), *sizes, "yes" if mode + 1 in moved else ""))
    return rows


def distortion_rows(comparison: LevelComparison) -> list[tuple[str, ...]]:
    """A row for each level with a periodic force."""
    title = ("distortion of", comparison.level_name, "period, s", "odd, dB", "even, dB", "scatter, dB")
    rows: list[tuple[str, ...]] = [title]
    for level, found in zip(comparison.levels, comparison.distortions, strict=True):
        if found is not None:
            powers = (
                "" if power is None else f"{power:.1f}" for power in (found.odd, found.even, found.noise)
            )
            rows.append((found.channel, f"{level:.3g}", f"{found.period:.4g}", *powers))
    return rows


def ring_down_rows(comparison: LevelComparison) -> list[tuple[str, ...]]:
    """Rows for each mode that rings down, from its largest to its smallest amplitude."""
    rows: list[tuple[str, ...]] = [("ring-down", "channel", "amplitude", *_OF_MODES, "unit")]
    for ring in comparison.ring_downs:
        places = np.unique(np.linspace(0, len(ring.amplitude) - 1, _ROWS).round().astype(int))
        for place in places.tolist():
            f, df = float(ring.frequency[place]), float(ring.frequency_error[place])
            d, dd = 100.0 * float(ring.damping[place]), 100.0 * float(ring.damping_error[place])
            named = (ring_name(ring), ring.channel) if place == 0 else ("", "")
            sizes = *format_both(f, df), *format_both(d, dd)
            rows.append((*named, f"{ring.amplitude[place]:.3g}", *sizes, ring.unit))
    return rows


def gaps_text(comparison: LevelComparison) -> str:
    """What of gaps was bridged, and which channels ring-downs leave out for longer ones; empty where nothing is missing."""
    sentences = []
    if comparison.bridged:
        counts = ", ".join(f"{gaps.samples} of {gaps.channel} ({gaps.record})" for gaps in comparison.bridged)
        sentences.append(f"Missing samples, at most six in a row, are interpolated: {counts}.")
    names = comparison.with_gaps
    if names:
        sentences.append(
            f"{', '.join(names)} {'lacks' if len(names) == 1 else 'lack'} samples at the highest level, more than six in a "
            "row, and no mode is followed there as it rings down."
        )
    return " ".join(sentences)


def ring_name(ring: RingDown) -> str:
    """A mode that rings down, by its frequency at the smallest amplitude."""
    return f"mode near {ring.frequency[-1]:.4g} Hz"
