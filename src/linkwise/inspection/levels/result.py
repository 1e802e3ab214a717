"""Linearity, from records of one test at several levels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from linkwise.argument_types import checked
from linkwise.arrays import Bools, Floats
from linkwise.display import JudgedView, as_text
from linkwise.inspection.levels.acceleration_surface import AccelerationSurface
from linkwise.inspection.levels.bridged_gaps import BridgedGaps
from linkwise.inspection.levels.distortion import Distortion
from linkwise.inspection.levels.response_function import ResponseFunction
from linkwise.inspection.levels.ring_down import RingDown
from linkwise.inspection.levels.significance import DAMPING, FREQUENCY, differ
from linkwise.verdict import Verdict

OF_BANDWIDTH, OF_DAMPING = 0.1, 0.05
"""Standard errors of the frequency, over half the bandwidth, and of the damping, relative, of a mode that can be followed."""
UNDAMPED = 2e-4
"""Damping of what is no mode, but a line of the force or its distortion."""
_GROWTH = 2.0  # times what linear modes leave of the lowest level, noise allowed for: shares of taps scatter by less


@dataclass(frozen=True, eq=False)
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
    >>> found = lw.compare_levels([lw.read_record("soft_tap.csv"), lw.read_record("hard_tap.csv")])
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

    @checked
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
        has_moved = np.zeros(self.frequencies.shape[1], dtype=bool)
        for values, errors, least in (
            (self.frequencies, self.frequency_errors, FREQUENCY),
            (self.damping, self.damping_errors, DAMPING),
        ):
            has_moved |= differ(values[level], errors[level], values[0], errors[0], least)
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
        unclear = (self.frequency_errors > OF_BANDWIDTH * self.damping * self.frequencies) | (
            self.damping_errors > OF_DAMPING * self.damping
        )
        unclear |= self.lost
        excess = np.maximum(self.left - self.noise, 0.0)
        grown = excess > _GROWTH * excess[0] + self.noise + self.noise[0]
        holds = {
            Verdict.MODES_NOT_DETERMINED: bool(unclear[below].any()),
            Verdict.RESIDUALS_GROW_WITH_LEVEL: first is None and bool(grown.any()),
            Verdict.MODES_MOVE: first is not None or decays_move,
        }
        return tuple(verdict for verdict, applies in holds.items() if applies) or (Verdict.LINEAR_IN_RANGE,)

    def __str__(self) -> str:
        return as_text(self)

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
                        for f, df, d, dd in zip(
                            self.frequencies[number].tolist(),
                            self.frequency_errors[number].tolist(),
                            self.damping[number].tolist(),
                            self.damping_errors[number].tolist(),
                            strict=True,
                        )
                    ],
                    "distortion": None if distortion is None else vars(distortion),
                }
                for number, (label, distortion) in enumerate(zip(self.labels, self.distortions, strict=True))
            ],
            "ring_down": [
                {
                    "mode": ring.mode,
                    "channel": ring.channel,
                    "amplitude": ring.amplitude.tolist(),
                    "frequency": ring.frequency.tolist(),
                    "frequency_error": ring.frequency_error.tolist(),
                    "damping": ring.damping.tolist(),
                    "damping_error": ring.damping_error.tolist(),
                    "moves": ring.moves,
                }
                for ring in self.ring_downs
            ],
            "without_ring_down": list(self.with_gaps),
            "bridged": [vars(gaps) for gaps in self.bridged],
            "first_nonlinear": None if first is None else self.labels[first],
        }
