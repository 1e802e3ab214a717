"""The result folder of `identify`: numbers, figures and a page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from linkwise.atomic import RESULT, atomic_folder, to_json
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.force_curve import GRID
from linkwise.estimates.uncertainty import COVARIANCE, Posterior, write_covariance
from linkwise.model.structure import Structure
from linkwise.model.toml_file import write_structure
from linkwise.progress import Progress, ProgressReport, part, silent
from linkwise.report.estimate_json import result_of
from linkwise.report.estimate_page import estimate_figures, estimate_page
from linkwise.report.section import Reported, write_figures


def write_result(
    estimate: Estimate,
    folder: str | Path,
    *,
    truth: Structure | None = None,
    progress: Progress = silent,
) -> Path:
    """Write result.json, structure.toml, covariance.csv (of an answer to be trusted), force_NAME.csv, figures and report.html
    into `folder`; all of them or none.

    An earlier result in `folder` is replaced when the new one is complete; raises OutputError for a folder that holds
    something else. `truth` adds the true forces to the figures and their NMSE; `progress` is told the fraction done.
    """
    result = result_of(estimate, truth)
    reported = Reported(estimate, truth, result.get("nmse_percent", {}))
    with atomic_folder(Path(folder)) as partial:
        write_numbers(estimate, partial)
        pictures = write_figures(estimate_figures(reported), partial, part(progress, 0.0, 0.9))
        progress(ProgressReport(0.9, "page"))
        write_page(estimate_page(reported, pictures, version=result["version"]), result, partial)
    return Path(folder)


def write_numbers(estimate: Estimate, folder: Path) -> None:
    """Write what was identified into an empty `folder`: the structure, the forces of its links and the covariance."""
    write_structure(estimate.structure, folder / "structure.toml")
    for found in estimate.links:
        _write_force(estimate, found.link.name, folder / f"force_{found.link.name}.csv")
    if estimate.trusted and estimate.intervals:
        write_covariance(Posterior.of(estimate), folder / COVARIANCE)


def write_page(page: str, result: dict[str, Any], folder: Path) -> None:
    """Write report.html, and result.json, which names the files beside it."""
    (folder / "report.html").write_text(page, encoding="utf-8")
    result = {**result, "files": sorted(path.name for path in folder.iterdir())}
    (folder / RESULT).write_text(to_json(result, indent=1) + "\n", encoding="utf-8")


def _write_force(estimate: Estimate, name: str, path: Path) -> None:
    """The force at v = 0 and its 95 % band over the range that the record visited: columns d in m, the others in N."""
    d = np.linspace(*estimate.link(name).d_range, GRID)
    table = np.stack([d, *estimate.force_band(name, d)], axis=1)
    np.savetxt(path, table, fmt="%.10g", delimiter=",", header="d,force,lower,upper", comments="")
