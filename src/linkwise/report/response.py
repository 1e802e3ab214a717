"""The result folder of `respond`: response.json, branches as a table, figures and a page."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup

from linkwise import __version__
from linkwise.display import csv_cell
from linkwise.model.structure_file import write_structure
from linkwise.output import RESPONSE
from linkwise.progress import Progress, silent
from linkwise.registry import Registry, lazy_module
from linkwise.report.page import Build, Reported, ResultFolder, Section, section_page, sections_of
from linkwise.response.result import Response, headline, peak_rows

if TYPE_CHECKING:
    from linkwise.plot import responses as response_figures
else:  # matplotlib loads where a figure is drawn
    response_figures = lazy_module("linkwise.plot.responses")


def response_of(result: Response) -> dict[str, Any]:
    """Return the content of response.json as plain data.

    Parameters
    ----------
    result : Response
        A result of `respond`.

    Returns
    -------
    dict
        The result as plain data, and the version of linkwise.

    Examples
    --------
    >>> import linkwise as lw
    >>> result = lw.respond(lw.bnes_chain(2), force={"m1": 0.1}, hz=(29.0, 31.0), starts=0)
    >>> sorted(lw.report.response_of(result)["levels"][0])
    ['branches', 'folds_hz', 'force', 'irregular']
    """
    return {**result.to_dict(), "version": __version__}


def _amplitudes(reported: Reported[Response]) -> Section:
    """Amplitudes over frequency."""
    text = (
        "Amplitude is half of peak to peak over a period. Unstable motion, which no test shows, is dotted; between folds "
        "the motion jumps from one stable branch to another."
    )
    figure = partial(response_figures.response_figure, reported.result)
    return Section("Amplitude over frequency", [text], rows=peak_rows(reported.result), figure=figure)


SECTIONS: Registry[Build[Response]] = Registry("section", {"response": _amplitudes})
"""The sections of a response, in order; the name of a section is that of its figure's files."""


def response_page(
    reported: Reported[Response], sections: Mapping[str, Section], pictures: Mapping[str, Markup]
) -> str:
    """The page of a response as text, HTML that carries everything in itself."""
    result = reported.result
    return section_page(
        result,
        sections,
        pictures,
        verdict=headline(result),
        findings=result.findings,
        structure=result.structure,
    )


def _write_data(reported: Reported[Response], folder: Path) -> None:
    """The structure, and branches.csv: a line for every point of a branch."""
    result = reported.result
    write_structure(result.structure, folder / "structure.toml")
    kinds = ("amplitude", "first harmonic", "phase in degrees", "lower", "upper")
    names = [f"{channel} {kind}" for channel in result.channels for kind in kinds]
    with (folder / "branches.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        head = ["level", "branch", "hz", "stable", "largest multiplier", "bifurcation"]
        writer.writerow([csv_cell(name) for name in [*head, *names]])
        for level in result.levels:
            for number, branch in enumerate(level.branches, start=1):
                unknown = np.full_like(branch.amplitude, np.nan)
                harmonic = branch.first_harmonic
                columns = np.stack(
                    [
                        branch.amplitude,
                        np.abs(harmonic),
                        np.degrees(np.angle(harmonic)),
                        unknown if branch.lower is None else branch.lower,
                        unknown if branch.upper is None else branch.upper,
                    ],
                    axis=2,
                ).reshape(len(branch.hz), -1)
                for row, hz in enumerate(branch.hz.tolist()):
                    fixed = [f"{level.size:.10g}", number, f"{hz:.10g}", int(branch.stable[row])]
                    fixed += [f"{branch.largest_multiplier[row]:.10g}", branch.bifurcations[row]]
                    writer.writerow(
                        [*fixed, *("" if np.isnan(v) else f"{v:.10g}" for v in columns[row].tolist())]
                    )


RESPONSE_FOLDER: ResultFolder[Response] = ResultFolder(
    mark=RESPONSE,
    document=lambda result, _: response_of(result),
    data=_write_data,
    sections=partial(sections_of, SECTIONS),
    page=response_page,
)
"""What `respond` hands over."""


def write_response(result: Response, folder: str | Path, *, progress: Progress = silent) -> Path:
    """Write a response into a folder: response.json, branches.csv, the structure, figures and report.html.

    Parameters
    ----------
    result : Response
        What `respond` returned.
    folder : path-like
        The folder. An earlier result of `respond` in it is replaced when the new one is complete.
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
    >>> result = lw.respond(lw.bnes_chain(2), force={"m1": 0.1}, hz=(29.0, 31.0), starts=0)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     written = lw.report.write_response(result, f"{folder}/response")
    ...     sorted(path.name for path in written.iterdir())
    ['branches.csv', 'report.html', 'response.json', 'response.png', 'structure.toml']
    """
    return RESPONSE_FOLDER.write(result, folder, progress=progress)
