"""The result folder: what `identify` and `discover` hand over (result.json and what stands beside it)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from linkwise.atomic import RESULT, atomic_folder, to_json
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.uncertainty import COVARIANCE, Posterior, write_covariance
from linkwise.model.structure import Structure
from linkwise.model.toml_file import write_structure
from linkwise.plot import force_figure, histories_figure, save
from linkwise.plot.force_view import GRID
from linkwise.progress import Progress, ProgressReport, part, silent
from linkwise.report.estimate_json import result_of
from linkwise.report.estimate_page import report

PICTURES = 24  # links with a figure; a long chain's others have their numbers and their force file


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
    with atomic_folder(Path(folder)) as partial:
        pictured = write_links(estimate, partial, truth, part(progress, 0.0, 0.7))
        page = report(
            estimate, version=result["version"], pictured=pictured, truth=truth, nmse=result.get("nmse_percent", {}),
            progress=part(progress, 0.7, 1.0),
        )  # fmt: skip
        write_page(page, result, partial)
    return Path(folder)


def write_links(
    estimate: Estimate,
    folder: Path,
    truth: Structure | None = None,
    progress: Progress = silent,
) -> tuple[str, ...]:
    """Write what was identified into an empty `folder`, numbers and figures; return the names of the links pictured."""
    write_structure(estimate.structure, folder / "structure.toml")
    for found in estimate.links:
        _write_force(estimate, found.link.name, folder / f"force_{found.link.name}.csv")
    if estimate.trusted and estimate.intervals:
        write_covariance(Posterior.of(estimate), folder / COVARIANCE)
    save(histories_figure(estimate.record), folder / "histories")
    pictured = _pictured(estimate)
    for number, name in enumerate(pictured):
        progress(ProgressReport(number / len(pictured), f"figure of {name}"))
        save(force_figure(estimate, name, truth=truth), folder / f"force_{name}")
    return pictured


def write_page(page: str, result: dict[str, Any], folder: Path) -> None:
    """Write report.html, and result.json, which names the files beside it."""
    (folder / "report.html").write_text(page, encoding="utf-8")
    result = {**result, "files": sorted(path.name for path in folder.iterdir())}
    (folder / RESULT).write_text(to_json(result, indent=1) + "\n", encoding="utf-8")


def _pictured(estimate: Estimate) -> tuple[str, ...]:
    """The links that get a figure: those with something identified first, as many as anyone looks at."""
    found = sorted(
        estimate.links, key=lambda each: all(coefficient.known for coefficient in each.coefficients)
    )
    return tuple(each.link.name for each in found[:PICTURES])


def _write_force(estimate: Estimate, name: str, path: Path) -> None:
    """The force at v = 0 and its 95 % band over the range that the record visited: columns d in m, the others in N."""
    d = np.linspace(*estimate.link(name).d_range, GRID)
    table = np.stack([d, *estimate.force_band(name, d)], axis=1)
    np.savetxt(path, table, fmt="%.10g", delimiter=",", header="d,force,lower,upper", comments="")
