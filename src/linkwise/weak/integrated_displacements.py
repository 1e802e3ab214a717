"""Records as the weak screen needs them: with a displacement of every mass, integrated where it was not measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from linkwise.model.link import Mass
from linkwise.records.channel import Channel
from linkwise.records.record import Record
from linkwise.signals.noise import channel_noise
from linkwise.signals.states import drift_frequency, highpass, integral, smoothed


def with_displacements(record: Record, masses: Sequence[Mass]) -> Record:
    """`record` itself if it has the displacement of every mass, else with displacements integrated from what it has.

    The integration constant is lost, so that a spring away from d = 0 appears as other powers of d. The result therefore only
    suggests candidates; the likelihood, which uses the measured channels, decides.
    """
    missing = [mass.name for mass in masses if f"x:{mass.name}" not in record.channels]
    if not missing:
        return record
    sigma = channel_noise(record)
    names, columns, noise = list(record.channels), [record.values], dict(record.noise)
    for name in missing:
        channel = record.motions_of(name)[0]
        value = smoothed(record, channel, sigma[channel])[0]
        x = integral(value, record.step)
        if channel.kind == "a":
            cutoff = drift_frequency(value, record.rate)
            velocity = highpass(x, record.rate, cutoff)
            x = highpass(integral(velocity, record.step), record.rate, cutoff)
        names.append(Channel("x", name))
        columns.append(x[:, None])
        relative = sigma[channel] / float(np.sqrt(np.nanmean(record.channel(channel) ** 2)))
        noise[f"x:{name}"] = relative * float(np.sqrt(np.mean(x**2)))
    return replace(record, channels=tuple(names), values=np.hstack(columns), noise=noise, uncertainty={})
