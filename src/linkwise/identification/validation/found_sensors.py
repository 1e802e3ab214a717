"""Errors of sensors that an answer found, taken out of the record that it is compared with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from linkwise.errors import IdentificationError, RecordError
from linkwise.estimates.sensor_error import SensorErrorEstimate
from linkwise.records.delays import without_delays
from linkwise.records.record import Record
from linkwise.records.sensor_uncertainty import SensorUncertainty

_ORDER = ("offset", "gain", "delay")  # in which they are undone: an offset is added last


def without_found_errors(
    record: Record, errors: Sequence[SensorErrorEstimate], corrected: Mapping[str, Sequence[str]]
) -> tuple[Record, tuple[str, ...]]:
    """The record as it would be without the `errors`, and sentences on what was taken out and what was not.

    The standard errors are what is known of the sensors then, in place of what the record states. Errors of the kinds that
    are `corrected`, by channel, stay: the record is without them. Raises IdentificationError for another kind or channel.
    """
    _require_kinds(corrected, record)
    taken_out, remarks = [], []
    for error in sorted(errors, key=lambda error: _ORDER.index(error.kind)):
        if error.channel not in record.channels:
            continue
        if error.kind in corrected.get(error.channel, ()):
            remarks.append(
                f"The {error.kind} of {error.channel} that the answer found, {error.value:.6g}{_unit(error)}, was not "
                "removed: what is stated of it for this record counts."
            )
            continue
        try:
            record = _without(record, error)
        except RecordError as refusal:
            remarks.append(
                f"The {error.kind} of {error.channel} that the answer found was not removed: {refusal}"
            )
        else:
            taken_out.append(f"{error.kind} of {error.channel}")
    if taken_out:
        remarks.append(
            f"Removed from the record, as found by the answer: {', '.join(taken_out)}. If a sensor was exchanged or "
            f"adjusted since, identify again."
        )
    return record, tuple(remarks)


def _require_kinds(corrected: Mapping[str, Sequence[str]], record: Record) -> None:
    for channel, kinds in corrected.items():
        wrong = next((kind for kind in kinds if kind not in _ORDER), None)
        if wrong is not None or channel not in record.channels:
            reason = (
                f"the {wrong} of a channel; choose from {', '.join(_ORDER)}"
                if wrong
                else "a channel of the record"
            )
            raise IdentificationError(
                f"corrected takes errors that the record is without, by channel, got {channel}: {', '.join(kinds)}, which is "
                f"not {reason}",
                arguments=("corrected",),
            )


def _unit(error: SensorErrorEstimate) -> str:
    return "" if error.unit == "1" else f" {error.unit}"


def _without(record: Record, error: SensorErrorEstimate) -> Record:
    """The record without one error; RecordError where it cannot be taken out."""
    column, values = record.channels.index(error.channel), record.values.copy()
    if error.kind == "delay":
        record = without_delays(record, {error.channel: error.value})
    elif error.kind == "offset":
        values[:, column] -= error.value
        record = replace(record, values=values)
    elif error.value > 0.0:
        values[:, column] /= error.value
        record = replace(record, values=values)
    else:
        raise RecordError(f"a gain must be positive, got {error.value:g}")
    stated = record.uncertainty.get(error.channel, SensorUncertainty())
    known = replace(stated, **{error.kind: error.standard_error})
    return replace(record, uncertainty={**record.uncertainty, error.channel: known})
