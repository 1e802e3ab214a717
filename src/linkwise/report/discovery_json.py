"""What result.json says of a discovery."""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

from linkwise.discovery.result import Discovery
from linkwise.discovery.scoring import align_truth, term_score
from linkwise.model.structure import Structure
from linkwise.report.estimate_json import result_of


def discovery_of(found: Discovery, truth: Structure | None = None) -> dict[str, Any]:
    """What result.json says, as plain data.

    With a `truth` also "nmse_percent" by link (paper Eq. 8), null where there is no such force in truth, and "truth", the
    names of the terms that are right, missing and false. Raises StructureError for a truth with other masses.
    """
    result = {**found.to_dict(), "version": version("linkwise")}
    if truth is None:
        return result
    score = term_score(found.structure, truth)
    compared = {
        "right": list(score.right),
        "missing": list(score.missing),
        "extra": list(score.extra),
        "missing_links": list(score.missing_links),
        "extra_links": list(score.extra_links),
    }
    beside = result_of(found.estimate, align_truth(found.structure, truth))
    return {**result, "nmse_percent": beside["nmse_percent"], "truth": compared}
