"""One channel as the checks look at it: samples, noise, levels, spectra and rest, each computed once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from linkwise.arrays import Bools, Floats
from linkwise.inspection.rest import rest_period
from linkwise.inspection.spectrum import SHARED_BLOCKS, Spectrogram
from linkwise.records.channel import Channel

_EVEN = 0.02  # of a step: how far the differences of levels are from multiples of it
_ROUNDED = 8.0  # units in the last place by which a level may be off, after conversion of its unit
_LOOKED_AT = 300  # samples whose digits are counted
_PRINTED = 11  # digits from which on decimal rounding is no coarser than any measurement
# of the power of a motion: below the frequency that this share lies under, it is to be resolved
_CARRYING = 0.99
_DEVIATIONS = (
    5.0  # of the power that noise leaves above a frequency, whose sums over few frequencies are skew
)
_NOISE_SAMPLES = (
    8.0  # of a record, each worth one for the variance of its noise, as it is taken from differences
)


@dataclass(frozen=True, eq=False)
class ChannelSignal:
    """Samples `values` (N,) of the channel `name` at `rate` in Hz from `start` in s, with noise of standard deviation `sigma`.

    `sigma` is NaN where it cannot be estimated; `angular` says that its place turns.
    """

    name: str
    values: Floats
    rate: float
    start: float
    sigma: float
    angular: bool = False

    @property
    def channel(self) -> Channel:
        """Kind and place."""
        return replace(Channel.parse(self.name), angular=self.angular)

    @property
    def is_input(self) -> bool:
        """Whether it drives the structure."""
        return self.channel.is_input

    @cached_property
    def present(self) -> Bools:
        """True where there is a sample, shape (N,)."""
        return ~np.isnan(self.values)

    @cached_property
    def observed(self) -> Floats:
        """The samples that there are."""
        return self.values[self.present]

    @cached_property
    def is_constant(self) -> bool:
        """Whether it has no two different samples."""
        return not self.observed.size or bool(np.all(self.observed == self.observed[0]))

    @cached_property
    def rms(self) -> float:
        """Root mean square deviation from the mean."""
        return 0.0 if self.is_constant else float(np.std(self.observed))

    @cached_property
    def filled(self) -> Floats:
        """Samples (N,) with gaps bridged by lines; zeros for a channel without samples."""
        if not self.observed.size:
            return np.zeros(len(self.values))
        index = np.arange(len(self.values))
        return np.interp(index, index[self.present], self.observed)

    @cached_property
    def levels(self) -> Floats:
        """The different values, in rising order."""
        return np.unique(self.observed)

    @cached_property
    def step(self) -> float:
        """Quantisation step in the unit of the channel; 0 where there is none or it is as small as rounding."""
        levels = self.levels
        if len(levels) < 3:
            return 0.0
        gaps = np.diff(levels)
        rounding = _ROUNDED * float(np.spacing(np.abs(self.observed).max()))
        step = float(gaps[gaps > rounding].min(initial=np.inf))
        if not rounding < _EVEN * step < np.inf:
            return 0.0
        multiples = gaps / step
        return step if np.mean(np.abs(multiples - np.rint(multiples)) < _EVEN) > _CARRYING else 0.0

    @cached_property
    def digits(self) -> int:
        """Significant decimal digits of the samples; 17 where they are as many as a number holds."""
        some = self.observed[:: max(1, len(self.observed) // _LOOKED_AT)]
        some = some[some != 0.0]
        roundings = _ROUNDED * np.spacing(np.abs(some))
        for digits in range(1, _PRINTED):
            if all(
                abs(float(f"{value:.{digits - 1}e}") - value) <= rounding
                for value, rounding in zip(some.tolist(), roundings.tolist(), strict=True)
            ):
                return digits
        return 17

    @cached_property
    def grain(self) -> Floats:
        """Distance (N,) between a sample and the next value that could have been recorded."""
        size = np.maximum(np.abs(self.filled), np.finfo(float).tiny)
        decimal = 10.0 ** (np.floor(np.log10(size)) + 1 - self.digits)
        return np.asarray(np.maximum(np.maximum(self.step, decimal), np.spacing(size)))

    @cached_property
    def spectrogram(self) -> Spectrogram:
        """Power over time and frequency."""
        return Spectrogram.of(self.filled, self.rate)

    @cached_property
    def highest(self) -> float:
        """Frequency in Hz below which lie 99 % of the power beyond the noise, as far as the noise lets it be seen; 0 where
        no power is beyond the noise.
        """
        spectrum = self.spectrogram
        noise = 0.0 if np.isnan(self.sigma) else 2.0 * self.sigma**2 / self.rate
        above = np.cumsum((spectrum.mean[1:-1] - noise)[::-1])[::-1]
        count = np.arange(len(above), 0, -1)
        of_blocks = np.sqrt(SHARED_BLOCKS / len(spectrum.time) / count)
        by_noise = _DEVIATIONS * noise * count * np.hypot(of_blocks, self.noise_power_error)
        resolved = above > (1.0 - _CARRYING) * above.max(initial=0.0) + by_noise
        return float(spectrum.frequency[1:-1][resolved].max(initial=0.0))

    @property
    def noise_power_error(self) -> float:
        """Relative standard error of the power of the noise."""
        return float(np.sqrt(_NOISE_SAMPLES / max(len(self.observed), 1)))

    @cached_property
    def rest(self) -> slice | None:
        """Samples at the end, or else at the start, in which nothing moves; None where there is motion throughout."""
        return None if self.is_constant else rest_period(self.filled)
