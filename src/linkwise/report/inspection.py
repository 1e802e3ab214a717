"""The result folder of `inspect`: numbers, and a page of alerts, histories, spectra, maps and coherence."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from matplotlib.figure import Figure

from linkwise.inspection.levels.compare import (
    LevelComparison,
    distortion_rows,
    gaps_text,
    mode_rows,
    ring_down_rows,
)
from linkwise.inspection.levels.compare import headline as level_headline
from linkwise.inspection.levels.quantities import labels
from linkwise.inspection.result import HEAD, Inspection, alert_text, channel_row, headline
from linkwise.output import INSPECTION
from linkwise.plot.levels import (
    acceleration_surfaces_figure,
    distortion,
    level_responses_figure,
    levels_figure,
    ring_down_figure,
)
from linkwise.plot.records import coherences_figure, histories_figure, spectra_figure, spectrograms_figure
from linkwise.plot.style import single
from linkwise.report.page import Build, Head, Section, sectioned, sections_of

PICTURED = 8  # records with figures; the others have their table


def _levels(result: Inspection) -> Section | None:
    levels = result.levels
    if levels is None:
        return None
    title, figure = "Modes", None
    if len(levels.levels) > 1:
        title, figure = "Modes over level", partial(levels_figure, levels)
    return Section(title, level_headline(levels), rows=mode_rows(levels), figure=figure)


def _of_levels(
    title: str,
    text: str,
    shown: Callable[[LevelComparison], bool],
    figure: Callable[[LevelComparison], Figure],
    rows: Callable[[LevelComparison], Sequence[Sequence[str]]] = lambda levels: (),
) -> Build[Inspection]:
    """A section of what levels may have; the text is followed by that of gaps in a ring-down."""

    def build(result: Inspection) -> Section | None:
        levels = result.levels
        if levels is None or not shown(levels):
            return None
        words = f"{text} {gaps_text(levels)}".rstrip() if rows is ring_down_rows else text
        return Section(title, [words], rows=rows(levels), figure=partial(figure, levels))

    return build


_responses = _of_levels(
    "Response functions",
    "Absolute value of the response per force, and the part of its power that follows from the force linearly.",
    lambda levels: bool(levels.responses),
    level_responses_figure,
)
_distortion = _of_levels(
    "Distortion",
    "Power over that of the response where the periodic force excites nothing, and the scatter of periods: noise, and "
    "what of the start has not died out.",
    lambda levels: any(levels.distortions),
    lambda levels: single(partial(distortion, levels)),
    distortion_rows,
)
_ring_down = _of_levels(
    "Ring-down",
    "Frequency and damping of modes over their amplitude, at the highest level after the force has ended, from windows of "
    "the decay.",
    lambda levels: bool(levels.ring_downs),
    ring_down_figure,
    ring_down_rows,
)
_surfaces = _of_levels(
    "Restoring force",
    "Acceleration with the sign reversed over displacement and velocity of a sensor, at the highest level while no force "
    "acts: the restoring force per mass, to which other modes add scatter. A linear stiffness gives a straight line "
    "at no velocity.",
    lambda levels: bool(levels.surfaces),
    acceleration_surfaces_figure,
)


def _alerts(inspection: Inspection) -> Section | None:
    """What is wrong with the records."""
    items = [alert_text(inspection, alert) for alert in inspection.alerts]
    return Section("Alerts", items=items) if items else None


def _histories(inspection: Inspection, number: int) -> Section:
    """A table of the channels of one record, and their histories."""
    record = inspection.records[number]
    end = record.start + record.duration
    return Section(
        labels(inspection.records)[number],
        [f"{len(record)} samples at {record.rate:g} Hz, from {record.start:g} to {end:g} s."],
        record.notes,
        [HEAD, *(channel_row(channel) for channel in inspection.channels_of(number))],
        partial(histories_figure, record) if number < PICTURED else None,
    )


def _pictured(
    title: str, text: str, draw: Callable[[Inspection, int], Figure], *, channels: int = 1
) -> Callable[[Inspection, int], Section | None]:
    """A section of a picture of a record with at least so many channels, for the first records."""

    def build(inspection: Inspection, number: int) -> Section | None:
        if number >= PICTURED or len(inspection.records[number].channels) < channels:
            return None
        of = f" of {labels(inspection.records)[number]}" if len(inspection.records) > 1 else ""
        figure = partial(draw, inspection, number)
        return Section(f"{title}{of}", [text], figure=figure)

    return build


_spectra = _pictured(
    "Spectra",
    "Amplitude spectral density; dashed is white noise of the level that was found.",
    spectra_figure,
)
_maps = _pictured(
    "Time and frequency",
    "Power spectral density over time and frequency, dark where it is large; a steady line may be hum.",
    spectrograms_figure,
)
_coherence = _pictured(
    "Coherence",
    "The part of the power of a channel that follows linearly from the one before it; dashed is what independent noise "
    "exceeds at one of 20 frequencies. A nonlinear link, noise and a clock of its own lower it.",
    coherences_figure,
    channels=2,
)


SECTIONS: dict[str, Build[Inspection]] = {
    "levels": _levels,
    "responses": _responses,
    "distortion": _distortion,
    "ring_down": _ring_down,
    "surfaces": _surfaces,
    "alerts": _alerts,
}
"""What stands before the records, in order; the name of a section is that of its figure's files."""

RECORD_SECTIONS: dict[str, Callable[[Inspection, int], Section | None]] = {
    "histories": _histories,
    "spectra": _spectra,
    "maps": _maps,
    "coherence": _coherence,
}
"""What is shown of each record, from the inspection and the number of the record."""


def inspection_sections(result: Inspection) -> dict[str, Section]:
    """All sections by the names of their files, those of one record among several with its number, as `histories_2`."""
    count = len(result.records)
    of_records = {
        name if count == 1 else f"{name}_{number + 1}": section
        for number in range(count)
        for name, build in RECORD_SECTIONS.items()
        if (section := build(result, number)) is not None
    }
    return {**sections_of(SECTIONS, result), **of_records}


def _head(inspection: Inspection) -> Head:
    verdict = [*(level_headline(inspection.levels) if inspection.levels else []), headline(inspection)]
    return Head(verdict, title="Inspection")


INSPECTION_FOLDER = sectioned(INSPECTION, _head, inspection_sections, lambda inspection, folder: None)
"""What `inspect` hands over."""
