"""An answer beside the true structure: errors of forces, and of a discovery the terms that are right, missing and false."""

from __future__ import annotations

from typing import Any

from linkwise.discovery.result import Discovery
from linkwise.errors import RecordError
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.scoring import align_truth, term_score
from linkwise.identification.identify import nmse
from linkwise.model.link import Link
from linkwise.model.structure import Structure
from linkwise.records.record import Record

_SCORES = ("right", "missing", "extra", "missing_links", "extra_links")


def compared(result: object, truth: Structure) -> dict[str, Any]:
    """The errors of forces in %, and of a discovery the score of its terms; nothing of other results."""
    if isinstance(result, Discovery):
        score = term_score(result.structure, truth)
        errors = _force_errors(result.estimate, align_truth(result.structure, truth))
        return {"nmse_percent": errors, "truth": {name: list(getattr(score, name)) for name in _SCORES}}
    return {"nmse_percent": _force_errors(result, truth)} if isinstance(result, Estimate) else {}


def _force_errors(estimate: Estimate, truth: Structure) -> dict[str, float | None]:
    """The NMSE of the force of each link in %, None where the record does not determine it."""
    links = (link for link in estimate.structure.links if link.name not in estimate.structure.modes)
    return {link.name: _force_error(truth.link(link.name), link, estimate.record) for link in links}


def _force_error(true: Link, identified: Link, record: Record) -> float | None:
    try:
        return nmse(true, identified, record)
    except RecordError:  # an end without displacement, or a force that does not vary
        return None
