"""Noise that is correlated from sample to sample."""

import numpy as np
import scipy


def autoregressive(rng: np.random.Generator, shape: tuple[int, int], correlation: float) -> np.ndarray:
    """First-order noise of unit power in the first channel, white noise in the others."""
    noise = rng.normal(size=shape)
    driven = scipy.signal.lfilter([1.0], [1.0, -correlation], noise[:, 0])
    noise[:, 0] = driven * np.sqrt(1.0 - correlation**2)
    return noise


def differenced(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    return np.asarray(np.diff(rng.normal(size=(shape[0] + 1, shape[1])), axis=0) / np.sqrt(2.0))
