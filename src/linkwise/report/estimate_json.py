"""What result.json says of an estimate."""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

from linkwise.errors import RecordError
from linkwise.estimates.estimate import Estimate
from linkwise.identification.force_error import nmse
from linkwise.model.structure import Link, Structure
from linkwise.records.record import Record


def result_of(estimate: Estimate, truth: Structure | None = None) -> dict[str, Any]:
    """What result.json says, as plain data; with a `truth` also "nmse_percent" by link (paper Eq. 8),
    null where the record does not tell it.
    """
    result = {**estimate.to_dict(), "version": version("linkwise")}
    return result if truth is None else {**result, "nmse_percent": _errors(estimate, truth)}


def _errors(estimate: Estimate, truth: Structure) -> dict[str, float | None]:
    """NMSE in % of each identified force over the motion of the record; None where the record does not tell it."""
    return {
        link.name: _error(truth.link(link.name), link, estimate.record) for link in estimate.structure.links
    }


def _error(true: Link, found: Link, record: Record) -> float | None:
    try:
        return nmse(true, found, record)
    except RecordError:  # an end without displacement, or a force that does not vary
        return None
