"""Synthetic measurement noise for simulated records."""

from __future__ import annotations

import numpy as np

from linkwise.arrays import Floats


def white_noise(name: str, samples: Floats, decibel: float, seed: int) -> tuple[Floats, float]:
    """White Gaussian noise (N,) for one channel, and its standard deviation, at a signal-to-noise ratio in dB.

    The generator depends on `seed` and the channel's name only. Missing samples (NaN) do not count in the signal's power.
    """
    sigma = 0.0
    if not np.isnan(samples).all():
        sigma = float(np.sqrt(np.nanmean(samples**2) * 10.0 ** (-decibel / 10.0)))
    generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(name.encode())))
    return sigma * generator.standard_normal(len(samples)), sigma
