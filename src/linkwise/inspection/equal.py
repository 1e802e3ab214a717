"""Channels that hold the same samples, as they are, scaled or mirrored."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from linkwise.inspection.alert import Alert
from linkwise.inspection.record_signals import RecordSignals


def equal(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of responses that are copies of another channel."""
    known: dict[bytes, tuple[str, bool]] = {}
    for signal in signals.moving:
        peak = signal.observed[np.argmax(np.abs(signal.observed))]
        shape = (signal.values / peak).astype(
            np.float32
        )  # single precision: copies in different units compare equal
        first, mirrored = known.setdefault(shape.tobytes(), (signal.name, bool(peak < 0.0)))
        if first == signal.name or signal.is_input:
            continue
        how = "the samples of" if mirrored == (peak < 0.0) else "the samples, with the opposite sign, of"
        message = (
            f"holds {how} {first}: one measurement counts twice, and one mass gets the motion of another; find out which of "
            "the two is mislabelled and leave it out"
        )
        yield Alert("equal", signal.name, message, np.inf)
