"""The anti-alias filter of `Record.decimate`: a symmetric low-pass that leaves white noise white."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from linkwise.arrays import Bools, Floats
from linkwise.errors import RecordError
from linkwise.records.interpolation import BAND_LIMITED

ATTENUATION = 80.0  # dB, from STOPBAND on
PASSBAND = 0.8  # of the new Nyquist frequency; there the gain is 1 within 10^(-ATTENUATION / 20)
STOPBAND = 1.2  # of the new Nyquist frequency
_SPAN = 25  # outputs to either side that a sample enters: shorter filters miss ATTENUATION
_GRID = 64  # points of the spectrum for a tap
_AUDIBLE = 1e-3  # of the root mean square of a channel: motion between the bands that is told
_ABOVE_FLOOR = 4.0  # times the power density of what is above the filter


@dataclass(frozen=True, eq=False)
class Lowpass:
    """A symmetric filter of `length` = 2 `half` + 1 taps that keeps every `factor`-th of its outputs."""

    factor: int
    taps: Floats

    @property
    def length(self) -> int:
        """Number of taps: samples that enter one output."""
        return len(self.taps)

    @property
    def half(self) -> int:
        """Number of samples dropped at each end."""
        return len(self.taps) // 2

    @property
    def noise_gain(self) -> float:
        """The factor by which the standard deviation of white noise shrinks."""
        return float(np.sqrt(np.sum(self.taps**2)))

    def notes(self, channels: Sequence[str], values: Floats, rate: float) -> tuple[str, ...]:
        """What it does to the `values` (N, C) of `channels`, sampled at `rate` in Hz, one sentence each."""
        note = (
            f"Decimated by {self.factor} behind an anti-alias filter, which leaves {100.0 * self.noise_gain:.0f} % of the "
            f"standard deviation of white noise; {self.half} samples at each end were dropped, where the filter is incomplete."
        )
        return (note, *_between_the_bands(channels, values, rate, self.factor))

    def apply(self, values: Floats) -> Floats:
        """`values` (N, C) filtered along time and decimated, both ends dropped: ((N - length) // factor + 1, C)."""
        size = (
            1 << (len(values) - 1).bit_length()
        )  # wrap-around affects the first length - 1 outputs only, which are dropped
        spectrum = np.fft.rfft(values, size, axis=0) * np.fft.rfft(self.taps, size)[:, np.newaxis]
        filtered = np.fft.irfft(spectrum, size, axis=0)
        return np.ascontiguousarray(filtered[self.length - 1 : len(values) : self.factor])


@lru_cache(maxsize=16)
def lowpass(factor: int) -> Lowpass:
    """The filter for decimation by `factor` >= 2: flat up to `PASSBAND`, `ATTENUATION` from `STOPBAND` on.

    Its squared gain at a frequency and at that which folds onto it add up to 1, as those of the scaling function of Meyer's
    wavelet do (Daubechies, Ten Lectures on Wavelets, section 4.2): white noise stays white when every `factor`-th sample is
    kept. Any filter that is steep enough to stop at the Nyquist frequency would leave noise that is correlated from sample to
    sample, and residuals that no law explains.
    """
    half = _SPAN * factor
    size = 1 << (_GRID * half - 1).bit_length()
    frequency = np.arange(size // 2 + 1) * 2.0 * factor / size  # of the new Nyquist frequency
    x = np.clip((frequency - PASSBAND) / (STOPBAND - PASSBAND), 0.0, 1.0)
    gain = np.cos(0.5 * np.pi * x**4 * (35.0 - 84.0 * x + 70.0 * x**2 - 20.0 * x**3))
    response = np.fft.irfft(gain, size)
    taps = np.concatenate([response[-half:], response[: half + 1]])
    return Lowpass(factor, taps / taps.sum())


def _between_the_bands(channels: Sequence[str], values: Floats, rate: float, factor: int) -> tuple[str, ...]:
    """A sentence on the channels (C,) whose `values` (N, C) move where the filter neither keeps nor stops them."""
    nyquist = rate / factor / 2.0
    centred = (values - values.mean(axis=0)) * np.hanning(len(values))[:, np.newaxis]
    power = np.abs(np.fft.rfft(centred, axis=0)) ** 2
    frequency = np.arange(len(power)) * rate / len(values)
    between = (frequency > PASSBAND * nyquist) & (frequency < STOPBAND * nyquist)
    above = frequency >= STOPBAND * nyquist
    whole = power.sum(axis=0)
    moving = (power[between].mean(axis=0) > _ABOVE_FLOOR * power[above].mean(axis=0)) & (
        power[between].sum(axis=0) > _AUDIBLE**2 * whole
    )
    names = ", ".join(name for name, moves in zip(channels, moving, strict=True) if moves)
    if not names:
        return ()
    return (
        f"{names}: the motion between {PASSBAND * nyquist:.4g} and {STOPBAND * nyquist:.4g} Hz is neither kept nor "
        f"removed by the filter, and is aliased; decimate by less.",
    )


def check_interpolation(interpolation: Mapping[str, str]) -> None:
    """Refuse channels that are not band-limited between samples: a filter of the samples is not a filter of the signal."""
    for name, kind in interpolation.items():
        if kind != BAND_LIMITED:
            raise RecordError(
                f"is stated as {kind} between its samples, which samples at a lower rate cannot show; keep the rate of the "
                "record, or record the force or motion itself and not its set value",
                channel=name,
            )


def check_factor(factor: float) -> None:
    """Raise RecordError unless `factor` is a positive integer."""
    if isinstance(factor, bool) or int(factor) != factor or factor < 1:
        raise RecordError(f"factor must be a positive integer, got {factor!r}")


def check_complete(channels: Sequence[str], missing: Bools) -> None:
    """Raise RecordError where one of the `channels` has `missing` (N, C) samples."""
    if missing.any():
        raise RecordError(
            "samples are missing, and the anti-alias filter cannot bridge a gap; select a complete piece with "
            "record.between first",
            channel=channels[int(np.argmax(missing.any(axis=0)))],
            arguments=("earliest", "latest"),
        )


def lowpass_for(factor: int, samples: int) -> Lowpass:
    """The filter for a record of so many samples. Raises RecordError where it is longer than the record."""
    antialias = lowpass(factor)
    if samples < antialias.length:
        raise RecordError(
            f"{samples} samples are too few to decimate by {factor}: its anti-alias filter spans {antialias.length}"
        )
    return antialias
