"""The result folder of `discover`: that of `identify`, with the graph, the path and the evidence for every term."""

from __future__ import annotations

import csv
import math
from dataclasses import fields, replace
from pathlib import Path

from linkwise.argument_types import checked
from linkwise.deprecation import Deprecated, deprecated_keyword
from linkwise.discovery.result import Discovery, TermEvidence
from linkwise.discovery.scoring import align_truth
from linkwise.display import csv_cell
from linkwise.model.structure import Structure
from linkwise.progress import Progress, silent
from linkwise.report.discovery_json import discovery_of
from linkwise.report.discovery_page import discovery_figures, discovery_page
from linkwise.report.estimate_folder import write_numbers
from linkwise.report.result_folder import ResultFolder
from linkwise.report.section import Reported


@deprecated_keyword("found", Deprecated("discovery", since="0.2.0", until="0.4.0"))
@checked
def write_discovery(
    discovery: Discovery,
    folder: str | Path,
    *,
    truth: Structure | None = None,
    progress: Progress = silent,
) -> Path:
    """Write a discovery into a folder.

    The folder holds what `write_result` writes, and terms.csv, the graph, the path and the evidence.

    Parameters
    ----------
    discovery : Discovery
        What `discover` returned.
    folder : path-like
        The folder. An earlier result in it is replaced when the new one is complete.
    truth : Structure, optional
        The true structure: its forces are added to the figures, and the NMSE of the forces and the terms that are right to
        the numbers.
    progress : Progress
        Called with a `ProgressReport` before each figure.

    Returns
    -------
    pathlib.Path
        The folder.

    Raises
    ------
    OutputError
        If the folder holds something else, or cannot be written; then nothing is changed.
    StructureError
        If `truth` has other masses.

    Examples
    --------
    >>> import tempfile
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=2.0, rate=1000.0).with_noise(30.0, seed=1)
    >>> discovery = lw.discover(record, {"m1": 1.0, "m2": 0.01})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     written = lw.write_discovery(discovery, f"{folder}/discovery")
    ...     names = [path.name for path in written.iterdir()]
    >>> sorted(name for name in names if name.endswith((".json", ".html", ".toml")))
    ['report.html', 'result.json', 'structure.toml']
    """
    return DISCOVERY_FOLDER.write(discovery, folder, truth=truth, progress=progress)


_COLUMNS = {"identifiable": "told", "unambiguous": "reliable"}
"""Columns of terms.csv whose attribute was renamed: keys of files stay."""


def _write_data(reported: Reported[Discovery], folder: Path) -> None:
    """The candidates, and what is written of an estimate."""
    _write_terms(reported.result, folder / "terms.csv")
    write_numbers(reported.result.estimate, folder, reported.result.verdicts)


def _with_aligned_truth(discovery: Discovery) -> Discovery:
    """The discovery with the truth of a simulated record under the names of the discovered links, for figures."""
    estimate = discovery.estimate
    simulated = estimate.record.simulated
    if simulated is None:
        return discovery
    structures = (estimate.structure, simulated.structure)
    if any(
        link.law.states for structure in structures for link in structure.links
    ):  # not compared, see term_score
        return replace(discovery, estimate=replace(estimate, record=replace(estimate.record, simulated=None)))
    aligned = replace(simulated, structure=align_truth(*structures))
    return replace(discovery, estimate=replace(estimate, record=replace(estimate.record, simulated=aligned)))


def _write_terms(discovery: Discovery, path: Path) -> None:
    """A line for every candidate that was tested, the kept ones first; what is not finite is left empty."""
    apart = {"between", "possible_share"}
    names = [field.name for field in fields(TermEvidence) if field.name not in apart]
    rows = [
        [
            *(getattr(term, name) for name in names),
            *term.between,
            term.certain,
            term.penalty,
            term.possible_share,
        ]
        for term in discovery.terms
    ]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(
            [
                *(_COLUMNS.get(name, name) for name in names),
                "first",
                "second",
                "certain",
                "price",
                "possible_share",
            ]
        )
        writer.writerows([_cell(value) for value in row] for row in rows)


def _cell(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:.10g}" if math.isfinite(value) else ""
    return str(csv_cell(str(value)))


DISCOVERY_FOLDER: ResultFolder[Discovery] = ResultFolder(
    document=discovery_of,
    data=_write_data,
    figures=discovery_figures,
    page=discovery_page,
    shown=_with_aligned_truth,
)
"""What `discover` hands over."""
