"""The pages of absorption: what sinks do, and maps of it over parameters."""

from __future__ import annotations

from collections.abc import Mapping

from markupsafe import Markup

from linkwise import plot
from linkwise.absorption.intervals import AbsorptionIntervals, without_intervals
from linkwise.absorption.intervals_text import interval_headline, interval_rows
from linkwise.absorption.map_result import AbsorptionMap
from linkwise.absorption.result import Absorption
from linkwise.absorption.sweep_text import map_headline, map_rows
from linkwise.absorption.text import crossing_rows, energy_rows, harvest_rows, headline, mass_rows, primary
from linkwise.registry import Registry
from linkwise.report.section import Build, Reported, Section, sections_of
from linkwise.report.section_page import section_page

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
        figure=lambda: plot.decay_figure(reported.result),
    )


def _energy(reported: Reported[Answer]) -> Section:
    """Where the energy went."""
    plain = without_intervals(reported.result)
    text = (
        "Energies count from the lowest wells of all links, so the energy supplied is the energy stored and "
        f"dissipated: the balance closes to {max(plain.with_sinks.closure, plain.without.closure):.0e}."
    )
    return Section(
        "Energy", [text], rows=energy_rows(plain), figure=lambda: plot.energy_figure(reported.result)
    )


def _crossings(reported: Reported[Answer]) -> Section:
    """How the sinks cross from well to well."""
    plain = without_intervals(reported.result)
    return Section(
        "Wells crossed", rows=crossing_rows(plain), figure=lambda: plot.crossings_figure(reported.result)
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
    return Section("Map", rows=map_rows(swept), figure=lambda: plot.map_figure(swept))


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


def absorption_page(reported: Reported[Answer], pictures: Mapping[str, Markup]) -> str:
    """The page of a comparison as text, HTML that carries everything in itself; `pictures` are those of `write_figures`."""
    plain = without_intervals(reported.result)
    return section_page(
        plain.with_sinks.structure,
        sections_of(SECTIONS, reported),
        pictures,
        verdict=headline(plain),
        trusted=reported.result.trusted,
        findings=plain.findings,
    )


def map_page(reported: Reported[AbsorptionMap], pictures: Mapping[str, Markup]) -> str:
    """The page of a sweep as text, HTML that carries everything in itself; `pictures` are those of `write_figures`."""
    swept = reported.result
    return section_page(
        swept.structure,
        sections_of(MAP_SECTIONS, reported),
        pictures,
        verdict=map_headline(swept),
        trusted=swept.trusted,
        findings=swept.findings,
    )
