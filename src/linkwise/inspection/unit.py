"""Motion that is implausible in the unit, or at the rate, that was stated."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from linkwise.inspection.alert import Alert
from linkwise.inspection.record_signals import RecordSignals

FASTEST = 340.0  # m/s, that of sound: no structure vibrates so fast over a whole record
STRONGEST = 1e5  # m/s^2: only microscopic structures are accelerated so strongly over a whole record
_ORDERS = {"x": 0, "v": 1, "a": 2}  # derivatives of the displacement


def unit(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of responses whose velocity or acceleration is beyond anything that vibrates."""
    for signal in signals.moving:
        if signal.channel.kind not in _ORDERS or signal.angular or signal.highest <= 0.0:
            continue
        spectrum = signal.spectrogram
        inside = (spectrum.frequency > 0.0) & (spectrum.frequency <= signal.highest)
        omega = 2.0 * np.pi * spectrum.frequency[inside]
        velocity, acceleration = (
            float(np.sqrt(np.sum(spectrum.mean[inside] * omega**power) * spectrum.frequency[1]))
            for power in (2 * (order - _ORDERS[signal.channel.kind]) for order in (1, 2))
        )
        if acceleration > STRONGEST:
            motion = f"accelerate by {acceleration:.2g} m/s^2 (root mean square), more than 100 km/s^2"
            unless = "unless the structure is microscopic, "
        elif velocity > FASTEST and signal.channel.kind != "a":  # whose drift is no velocity
            motion = f"move at {velocity:.2g} m/s (root mean square), faster than sound"
            unless = ""
        else:
            continue
        message = (
            f"would {motion}: {unless}its unit is not {signal.channel.unit}, or the times are not in s, and all "
            "coefficients are wrong by powers of the factor; state the unit in the name of the column, such as [mm] or [ms]"
        )
        yield Alert("unit", signal.name, message, np.inf, arguments=("channels",))
