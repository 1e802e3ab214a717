"""The result folder of `identify`: numbers, figures and a page."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import numpy as np

from linkwise.argument_types import checked
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.force_curve import GRID
from linkwise.estimates.stated_trust import untrusted_comment
from linkwise.estimates.uncertainty import COVARIANCE, Posterior, write_covariance
from linkwise.model.structure import Structure
from linkwise.model.toml_file import format_structure
from linkwise.progress import Progress, silent
from linkwise.report.estimate_json import result_of
from linkwise.report.estimate_page import estimate_figures, estimate_page
from linkwise.report.result_folder import ResultFolder
from linkwise.verdict import Verdict, is_trusted, status_of


@checked
def write_result(
    estimate: Estimate,
    folder: str | Path,
    *,
    truth: Structure | None = None,
    progress: Progress = silent,
) -> Path:
    """Write an estimate into a folder.

    The folder holds result.json, structure.toml, force_NAME.csv, figures, report.html and, of an estimate that can be trusted,
    covariance.csv.

    Parameters
    ----------
    estimate : Estimate
        What `identify` returned.
    folder : path-like
        The folder. An earlier result in it is replaced when the new one is complete.
    truth : Structure, optional
        The true structure: its forces are added to the figures, and the NMSE of the forces to the numbers.
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

    Examples
    --------
    >>> import tempfile
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=1.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> fit = lw.identify(record, chain.unknown("nes"), method="weak")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     written = lw.write_result(fit, f"{folder}/answer")
    ...     names = [path.name for path in written.iterdir()]
    >>> sorted(name for name in names if name.endswith((".json", ".html", ".toml")))
    ['report.html', 'result.json', 'structure.toml']
    """
    return ESTIMATE_FOLDER.write(estimate, folder, truth=truth, progress=progress)


def write_numbers(estimate: Estimate, folder: Path, verdicts: Collection[Verdict]) -> None:
    """Write structure, forces of links and, of an answer to be trusted, the covariance into an empty `folder`."""
    trusted = is_trusted(verdicts)
    comment = "" if trusted else untrusted_comment(status_of(verdicts))
    (folder / "structure.toml").write_text(
        comment + format_structure(estimate.structure), encoding="utf-8", newline="\n"
    )
    for estimated_link in estimate.links:
        _write_force(estimate, estimated_link.link.name, folder / f"force_{estimated_link.link.name}.csv")
    if trusted and estimate.intervals:
        write_covariance(Posterior.of(estimate), folder / COVARIANCE)


def _write_force(estimate: Estimate, name: str, path: Path) -> None:
    """The force at v = 0 and its 95 % band over the range that the record visited: columns d in m, the others in N."""
    d = np.linspace(*estimate.link(name).d_range, GRID)
    table = np.stack([d, *estimate.force_band(name, d)], axis=1)
    np.savetxt(path, table, fmt="%.10g", delimiter=",", header="d,force,lower,upper", comments="")


ESTIMATE_FOLDER: ResultFolder[Estimate] = ResultFolder(
    document=result_of,
    data=lambda reported, folder: write_numbers(reported.result, folder, reported.result.verdicts),
    figures=estimate_figures,
    page=estimate_page,
)
"""What `identify` hands over."""
