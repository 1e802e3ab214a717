"""The result folder of `inspect`: numbers, and a page of alerts, histories, spectra, maps and coherence."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from matplotlib.figure import Figure

from linkwise.inspection.level_comparison import (
    LevelComparison,
    distortion_rows,
    gaps_text,
    mode_rows,
    ring_down_rows,
)
from linkwise.inspection.level_comparison import headline as level_headline
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
from linkwise.records.joining import labels
from linkwise.report.figure_units import in_units_of_figures
from linkwise.report.result_folder import Section
from linkwise.report.result_page import Head, sectioned

PICTURED = 8  # records with figures; the others have their table


def inspection_sections(result: Inspection) -> dict[str, Section]:
    """All sections by the names of their files, those of one record among several with its number, as `histories_2`."""
    sections = {} if result.levels is None else _of_levels(result.levels)
    if items := [alert_text(result, alert) for alert in result.alerts]:
        sections["alerts"] = Section("Alerts", items=items)
    for number in range(len(result.records)):
        end = "" if len(result.records) == 1 else f"_{number + 1}"
        sections |= {f"{name}{end}": section for name, section in _of_record(result, number).items()}
    return sections


def _of_levels(levels: LevelComparison) -> dict[str, Section]:
    """What several levels show, by the names of figures."""
    title, figure = "Modes", None
    if len(levels.levels) > 1:
        title, figure = "Modes over level", partial(levels_figure, levels)
    text = "Modes of each level as of a linear structure; moved are those that differ from the lowest by more than errors."
    sections = {"levels": Section(title, [text], rows=mode_rows(levels), figure=figure)}
    if levels.responses:
        text = "Absolute value of the response per force, and the part of its power that follows from the force linearly."
        figure = partial(level_responses_figure, levels)
        sections["responses"] = Section("Response functions", [text], figure=figure)
    if any(levels.distortions):
        text = (
            "Power over that of the response where the periodic force excites nothing, and the scatter of periods: noise, and "
            "what of the start has not died out."
        )
        figure = partial(single, partial(distortion, levels))
        sections["distortion"] = Section("Distortion", [text], rows=distortion_rows(levels), figure=figure)
    if levels.ring_downs:
        text = (
            "Frequency and damping of modes over their amplitude, at the highest level after the force has ended, from "
            f"windows of the decay. {gaps_text(levels)}"
        )
        head, *rows = ring_down_rows(levels)
        rows = [head, *in_units_of_figures(rows, slice(2, 3), alike=True)]
        figure = partial(ring_down_figure, levels)
        sections["ring_down"] = Section("Ring-down", [text.rstrip()], rows=rows, figure=figure)
    if levels.surfaces:
        text = (
            "Acceleration with the sign reversed over displacement and velocity of a sensor, at the highest level while no "
            "force acts: the restoring force per mass, to which other modes add scatter. A linear stiffness gives a straight "
            "line at no velocity."
        )
        figure = partial(acceleration_surfaces_figure, levels)
        sections["surfaces"] = Section("Restoring force", [text], figure=figure)
    return sections


def _of_record(inspection: Inspection, number: int) -> dict[str, Section]:
    """What is shown of one record: a table of its channels and their histories, and of the first records further figures."""
    record, name = inspection.records[number], labels(inspection.records)[number]
    text = f"{len(record)} samples at {record.rate:g} Hz, from {record.start:g} to {record.start + record.duration:g} s."
    rows = [HEAD, *in_units_of_figures([*map(channel_row, inspection.channels_of(number))], slice(3, 7))]
    rows = [*zip(*(column for column in zip(*rows, strict=True) if any(column[1:])), strict=True)]
    if number >= PICTURED:
        return {"histories": Section(name, [text], record.notes, rows)}
    of = f" of {name}" if len(inspection.records) > 1 else ""
    sections = {"histories": Section(name, [text], record.notes, rows, partial(histories_figure, record))}
    for key, (title, text, draw) in _PICTURES.items():
        if key != "coherence" or len(record.channels) > 1:
            sections[key] = Section(f"{title}{of}", [text], figure=partial(draw, inspection, number))
    return sections


_PICTURES: dict[str, tuple[str, str, Callable[[Inspection, int], Figure]]] = {
    "spectra": (
        "Spectra",
        "Amplitude spectral density; dashed is white noise of the level that was found.",
        spectra_figure,
    ),
    "maps": (
        "Time and frequency",
        "Power spectral density over time and frequency, dark where it is large; a steady line may be hum.",
        spectrograms_figure,
    ),
    "coherence": (
        "Coherence",
        "The part of the power of a channel that follows linearly from the one before it; dashed is what independent noise "
        "exceeds at one of 20 frequencies. A nonlinear link, noise and a clock of its own lower it.",
        coherences_figure,
    ),
}
"""Title, text and figure of what is drawn of each of the first records, by the names of figures."""


def _head(inspection: Inspection) -> Head:
    verdict = [*(level_headline(inspection.levels) if inspection.levels else []), headline(inspection)]
    return Head(verdict, title="Inspection")


_FOLLOWING = (
    "identify a structure from the record (identify), or find its links (discover).",
    "mend what the alerts name, or state it (--sensor), and inspect again.",
)
INSPECTION_FOLDER = sectioned(INSPECTION, _head, inspection_sections, _FOLLOWING)
"""What `inspect` hands over."""
