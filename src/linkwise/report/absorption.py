"""The result folders of `absorb`, its intervals and maps: absorption.json, histories, figures and a page."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup

from linkwise import __version__
from linkwise.absorption.intervals import (
    AbsorptionIntervals,
    interval_headline,
    interval_rows,
    without_intervals,
)
from linkwise.absorption.map import AbsorptionMap, map_headline, map_rows
from linkwise.absorption.result import (
    Absorption,
    crossing_rows,
    energy_rows,
    harvest_rows,
    headline,
    mass_rows,
    primary,
)
from linkwise.arrays import Floats
from linkwise.display import csv_cell
from linkwise.model.structure_file import write_structure
from linkwise.output import ABSORPTION
from linkwise.progress import Progress, silent
from linkwise.registry import Registry, lazy_module
from linkwise.report.page import Build, Reported, ResultFolder, Section, section_page, sections_of

if TYPE_CHECKING:
    from linkwise.plot import absorptions as absorption_figures
else:  # matplotlib loads where a figure is drawn
    absorption_figures = lazy_module("linkwise.plot.absorptions")


def absorption_of(result: Absorption | AbsorptionIntervals | AbsorptionMap) -> dict[str, Any]:
    """Return the content of absorption.json as plain data.

    Parameters
    ----------
    result : Absorption, AbsorptionIntervals or AbsorptionMap
        A result of `absorb`, `absorption_intervals` or `absorption_map`.

    Returns
    -------
    dict
        The result as plain data, and the version of linkwise.

    Examples
    --------
    >>> import linkwise as lw
    >>> result = lw.absorb(lw.bnes_chain(2), duration=2.0, release={"v:m1": 1.0})
    >>> lw.report.absorption_of(result)["trusted"]
    True
    """
    return {**result.to_dict(), "version": __version__}


Answer = Absorption | AbsorptionIntervals


def _intervals(reported: Reported[Answer]) -> Section | None:
    """The intervals of an answer that has some."""
    answer = reported.result
    if not isinstance(answer, AbsorptionIntervals):
        return None
    return Section("Intervals", [interval_headline(answer)], rows=interval_rows(answer))


def _masses(reported: Reported[Answer]) -> Section:
    """The decay of the primary masses with sinks and without."""
    plain = without_intervals(reported.result)
    text = (
        f"A mass has settled when it stays below {100 * plain.settle:g} % of its peak without sinks until the end, and has "
        "done so for the last 5 % of the run at least. The envelope is the largest excursion still to come; decay is the rate "
        "of an exponential through the peaks that none later exceeds."
    )
    return Section(
        primary(plain).capitalize(),
        [text],
        rows=mass_rows(plain),
        figure=lambda: absorption_figures.decay_figure(reported.result),
    )


def _energy(reported: Reported[Answer]) -> Section:
    """Where the energy went."""
    plain = without_intervals(reported.result)
    text = (
        "Energies count from the lowest wells of all links, so the energy supplied is the energy stored and "
        f"dissipated: the balance closes to {max(plain.with_sinks.closure, plain.without.closure):.0e}."
    )
    return Section(
        "Energy",
        [text],
        rows=energy_rows(plain),
        figure=lambda: absorption_figures.energy_figure(reported.result),
    )


def _crossings(reported: Reported[Answer]) -> Section:
    """How the sinks cross from well to well."""
    plain = without_intervals(reported.result)
    return Section(
        "Wells crossed",
        rows=crossing_rows(plain),
        figure=lambda: absorption_figures.crossings_figure(reported.result),
    )


def _harvesters(reported: Reported[Answer]) -> Section | None:
    """What harvesters take, where there are some."""
    plain = without_intervals(reported.result)
    if not plain.harvests:
        return None
    return Section("Harvesters", ["Dampers in parallel to links."], rows=harvest_rows(plain))


def _map(reported: Reported[AbsorptionMap]) -> Section:
    """The quantities over the swept parameters."""
    swept = reported.result
    return Section("Map", rows=map_rows(swept), figure=lambda: absorption_figures.map_figure(swept))


SECTIONS: Registry[Build[Answer]] = Registry(
    "section",
    {
        "intervals": _intervals,
        "decay": _masses,
        "energy": _energy,
        "crossings": _crossings,
        "harvesters": _harvesters,
    },
)
"""The sections of a comparison, in order; the name of a section is that of its figure's files."""

MAP_SECTIONS: Registry[Build[AbsorptionMap]] = Registry("section", {"map": _map})
"""The sections of a sweep, in order."""


def absorption_page(
    reported: Reported[Answer], sections: Mapping[str, Section], pictures: Mapping[str, Markup]
) -> str:
    """The page of a comparison as text, HTML that carries everything in itself; `pictures` are those of `write_figures`."""
    plain = without_intervals(reported.result)
    result, structure = reported.result, plain.with_sinks.structure
    return section_page(
        result, sections, pictures, verdict=headline(plain), findings=plain.findings, structure=structure
    )


def map_page(
    reported: Reported[AbsorptionMap], sections: Mapping[str, Section], pictures: Mapping[str, Markup]
) -> str:
    """The page of a sweep as text, HTML that carries everything in itself; `pictures` are those of `write_figures`."""
    swept = reported.result
    verdict, findings, structure = map_headline(swept), swept.findings, swept.structure
    return section_page(swept, sections, pictures, verdict=verdict, findings=findings, structure=structure)


def write_absorption(result: Answer, folder: str | Path, *, progress: Progress = silent) -> Path:
    """Write a comparison with and without sinks into a folder: absorption.json, histories, figures and report.html.

    Parameters
    ----------
    result : Absorption or AbsorptionIntervals
        What `absorb` or `absorption_intervals` returned.
    folder : path-like
        The folder. An earlier result of `absorb` in it is replaced when the new one is complete.
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
    >>> result = lw.absorb(lw.bnes_chain(2), duration=1.0, rate=500.0, release={"v:m1": 1.0})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     written = lw.report.write_absorption(result, f"{folder}/absorption")
    ...     names = [path.name for path in written.iterdir()]
    >>> sorted(name for name in names if name.endswith((".json", ".html", ".toml")))
    ['absorption.json', 'report.html', 'structure.toml']
    """
    return ABSORPTION_FOLDER.write(result, folder, progress=progress)


def write_absorption_map(result: AbsorptionMap, folder: str | Path, *, progress: Progress = silent) -> Path:
    """Write a sweep into a folder: absorption.json, map.csv, map.png and report.html.

    Parameters
    ----------
    result : AbsorptionMap
        What `absorption_map` returned.
    folder : path-like
        The folder. An earlier result of `absorb` in it is replaced when the new one is complete.
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
    >>> over = {"nes1.alpha": [-150.0, -100.0, -50.0]}
    >>> swept = lw.absorption.absorption_map(lw.bnes_chain(2), over, duration=0.5, rate=500.0, release={"v:m1": 1.0})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     written = lw.report.write_absorption_map(swept, f"{folder}/map")
    ...     names = [path.name for path in written.iterdir()]
    >>> sorted(name for name in names if name.endswith((".json", ".html", ".toml")))
    ['absorption.json', 'report.html']
    """
    return MAP_FOLDER.write(result, folder, progress=progress)


def _write_columns(path: Path, names: Sequence[str], columns: Sequence[Floats]) -> None:
    """A CSV file with a header."""
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerow([csv_cell(name) for name in names])
        np.savetxt(file, np.column_stack(columns), fmt="%.10g", delimiter=",")


def _write_map(reported: Reported[AbsorptionMap], folder: Path) -> None:
    """map.csv: a line for every point of the grid, the swept parameters first."""
    swept = reported.result
    grids = np.meshgrid(*(axis.values for axis in swept.axes), indexing="ij")
    names = [axis.name for axis in swept.axes] + [quantity.name for quantity in swept.quantities]
    table = [grid.ravel() for grid in grids] + list(swept.values.reshape(-1, len(swept.quantities)).T)
    _write_columns(folder / "map.csv", names, table)


def _write_data(reported: Reported[Answer], folder: Path) -> None:
    """The structure, and decay.csv, energy.csv and crossings.csv: time in s, displacements in m, energies in J."""
    result = reported.result
    absorption = without_intervals(result)
    bands = (result.lower, result.upper) if isinstance(result, AbsorptionIntervals) else ()
    names, columns = ["time"], [absorption.time]
    for number, mass in enumerate(absorption.masses):
        for side, label in ((absorption.with_sinks, ""), (absorption.without, " without sinks")):
            names += [f"x:{mass.name}{label}", f"envelope:{mass.name}{label}"]
            columns += [side.displacement(mass.name), np.ascontiguousarray(side.envelope[:, number])]
        for end, label in zip(bands, ("lower", "upper"), strict=False):
            names.append(f"envelope:{mass.name} {label}")
            columns.append(np.ascontiguousarray(end[:, number]))
    _write_columns(folder / "decay.csv", names, columns)
    write_structure(absorption.with_sinks.structure, folder / "structure.toml")
    names, columns = ["time"], [absorption.time]
    for side, label in ((absorption.with_sinks, ""), (absorption.without, " without sinks")):
        names += [f"{name}{label}" for name in ("put in", "stored", *side.dissipated_by)]
        columns += [side.supplied, side.stored, *side.dissipated_by.values()]
    _write_columns(folder / "energy.csv", names, columns)
    with (folder / "crossings.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("sink", "time"))
        writer.writerows(
            (csv_cell(work.sink.link), f"{time:.12g}") for work in absorption.sinks for time in work.crossings
        )


ABSORPTION_FOLDER: ResultFolder[Answer] = ResultFolder(
    mark=ABSORPTION,
    document=lambda result, _: absorption_of(result),
    data=_write_data,
    sections=partial(sections_of, SECTIONS),
    page=absorption_page,
)
"""What `absorb` hands over of a comparison."""

MAP_FOLDER: ResultFolder[AbsorptionMap] = ResultFolder(
    mark=ABSORPTION,
    document=lambda swept, _: absorption_of(swept),
    data=_write_map,
    sections=partial(sections_of, MAP_SECTIONS),
    page=map_page,
)
"""What `absorb` hands over of a sweep."""
