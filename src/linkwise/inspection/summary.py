"""What a channel is and holds, as numbers."""

from __future__ import annotations

import numpy as np

from linkwise.inspection.channel_signal import ChannelSignal
from linkwise.inspection.result import ChannelSummary
from linkwise.inspection.spikes import without_spikes

_LARGEST_RATIO = 1e12  # of motion to noise: below it lies the rounding of numbers


def summary(signal: ChannelSignal, record: str) -> ChannelSummary:
    """The summary of a channel of the record that is labelled `record`."""
    values = signal.observed
    span = float(values.max() - values.min()) if values.size else 0.0
    noise = None if np.isnan(signal.sigma) or signal.is_constant else float(signal.sigma)
    motion = None if noise is None else float(np.mean(values**2)) - noise**2
    audible = (
        noise is not None and noise > signal.rms / _LARGEST_RATIO and motion is not None and motion > 0.0
    )
    highest = None if signal.is_constant else without_spikes(signal).highest or None
    return ChannelSummary(
        name=signal.name,
        unit=signal.channel.unit,
        record=record,
        samples=len(values),
        missing=len(signal.values) - len(values),
        rate=signal.rate,
        minimum=float(values.min()) if values.size else None,
        maximum=float(values.max()) if values.size else None,
        rms=signal.rms if values.size else None,
        noise=noise,
        snr_db=float(10.0 * np.log10(motion / noise**2)) if audible and noise and motion else None,
        step=signal.step or None,
        bits=float(np.log2(span / signal.step + 1.0)) if signal.step else None,
        highest_frequency=highest,
        samples_per_period=None if highest is None else signal.rate / highest,
    )
