"""Noise that is stated of a channel, against the samples that hold it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from linkwise.errors import RecordError
from linkwise.records.record import Record

_LARGEST = 10.0  # times the root mean square of samples that hold the noise: chance does not make it twice


def check_stated_noise(records: Sequence[Record]) -> None:
    """Raise RecordError where the noise stated of a response is far more than its samples, which hold it, could be."""
    for record in records:
        for name in set(record.noise).intersection(record.responses):
            samples = record.channel(name)
            samples = samples[np.isfinite(samples)]
            size, sigma = float(np.sqrt(np.mean(samples**2))) if len(samples) else 0.0, record.noise[name]
            if 0.0 < size < sigma / _LARGEST:
                unit = record.unit(name)
                raise RecordError(
                    f"its noise is stated as {sigma:g} {unit}, but its samples, which hold that noise, have a root mean "
                    f"square of {size:.3g} {unit}; check the number and its unit",
                    channel=name,
                )
