"""The result folders of `absorb`, its intervals and maps, and of `design`: numbers, histories, figures and a page."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from linkwise.absorption.design import (
    ADDED_MASS,
    Design,
    design_headline,
    design_rows,
    place_rows,
    trade_off_rows,
)
from linkwise.absorption.intervals import (
    AbsorptionIntervals,
    Answer,
    interval_headline,
    interval_rows,
    without_intervals,
)
from linkwise.absorption.map import AbsorptionMap, map_headline, map_rows
from linkwise.absorption.result import crossing_rows, energy_rows, harvest_rows, headline, mass_rows, primary
from linkwise.output import ABSORPTION, DESIGN
from linkwise.plot.absorptions import (
    crossings_figure,
    decay_figure,
    designs_figure,
    energy_figure,
    map_figure,
    trade_off,
)
from linkwise.plot.style import single
from linkwise.report.response import amplitude_sections
from linkwise.report.result_folder import ResultFolder, Section, csv_table
from linkwise.report.result_page import Head, sectioned


def _comparison_sections(result: Answer) -> dict[str, Section]:
    """The sections of a comparison by the names of their figures."""
    plain, sections = without_intervals(result), {}
    if isinstance(result, AbsorptionIntervals):
        text, rows = interval_headline(result), interval_rows(result)
        sections["intervals"] = Section("Intervals", [text], rows=rows)
    text = (
        f"A mass has settled when it stays below {100 * plain.settle:g} % of its peak without sinks until the end, and has "
        "done so for the last 5 % of the run at least. The envelope is the largest excursion still to come; decay is the rate "
        "of an exponential through the peaks that none later exceeds."
    )
    title, figure = primary(plain).capitalize(), partial(decay_figure, result)
    sections["decay"] = Section(title, [text], rows=mass_rows(plain), figure=figure)
    text = (
        "Energies count from the lowest wells of all links, so the energy supplied is the energy stored and "
        f"dissipated: the balance closes to {max(plain.with_sinks.closure, plain.without.closure):.0e}."
    )
    figure = partial(energy_figure, result)
    sections["energy"] = Section("Energy", [text], rows=energy_rows(plain), figure=figure)
    figure = partial(crossings_figure, result)
    sections["crossings"] = Section("Wells crossed", rows=crossing_rows(plain), figure=figure)
    if plain.harvests:
        text = "Dampers in parallel to links."
        sections["harvesters"] = Section("Harvesters", [text], rows=harvest_rows(plain))
    return sections


def _comparison_head(result: Answer) -> Head:
    plain = without_intervals(result)
    return Head(headline(plain), plain.with_sinks.structure, plain.findings)


def _write_map_data(swept: AbsorptionMap, folder: Path) -> None:
    """map.csv: a line for every point of the grid, the swept parameters first."""
    grids = np.meshgrid(*(axis.values for axis in swept.axes), indexing="ij")
    names = [axis.name for axis in swept.axes] + [quantity.name for quantity in swept.quantities]
    table = [grid.ravel() for grid in grids] + list(swept.values.reshape(-1, len(swept.quantities)).T)
    csv_table(folder / "map.csv", names, np.column_stack(table).tolist())


def _write_data(result: Answer, folder: Path) -> None:
    """decay.csv, energy.csv and crossings.csv: time in s, displacements in m, energies in J."""
    absorption = without_intervals(result)
    bands = (result.lower, result.upper) if isinstance(result, AbsorptionIntervals) else ()
    names, columns = ["time"], [absorption.time]
    for number, mass in enumerate(absorption.masses):
        for side, label in ((absorption.with_sinks, ""), (absorption.without, " without sinks")):
            names += [f"x:{mass.name}{label}", f"envelope:{mass.name}{label}"]
            columns += [side.displacement(mass.name), side.envelope[:, number]]
        for end, label in zip(bands, ("lower", "upper"), strict=False):
            names.append(f"envelope:{mass.name} {label}")
            columns.append(end[:, number])
    csv_table(folder / "decay.csv", names, np.column_stack(columns).tolist())
    names, columns = ["time"], [absorption.time]
    for side, label in ((absorption.with_sinks, ""), (absorption.without, " without sinks")):
        names += [f"{name}{label}" for name in ("put in", "stored", *side.dissipated_by)]
        columns += [side.supplied, side.stored, *side.dissipated_by.values()]
    csv_table(folder / "energy.csv", names, np.column_stack(columns).tolist())
    crossings = [(work.sink.link, f"{time:.12g}") for work in absorption.sinks for time in work.crossings]
    csv_table(folder / "crossings.csv", ("sink", "time"), crossings)


_FOLLOWING = ("find the coefficients and masses at which the sinks absorb best (design).",)
ABSORPTION_FOLDER = sectioned(ABSORPTION, _comparison_head, _comparison_sections, _FOLLOWING, _write_data)
"""What `absorb` hands over of a comparison."""

MAP_FOLDER: ResultFolder[AbsorptionMap] = sectioned(
    ABSORPTION,
    lambda swept: Head(map_headline(swept), swept.structure, swept.findings),
    lambda swept: {"map": Section("Map", rows=map_rows(swept), figure=partial(map_figure, swept))},
    _FOLLOWING,
    _write_map_data,
)
"""What `absorb` hands over of a sweep."""


def _design_sections(result: Design) -> dict[str, Section]:
    """The sections of a design by the names of their figures."""
    sections = {"best": Section("Best design", rows=design_rows(result))}
    if result.places:
        sections["places"] = Section("Places", rows=place_rows(result))
    if len(result.trade_off) > 1:
        text = "No lighter design that was tried is as good. Grey: the other designs within the limits."
        rows, figure = trade_off_rows(result), partial(single, partial(trade_off, result))
        sections["trade_off"] = Section("Trade-off", [text], rows=rows, figure=figure)
    text = "Every design that was simulated; where neighbours differ, thresholds or chance decide, and no surface is smooth."
    sections["designs"] = Section("Designs", [text], figure=partial(designs_figure, result))
    if result.response is not None:
        sections |= amplitude_sections(result.response, "Steady motion of the best")
    rows, figure = mass_rows(result.absorption), partial(decay_figure, result.absorption)
    sections["decay"] = Section("Motion of the best", rows=rows, figure=figure)
    return sections


def _write_designs(result: Design, folder: Path) -> None:
    """designs.csv: a line for every design, in the order of the search."""
    names = [*(axis.name for axis in result.axes), ADDED_MASS, "within limits", result.quantity.name]
    columns = result.added_mass, result.allowed, result.objectives
    csv_table(folder / "designs.csv", names, np.column_stack([result.points, *columns]).tolist())


DESIGN_FOLDER: ResultFolder[Design] = sectioned(
    DESIGN,
    lambda result: Head(design_headline(result), result.structure, result.findings),
    _design_sections,
    [
        "structure.toml is the best design: compare it with and without its sinks (absorb), or under a force (respond)."
    ],
    _write_designs,
)
"""What `design` hands over."""
