"""Clipped samples: those at an end of the range of a sensor, beyond which the fitted motion goes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from linkwise.estimates.causes import Cause
from linkwise.inspection.channel_signal import RecordSignals
from linkwise.inspection.samples import rails
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.records.record import Record

_BEYOND = 4.0  # standard errors, of the mean or of the power, which noise exceeds once in 30 000 and in 2 000 channels


def clipped_samples(fit: LikelihoodFit, records: Sequence[Record]) -> Iterator[Cause]:
    """The channels with samples at an end of their range that a fit contradicts: its motion goes on beyond it.

    The largest samples of a sensor that was not overloaded have noise to the outside, so that the motion is inside. A motion
    with a large model error follows the samples, and is beyond them by less than it misses them by.
    """
    responses = [name for name in records[0].channels if name not in records[0].inputs]
    ends: dict[str, set[tuple[float, float]]] = {}
    for record in records:
        for signal in RecordSignals.of(record).responses:
            ends.setdefault(signal.channel, set()).update(rails(signal))
    for number, name in enumerate(responses):
        samples, observed = fit.segments.samples[:, number], fit.segments.observed[:, number]
        residuals = fit.misfit.residuals[:, number] / fit.optimum.noise
        beyond = [-side * residuals[(samples == value) & observed] for value, side in ends.get(name, ())]
        outside = np.concatenate(beyond) if beyond else np.empty(0)
        count, total = len(outside), float(np.sum(outside))
        gain = float(np.sum(outside**2)) - count
        if total > _BEYOND * np.sqrt(count) or (total > 0.0 and gain > _BEYOND * np.sqrt(2.0 * count)):
            yield Cause("clipped", name, float(count), "1", gain, standard_error=0.0)
