"""Records whose samples are not evenly spaced in time, as they show by themselves: samples lost, held or written twice."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from linkwise.inspection.inspect import inspect
from linkwise.likelihood.judgement import Judgement
from linkwise.records.record import Record
from linkwise.verdict import Verdict

_JUMPS = "jumps between two samples"  # of a channel that lacks samples, without a gap in the times
_SYSTEMATIC = (Verdict.MEASUREMENT_ERROR, Verdict.SYSTEMATIC_MISFIT, Verdict.UNEXPLAINED_FORCES)


def before_other_causes(judgement: Judgement, records: Sequence[Record]) -> Judgement:
    """The judgement, with uneven samples told before the causes of a diagnosis, all of which such samples resemble.

    A step in time moves everything behind it, which gains and delays explain in part.
    """
    if judgement.verdict not in _SYSTEMATIC or not judgement.diagnosis:
        return judgement
    shown = {
        f"{alert.channel} {alert.message.partition(',' if alert.kind == 'dropped' else ':')[0]}"
        for alert in inspect(tuple(records)).alerts
        if alert.kind == "doubled" or (alert.kind == "dropped" and alert.message.startswith(_JUMPS))
    }
    if not shown:
        return judgement
    return replace(
        judgement,
        message=(
            f"The record shows by itself what comes before any cause below: {'; '.join(sorted(shown))}. Samples were lost or "
            "written twice, so that what follows is early or late. Mend that first, as the alerts say, and identify again. "
            f"As it stands: {judgement.message[:1].lower()}{judgement.message[1:]}"
        ),
    )
