"""Samples that are missing."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from linkwise.inspection.alert import Alert
from linkwise.inspection.record_signals import RecordSignals
from linkwise.inspection.spikes import jumps
from linkwise.records.common_samples import sampled_every

_NAMED = 3  # jumps whose times are told


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
        share, arguments = float(missing.mean()), ("earliest", "latest")
        yield Alert("dropped", signal.name, message, share, arguments=arguments, is_of_gaps=True)


def lost(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of displacements that jump, as where a logger lost samples without a gap in the times."""
    for signal in signals.responses:
        rows = jumps(signal)
        if not len(rows):
            continue
        when = ", ".join(f"{signal.start + row / signal.rate:.6g}" for row in rows[:_NAMED])
        times = f"{when} s" if len(rows) <= _NAMED else f"{when} s and {len(rows) - _NAMED} other times"
        message = (
            f"jumps between two samples at {times}, and moves on smoothly from there: if the logger lost samples, "
            "everything after them comes early, and stiffness and damping are wrong by many standard errors; cut the record "
            "to a piece without a jump, or put the lost times back"
        )
        size = float(np.sqrt(np.sum(np.diff(signal.filled)[rows - 1] ** 2) / len(signal.values))) / signal.rms
        yield Alert("dropped", signal.name, message, size**0.5, arguments=("earliest", "latest"))
