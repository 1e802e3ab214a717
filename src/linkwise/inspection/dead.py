"""Dead channels: nothing but one value, or nothing but noise."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from linkwise.inspection.alert import Alert
from linkwise.inspection.record_signals import RecordSignals

_MOTION = 1.2  # times the power of its noise: what has less holds no motion; noise scatters by a few per cent


def dead(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of responses that hold nothing, and of inputs without samples."""
    for signal in signals.channels:
        if not signal.observed.size:
            yield Alert("dead", signal.name, "every sample is missing; leave the channel out", np.inf)
        elif signal.is_constant and not signal.is_input:
            message = (
                f"every sample is {signal.observed[0]:g}: it shows no motion, and a fit to it is wrong throughout; "
                "leave the channel out, and check sensor and cable"
            )
            yield Alert("dead", signal.name, message, np.inf)
        elif not signal.is_input and signal.rms**2 < _MOTION * signal.sigma**2:
            message = (
                f"holds nothing but noise of {signal.sigma:.3g} {signal.channel.unit}: nothing of the motion is in it; check "
                "sensor, cable and range, excite more strongly, or leave the channel out"
            )
            yield Alert("dead", signal.name, message, np.inf)
