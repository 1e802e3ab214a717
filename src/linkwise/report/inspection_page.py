"""The page of an inspection: alerts first, then histories and spectra."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING

from markupsafe import Markup

from linkwise.inspection.levels.result import LevelComparison
from linkwise.inspection.levels.text import distortion_rows, mode_rows
from linkwise.inspection.levels.text import headline as level_headline
from linkwise.inspection.result import Inspection, labels
from linkwise.inspection.text import HEAD, alert_text, channel_row, headline
from linkwise.lazy import LazyFunction
from linkwise.report.section import Reported, Section
from linkwise.report.section_page import section_page

if TYPE_CHECKING:
    from linkwise.plot import (
        distortion_figure,
        histories_figure,
        level_responses_figure,
        levels_figure,
        ring_down_figure,
        spectra_figure,
    )
else:  # matplotlib loads where a figure is drawn, which may be another process
    histories_figure = LazyFunction("linkwise.plot", "histories_figure")
    spectra_figure = LazyFunction("linkwise.plot", "spectra_figure")
    levels_figure = LazyFunction("linkwise.plot", "levels_figure")
    level_responses_figure = LazyFunction("linkwise.plot", "level_responses_figure")
    distortion_figure = LazyFunction("linkwise.plot", "distortion_figure")
    ring_down_figure = LazyFunction("linkwise.plot", "ring_down_figure")

PICTURED = 8  # records with figures; the others have their table


def inspection_sections(reported: Reported[Inspection]) -> dict[str, Section]:
    """The alerts, and of each record a table, its histories and its spectra, by the names of their files."""
    inspection = reported.result
    sections = {} if inspection.levels is None else _level_sections(inspection.levels)
    if inspection.alerts:
        items = [alert_text(inspection, alert) for alert in inspection.alerts]
        sections["alerts"] = Section("Alerts", items=items)
    for number, (label, record) in enumerate(
        zip(labels(inspection.records), inspection.records, strict=True)
    ):
        end = record.start + record.duration
        text = f"{len(record)} samples at {record.rate:g} Hz, from {record.start:g} to {end:g} s."
        table = [HEAD, *(channel_row(channel) for channel in inspection.channels_of(number))]
        ending = "" if len(inspection.records) == 1 else f"_{number + 1}"
        pictured = number < PICTURED
        sections[f"histories{ending}"] = Section(
            label,
            [text],
            record.notes,
            table,
            partial(histories_figure, record) if pictured else None,
            interactive=True,
        )
        if pictured:
            title = "Spectra" if len(inspection.records) == 1 else f"Spectra of {label}"
            text = "Amplitude spectral density; dashed is white noise of the level that was found."
            sections[f"spectra{ending}"] = Section(
                title, [text], figure=partial(spectra_figure, inspection, number), interactive=True
            )
    return sections


def _level_sections(levels: LevelComparison) -> dict[str, Section]:
    """What records at several levels tell of linearity."""
    sections = {
        "levels": Section(
            "Modes over level",
            level_headline(levels),
            rows=mode_rows(levels),
            figure=partial(levels_figure, levels),
        ),
        "responses": Section(
            "Response functions",
            [
                "Absolute value of the response per force, and the part of its power that follows from the force linearly."
            ],
            figure=partial(level_responses_figure, levels),
        ),
    }
    if any(levels.distortions):
        sections["distortion"] = Section(
            "Distortion",
            [
                "Power over that of the response where the periodic force excites nothing, and the scatter of periods: noise, "
                "and what of the start has not died out."
            ],
            rows=distortion_rows(levels),
            figure=partial(distortion_figure, levels),
        )
    if levels.ring_downs:
        sections["ring_down"] = Section(
            "Ring-down",
            [
                "Frequency and damping of modes over their amplitude, after the force of the highest level has ended."
            ],
            figure=partial(ring_down_figure, levels),
        )
    return sections


def inspection_page(reported: Reported[Inspection], pictures: Mapping[str, Markup]) -> str:
    """The page as text, HTML that carries everything in itself; `pictures` are those of `write_figures`."""
    inspection = reported.result
    return section_page(
        None,
        inspection_sections(reported),
        pictures,
        title="Inspection",
        verdict=[
            *([] if inspection.levels is None else level_headline(inspection.levels)),
            headline(inspection),
        ],
        trusted=inspection.trusted,
    )
