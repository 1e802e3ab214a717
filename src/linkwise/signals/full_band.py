"""White noise of channels whose motion fills the band up to half the sampling rate, as at five samples a period.

No cell of the time-frequency plane is then free of motion. Where the power falls throughout the band, as that of motion does,
the noise is no more than what is left at its end. Noise behind an anti-aliasing filter falls there alone, and is left as it
is.
"""

from __future__ import annotations

import numpy as np

from linkwise.arrays import Floats

_ORDER = 4  # of the differences taken before the window, which keep slow motion from leaking into high bins
_BANDS = ((0.125, 0.25), (0.25, 0.375), (0.4, 0.5))  # cycles per sample
_FEWEST = 40  # samples: fewer leave the last band a power that is wrong by half of it
_MOST = 1156  # samples from which there are cells in which motion is absent for a time, if only at the edge of the band
_WINDOW_LOSS = 1.95  # by which the Hann window divides the number of independent bins
_SIGMAS = 2.0  # of the power in the last band: noise that is too low is not told from a misfit of laws, too high a one is
# of the power in the first band: what is left in the second, where motion falls towards the third
_FALLS = 0.5
_LOWER = 0.35  # of the power of the noise found otherwise: more may be chance


def noise_beside_motion(samples: Floats, level: float) -> float:
    """The power of the noise of a channel, no more than the `level` found where motion leaves cells to noise.

    Parameters
    ----------
    samples : array of shape (N,)
        The channel, without gaps.
    level : float
        The power of the noise that other cells tell.

    Returns
    -------
    float
        An upper bound of the power; `level` where motion does not seem to fill the band.
    """
    if not _FEWEST <= len(samples) < _MOST:
        return level
    differences = np.diff(samples, _ORDER)
    count = len(differences)
    hann = 0.5 - 0.5 * np.cos(2.0 * np.pi * (np.arange(count) + 0.5) / count)
    frequency = np.arange(1, (count + 1) // 2) / count
    gain = (2.0 * np.sin(np.pi * frequency)) ** (2 * _ORDER)
    power = np.abs(np.fft.rfft(differences * hann)[1 : len(frequency) + 1]) ** 2 / gain / np.sum(hann**2)
    bands = [power[(frequency >= lowest) & (frequency < highest)] for lowest, highest in _BANDS]
    low, middle, high = (float(np.mean(band)) for band in bands)
    freedom = 2.0 * len(bands[-1]) / _WINDOW_LOSS
    bound = high * (1.0 + _SIGMAS * np.sqrt(2.0 / freedom))
    return bound if middle < _FALLS * low and bound < _LOWER * level else level
