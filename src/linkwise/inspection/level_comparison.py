"""How modes, response functions and distortion move with the level of a test: the comparison, and its text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from linkwise.arrays import Bools, Floats, Indices
from linkwise.display import JudgedView, format_both, paragraph, table, text_of
from linkwise.errors import IdentificationError, RecordError
from linkwise.inspection.level_quantities import (
    DAMPING,
    FREQUENCY,
    AccelerationSurface,
    BridgedGaps,
    Distortion,
    ResponseFunction,
    RingDown,
    acceleration_surfaces,
    bridged_gaps,
    decay_of,
    decaying_modes,
    differ,
    distortion,
    motions,
    ring_downs,
)
from linkwise.modal.measurement import ModalMeasurement
from linkwise.modal.pursuit import RefinedModes, pursued_modes, refined_modes
from linkwise.progress import Progress, ProgressReport, part, silent
from linkwise.records.joining import labels, record_list
from linkwise.records.record import Record
from linkwise.signals.gaps import forces_bridged, short_gaps_bridged
from linkwise.signals.noise import channel_noise
from linkwise.verdict import Verdict

_OF_BANDWIDTH, _OF_DAMPING = 0.1, 0.05
"""Standard errors of the frequency, over half the bandwidth, and of the damping, relative, of a mode that can be followed."""
_UNDAMPED = 2e-4
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
    def _modes(self) -> Floats:
        """(R, n, 4) frequency, its error, damping and its error."""
        sizes = (self.frequencies, self.frequency_errors, self.damping, self.damping_errors)
        return np.stack(sizes, axis=-1)

    @property
    def lost(self) -> Bools:
        """(R, n) whether a mode could not be followed to a level, where what explains its record is no mode."""
        return np.asarray(self.damping <= _UNDAMPED)

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
        unclear = self.frequency_errors > _OF_BANDWIDTH * self.damping * self.frequencies
        unclear |= (self.damping_errors > _OF_DAMPING * self.damping) | self.lost
        excess = np.maximum(self.left - self.noise, 0.0)
        grown = excess > _GROWTH * excess[0] + self.noise + self.noise[0]
        holds = {
            Verdict.MODES_NOT_DETERMINED: bool(unclear[below].any()),
            Verdict.RESIDUALS_GROW_WITH_LEVEL: first is None and bool(grown.any()),
            Verdict.MODES_MOVE: first is not None or decays_move,
        }
        return tuple(verdict for verdict, applies in holds.items() if applies) or (Verdict.LINEAR_IN_RANGE,)

    def __str__(self) -> str:
        tables = map(table, (mode_rows(self), distortion_rows(self), ring_down_rows(self)))
        return text_of(map(paragraph, headline(self)), *tables, [paragraph(gaps_text(self))])

    def to_dict(self) -> dict[str, Any]:
        """The comparison as plain data.

        Returns
        -------
        dict
            "levels", lowest first, with "modes" each, "first_nonlinear", the label of a level or None, and verdicts.
        """
        first = self.first_nonlinear
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
                        for f, df, d, dd in self._modes[number].tolist()
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
        largest = max(moving, key=lambda ring: float(ring.amplitude[0]))
        others = f", and {len(moving) - 1} more as well" if len(moving) > 1 else ""
        return f"Not linear: as it rings down, {_moved(largest)}{others}."
    if first is None:
        claim = "Linear" if comparison.trusted else "Perhaps linear"
        by = "with the level" if len(comparison.levels) > 1 else "as it rings down"
        return f"{claim} up to {_level_text(comparison, -1)}: no mode moves {by} by more than its errors."
    moved = comparison.moved(first)
    modes = f"mode{'s' if len(moved) > 1 else ''} {', '.join(map(str, moved))}"
    lowest = f"{comparison.levels[0]:.3g} {comparison.unit}"
    return (
        f"Not linear from {_level_text(comparison, first)} on ({comparison.labels[first]}): {modes} "
        f"differ{'s' if len(moved) == 1 else ''} from {lowest} by more than errors."
    )


def _level_text(comparison: LevelComparison, number: int) -> str:
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
            record = (label, f"{comparison.levels[level]:.3g}") if mode == 0 else ("", "")
            if comparison.lost[level, mode]:
                rows.append((*record, str(mode + 1), *[""] * 4, "lost"))
                continue
            sizes = _mode_cells(comparison._modes[level, mode].tolist())
            rows.append((*record, str(mode + 1), *sizes, "yes" if mode + 1 in moved else ""))
    return rows


def _mode_cells(mode: Sequence[float]) -> tuple[str, ...]:
    """Frequency and damping in % of a mode, each with its standard error."""
    f, df, d, dd = mode
    return *format_both(f, df), *format_both(100.0 * d, 100.0 * dd)


def distortion_rows(comparison: LevelComparison) -> list[tuple[str, ...]]:
    """A row for each level with a periodic force."""
    title = ("distortion of", comparison.level_name, "period, s", "odd, dB", "even, dB", "scatter, dB")
    rows: list[tuple[str, ...]] = [title]
    for level, of_level in zip(comparison.levels, comparison.distortions, strict=True):
        if of_level is not None:
            sizes = (of_level.odd, of_level.even, of_level.noise)
            powers = ("" if power is None else f"{power:.1f}" for power in sizes)
            rows.append((of_level.channel, f"{level:.3g}", f"{of_level.period:.4g}", *powers))
    return rows


def ring_down_rows(comparison: LevelComparison) -> list[tuple[str, ...]]:
    """Rows for each mode that rings down, from its largest to its smallest amplitude."""
    rows: list[tuple[str, ...]] = [("ring-down", "channel", "amplitude", *_OF_MODES, "unit")]
    for ring in comparison.ring_downs:
        places = np.unique(np.linspace(0, len(ring.amplitude) - 1, _ROWS).round().astype(int))
        for place in places.tolist():
            named = (ring_name(ring), ring.channel) if place == 0 else ("", "")
            sizes = _mode_cells([float(getattr(ring, name)[place]) for name in _OF_WINDOWS[1:]])
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


_SHORTEST = 50  # samples of a decay
_MOST = 6  # modes that are followed, where their number is not given: those that respond most


def compare_levels(
    records: Sequence[Record], *, modes: int | None = None, progress: Progress = silent
) -> LevelComparison:
    """Compare records of one test at several levels: is the structure linear, and from which level on is it not?

    The linear modes that explain each record best are followed from the lowest level up. In a linear structure they stay.
    The level of a record is the peak of its forces, which does not depend on how long the record goes on after a tap.

    The level of records without forces is the peak of the motion, and their modes are those of the free decay after it. One
    record alone shows its modes as they ring down.

    Parameters
    ----------
    records : sequence of Record
        Records with the same channels. The peaks of the applied forces (N) are the levels; without any, those of the motion.
    modes : int, optional
        Number of modes that are followed; by default those that the lowest level shows, the 6 that respond most.
    progress : Progress
        Called with a `ProgressReport` for every record.

    Returns
    -------
    LevelComparison
        Frequencies, damping, response functions and distortion over the level, and modes as they ring down.

    Raises
    ------
    RecordError
        If there is no record, no mode stands above the noise at the lowest level, or a single record shows no decay.
    IdentificationError
        If the records lack a motion, or differ in their channels.
    TypeError
        If something else is given.

    See Also
    --------
    inspect : Look at each record by itself.

    Examples
    --------
    >>> import linkwise as lw
    >>> number = lw.Coefficient.number
    >>> law, values = lw.Law.parse("k*d + k3*d**3 + c*v"), {"k": number(4e3), "k3": number(4e9), "c": number(1.0)}
    >>> link = lw.Link("spring", ("m1", lw.model.GROUND), law, values)
    >>> oscillator = lw.Structure("hardening", (lw.Mass("m1", number(1.0)),), (link,))
    >>> taps = [
    ...     lw.simulate(
    ...         oscillator, forces={"m1": f"{size}*exp(-((t - 0.1)/0.01)**2)"}, duration=4.0, rate=200.0, sensors=["a:m1"]
    ...     ).with_noise(40.0, seed=1)
    ...     for size in (0.1, 0.2, 2.0)
    ... ]
    >>> found = lw.inspection.compare_levels(taps)
    >>> found.first_nonlinear, found.moved(1), found.moved(2)
    (2, (), (1,))
    """
    given = record_list(records, "compare_levels(records): records")
    if not given:
        raise RecordError("levels are compared between two records or more, or one that rings down; got none")
    records = [forces_bridged(record) for record in given]
    _require_same_channels(records)
    forced = bool(records[0].forces)
    channel = None if forced else _loudest(records[0], records[0].motions)
    levels = np.array([_size(record, channel) for record in records])
    order = np.argsort(levels, kind="stable").tolist()
    ordered = [records[place] for place in order]
    complete = [short_gaps_bridged(record) or record for record in ordered]
    names = labels(ordered, "level")
    measured = [_measurement(record, forced=forced) for record in ordered]
    of_highest = channel_noise(ordered[-1])
    rings = ring_downs(complete[-1], of_highest)
    gaps = tuple(name for name in ordered[-1].motions if name not in motions(complete[-1]))
    if len(records) == 1 and not rings:
        raise RecordError(_no_ring_down(gaps))
    if modes is not None or (forced and len(records) > 1):
        pursued = pursued_modes(measured[0], modes, part(progress, 0.0, 0.5))
        start = np.stack([pursued.frequencies, pursued.damping], axis=1)
    else:
        start = decaying_modes(decay_of(complete[0]), channel_noise(ordered[0]))
    if not len(start):
        message = "no mode stands above the noise at the lowest level; excite the structure more strongly"
        raise RecordError(message)
    every = refined_modes(measured[0], *start.T)
    selected = np.arange(len(every.damping)) if modes is not None else _followed(every)
    frequencies, damping = every.frequencies[selected], every.damping[selected]
    fits: list[RefinedModes] = []
    for number, at_level in enumerate(measured, start=1):
        progress(ProgressReport(0.5 + 0.5 * (number - 1) / len(records), f"level {number}"))
        fits.append(refined_modes(at_level, frequencies, damping))
        frequencies, damping = fits[-1].frequencies, fits[-1].damping
    response, force = _channels(ordered[0]) if forced else ("", "")
    return LevelComparison(
        labels=names,
        levels=levels[order],
        channel=channel,
        unit=ordered[0].unit(channel or force),
        frequencies=np.array([fit.frequencies for fit in fits]),
        damping=np.array([fit.damping for fit in fits]),
        frequency_errors=np.array([fit.relative_errors[:, 0] * fit.frequencies for fit in fits]),
        damping_errors=np.array([fit.relative_errors[:, 1] * fit.damping for fit in fits]),
        left=np.array([fit.left for fit in fits]),
        noise=np.array([_noise_share(record, fit) for record, fit in zip(ordered, fits, strict=True)]),
        responses=tuple(ResponseFunction.of(record, response, force) for record in ordered if forced),
        distortions=tuple(distortion(record, response, force) if forced else None for record in complete),
        ring_downs=rings,
        with_gaps=gaps,
        bridged=bridged_gaps(names, [given[place] for place in order], complete),
        surfaces=acceleration_surfaces(complete[-1], fits[0].frequencies, of_highest),
    )


def _no_ring_down(gaps: Sequence[str]) -> str:
    """Why a single record shows nothing."""
    if gaps:
        return (
            f"no mode can be followed as it rings down: {', '.join(gaps)} lack samples. Cut the record to a part without "
            "gaps of more than six samples, or give a second level to compare"
        )
    return (
        "levels are compared between two records or more, and this one alone does not ring down: it has no part without a "
        "force that is long enough to follow a mode as it decays"
    )


def _size(record: Record, channel: str | None) -> float:
    """The level of a record: the largest magnitude of all forces, or of a channel of the motion."""
    names = record.forces if channel is None else [channel]
    return max(float(np.nanmax(np.abs(record.channel(name)))) for name in names)


def _loudest(record: Record, motions: Sequence[str]) -> str:
    """The one of some motions that stands farthest above its noise."""
    noise = channel_noise(record)
    if not motions:
        listed = ", ".join(record.channels)
        raise IdentificationError(f"modes need a motion, such as a:beam.tip; the channels are {listed}")
    return max(motions, key=lambda name: float(np.nanstd(record.channel(name)) / noise[name]))


def _measurement(record: Record, *, forced: bool) -> ModalMeasurement:
    """The responses to forces, or the free decay where no force was recorded."""
    if forced:
        return ModalMeasurement.of([record], scaled=False)
    decay = decay_of(record)
    if len(decay) < _SHORTEST:
        raise IdentificationError(
            f"no applied force was recorded, and {record.source or 'a record'} does not decay freely for {_SHORTEST} samples "
            "or more: modes follow from an applied force (force:beam.tip) and the motion that it gives, or from a free decay"
        )
    return ModalMeasurement.of_decay(decay)


def _noise_share(record: Record, modes: RefinedModes) -> float:
    """Power of the noise as a part of that of the responses, as `RefinedModes.left` is one."""
    noise = channel_noise(record)
    variance = np.array([noise[name] ** 2 for name in record.motions])
    return float(np.mean(variance / np.maximum(modes.power, np.finfo(float).tiny)))


def _require_same_channels(records: Sequence[Record]) -> None:
    first = records[0].channels
    for number, record in enumerate(records[1:], start=2):
        differences = [f"{name} is missing" for name in first if name not in record.channels]
        differences += [f"{name} is not in the first" for name in record.channels if name not in first]
        if differences:
            raise IdentificationError(
                "levels are compared between records with the same channels; of "
                f"{record.source or f'record {number}'}, {', and '.join(differences)}"
            )


def _followed(refined: RefinedModes) -> Indices:
    """The numbers of the modes that are well determined, at most those that respond most, in the order of frequencies."""
    size = np.abs(refined.residues).max(axis=(1, 2)) if refined.residues.size else refined.free.max(axis=1)
    of_frequency, of_damping = refined.relative_errors.T
    firm = (of_frequency < _OF_BANDWIDTH * refined.damping) & (of_damping < _OF_DAMPING)
    firm &= refined.damping > _UNDAMPED
    some = np.flatnonzero(firm) if firm.any() else np.arange(len(size))
    return np.sort(some[np.argsort(-(size / refined.damping)[some])][:_MOST])


def _channels(record: Record) -> tuple[str, str]:
    """The largest force, and a response where it acts, or else that which stands farthest above its noise."""
    force = max(record.forces, key=lambda name: float(np.mean(record.channel(name) ** 2)))
    at_force = [channel for channel in record.motions if channel.place == force.place]
    return _loudest(record, at_force or record.motions), force
