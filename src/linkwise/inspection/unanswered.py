"""Alerts of the records of an answer, less those of what the answer allows for."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from linkwise.inspection.alert import Alert
from linkwise.inspection.inspect import inspect
from linkwise.inspection.mark_missing import marked_samples
from linkwise.inspection.result import labels
from linkwise.records.record import Record

# turns by which a stated hum may differ from the line at the end of a record: a tone beside it leaves most of the line
_TURN = 0.25
_TOLD = 0.01  # Hz to which an alert names the line


class EstimatedError(NamedTuple):
    """An error of a sensor that is estimated with the coefficients.

    Attributes
    ----------
    kind : str
        As of an `Alert`.
    channel : str
        The channel.
    frequency : float or None
        In Hz, of a hum.

    Examples
    --------
    >>> import linkwise as lw
    >>> lw.EstimatedError("hum", "a:m1", 50.0).frequency
    50.0
    """

    kind: str
    channel: str
    frequency: float | None = None


def unanswered_alerts(
    records: Sequence[Record], estimated: Collection[EstimatedError] = ()
) -> tuple[Alert, ...]:
    """Alerts of records that an answer does not allow for, worst first.

    Parameters
    ----------
    records : sequence of Record
        The records.
    estimated : collection of EstimatedError, optional
        Errors that are estimated with the coefficients. Samples that were marked as missing are left out in any answer.

    Returns
    -------
    tuple of Alert
        As of `inspect`.
    """
    names = labels(tuple(records))
    marked = {name: _marked_alone(record) for name, record in zip(names, records, strict=True)}
    near = {name: _TURN / record.duration + _TOLD for name, record in zip(names, records, strict=True)}
    return tuple(
        alert
        for alert in inspect(records).alerts
        if not _is_estimated(alert, estimated, near[alert.record])
        and not (alert.is_of_gaps and alert.channel in marked[alert.record])
    )


def _marked_alone(record: Record) -> set[str]:
    """Channels that lack no more samples than were marked as missing."""
    return {
        channel
        for channel, count in marked_samples(record).items()
        if np.isnan(record.channel(channel)).sum() <= count
    }


def _is_estimated(alert: Alert, estimated: Collection[EstimatedError], near: float) -> bool:
    """Whether what an alert names is estimated, all of its lines where it is a hum, each within `near` in Hz."""
    stated = [
        error.frequency for error in estimated if (error.kind, error.channel) == (alert.kind, alert.channel)
    ]
    return bool(stated) and all(
        any(frequency is not None and abs(line - frequency) < near for frequency in stated)
        for line in alert.frequencies
    )
