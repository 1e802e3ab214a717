"""Readings of a sensor at and beside an end of its range, which a channel marks as missing and which still tell something."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import RecordError


@dataclass(frozen=True, eq=False)
class ClippedSamples:
    """What a sensor read where it was overloaded or nearly so, as `mark_missing` keeps it in `Record.clipped`.

    Attributes
    ----------
    samples : array of shape (N,)
        The channel as it is with these readings marked as missing, NaN.
    readings : array of shape (N,)
        The readings there, in the unit of the channel; NaN elsewhere.
    sides : array of shape (N,)
        1 where the true reading is the one given or more, -1 where it is the one given or less, 0 where it is exact.

    Raises
    ------
    RecordError
        If lengths differ, a reading has no side or another than these, or the channel has a sample where there is a reading.

    Examples
    --------
    >>> import linkwise as lw
    >>> import numpy as np
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=2.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> x = record.channel("x:m1")
    >>> peak = 0.8 * np.abs(x).max()
    >>> overloaded = {"x:m1": np.clip(x, -peak, peak), "x:m2": record.channel("x:m2")}
    >>> marked = lw.mark_missing(lw.Record.from_arrays(record.time, overloaded))
    >>> sides = marked.clipped["x:m1"].sides
    >>> int((sides > 0).sum()), int((sides < 0).sum())
    (22, 22)
    """

    samples: Floats
    readings: Floats
    sides: Floats

    def __post_init__(self) -> None:
        for name in ("samples", "readings", "sides"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=float))
        shapes = [array.shape for array in (self.samples, self.readings, self.sides)]
        if len(set(shapes)) > 1 or len(shapes[0]) != 1:
            raise RecordError(
                f"clipped samples, their readings and sides are arrays of one length, got the shapes {shapes}"
            )
        is_read = ~np.isnan(self.readings)
        wrong = np.flatnonzero(is_read & ~np.isin(self.sides, (-1.0, 0.0, 1.0)))
        if len(wrong):
            raise RecordError(
                f"the side of a reading is -1, 0 or 1, got {self.sides[wrong[0]]:g} at sample {wrong[0]}"
            )
        both = np.flatnonzero(is_read & ~np.isnan(self.samples))
        if len(both):
            raise RecordError(
                f"a clipped sample is missing in its channel, and sample {both[0]} is there beside its reading: mark it as NaN"
            )

    def of(self, samples: Floats) -> ClippedSamples | None:
        """The readings of a channel, if it is as it was when they were marked.

        Parameters
        ----------
        samples : array of shape (N,)
            The channel.

        Returns
        -------
        ClippedSamples or None
            None where it was changed since, so that the readings are those of another signal.
        """
        return self if np.array_equal(self.samples, samples, equal_nan=True) else None

    def rows(self, which: slice) -> ClippedSamples:
        """The readings among some samples.

        Parameters
        ----------
        which : slice
            The samples.

        Returns
        -------
        ClippedSamples
            Those of the samples alone.
        """
        return ClippedSamples(self.samples[which], self.readings[which], self.sides[which])

    @classmethod
    def none_of(cls, samples: Floats) -> ClippedSamples:
        """Those of a channel without any.

        Parameters
        ----------
        samples : array of shape (N,)
            The channel.

        Returns
        -------
        ClippedSamples
            Without readings.
        """
        return cls(samples, np.full(len(samples), np.nan), np.full(len(samples), np.nan))

    def followed_by(self, others: ClippedSamples, gap: int) -> ClippedSamples:
        """The readings of this part of a channel and of another.

        Parameters
        ----------
        others : ClippedSamples
            Those of the other part.
        gap : int
            The number of missing samples between them.

        Returns
        -------
        ClippedSamples
            Those of both.
        """
        missing = np.full(gap, np.nan)
        pairs = zip(
            (self.samples, self.readings, self.sides),
            (others.samples, others.readings, others.sides),
            strict=True,
        )
        return ClippedSamples(*(np.concatenate([first, missing, second]) for first, second in pairs))
