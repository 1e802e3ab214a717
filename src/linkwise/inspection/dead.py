"""Dead channels: nothing but one value, or nothing but noise."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from linkwise.inspection.alert import Alert
from linkwise.inspection.channel_signal import ChannelSignal
from linkwise.inspection.record_signals import RecordSignals

_MOTION = 0.2  # of the power of its noise: a channel with more moves, however short it is
_DEVIATIONS = 5.0  # of the power of the noise of a long channel


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
        elif not signal.is_input and _is_noise(signal):
            message = (
                f"holds nothing but noise of {signal.sigma:.3g} {signal.channel.unit}: nothing of the motion is in it; check "
                "sensor, cable and range, excite more strongly, or leave the channel out"
            )
            yield Alert("dead", signal.name, message, np.inf)


def _is_noise(signal: ChannelSignal) -> bool:
    """Whether it has no more power than its noise, neither in all nor at some frequency."""
    motion = min(_MOTION, _DEVIATIONS * signal.noise_power_error)
    return signal.rms**2 < (1.0 + motion) * signal.sigma**2 and signal.highest == 0.0
