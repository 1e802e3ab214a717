"""What stated errors of sensors make a prediction differ from a record."""

from __future__ import annotations

from dataclasses import replace
from math import isinf

import numpy as np

from linkwise.arrays import Floats
from linkwise.identification.validation.prediction import Prediction
from linkwise.records.record import Record
from linkwise.records.sensor_uncertainty import COMMON, SensorUncertainty


def with_stated_sensors(prediction: Prediction, record: Record) -> Prediction:
    """The prediction whose errors count those of the sensors of `record`, whose gain, offset or delay is known to within.

    They add to the errors of laws, which are of one kind throughout a record. What is unknown altogether adds nothing.
    """
    if not record.uncertainty:
        return prediction
    common = record.uncertainty.get(COMMON, SensorUncertainty()).gain
    variance = np.zeros_like(prediction.by_laws)
    for column, name in enumerate(record.responses):
        known, shown = record.uncertainty.get(name, SensorUncertainty()), prediction.predicted[:, column]
        gain, shared, offset, delay = (
            0.0 if isinf(sigma) else sigma for sigma in (known.gain, common, known.offset, known.delay)
        )
        variance[:, column] = (gain**2 + shared**2) * shown**2 + offset**2
        if delay:
            variance[:, column] += (delay * _largest_rate(shown, record.step)) ** 2
    return replace(prediction, by_laws=prediction.by_laws + variance)


def _largest_rate(shown: Floats, step: float) -> Floats:
    """(N,) the larger absolute slope beside each sample, of which one may be beside a gap of what is predicted."""
    slopes = np.abs(np.diff(shown)) / step
    beside: Floats = np.fmax(np.append(np.nan, slopes), np.append(slopes, np.nan))
    return beside


def unknown_sensors(record: Record) -> tuple[str, ...]:
    """A sentence on errors of sensors that are unknown, which a prediction cannot count."""
    names = [
        f"{kind} of {name}"
        for name, known in record.uncertainty.items()
        for kind in ("gain", "offset", "delay")
        if isinf(getattr(known, kind))
    ]
    return (f"Errors taken as zero, though stated as unknown: {', '.join(names)}.",) if names else ()
