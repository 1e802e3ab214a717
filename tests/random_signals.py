"""Random forces in a band of frequencies, and noise that is correlated from sample to sample."""

import numpy as np
import scipy

import linkwise as lw


def random_force(
    rng: np.random.Generator,
    duration: float,
    rate: float,
    *,
    rms: float = 6.0,
    highest: float = 12.0,
    band_limited: bool = False,
) -> lw.model.Sampled:
    """A normal force with a flat spectrum from 1 Hz to `highest` and a root mean square of `rms` in N."""
    samples = round(duration * rate) + 1
    frequency = np.fft.rfftfreq(samples, 1.0 / rate)
    band = (frequency > 1.0) & (frequency < highest)
    force = np.fft.irfft((rng.normal(size=len(band)) + 1j * rng.normal(size=len(band))) * band, samples)
    return lw.model.Sampled(0.0, rate, rms * force / force.std(), band_limited=band_limited)


def autoregressive(rng: np.random.Generator, shape: tuple[int, int], correlation: float) -> np.ndarray:
    """First-order noise of unit power in the first channel, white noise in the others."""
    noise = rng.normal(size=shape)
    driven = scipy.signal.lfilter([1.0], [1.0, -correlation], noise[:, 0])
    noise[:, 0] = driven * np.sqrt(1.0 - correlation**2)
    return noise


def differenced(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    return np.asarray(np.diff(rng.normal(size=(shape[0] + 1, shape[1])), axis=0) / np.sqrt(2.0))
