"""The result folder of `discover`: that of `identify`, with the graph, the path and the evidence for every term."""

from __future__ import annotations

import csv
import math
from dataclasses import fields, replace
from pathlib import Path

from linkwise.atomic import atomic_folder
from linkwise.discovery.result import Discovery, TermEvidence
from linkwise.discovery.scoring import align_truth, term_score
from linkwise.estimates.estimate import Estimate
from linkwise.model.structure import Structure
from linkwise.plot import save
from linkwise.plot.discovery_graph import graph_figure
from linkwise.plot.discovery_path import evidence_figure, path_figure
from linkwise.progress import Progress, ProgressReport, part, silent
from linkwise.report.discovery_json import discovery_of
from linkwise.report.discovery_page import discovery_page
from linkwise.report.estimate_folder import write_links, write_page


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
    found = replace(found, estimate=_by_names_found(found.estimate))
    with atomic_folder(Path(folder)) as partial:
        progress(ProgressReport(0.0, "graph"))
        figures = {"graph": graph_figure, "path": path_figure, "evidence": evidence_figure}
        for name, draw in figures.items():
            save(draw(found), partial / name)
        _write_terms(found, partial / "terms.csv")
        pictured = write_links(found.estimate, partial, beside, part(progress, 0.1, 0.7))
        page = discovery_page(
            found, partial, score=None if truth is None else term_score(found.structure, truth),
            progress=part(progress, 0.7, 1.0),
            version=result["version"], pictured=pictured, truth=beside, nmse=result.get("nmse_percent"),
        )  # fmt: skip
        write_page(page, result, partial)
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
    return str(value)
