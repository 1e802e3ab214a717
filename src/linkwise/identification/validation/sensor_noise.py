"""Noise of the responses of a record that may have many gaps."""

from __future__ import annotations

import numpy as np
import scipy

from linkwise.records.record import Record
from linkwise.signals.channel_noise import noise_variance

# of the RMS of a channel: interpolated inputs and sensitivities in single precision are not better
_FLOOR = 1e-5
_LONGEST = 16  # samples of a gap that is filled: the shortest block in which noise is estimated


def sensor_noise(record: Record) -> dict[str, float]:
    """Standard deviation of the noise of every response: stated, or estimated from samples with the gaps between them filled.

    Filled samples have next to no noise of their own, so the estimate is raised by their share. Long gaps stay, since blocks
    within one would pass for quiet, unless nothing is left between them.
    """
    noise = _estimated(record, _LONGEST)
    if any(sigma == 0.0 for sigma in noise.values()):
        noise |= {
            name: sigma for name, sigma in _estimated(record, len(record)).items() if noise[name] == 0.0
        }
    floor = {name: _FLOOR * float(np.sqrt(np.nanmean(record.channel(name) ** 2))) for name in noise}
    return {name: max(sigma, floor[name]) for name, sigma in noise.items()}


def _estimated(record: Record, longest: int) -> dict[str, float]:
    """Standard deviations with gaps of at most `longest` samples filled; 0 for a channel that has too many others."""
    values = record.select(record.responses).values.T.copy()
    raised = np.ones(len(values))
    for row, name in enumerate(record.responses):
        present = np.isfinite(values[row])
        if present.all() or present.sum() <= 3 or name in record.noise:
            continue
        at = np.flatnonzero(present)
        before = np.searchsorted(at, np.arange(len(present)))
        ends = np.concatenate([[-1], at, [len(present)]])
        short = ~present & (ends[before + 1] - ends[before] - 1 <= longest)
        spline = scipy.interpolate.CubicSpline(at, values[row, at])
        values[row, short] = spline(np.clip(np.flatnonzero(short), at[0], at[-1]))
        raised[row] = np.sqrt(1.0 + short.sum() / present.sum())
    sigma = raised * np.sqrt(noise_variance(record, record.responses, values))
    return dict(zip(record.responses, sigma.tolist(), strict=True))
