"""Random forces in a band of frequencies, by which many tests drive an oscillator."""

import numpy as np

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
