"""The force window of a modal test: a hammer gives no force between its hits, and what its channel shows there is noise.

References
----------
D. J. Ewins, Modal Testing, 2nd ed. (2000), section 3.10.3, for windows of transient tests.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from linkwise.arrays import Bools, Floats, stretches
from linkwise.errors import RecordError
from linkwise.records.channel import Channel
from linkwise.records.record import Record

_NORMAL = 1.4826  # standard deviations of a normal variable in its median absolute deviation
_THRESHOLD = 5.0  # standard deviations of the noise, which none of a million samples of it exceeds
_PEAK = 20.0  # standard deviations that a hit reaches at least: lower pulses may be outliers
_QUIET = 0.5  # of a record, at least, in which there is no hit
_FEWEST = 40  # samples without a hit, from which the noise is known to within a ninth
# of the width of a pulse, by which it begins before and ends behind its samples above the level
_FLANK = 0.25
_LAGS = 10  # of the autocorrelation by which noise is judged to be white
_CHANCE = 1e-4  # of what is white
_FOOT = 0.05  # of the peak of a force, above which samples belong to a hit
_LARGE = 0.2  # of it, which a hit reaches that counts
_BESIDE = 4  # samples beside these, where the band limit of a sensor still shows a hit
COARSE, UNDERSAMPLED = 12, 7
"""Samples of half a sine, whose sum gives its impulse to within 0.2 and 0.5 %: of fewer, residuals show the error of
the impulse beside little noise, and coefficients move before residuals do.
"""


@dataclass(frozen=True, eq=False)
class ForceWindow:
    """Where a force of hits acts: `inside` (N,), beside `noise`, the standard deviation in N, and `mean` in N of the rest."""

    channel: Channel
    inside: Bools
    noise: float
    mean: float

    @property
    def description(self) -> str:
        """What was done, in a sentence."""
        hits = len(stretches(self.inside))
        count = "one hit" if hits == 1 else f"{hits} hits"
        return f"{self.channel} was taken as 0 outside of {count}, where it shows noise of {self.noise:.3g} N (force window)."


def force_window(
    channel: Channel, values: Floats, margin: int | None = None, *, hits: bool = False
) -> ForceWindow | None:
    """The window of a channel that is quiet but for pulses; None where it is not, or has no noise.

    Parameters
    ----------
    channel : Channel
        The channel of the force.
    values : array of shape (N,)
        Its samples in N.
    margin : int, optional
        Samples of the window before and behind each pulse; by default a quarter of its width.
    hits : bool, optional
        Whether pulses are known to be hits; the quiet part is then not asked to be white, or free of an offset.
    """
    if not np.isfinite(values).all():
        return None
    middle = float(np.median(values))
    noise = _NORMAL * float(np.median(np.abs(values - middle)))
    if noise == 0.0:
        return None
    loud = np.abs(values - middle) > _THRESHOLD * noise
    if not loud.any() or np.abs(values - middle).max() < _PEAK * noise:
        return None
    inside = _widened(loud, margin)
    quiet = values[~inside]
    if len(quiet) < max(_FEWEST, _QUIET * len(values)):
        return None
    mean, deviation = float(quiet.mean()), float(quiet.std())
    if not hits and not (_is_white(quiet) and abs(mean) < deviation):
        return None
    return ForceWindow(channel, inside, deviation, mean)


def coarse_hits(record: Record, fewer: int) -> dict[str, int]:
    """The forces of hits with `fewer` samples than would tell the impulse, and how many the shortest has.

    Such a pulse is not band-limited between its samples.
    """
    hits = {str(name): _hits(record.channel(name)) for name in record.forces}
    shortest = {name: min(hit.stop - hit.start for hit in own) for name, own in hits.items() if own}
    return {name: samples for name, samples in shortest.items() if samples < fewer}


def without_hits(record: Record, forces: Collection[str]) -> list[Record]:
    """The pieces of a record behind the hits of some forces, without the channels of these.

    What is before the first hit is at rest as a rule, and determines no coefficient.

    Parameters
    ----------
    record : Record
        The record.
    forces : collection of str
        The channels of forces that are zero but for hits.

    Returns
    -------
    list of Record
        The pieces of at least 40 samples.
    """
    acting = np.zeros(len(record), dtype=bool)
    for name in forces:
        for hit in _hits(record.channel(name)):
            acting[max(hit.start - _BESIDE, 0) : hit.stop + _BESIDE] = True
    kept = record.select(name for name in record.channels if str(name) not in forces)
    return [
        kept[piece] for piece in stretches(~acting) if piece.start and piece.stop - piece.start >= _FEWEST
    ]


def _hits(force: Floats) -> list[slice]:
    """The hits of a force that is quiet for most of the time; none of another one."""
    size = np.abs(np.nan_to_num(force))
    loud = size > _FOOT * size.max(initial=0.0)
    if np.mean(loud) > 1.0 - _QUIET:
        return []
    return [hit for hit in stretches(loud) if size[hit].max() > _LARGE * size.max()]


def coarseness(samples: int) -> float:
    """The standard deviation of the impulse of half a sine by the sum over so many samples of it, relative to it.

    Over all positions of the samples in a pulse, by the first alias of its spectrum.
    """
    return 1.0 / (4.0 * samples**2 - 1.0)


def _widened(loud: Bools, margin: int | None) -> Bools:
    """(N,) the pulses of the samples that are `loud`, with their flanks."""
    inside = np.zeros_like(loud)
    for pulse in stretches(loud):
        flank = 2 + round(_FLANK * (pulse.stop - pulse.start)) if margin is None else margin
        inside[max(pulse.start - flank, 0) : pulse.stop + flank] = True
    return inside


def _is_white(quiet: Floats) -> bool:
    """Whether the autocorrelation of quiet samples is that of white noise (Ljung and Box 1978)."""
    centred, count = quiet - quiet.mean(), len(quiet)
    lags = np.arange(1, _LAGS + 1)
    power = float(centred @ centred)
    correlation = np.array([centred[lag:] @ centred[:-lag] for lag in lags]) / power
    statistic = count * (count + 2.0) * float(np.sum(correlation**2 / (count - lags)))
    return float(scipy.special.chdtrc(_LAGS, statistic)) > _CHANCE


def with_force_windows(record: Record, margin: float | None = None, *, required: bool = False) -> Record:
    """The record with forces of hits at 0 between the hits, their noise in `noise`, and notes of what was done.

    Forces that are quiet but for pulses, beside white noise, get a window by themselves.

    Parameters
    ----------
    record : Record
        The record.
    margin : float, optional
        Time in s of the window before and behind each hit; by default a quarter of the hit's width.
    required : bool, optional
        Whether each force must have hits; what it shows between them is then not asked to be white, or free of an offset.

    Returns
    -------
    Record
        The record, or itself where no force has a window.

    Raises
    ------
    RecordError
        If windows are required, and a force has no hits, or the record no force.
    """
    samples = None if margin is None else round(margin * record.rate)
    forces: Sequence[Channel] = record.forces
    candidates = [force_window(name, record.channel(name), samples, hits=required) for name in forces]
    if required and not forces:
        raise RecordError("there is no force to window: no applied force was recorded")
    for name, window in zip(forces, candidates, strict=True):
        if required and window is None:
            raise RecordError(
                "it has no force window: it is not quiet but for pulses, or shows no noise between them; leave the force "
                "window out",
                channel=name,
            )
    windows = [window for window in candidates if window is not None]
    if not windows:
        return record
    values, noise = record.values.copy(), dict(record.noise)
    for window in windows:
        column = record.channels.index(window.channel)
        values[:, column] = np.where(window.inside, values[:, column] - window.mean, 0.0)
        noise.setdefault(window.channel, window.noise)
    notes = (*record.notes, *(window.description for window in windows))
    return replace(record, values=values, noise=noise, notes=notes)
