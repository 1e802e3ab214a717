"""The result folders of `absorb`, its intervals and maps, and of `design`: numbers, histories, figures and a page."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from linkwise.absorption.design import ADDED_MASS, Design, design_headline, design_rows, trade_off_rows
from linkwise.absorption.intervals import (
    AbsorptionIntervals,
    Answer,
    interval_headline,
    interval_rows,
    without_intervals,
)
from linkwise.absorption.map import AbsorptionMap, map_headline, map_rows
from linkwise.absorption.result import crossing_rows, energy_rows, harvest_rows, headline, mass_rows, primary
from linkwise.model.structure_file import write_structure
from linkwise.output import ABSORPTION, DESIGN
from linkwise.plot.absorptions import (
    crossings_figure,
    decay_figure,
    designs_figure,
    energy_figure,
    map_figure,
    trade_off,
)
from linkwise.plot.responses import response_figure
from linkwise.plot.style import single
from linkwise.report.page import Build, Head, ResultFolder, Section, csv_table, sectioned, sections_of
from linkwise.response.result import headline as response_headline
from linkwise.response.result import peak_rows


def _intervals(result: Answer) -> Section | None:
    """The intervals of an answer that has some."""
    if not isinstance(result, AbsorptionIntervals):
        return None
    return Section("Intervals", [interval_headline(result)], rows=interval_rows(result))


def _masses(result: Answer) -> Section:
    """The decay of the primary masses with sinks and without."""
    plain = without_intervals(result)
    text = (
        f"A mass has settled when it stays below {100 * plain.settle:g} % of its peak without sinks until the end, and has "
        "done so for the last 5 % of the run at least. The envelope is the largest excursion still to come; decay is the rate "
        "of an exponential through the peaks that none later exceeds."
    )
    figure = partial(decay_figure, result)
    return Section(primary(plain).capitalize(), [text], rows=mass_rows(plain), figure=figure)


def _energy(result: Answer) -> Section:
    """Where the energy went."""
    plain = without_intervals(result)
    text = (
        "Energies count from the lowest wells of all links, so the energy supplied is the energy stored and "
        f"dissipated: the balance closes to {max(plain.with_sinks.closure, plain.without.closure):.0e}."
    )
    return Section("Energy", [text], rows=energy_rows(plain), figure=partial(energy_figure, result))


def _crossings(result: Answer) -> Section:
    """How the sinks cross from well to well."""
    plain = without_intervals(result)
    return Section("Wells crossed", rows=crossing_rows(plain), figure=partial(crossings_figure, result))


def _harvesters(result: Answer) -> Section | None:
    """What harvesters take, where there are some."""
    plain = without_intervals(result)
    if not plain.harvests:
        return None
    return Section("Harvesters", ["Dampers in parallel to links."], rows=harvest_rows(plain))


def _map(swept: AbsorptionMap) -> Section:
    """The quantities over the swept parameters."""
    return Section("Map", rows=map_rows(swept), figure=partial(map_figure, swept))


SECTIONS: dict[str, Build[Answer]] = {
    "intervals": _intervals,
    "decay": _masses,
    "energy": _energy,
    "crossings": _crossings,
    "harvesters": _harvesters,
}
"""The sections of a comparison, in order; the name of a section is that of its figure's files."""


def _head(result: Answer) -> Head:
    plain = without_intervals(result)
    return Head(headline(plain), plain.with_sinks.structure, plain.findings)


def _write_map(swept: AbsorptionMap, folder: Path) -> None:
    """map.csv: a line for every point of the grid, the swept parameters first."""
    grids = np.meshgrid(*(axis.values for axis in swept.axes), indexing="ij")
    names = [axis.name for axis in swept.axes] + [quantity.name for quantity in swept.quantities]
    table = [grid.ravel() for grid in grids] + list(swept.values.reshape(-1, len(swept.quantities)).T)
    csv_table(folder / "map.csv", names, np.column_stack(table).tolist())


def _write_data(result: Answer, folder: Path) -> None:
    """The structure, and decay.csv, energy.csv and crossings.csv: time in s, displacements in m, energies in J."""
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
    write_structure(absorption.with_sinks.structure, folder / "structure.toml")
    names, columns = ["time"], [absorption.time]
    for side, label in ((absorption.with_sinks, ""), (absorption.without, " without sinks")):
        names += [f"{name}{label}" for name in ("put in", "stored", *side.dissipated_by)]
        columns += [side.supplied, side.stored, *side.dissipated_by.values()]
    csv_table(folder / "energy.csv", names, np.column_stack(columns).tolist())
    crossings = [(work.sink.link, f"{time:.12g}") for work in absorption.sinks for time in work.crossings]
    csv_table(folder / "crossings.csv", ("sink", "time"), crossings)


ABSORPTION_FOLDER = sectioned(ABSORPTION, _head, partial(sections_of, SECTIONS), _write_data)
"""What `absorb` hands over of a comparison."""

MAP_FOLDER: ResultFolder[AbsorptionMap] = sectioned(
    ABSORPTION,
    lambda swept: Head(map_headline(swept), swept.structure, swept.findings),
    partial(sections_of, {"map": _map}),
    _write_map,
)
"""What `absorb` hands over of a sweep."""


def _best_design(result: Design) -> Section:
    return Section("Best design", rows=design_rows(result))


def _trade_off(result: Design) -> Section | None:
    """Mass against what was minimised, where the mass was varied."""
    if len(result.trade_off) < 2:
        return None
    text = "No lighter design that was tried is as good. Grey: the other designs within the limits."
    return Section(
        "Trade-off", [text], rows=trade_off_rows(result), figure=partial(single, partial(trade_off, result))
    )


def _designs(result: Design) -> Section:
    """Where the designs lie that were tried."""
    text = "Every design that was simulated; where neighbours differ, thresholds or chance decide, and no surface is smooth."
    return Section("Designs", [text], figure=partial(designs_figure, result))


def _best_motion(result: Design) -> Section:
    """The motion with the best sinks, and without."""
    figure = partial(decay_figure, result.absorption)
    return Section("Motion of the best", rows=mass_rows(result.absorption), figure=figure)


def _best_response(result: Design) -> Section | None:
    """The steady motion of the best over frequency, where that was asked for."""
    response = result.response
    if response is None:
        return None
    figure = partial(response_figure, response)
    return Section(
        "Steady motion of the best", response_headline(response), rows=peak_rows(response), figure=figure
    )


DESIGN_SECTIONS: dict[str, Build[Design]] = {
    "best": _best_design,
    "trade_off": _trade_off,
    "designs": _designs,
    "response": _best_response,
    "decay": _best_motion,
}
"""The sections of the page, in order."""


def _write_designs(result: Design, folder: Path) -> None:
    """The structure of the best, and designs.csv: a line for every design, in the order of the search."""
    write_structure(result.structure, folder / "structure.toml")
    names = [*(axis.name for axis in result.axes), ADDED_MASS, "within limits", result.quantity.name]
    columns = result.added_mass, result.allowed, result.objectives
    csv_table(folder / "designs.csv", names, np.column_stack([result.points, *columns]).tolist())


DESIGN_FOLDER: ResultFolder[Design] = sectioned(
    DESIGN,
    lambda result: Head(design_headline(result), result.structure, result.findings),
    partial(sections_of, DESIGN_SECTIONS),
    _write_designs,
)
"""What `design` hands over."""
