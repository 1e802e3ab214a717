"""A record as the weak screen wants it: a displacement of every mass, read off velocities or accelerations where need be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from linkwise.likelihood.starts.inverse_dynamics import DRIFT, highpassed, smoothed, summed
from linkwise.model.link import Mass
from linkwise.records.record import Record
from linkwise.signals.channel_noise import channel_noise


def with_displacements(record: Record, masses: Sequence[Mass]) -> Record:
    """`record` itself where every mass has its displacement; else with displacements summed up from what there is.

    A sum knows no constant, so a spring that holds off centre bends into other powers of d: the likelihood, which sees the
    sensors themselves, decides on what this suggests.
    """
    lost = [mass.name for mass in masses if f"x:{mass.name}" not in record.channels]
    if not lost:
        return record
    sigma = channel_noise(record)
    names, columns, noise = list(record.channels), [record.values], dict(record.noise)
    for name in lost:
        kind = "v" if f"v:{name}" in record.channels else "a"
        channel = f"{kind}:{name}"
        value = smoothed(record, channel, sigma)[0]
        x = summed(value, record.step)
        if kind == "a":
            x = highpassed(summed(highpassed(x, record.rate, DRIFT), record.step), record.rate, DRIFT)
        names.append(f"x:{name}")
        columns.append(x[:, None])
        share = sigma[channel] / float(np.sqrt(np.nanmean(record.channel(channel) ** 2)))
        noise[f"x:{name}"] = share * float(np.sqrt(np.mean(x**2)))
    return replace(record, channels=tuple(names), values=np.hstack(columns), noise=noise)
