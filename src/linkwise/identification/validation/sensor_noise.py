"""Noise of the responses of a record that may have many gaps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy

from linkwise.records.record import Record
from linkwise.signals.channel_noise import channel_noise

_FLOOR = (
    1e-5  # of the RMS of a channel: interpolated inputs and sensitivities in single precision are not better
)


def sensor_noise(record: Record) -> dict[str, float]:
    """Standard deviation of the noise of every response: stated, or estimated from samples with the gaps between them filled.

    Filled samples have next to no noise of their own, so the estimate is raised by their share.
    """
    responses = record.select(record.responses)
    values = responses.values.copy()
    raised = {}
    for column, name in enumerate(responses.channels):
        present = np.isfinite(values[:, column])
        raised[name] = 1.0
        if not present.all() and present.sum() > 3 and name not in record.noise:
            at = np.flatnonzero(present)
            spline = scipy.interpolate.CubicSpline(at, values[at, column])
            filled = spline(np.clip(np.arange(len(values)), at[0], at[-1]))
            values[:, column] = np.where(present, values[:, column], filled)
            raised[name] = 1.0 / np.sqrt(present.mean())
    noise = channel_noise(replace(responses, values=values, simulated=None))
    floor = {name: _FLOOR * float(np.sqrt(np.nanmean(record.channel(name) ** 2))) for name in noise}
    return {name: max(raised[name] * sigma, floor[name]) for name, sigma in noise.items()}
