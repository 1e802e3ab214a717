"""Records that are too coarse or too short."""

from __future__ import annotations

from collections.abc import Iterator

from linkwise.inspection.alert import Alert
from linkwise.inspection.record_signals import RecordSignals
from linkwise.inspection.spikes import without_spikes

_FEWEST = 3.0  # samples in a period of the fastest motion that matters
_PERIODS = 3.0  # of the fastest motion
_SAMPLES = 100  # of a record


def few_samples(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of responses that move too fast for their sampling rate."""
    for signal in map(without_spikes, signals.responses):
        if signal.highest * _FEWEST <= signal.rate:
            continue
        message = (
            f"motion up to {signal.highest:.3g} Hz is sampled {signal.rate / signal.highest:.2g} times a period: derivatives "
            "and integrals between samples are guesses, and what is faster is aliased to lower frequencies; sample at "
            f"{10.0 * signal.highest:.2g} Hz or more, behind an anti-alias filter"
        )
        yield Alert("few-samples", signal.name, message, 0.5)


def short(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of a record that holds too little."""
    record = signals.record
    moving = [signal for signal in map(without_spikes, signals.responses) if signal.highest > 0.0]
    for signal in moving:
        periods = record.duration * signal.highest
        if len(record) >= _SAMPLES and periods >= _PERIODS:
            continue
        message = (
            f"{len(record)} samples and {periods:.2g} periods of its motion are few: noise and spectrum cannot be estimated, "
            "and intervals are unreliable; record at least ten periods"
        )
        yield Alert("short", signal.name, message, 0.3)
