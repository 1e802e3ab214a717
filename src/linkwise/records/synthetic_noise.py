"""Synthetic measurement noise for simulated records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import RecordError

LARGEST_RATIO = 1000.0  # dB, either way: the powers of nothing that is measured are further apart


def with_white_noise(
    values: Floats,
    channels: Sequence[str],
    names: Sequence[str],
    decibel: float,
    seed: int,
    earlier: Mapping[str, float],
) -> tuple[Floats, dict[str, float]]:
    """`values` (N, C) of `channels` with white Gaussian noise on those in `names`, and the standard deviation of each.

    `decibel` is the signal-to-noise ratio in dB; missing samples (NaN) do not count in the power of the signal. The generator
    of a channel depends on `seed` and its name only. `earlier` is the noise that is there already, which adds to the
    deviations.
    """
    if not abs(decibel) <= LARGEST_RATIO:
        raise RecordError(
            f"decibel must be within {LARGEST_RATIO:g} of zero, got {decibel!r}; without noise, use the record as it is"
        )
    if seed < 0:
        raise RecordError(f"seed must not be negative, got {seed}")
    noisy, added = values.copy(), {}
    for name in names:
        samples = noisy[:, channels.index(name)]
        sigma = 0.0
        if not np.isnan(samples).all():
            sigma = float(np.sqrt(np.nanmean(samples**2) * 10.0 ** (-decibel / 10.0)))
        generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(name.encode())))
        samples += sigma * generator.standard_normal(len(samples))
        added[name] = float(np.hypot(sigma, earlier.get(name, 0.0)))
    noisy.setflags(write=False)
    return noisy, added
