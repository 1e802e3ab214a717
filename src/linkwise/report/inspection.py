"""The result folder of `inspect`: numbers, and a page of alerts, histories, spectra, maps and coherence."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from markupsafe import Markup

from linkwise.errors import expect
from linkwise.inspection.levels.result import distortion_rows, gaps_text, mode_rows, ring_down_rows
from linkwise.inspection.levels.result import headline as level_headline
from linkwise.inspection.result import HEAD, Inspection, alert_text, channel_row, headline, labels
from linkwise.progress import Progress, silent
from linkwise.registry import Registry, lazy_module
from linkwise.report.page import Build, Reported, ResultFolder, Section, section_page, sections_of

if TYPE_CHECKING:
    from linkwise.plot import levels as level_figures
    from linkwise.plot import records as record_figures
else:  # matplotlib loads where a figure is drawn
    level_figures = lazy_module("linkwise.plot.levels")
    record_figures = lazy_module("linkwise.plot.records")

PICTURED = 8  # records with figures; the others have their table


def _levels(reported: Reported[Inspection]) -> Section | None:
    """The modes over the level of the records."""
    levels = reported.result.levels
    if levels is None:
        return None
    if len(levels.levels) == 1:
        return Section("Modes", level_headline(levels), rows=mode_rows(levels))
    return Section(
        "Modes over level",
        level_headline(levels),
        rows=mode_rows(levels),
        figure=lambda: level_figures.levels_figure(levels),
    )


def _responses(reported: Reported[Inspection]) -> Section | None:
    """The response functions at each level."""
    levels = reported.result.levels
    if levels is None or not levels.responses:
        return None
    text = "Absolute value of the response per force, and the part of its power that follows from the force linearly."
    return Section("Response functions", [text], figure=lambda: level_figures.level_responses_figure(levels))


def _distortion(reported: Reported[Inspection]) -> Section | None:
    """What a periodic force excites at other frequencies than its own."""
    levels = reported.result.levels
    if levels is None or not any(levels.distortions):
        return None
    text = (
        "Power over that of the response where the periodic force excites nothing, and the scatter of periods: noise, and "
        "what of the start has not died out."
    )
    return Section(
        "Distortion",
        [text],
        rows=distortion_rows(levels),
        figure=lambda: level_figures.distortion_figure(levels),
    )


def _ring_down(reported: Reported[Inspection]) -> Section | None:
    """The modes over their amplitude while they ring down."""
    levels = reported.result.levels
    if levels is None or not levels.ring_downs:
        return None
    text = (
        "Frequency and damping of modes over their amplitude, at the highest level after the force has ended, from windows of "
        "the decay."
    )
    return Section(
        "Ring-down",
        [f"{text} {gaps_text(levels)}".rstrip()],
        rows=ring_down_rows(levels),
        figure=lambda: level_figures.ring_down_figure(levels),
    )


def _surfaces(reported: Reported[Inspection]) -> Section | None:
    """The restoring force at sensors, before any model."""
    levels = reported.result.levels
    if levels is None or not levels.surfaces:
        return None
    text = (
        "Acceleration with the sign reversed over displacement and velocity of a sensor, at the highest level while no force "
        "acts: the restoring force per mass, to which other modes add scatter. A linear stiffness gives a straight line "
        "at no velocity."
    )
    return Section(
        "Restoring force", [text], figure=lambda: level_figures.acceleration_surfaces_figure(levels)
    )


def _alerts(reported: Reported[Inspection]) -> Section | None:
    """What is wrong with the records."""
    inspection = reported.result
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
        (lambda: record_figures.histories_figure(record)) if number < PICTURED else None,
        interactive=True,
    )


def _spectra(inspection: Inspection, number: int) -> Section | None:
    """The spectra of the channels of one record."""
    if number >= PICTURED:
        return None
    text = "Amplitude spectral density; dashed is white noise of the level that was found."
    return Section(
        _titled("Spectra", inspection, number),
        [text],
        figure=lambda: record_figures.spectra_figure(inspection, number),
        interactive=True,
    )


def _maps(inspection: Inspection, number: int) -> Section | None:
    """The channels of one record over time and frequency."""
    if number >= PICTURED:
        return None
    text = "Power spectral density over time and frequency, dark where it is large; a steady line may be hum."
    return Section(
        _titled("Time and frequency", inspection, number),
        [text],
        figure=lambda: record_figures.spectrograms_figure(inspection, number),
    )


def _coherence(inspection: Inspection, number: int) -> Section | None:
    """How the channels of one record go together."""
    if number >= PICTURED or len(inspection.records[number].channels) < 2:
        return None
    text = (
        "The part of the power of a channel that follows linearly from the one before it; dashed is what independent noise "
        "exceeds at one of 20 frequencies. A nonlinear link, noise and a clock of its own lower it."
    )
    return Section(
        _titled("Coherence", inspection, number),
        [text],
        figure=lambda: record_figures.coherences_figure(inspection, number),
        interactive=True,
    )


def _titled(title: str, inspection: Inspection, number: int) -> str:
    """The title, with the record where there are several."""
    return f"{title} of {labels(inspection.records)[number]}" if len(inspection.records) > 1 else title


SECTIONS: Registry[Build[Inspection]] = Registry(
    "section",
    {
        "levels": _levels,
        "responses": _responses,
        "distortion": _distortion,
        "ring_down": _ring_down,
        "surfaces": _surfaces,
        "alerts": _alerts,
    },
)
"""What stands before the records, in order; the name of a section is that of its figure's files."""

RECORD_SECTIONS: Registry[Callable[[Inspection, int], Section | None]] = Registry(
    "section", {"histories": _histories, "spectra": _spectra, "maps": _maps, "coherence": _coherence}
)
"""What is shown of each record, from the inspection and the number of the record."""


def inspection_sections(reported: Reported[Inspection]) -> dict[str, Section]:
    """All sections by the names of their files, those of one record among several with its number, as `histories_2`."""
    count = len(reported.result.records)
    of_records = {
        name if count == 1 else f"{name}_{number + 1}": section
        for number in range(count)
        for name, build in RECORD_SECTIONS.items()
        if (section := build(reported.result, number)) is not None
    }
    return {**sections_of(SECTIONS, reported), **of_records}


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


def write_inspection(inspection: Inspection, folder: str | Path, *, progress: Progress = silent) -> Path:
    """Write an inspection into a folder: inspection.json, figures of histories and spectra, and report.html.

    Parameters
    ----------
    inspection : Inspection
        What `inspect` returned.
    folder : path-like
        The folder. An earlier inspection in it is replaced when the new one is complete.
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
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=1.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> inspection = lw.inspect(record)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     written = lw.report.write_inspection(inspection, f"{folder}/inspection")
    ...     names = [path.name for path in written.iterdir()]
    >>> sorted(name for name in names if name.endswith((".json", ".html", ".toml")))
    ['inspection.json', 'report.html']
    """
    expect("write_inspection(inspection, folder): inspection", inspection, Inspection)
    expect("write_inspection(inspection, folder): folder", folder, str, Path)
    return INSPECTION_FOLDER.write(inspection, folder, progress=progress)


INSPECTION_FOLDER: ResultFolder[Inspection] = ResultFolder(
    mark="inspection.json",
    document=lambda inspection, truth: {"method": "inspect", **inspection.to_dict()},
    data=lambda reported, folder: None,
    figures=inspection_sections,
    page=inspection_page,
)
"""What `inspect` hands over."""
