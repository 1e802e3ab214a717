"""The result folder of `design`: design.json, all designs, the structure of the best, figures and a page."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from linkwise import __version__
from linkwise.absorption.design import ADDED_MASS, Design, design_headline, design_rows, trade_off_rows
from linkwise.absorption.result import mass_rows
from linkwise.display import csv_cell
from linkwise.model.structure_file import write_structure
from linkwise.output import DESIGN
from linkwise.progress import Progress, silent
from linkwise.registry import Registry, lazy_module
from linkwise.report.page import Build, Reported, ResultFolder, Section, section_page, sections_of

if TYPE_CHECKING:
    from linkwise.plot import absorptions as absorption_figures
    from linkwise.plot import design as design_figures
else:  # matplotlib loads where a figure is drawn
    absorption_figures = lazy_module("linkwise.plot.absorptions")
    design_figures = lazy_module("linkwise.plot.design")


def design_of(result: Design) -> dict[str, Any]:
    """Return the content of design.json as plain data.

    Parameters
    ----------
    result : Design
        What `design` returned.

    Returns
    -------
    dict
        The result as plain data, and the version of linkwise.

    Examples
    --------
    >>> import linkwise as lw
    >>> few = lw.absorption.DesignOptions(evaluations=8)
    >>> over = {"nes1.alpha": (-300.0, -20.0)}
    >>> found = lw.design(lw.bnes_chain(2), over, "rms", few, duration=0.5, release={"v:m1": 1.0})
    >>> sorted(lw.report.design_of(found)["trade_off"][0])
    ['added_mass', 'objective']
    """
    return {**result.to_dict(), "version": __version__}


def _best(reported: Reported[Design]) -> Section:
    return Section("Best design", rows=design_rows(reported.result))


def _trade_off(reported: Reported[Design]) -> Section | None:
    """Mass against what was minimised, where the mass was varied."""
    result = reported.result
    if len(result.trade_off) < 2:
        return None
    text = "No lighter design that was tried is as good. Grey: the other designs within the limits."
    return Section(
        "Trade-off",
        [text],
        rows=trade_off_rows(result),
        figure=lambda: design_figures.trade_off_figure(result),
    )


def _designs(reported: Reported[Design]) -> Section:
    """Where the designs lie that were tried."""
    result = reported.result
    text = "Every design that was simulated; where neighbours differ, thresholds or chance decide, and no surface is smooth."
    return Section("Designs", [text], figure=lambda: design_figures.designs_figure(result))


def _decay(reported: Reported[Design]) -> Section:
    """The motion with the best sinks, and without."""
    plain = reported.result.absorption
    return Section(
        "Motion of the best", rows=mass_rows(plain), figure=lambda: absorption_figures.decay_figure(plain)
    )


SECTIONS: Registry[Build[Design]] = Registry(
    "section", {"best": _best, "trade_off": _trade_off, "designs": _designs, "decay": _decay}
)
"""The sections of the page, in order."""


def design_page(
    reported: Reported[Design], sections: Mapping[str, Section], pictures: Mapping[str, Markup]
) -> str:
    """The page as text, HTML that carries everything in itself; `pictures` are those of `write_figures`."""
    result = reported.result
    headline, findings = design_headline(result), result.findings
    return section_page(
        result, sections, pictures, verdict=headline, findings=findings, structure=result.structure
    )


def write_design(result: Design, folder: str | Path, *, progress: Progress = silent) -> Path:
    """Write a design into a folder: design.json, designs.csv, structure.toml of the best, figures and report.html.

    Parameters
    ----------
    result : Design
        What `design` returned.
    folder : path-like
        The folder. An earlier result of `design` in it is replaced when the new one is complete.
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
    >>> few = lw.absorption.DesignOptions(evaluations=8)
    >>> over = {"nes1.alpha": (-300.0, -20.0)}
    >>> found = lw.design(lw.bnes_chain(2), over, "rms", few, duration=0.5, release={"v:m1": 1.0})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     written = lw.report.write_design(found, f"{folder}/best")
    ...     names = [path.name for path in written.iterdir()]
    >>> sorted(name for name in names if name.endswith((".json", ".html", ".toml")))
    ['design.json', 'report.html', 'structure.toml']
    """
    return DESIGN_FOLDER.write(result, folder, progress=progress)


def _write_data(reported: Reported[Design], folder: Path) -> None:
    """The structure of the best, and designs.csv: a line for every design, in the order of the search."""
    result = reported.result
    write_structure(result.structure, folder / "structure.toml")
    with (folder / "designs.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        names = [*(axis.name for axis in result.axes), ADDED_MASS, "within limits", result.quantity.name]
        writer.writerow([csv_cell(name) for name in names])
        columns = result.added_mass.tolist(), result.allowed.tolist(), result.objectives.tolist()
        for point, mass, allowed, objective in zip(result.points.tolist(), *columns, strict=True):
            numbers = [f"{value:.10g}" for value in (*point, mass)]
            writer.writerow([*numbers, int(allowed), f"{objective:.10g}"])


DESIGN_FOLDER: ResultFolder[Design] = ResultFolder(
    mark=DESIGN,
    document=lambda result, _: design_of(result),
    data=_write_data,
    sections=partial(sections_of, SECTIONS),
    page=design_page,
)
"""What `design` hands over."""
