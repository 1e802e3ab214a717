"""The result folder of `discover`: that of `identify`, with the graph, the path and the evidence for every term."""

from __future__ import annotations

import csv
import math
from dataclasses import fields, replace
from pathlib import Path

from linkwise.atomic import atomic_folder
from linkwise.discovery.result import Discovery, TermEvidence
from linkwise.discovery.scoring import align_truth
from linkwise.estimates.estimate import Estimate
from linkwise.model.structure import Structure
from linkwise.progress import Progress, ProgressReport, part, silent
from linkwise.report.discovery_json import discovery_of
from linkwise.report.discovery_page import SECTIONS, discovery_page
from linkwise.report.estimate_folder import write_numbers, write_page
from linkwise.report.estimate_page import estimate_figures
from linkwise.report.section import Reported, sections_of, write_figures
from linkwise.text import csv_cell


def write_discovery(
    found: Discovery,
    folder: str | Path,
    *,
    truth: Structure | None = None,
    progress: Progress = silent,
) -> Path:
    """Write what `write_result` writes into `folder`, and graph, path and evidence as figures and terms.csv; all or none.

    An earlier result in `folder` is replaced when the new one is complete; raises OutputError for a folder that holds
    something else. `truth` adds the true forces to the figures, their NMSE and the terms that are right; `progress` is
    told the fraction done.
    """
    result = discovery_of(found, truth)
    beside = None if truth is None else align_truth(found.structure, truth)
    reported = Reported(replace(found, estimate=_by_names_found(found.estimate)), truth)
    links = Reported(reported.result.estimate, beside, result.get("nmse_percent", {}))
    with atomic_folder(Path(folder)) as partial:
        _write_terms(found, partial / "terms.csv")
        write_numbers(links.result, partial)
        figures = {**sections_of(SECTIONS, reported), **estimate_figures(links)}
        pictures = write_figures(figures, partial, part(progress, 0.0, 0.9))
        progress(ProgressReport(0.9, "page"))
        write_page(discovery_page(reported, links, pictures, version=result["version"]), result, partial)
    return Path(folder)


def _by_names_found(estimate: Estimate) -> Estimate:
    """The estimate with the truth of a simulated record under the names of the links found, for figures to show beside."""
    simulated = estimate.record.simulated
    if simulated is None:
        return estimate
    beside = replace(simulated, structure=align_truth(estimate.structure, simulated.structure))
    return replace(estimate, record=replace(estimate.record, simulated=beside))


def _write_terms(found: Discovery, path: Path) -> None:
    """A line for every candidate that was tested, the kept ones first; what is not finite is left empty."""
    names = [field.name for field in fields(TermEvidence) if field.name != "between"]
    rows = [
        [*(getattr(term, name) for name in names), *term.between, term.certain, term.penalty]
        for term in found.terms
    ]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*names, "first", "second", "certain", "price"])
        writer.writerows([_cell(value) for value in row] for row in rows)


def _cell(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:.10g}" if math.isfinite(value) else ""
    return str(csv_cell(str(value)))
