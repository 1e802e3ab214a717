"""Quantisation that is coarser than the noise."""

from __future__ import annotations

from collections.abc import Iterator

from linkwise.inspection.alert import Alert
from linkwise.inspection.record_signals import RecordSignals

_WHITE = 0.58  # of a step: noise, rounding included, below which rounding is not white; noise of half a step whitens it
_FINE = 1e-3  # of the root mean square: finer steps are as good as none


def quantised(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of channels whose steps are not hidden by noise."""
    for signal in signals.moving:
        if signal.step <= _FINE * signal.rms or not signal.sigma < _WHITE * signal.step:
            continue
        unit, rounding = signal.channel.unit, signal.step / 12.0**0.5
        steps = (signal.observed.max() - signal.observed.min()) / signal.step
        message = (
            f"comes in steps of {signal.step:.3g} {unit}, {steps:.0f} over its range, and its noise is smaller: rounding then "
            "follows the motion, and intervals are too narrow; use a smaller range of the converter, or state a noise of "
            f"{rounding:.2g} {unit}"
        )
        yield Alert("quantised", signal.name, message, rounding / signal.rms, arguments=("noise",))
