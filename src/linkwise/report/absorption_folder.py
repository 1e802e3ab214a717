"""The result folder of `absorb`: numbers, histories, figures and a page."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from linkwise.absorption.intervals import AbsorptionIntervals
from linkwise.absorption.intervals_text import interval_headline, interval_rows
from linkwise.absorption.result import Absorption
from linkwise.absorption.sweep import AbsorptionMap
from linkwise.absorption.sweep_text import map_headline, map_rows
from linkwise.absorption.text import crossing_rows, energy_rows, harvest_rows, headline, mass_rows
from linkwise.arrays import Floats
from linkwise.atomic import ABSORPTION, atomic_folder, to_json
from linkwise.model.toml_file import format_structure, write_structure
from linkwise.plot import save
from linkwise.plot.absorption import Bands, crossings_figure, decay_figure, energy_figure
from linkwise.plot.absorption_map import map_figure
from linkwise.progress import Progress, ProgressReport, silent
from linkwise.report.absorption_json import absorption_of
from linkwise.report.section_page import Section, embedded, sheet_page


def write_absorption(
    answer: Absorption | AbsorptionIntervals,
    folder: str | Path,
    *,
    progress: Progress = silent,
) -> Path:
    """Write absorption.json, histories, figures and report.html into `folder`; all of them or none.

    An earlier result in `folder` is replaced when the new one is complete; raises OutputError for a folder that holds
    something else.
    """
    told = answer if isinstance(answer, AbsorptionIntervals) else None
    found = answer.found if isinstance(answer, AbsorptionIntervals) else answer
    bands = None if told is None else (told.lower, told.upper)
    with atomic_folder(Path(folder), ABSORPTION) as partial:
        _write_histories(found, bands, partial)
        progress(ProgressReport(0.2, "figures"))
        save(decay_figure(found, bands), partial / "decay")
        save(energy_figure(found), partial / "energy")
        save(crossings_figure(found), partial / "crossings")
        progress(ProgressReport(0.9, "page"))
        sections = _sections(found, partial)
        if told is not None:
            sections.insert(0, Section("Intervals", interval_headline(told), interval_rows(told)))
        structure = found.with_sinks.structure
        write_structure(structure, partial / "structure.toml")
        page = sheet_page(
            structure.name or "structure",
            verdict=headline(found),
            trusted=answer.trusted,
            sections=sections,
            structure=format_structure(structure),
            version=version("linkwise"),
            findings=found.findings,
        )
        (partial / "report.html").write_text(page, encoding="utf-8")
        _finish(partial, absorption_of(answer))
    return Path(folder)


def write_absorption_map(found: AbsorptionMap, folder: str | Path, *, progress: Progress = silent) -> Path:
    """Write absorption.json, map.csv, map.png, map.svg and report.html of a sweep into `folder`, as `write_absorption`."""
    with atomic_folder(Path(folder), ABSORPTION) as partial:
        grids = np.meshgrid(*(axis.values for axis in found.axes), indexing="ij")
        names = [axis.name for axis in found.axes] + [each.name for each in found.quantities]
        table = [grid.ravel() for grid in grids] + list(found.values.reshape(-1, len(found.quantities)).T)
        _write_columns(partial / "map.csv", names, table)
        progress(ProgressReport(0.2, "figure"))
        save(map_figure(found), partial / "map")
        structure = format_structure(found.structure)
        page = sheet_page(
            found.structure.name or "structure",
            verdict=map_headline(found),
            trusted=found.trusted,
            sections=[Section("Map", "", map_rows(found), embedded(partial / "map.svg"))],
            structure=structure,
            version=version("linkwise"),
            findings=found.findings,
        )
        (partial / "report.html").write_text(page, encoding="utf-8")
        _finish(partial, absorption_of(found))
    return Path(folder)


def _finish(partial: Path, result: dict[str, Any]) -> None:
    """Write absorption.json, which names the files beside it."""
    result["files"] = sorted(path.name for path in partial.iterdir())
    (partial / ABSORPTION).write_text(to_json(result, indent=1) + "\n", encoding="utf-8")


def _write_columns(path: Path, names: Sequence[str], columns: Sequence[Floats]) -> None:
    """A CSV file with a header."""
    np.savetxt(
        path, np.column_stack(columns), fmt="%.10g", delimiter=",", header=",".join(names), comments=""
    )


def _write_histories(found: Absorption, bands: Bands | None, folder: Path) -> None:
    """decay.csv, energy.csv and crossings.csv: time in s, displacements in m, energies in J."""
    names, columns = ["time"], [found.time]
    for number, mass in enumerate(found.masses):
        for side, label in ((found.with_sinks, ""), (found.without, " without sinks")):
            names += [f"x:{mass.name}{label}", f"envelope:{mass.name}{label}"]
            columns += [
                side.x[:, side.structure.mass_names.index(mass.name)],
                np.ascontiguousarray(side.envelope[:, number]),
            ]
        for end, label in zip(bands or (), ("lower", "upper"), strict=False):
            names.append(f"envelope:{mass.name} {label}")
            columns.append(np.ascontiguousarray(end[:, number]))
    _write_columns(folder / "decay.csv", names, columns)
    names, columns = ["time"], [found.time]
    for side, label in ((found.with_sinks, ""), (found.without, " without sinks")):
        names += [
            f"{what}{label}" for what in ("put in", "stored", *(link.name for link in side.structure.links))
        ]
        columns += [side.put_in, side.stored, *side.dissipated.T]
    _write_columns(folder / "energy.csv", names, columns)
    rows = [f"{work.sink.link},{time:.12g}" for work in found.sinks for time in work.crossings]
    (folder / "crossings.csv").write_text("\n".join(["sink,time", *rows]) + "\n", encoding="utf-8")


def _sections(found: Absorption, folder: Path) -> list[Section]:
    settle = (
        f"A mass has settled when it stays below {100 * found.settle:g} % of its peak without sinks until the end, and has "
        "done so for the last 5 % of the run at least. The envelope is the largest excursion still to come; decay is the rate "
        "of an exponential through the peaks that none later exceeds."
    )
    energy = (
        "Energies count from the lowest wells of all links, so that what was put in is what is still there and what each link "
        f"dissipated: the balance closes to {max(found.with_sinks.closure, found.without.closure):.0e}."
    )
    sections = [
        Section("Primary masses", settle, mass_rows(found), embedded(folder / "decay.svg")),
        Section("Energy", energy, energy_rows(found), embedded(folder / "energy.svg")),
        Section("Wells crossed", "", crossing_rows(found), embedded(folder / "crossings.svg")),
    ]
    if found.harvests:
        sections.append(Section("Harvesters", "Dampers in parallel to links.", harvest_rows(found)))
    return sections
