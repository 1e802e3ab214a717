"""Motion that is implausible in the unit, or at the rate, that was stated."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from linkwise.inspection.alert import Alert
from linkwise.inspection.record_signals import RecordSignals

FASTEST = 1e5  # m/s^2: no vibrating structure is accelerated so strongly over a whole record
_ORDERS = {"x": 2, "v": 1, "a": 0}  # derivatives to the acceleration


def unit(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of responses whose acceleration is beyond anything that vibrates."""
    for signal in signals.moving:
        if signal.channel.kind not in _ORDERS or signal.highest <= 0.0:
            continue
        spectrum = signal.spectrogram
        inside = (spectrum.frequency > 0.0) & (spectrum.frequency <= signal.highest)
        omega = 2.0 * np.pi * spectrum.frequency[inside]
        density = spectrum.mean[inside] * omega ** (2 * _ORDERS[signal.channel.kind])
        acceleration = float(np.sqrt(np.sum(density) * spectrum.frequency[1]))
        if acceleration <= FASTEST:
            continue
        message = (
            f"would accelerate by {acceleration:.2g} m/s^2 (root mean square), more than 100 km/s^2: its unit is not "
            f"{signal.channel.unit}, or the times are not in s, and all coefficients are wrong by powers of the factor; state "
            "the unit in the name of the column, such as [mm] or [ms]"
        )
        yield Alert("unit", signal.name, message, np.inf, arguments=("channels",))
