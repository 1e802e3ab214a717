"""The result folder of `absorb`: numbers, histories, figures and a page."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from linkwise.absorption.intervals import AbsorptionIntervals, without_intervals
from linkwise.absorption.map_result import AbsorptionMap
from linkwise.argument_types import checked
from linkwise.arrays import Floats
from linkwise.deprecation import Deprecated, deprecated_keyword
from linkwise.display import csv_cell
from linkwise.model.toml_file import write_structure
from linkwise.output import ABSORPTION
from linkwise.progress import Progress, silent
from linkwise.report.absorption_json import absorption_of
from linkwise.report.absorption_page import (
    MAP_SECTIONS,
    SECTIONS,
    Answer,
    absorption_page,
    map_page,
)
from linkwise.report.result_folder import ResultFolder
from linkwise.report.section import Reported, sections_of


@deprecated_keyword("answer", Deprecated("result", since="0.2.0", until="0.4.0"))
@checked
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
    ...     written = lw.write_absorption(result, f"{folder}/absorption")
    ...     names = [path.name for path in written.iterdir()]
    >>> sorted(name for name in names if name.endswith((".json", ".html", ".toml")))
    ['absorption.json', 'report.html', 'structure.toml']
    """
    return ABSORPTION_FOLDER.write(result, folder, progress=progress)


@deprecated_keyword("found", Deprecated("result", since="0.2.0", until="0.4.0"))
@checked
def write_absorption_map(result: AbsorptionMap, folder: str | Path, *, progress: Progress = silent) -> Path:
    """Write a sweep into a folder: absorption.json, map.csv, map.png, map.svg and report.html.

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
    >>> swept = lw.absorption_map(lw.bnes_chain(2), over, duration=0.5, rate=500.0, release={"v:m1": 1.0})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     written = lw.write_absorption_map(swept, f"{folder}/map")
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


def _write_data(reported: Reported[Answer], folder: Path) -> None:
    """The histories and the structure."""
    _write_histories(reported.result, folder)
    write_structure(without_intervals(reported.result).with_sinks.structure, folder / "structure.toml")


def _write_map(reported: Reported[AbsorptionMap], folder: Path) -> None:
    """map.csv: a line for every point of the grid, the swept parameters first."""
    swept = reported.result
    grids = np.meshgrid(*(axis.values for axis in swept.axes), indexing="ij")
    names = [axis.name for axis in swept.axes] + [quantity.name for quantity in swept.quantities]
    table = [grid.ravel() for grid in grids] + list(swept.values.reshape(-1, len(swept.quantities)).T)
    _write_columns(folder / "map.csv", names, table)


def _write_histories(result: Answer, folder: Path) -> None:
    """decay.csv, energy.csv and crossings.csv: time in s, displacements in m, energies in J."""
    absorption = without_intervals(result)
    bands = (result.lower, result.upper) if isinstance(result, AbsorptionIntervals) else ()
    names, columns = ["time"], [absorption.time]
    for number, mass in enumerate(absorption.masses):
        for side, label in ((absorption.with_sinks, ""), (absorption.without, " without sinks")):
            names += [f"x:{mass.name}{label}", f"envelope:{mass.name}{label}"]
            columns += [
                side.displacement(mass.name),
                np.ascontiguousarray(side.envelope[:, number]),
            ]
        for end, label in zip(bands, ("lower", "upper"), strict=False):
            names.append(f"envelope:{mass.name} {label}")
            columns.append(np.ascontiguousarray(end[:, number]))
    _write_columns(folder / "decay.csv", names, columns)
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
    figures=lambda reported: sections_of(SECTIONS, reported),
    page=absorption_page,
)
"""What `absorb` hands over of a comparison."""

MAP_FOLDER: ResultFolder[AbsorptionMap] = ResultFolder(
    mark=ABSORPTION,
    document=lambda swept, _: absorption_of(swept),
    data=_write_map,
    figures=lambda reported: sections_of(MAP_SECTIONS, reported),
    page=map_page,
)
"""What `absorb` hands over of a sweep."""
