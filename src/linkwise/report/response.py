"""The result folders of `respond`, `backbone` and `basins`: numbers, curves as tables, figures and a page."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from linkwise.output import BACKBONE, BASINS, RESPONSE
from linkwise.plot.responses import backbone_figure, basins_figure, response_figure
from linkwise.plot.style import scale
from linkwise.records.channel_units import unit_in
from linkwise.report.result_folder import ResultFolder, Section, csv_table
from linkwise.report.result_page import Head, sectioned
from linkwise.response.backbone import Backbone, backbone_headline, backbone_rows
from linkwise.response.basins_of_attraction import Basins, basins_headline, basins_rows
from linkwise.response.result import Branch, Response, headline, mirrored, peak_rows

_LEVELS, _CHANNELS = 4, 3  # of which the head of a page says how large the motion is


def _largest_motion(result: Response) -> Iterator[str]:
    """How large stable motion is at each level, in the units of the figure."""
    for level in result.levels[:_LEVELS]:
        stable = [branch for branch in level.branches if branch.stable.any()]
        if not stable:
            continue
        hz = np.concatenate([branch.hz[branch.stable] for branch in stable])
        amplitude = np.concatenate([branch.amplitude[branch.stable] for branch in stable])
        peaks = []
        for channel, values in list(zip(result.channels, amplitude.T, strict=True))[:_CHANNELS]:
            factor, unit = scale(values.max(), unit_in(result.structure, channel))
            peak = f"{factor * values.max():.4g} {unit} at {hz[values.argmax()]:.5g} Hz"
            peaks.append(f"{channel} to {peak}")
        yield f"At {level.size:g} {result.drive.unit} stable motion reaches: {', '.join(peaks)}."


def amplitude_sections(result: Response, title: str = "Amplitude over frequency") -> dict[str, Section]:
    """Amplitudes over frequency, and a table of the branches."""
    text = (
        "Amplitude is half of peak to peak over a period. Unstable motion, which no test shows, is dotted; between folds "
        "the motion jumps from one stable branch to another."
    )
    if any(map(mirrored, result.levels)):
        text += " Branches that are mirror images of each other, as of twin wells, lie on one line; the table names them."
    text += " Grey points are measured." if result.measured else ""
    figure = partial(response_figure, result)
    return {
        "response": Section(title, [text], figure=figure),
        "branches": Section("Branches", rows=peak_rows(result), folded=True),
    }


def _write_data(result: Response, folder: Path) -> None:
    """branches.csv: a line for every point of a branch."""
    kinds = ("amplitude", "first harmonic", "phase in degrees", "lower", "upper", "mean")
    names = [f"{channel} {kind}" for channel in result.channels for kind in kinds]
    head = ["level", "branch", "hz", "stable", "largest multiplier", "bifurcation", *names]
    branches = ((level.size, *one) for level in result.levels for one in enumerate(level.branches, start=1))
    rows = ((size, number, *row) for size, number, branch in branches for row in _branch_rows(branch))
    csv_table(folder / "branches.csv", head, rows)


def _branch_rows(branch: Branch) -> Iterator[tuple[object, ...]]:
    """Of each point of a branch frequency, stability and bifurcation, and of each channel amplitudes, phase, bounds, mean."""
    unknown, harmonic = np.full_like(branch.amplitude, np.nan), branch.first_harmonic
    others = (unknown if bound is None else bound for bound in (branch.lower, branch.upper, branch.mean))
    values = [branch.amplitude, np.abs(harmonic), np.degrees(np.angle(harmonic)), *others]
    columns = np.stack(values, axis=2).reshape(len(branch.hz), -1).tolist()
    states = [part.tolist() for part in (branch.hz, branch.stable.astype(int), branch.largest_multiplier)]
    for *state, row in zip(*states, branch.bifurcations, columns, strict=True):
        yield *state, *("" if np.isnan(value) else value for value in row)


RESPONSE_FOLDER: ResultFolder[Response] = sectioned(
    RESPONSE,
    lambda result: Head((*headline(result), *_largest_motion(result)), result.structure, result.findings),
    amplitude_sections,
    ["sweep slowly over a fold in a test and lay it over these curves (respond --record)."],
    _write_data,
)
"""What `respond` hands over."""


def _backbone_sections(result: Backbone) -> dict[str, Section]:
    """Amplitudes and damping over the frequency of a mode."""
    text = ["The damping ratio is what the motion loses in a period, over 4 pi times its energy."]
    text += ["Grey points are measured."] if result.measured else []
    figure = partial(backbone_figure, result)
    return {
        "backbone": Section("Amplitude over frequency", text, figure=figure),
        "points": Section("Points of the curve", rows=backbone_rows(result), folded=True),
    }


def _write_backbone_data(result: Backbone, folder: Path) -> None:
    """backbone.csv: frequency in Hz, energy in J, amplitudes, damping ratio, and in phase resonance the force in N."""
    columns = {"damping": result.damping} | ({} if result.force is None else {"force": result.force})
    table = np.column_stack([result.hz, result.energy, result.amplitude, *columns.values()]).tolist()
    csv_table(folder / "backbone.csv", ("hz", "energy", *result.channels, *columns), table)


BACKBONE_FOLDER: ResultFolder[Backbone] = sectioned(
    BACKBONE,
    lambda result: Head(backbone_headline(result), result.structure, result.findings),
    _backbone_sections,
    ["lay a measured decay over the curve (backbone --levels), or compute what a force does (respond)."],
    _write_backbone_data,
)
"""What `backbone` hands over."""


def _write_basins_data(result: Basins, folder: Path) -> None:
    """basins.csv: the initial values and the number of the rest position, from 1, 0 where not decided."""
    first, second = np.meshgrid(*result.values, indexing="ij")
    rows = np.column_stack([first.ravel(), second.ravel(), result.ends.ravel() + 1]).tolist()
    csv_table(folder / "basins.csv", [*result.plane, "rest"], rows)


def _basins_sections(result: Basins) -> dict[str, Section]:
    """The plane of initial states."""
    figure = partial(basins_figure, result)
    return {"basins": Section("Where motion ends", rows=basins_rows(result), figure=figure)}


BASINS_FOLDER: ResultFolder[Basins] = sectioned(
    BASINS,
    lambda result: Head(basins_headline(result), result.structure),
    _basins_sections,
    ["compute what a force does there (respond)."],
    _write_basins_data,
)
"""What `basins` hands over."""
