"""Samples that are missing."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from linkwise.inspection.alert import Alert
from linkwise.inspection.record_signals import RecordSignals
from linkwise.records.common_samples import sampled_every


def dropped(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of channels that lack samples."""
    for signal in signals.channels:
        missing = ~signal.present
        if not missing.any() or not signal.observed.size:
            continue
        edges = np.flatnonzero(np.diff(np.concatenate([[False], missing, [False]])))
        starts, lengths = edges[::2], np.diff(edges)[::2]
        longest = int(np.argmax(lengths))
        gaps = "one gap" if len(lengths) == 1 else f"{len(lengths)} gaps"
        every = sampled_every(signal.present)
        if every > 1 and int(np.median(lengths)) == every - 1:
            message = (
                f"has a sample in one of {every} rows, so that its rate is {signal.rate / every:g} Hz: maximum likelihood and "
                "discovery take it as it is; the weak form alone and differentiation need samples that all channels have"
            )
            yield Alert("dropped", signal.name, message, float(missing.mean()))
            continue
        message = (
            f"{missing.sum()} of {len(missing)} samples are missing in {gaps}, the longest of {lengths[longest]} samples at "
            f"{signal.start + starts[longest] / signal.rate:g} s: maximum likelihood and the weak form leave them out, which "
            "costs accuracy only; differentiation needs a complete piece, cut to one"
        )
        yield Alert("dropped", signal.name, message, float(missing.mean()), arguments=("earliest", "latest"))
