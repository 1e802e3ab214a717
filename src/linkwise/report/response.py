"""The result folders of `respond`, `backbone` and `basins`: numbers, curves as tables, figures and a page."""

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
from linkwise.output import BACKBONE, BASINS, RESPONSE
from linkwise.progress import Progress, silent
from linkwise.registry import Registry, lazy_module
from linkwise.report.page import Build, Reported, ResultFolder, Section, section_page, sections_of
from linkwise.response.backbone import Backbone, backbone_headline, backbone_rows
from linkwise.response.rest_basins import Basins, basins_headline, basins_rows
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
    text += " Grey points are measured." if reported.result.measured else ""
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


def backbone_of(result: Backbone) -> dict[str, Any]:
    """Return the content of backbone.json as plain data.

    Parameters
    ----------
    result : Backbone
        A result of `backbone`.

    Returns
    -------
    dict
        The result as plain data, and the version of linkwise.

    Examples
    --------
    >>> import linkwise as lw
    >>> lw.report.backbone_of(lw.backbone(lw.bnes_chain(2), 1, to_energy=1e-3))["mode"]
    1
    """
    return {**result.to_dict(), "version": __version__}


def _curve(reported: Reported[Backbone]) -> Section:
    """Amplitudes over the frequency of a mode."""
    figure = partial(response_figures.backbone_figure, reported.result)
    text = ["Grey points are measured."] if reported.result.measured else []
    return Section("Amplitude over frequency", text, rows=backbone_rows(reported.result), figure=figure)


def _write_backbone_data(reported: Reported[Backbone], folder: Path) -> None:
    """The structure, and backbone.csv: frequency in Hz, energy in J and amplitudes."""
    result = reported.result
    write_structure(result.structure, folder / "structure.toml")
    with (folder / "backbone.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([csv_cell(name) for name in ("hz", "energy", *result.channels)])
        table = np.column_stack([result.hz, result.energy, result.amplitude])
        writer.writerows([f"{value:.10g}" for value in row] for row in table.tolist())


BACKBONE_SECTIONS: Registry[Build[Backbone]] = Registry("section", {"backbone": _curve})
"""The sections of a backbone, in order."""

BACKBONE_FOLDER: ResultFolder[Backbone] = ResultFolder(
    mark=BACKBONE,
    document=lambda result, _: backbone_of(result),
    data=_write_backbone_data,
    sections=partial(sections_of, BACKBONE_SECTIONS),
    page=lambda reported, sections, pictures: section_page(
        reported.result,
        sections,
        pictures,
        verdict=backbone_headline(reported.result),
        findings=reported.result.findings,
        structure=reported.result.structure,
    ),
)
"""What `backbone` hands over."""


def _write_basins_data(reported: Reported[Basins], folder: Path) -> None:
    """The structure, and basins.csv: the initial values and the number of the rest position, from 1, 0 where not decided."""
    result = reported.result
    write_structure(result.structure, folder / "structure.toml")
    with (folder / "basins.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*map(csv_cell, result.plane), "rest"])
        for first, row in zip(result.values[0].tolist(), result.ends.tolist(), strict=True):
            for second, end in zip(result.values[1].tolist(), row, strict=True):
                writer.writerow([f"{first:.10g}", f"{second:.10g}", end + 1])


def _plane(reported: Reported[Basins]) -> Section:
    """The plane of initial states."""
    figure = partial(response_figures.basins_figure, reported.result)
    return Section("Where motion ends", rows=basins_rows(reported.result), figure=figure)


BASINS_SECTIONS: Registry[Build[Basins]] = Registry("section", {"basins": _plane})
"""The sections of basins, in order."""

BASINS_FOLDER: ResultFolder[Basins] = ResultFolder(
    mark=BASINS,
    document=lambda result, _: {**result.to_dict(), "version": __version__},
    data=_write_basins_data,
    sections=partial(sections_of, BASINS_SECTIONS),
    page=lambda reported, sections, pictures: section_page(
        reported.result,
        sections,
        pictures,
        verdict=basins_headline(reported.result),
        structure=reported.result.structure,
    ),
)
"""What `basins` hands over."""


def write_backbone(result: Backbone, folder: str | Path, *, progress: Progress = silent) -> Path:
    """Write a backbone into a folder: backbone.json, backbone.csv, the structure, a figure and report.html.

    Parameters
    ----------
    result : Backbone
        What `backbone` returned.
    folder : path-like
        The folder. An earlier result of `backbone` in it is replaced when the new one is complete.
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
    >>> result = lw.backbone(lw.bnes_chain(2), 1, to_energy=1e-3)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     written = lw.report.write_backbone(result, f"{folder}/backbone")
    ...     sorted(path.name for path in written.iterdir())
    ['backbone.csv', 'backbone.json', 'backbone.png', 'report.html', 'structure.toml']
    """
    return BACKBONE_FOLDER.write(result, folder, progress=progress)
