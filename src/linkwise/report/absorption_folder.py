"""The result folder of `absorb`: numbers, histories, figures and a page."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from linkwise.absorption.intervals import AbsorptionIntervals, without_intervals
from linkwise.absorption.map_result import AbsorptionMap
from linkwise.arrays import Floats
from linkwise.atomic import ABSORPTION, atomic_folder, to_json
from linkwise.model.toml_file import write_structure
from linkwise.progress import Progress, ProgressReport, part, silent
from linkwise.report.absorption_json import absorption_of
from linkwise.report.absorption_page import (
    MAP_SECTIONS,
    SECTIONS,
    Answer,
    absorption_page,
    map_page,
)
from linkwise.report.section import Reported, sections_of, write_figures
from linkwise.text import csv_cell


def write_absorption(
    answer: Answer,
    folder: str | Path,
    *,
    progress: Progress = silent,
) -> Path:
    """Write absorption.json, histories, figures and report.html into `folder`; all of them or none.

    An earlier result in `folder` is replaced when the new one is complete; raises OutputError for a folder that holds
    something else.
    """
    reported = Reported(answer)
    with atomic_folder(Path(folder), ABSORPTION) as partial:
        _write_histories(answer, partial)
        write_structure(without_intervals(answer).with_sinks.structure, partial / "structure.toml")
        pictures = write_figures(sections_of(SECTIONS, reported), partial, part(progress, 0.0, 0.9))
        progress(ProgressReport(0.9, "page"))
        (partial / "report.html").write_text(absorption_page(reported, pictures), encoding="utf-8")
        _finish(partial, absorption_of(answer))
    return Path(folder)


def write_absorption_map(found: AbsorptionMap, folder: str | Path, *, progress: Progress = silent) -> Path:
    """Write absorption.json, map.csv, map.png, map.svg and report.html of a sweep into `folder`, as `write_absorption`."""
    reported = Reported(found)
    with atomic_folder(Path(folder), ABSORPTION) as partial:
        grids = np.meshgrid(*(axis.values for axis in found.axes), indexing="ij")
        names = [axis.name for axis in found.axes] + [each.name for each in found.quantities]
        table = [grid.ravel() for grid in grids] + list(found.values.reshape(-1, len(found.quantities)).T)
        _write_columns(partial / "map.csv", names, table)
        pictures = write_figures(sections_of(MAP_SECTIONS, reported), partial, part(progress, 0.0, 0.9))
        progress(ProgressReport(0.9, "page"))
        (partial / "report.html").write_text(map_page(reported, pictures), encoding="utf-8")
        _finish(partial, absorption_of(found))
    return Path(folder)


def _finish(partial: Path, result: dict[str, Any]) -> None:
    """Write absorption.json, which names the files beside it."""
    result["files"] = sorted(path.name for path in partial.iterdir())
    (partial / ABSORPTION).write_text(to_json(result, indent=1) + "\n", encoding="utf-8")


def _write_columns(path: Path, names: Sequence[str], columns: Sequence[Floats]) -> None:
    """A CSV file with a header."""
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerow([csv_cell(name) for name in names])
        np.savetxt(file, np.column_stack(columns), fmt="%.10g", delimiter=",")


def _write_histories(answer: Answer, folder: Path) -> None:
    """decay.csv, energy.csv and crossings.csv: time in s, displacements in m, energies in J."""
    found = without_intervals(answer)
    bands = (answer.lower, answer.upper) if isinstance(answer, AbsorptionIntervals) else ()
    names, columns = ["time"], [found.time]
    for number, mass in enumerate(found.masses):
        for side, label in ((found.with_sinks, ""), (found.without, " without sinks")):
            names += [f"x:{mass.name}{label}", f"envelope:{mass.name}{label}"]
            columns += [
                side.x[:, side.structure.mass_names.index(mass.name)],
                np.ascontiguousarray(side.envelope[:, number]),
            ]
        for end, label in zip(bands, ("lower", "upper"), strict=False):
            names.append(f"envelope:{mass.name} {label}")
            columns.append(np.ascontiguousarray(end[:, number]))
    _write_columns(folder / "decay.csv", names, columns)
    names, columns = ["time"], [found.time]
    for side, label in ((found.with_sinks, ""), (found.without, " without sinks")):
        names += [
            f"{what}{label}" for what in ("put in", "stored", *(link.name for link in side.structure.links))
        ]
        columns += [side.supplied, side.stored, *side.dissipated.T]
    _write_columns(folder / "energy.csv", names, columns)
    with (folder / "crossings.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("sink", "time"))
        writer.writerows(
            (csv_cell(work.sink.link), f"{time:.12g}") for work in found.sinks for time in work.crossings
        )
