"""The figures of the paper, redrawn from a study: motions of chains (2 to 5), forces of sinks (6, 7), errors and times
(8, 9), and sentences on them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from linkwise.absorption.absorb import without_sinks
from linkwise.absorption.sinks import find_sinks
from linkwise.model.chains import bnes_chain
from linkwise.model.excitation import Excitation
from linkwise.model.structure import Link
from linkwise.paper.tables import (
    DECIBELS,
    DURATION,
    INFORMED_NMSE,
    INFORMED_SECONDS,
    RATE,
    TABLE_2,
    PaperStudy,
    start,
)
from linkwise.plot.links import force_comparison_figure
from linkwise.plot.records import displacements_figure
from linkwise.plot.studies import curve_styles, draw_curves
from linkwise.plot.style import IDENTIFIED, MEASURED, SERIES, TRUE, legend_below, sheet
from linkwise.simulation.simulate import NEIGHBOURS, OrbitEnvelope, orbit_envelope
from linkwise.study.definition import Study
from linkwise.study.subject import Row, Subject
from linkwise.study.summary import StudySummary


@lru_cache(maxsize=4)
def chain_motion(masses: int, *, sinks: bool = True) -> OrbitEnvelope:
    """The paper's run of the chain of so many masses, with its sinks or without the masses that they are."""
    structure = bnes_chain(masses)
    if not sinks:
        drive = Excitation(release=start(masses))
        structure, _ = without_sinks(structure, find_sinks(structure), drive, "removed")
    return orbit_envelope(structure, start(masses), duration=DURATION, rate=RATE)


def figure_2() -> Figure:
    """Responses of the chain of two masses."""
    return displacements_figure(chain_motion(2), titles=("primary mass m1", "sink m2"))


def figure_3() -> Figure:
    """The primary mass of the chain of two with its sink and without."""
    alone = chain_motion(2, sinks=False)
    return displacements_figure(chain_motion(2), without=alone, titles=("primary mass m1",))


def figure_4() -> Figure:
    """Responses of the chain of eight masses: primary masses on the left, their sinks on the right."""
    motion = chain_motion(8)
    titles = [f"{('primary mass', 'sink')[k % 2]} {mass}" for k, mass in enumerate(motion.masses)]
    return displacements_figure(motion, columns=2, titles=titles)


def figure_5() -> Figure:
    """The primary masses of the chain of eight with their sinks and without."""
    without = chain_motion(8, sinks=False)
    titles = [f"primary mass {mass}" for mass in without.masses]
    return displacements_figure(chain_motion(8), without=without, columns=2, titles=titles)


_LEVELS = dict(zip(DECIBELS, (SERIES[2], SERIES[5], SERIES[1]), strict=True))


def figure_6(study: Study, table: StudySummary, paper: PaperStudy, classical: str) -> Figure | None:
    """The chain of two masses: a the force found at 20 dB by the method `classical`, b its error at 40, 30 and 20 dB.

    The maximum likelihood at 20 dB stands beside it. None where the study has no such answer.
    """
    return _figure(study, table, paper, 2, classical, shown=DECIBELS[-1:])


def figure_7(study: Study, table: StudySummary, paper: PaperStudy, classical: str) -> Figure | None:
    """The same for the chain of eight masses; a shows all three noise levels."""
    return _figure(study, table, paper, 8, classical, shown=DECIBELS)


def _figure(
    study: Study, table: StudySummary, paper: PaperStudy, masses: int, classical: str, shown: Sequence[float]
) -> Figure | None:
    subject_name = paper.named(masses)
    rows = {level: _median_row(table, subject_name, level, classical) for level in DECIBELS}
    judged = next((row for level in reversed(DECIBELS) if (row := rows[level]) is not None), None)
    if judged is None or subject_name is None:
        return None
    subject = study.subject(subject_name)
    structure = subject.structure
    link = _median_link(judged)  # one link for all curves: each has its own range of motion
    forces: dict[str, Link] = {}
    styles: dict[str, dict[str, Any]] = {}
    errors: list[str] = []
    drawn = [("", level, row) for level, row in rows.items()]
    for method in paper.likelihood[:1]:
        drawn.append((method, DECIBELS[-1], _median_row(table, subject_name, DECIBELS[-1], method)))
    for method, level, row in drawn:
        if row is not None:
            name = f"{method or 'SINDy'}, {level:g} dB"
            forces[name] = structure.with_values(row.coefficients).link(link)
            dashed = {"color": _LEVELS[level], "linestyle": (0, (4, 2))}
            styles[name] = {"color": IDENTIFIED} if method else dashed
            errors.append(f"{method} {row.links[link]:.3g} % at {level:g} dB".lstrip())
    return force_comparison_figure(
        structure.link(link),
        forces,
        _true_range(subject, link),
        styles=styles,
        only_errors=[f"SINDy, {level:g} dB" for level in DECIBELS if level not in shown],
        title=f"{link}; SINDy: {classical}; cycles of median error\nNMSE: {', '.join(errors)}",
    )


def _true_range(subject: Subject, link: str) -> tuple[float, float]:
    """The least and the greatest elongation of a link in m along the true motion."""
    truth = subject.simulate().simulated
    assert truth is not None  # of a simulation it is there
    structure = subject.structure
    d = structure.elongations(truth.displacement, truth.base)[:, structure.links.index(structure.link(link))]
    return float(d.min()), float(d.max())


def _median_link(row: Row) -> str:
    """Of the judged links the one whose error comes closest to the row's."""
    error = row.nmse or 0.0
    return min(row.links, key=lambda link: abs(row.links[link] - error))


def _median_row(table: StudySummary, name: str | None, level: float, method: str) -> Row | None:
    """The row that stands for a cell, None where none has coefficients."""
    cell = None if name is None else table.cell(name, level, method)
    row = None if cell is None else cell.median_row
    return row if row is not None and row.coefficients else None


_OTHERS = {"label": "SINDy, other conventions", "color": MEASURED, "lw": 0.6, "zorder": 1}


def _draw_printed(axes: Axes, table: StudySummary, name: str, values: Mapping[str, float]) -> None:
    """What the paper prints, by structure, beside what a study has."""
    at = [index for index, structure in enumerate(table.structures) if structure in values]
    printed = [values[table.structures[index]] for index in at]
    axes.plot(at, printed, color=TRUE, ls=(0, (4, 2)), marker="s", ms=5.5, mfc="none", label=name, zorder=4)


def figure_8(table: StudySummary, paper: PaperStudy, classical: str | None = None) -> Figure:
    """SINDy with all monomials: a to c the error at 40, 30 and 20 dB, d the time of one estimate at 20 dB.

    The paper's values are those of Table 2; it prints no times for d. linkwise's own estimators stand beside them, and other
    conventions than the one called `classical` behind them.
    """
    others = [method for method in paper.classical if method != classical]
    shown = [method for method in table.methods if method not in (*others, *paper.informed)]
    drawn = {**dict.fromkeys(others, _OTHERS), **curve_styles(shown)}
    with sheet(2, 2, height=5.9) as (figure, panels):
        for letter, axes, decibel in zip("abc", panels, DECIBELS, strict=False):
            printed = {name: TABLE_2[masses, decibel] for name, masses in paper.masses.items()}
            draw_curves(axes, table, decibel, "nmse", drawn)
            _draw_printed(axes, table, "paper, Table 2", printed)
            axes.set_title(f"{letter}  {decibel:g} dB")
        draw_curves(panels[3], table, DECIBELS[-1], "seconds", drawn)
        panels[3].set_title(f"d  time of one estimate, {DECIBELS[-1]:g} dB")
        legend_below(figure, *panels)
    return figure


def figure_9(table: StudySummary, paper: PaperStudy) -> Figure:
    """Physics-informed SINDy at 20 dB: a the error, b the time, with linkwise's own estimators beside it."""
    drawn = curve_styles([method for method in table.methods if method not in paper.classical])
    level = DECIBELS[-1]
    error: dict[str, float] = dict.fromkeys(paper.masses, INFORMED_NMSE)
    seconds = {name: INFORMED_SECONDS[masses] for name, masses in paper.masses.items()}
    shown = (
        ("nmse", error, f"a  {level:g} dB"),
        ("seconds", seconds, f"b  time of one estimate, {level:g} dB"),
    )
    with sheet(1, 2, height=3.3) as (figure, panels):
        for axes, (quantity, printed, title) in zip(panels, shown, strict=True):
            draw_curves(axes, table, level, quantity, drawn)
            _draw_printed(axes, table, "paper, physics-informed", printed)
            axes.set_title(title)
        legend_below(figure, *panels)
    return figure


def motion_captions() -> dict[str, str]:
    """Captions of Figures 2 to 5 by the names of their files."""
    two, eight = chain_motion(2), chain_motion(8)
    return {
        "figure_2": _two_masses(two),
        "figure_3": _motion_caption(two, "The paper: faster decay and smaller amplitudes."),
        "figure_4": _many(eight),
        "figure_5": _motion_caption(eight, 'The paper: "always lower than the linear" chain.'),
    }


def _two_masses(motion: OrbitEnvelope) -> str:
    d = motion.record.channel("x:m2") - motion.record.channel("x:m1")
    crossings = motion.record.time[1:][np.diff(np.sign(d)) != 0]
    followed = "Double precision follows this orbit to its end."
    return (
        f"The sink crosses between its wells until {crossings[-1]:.2f} s and comes to rest at {1e3 * d[-1]:.1f} mm "
        f"(the paper: until about 2.5 s, +10 mm). {followed if motion.horizon is None else _past(motion.horizon)}"
    )


def _many(motion: OrbitEnvelope) -> str:
    if motion.horizon is None:
        return "Double precision follows these orbits to their end."
    return (
        f"{_past(motion.horizon)} The band is the range of {NEIGHBOURS} neighbours whose starts differ by parts in 10¹²: the "
        "well that a sink falls into changes from one to the next, so the paper's curves can be compared with these up to the "
        "dashed line only."
    )


def _past(horizon: float) -> str:
    return (
        f"Up to {horizon:.2f} s the curves are the solution; past it every rounding error has grown to the size of the "
        "motion, and the curve is one of many."
    )


def _motion_caption(motion: OrbitEnvelope, paper: str) -> str:
    shares, without = {}, chain_motion(len(motion.masses), sinks=False)
    for mass in without.masses:
        power, alone = (np.mean(run.record.channel(f"x:{mass}") ** 2) for run in (motion, without))
        shares[mass] = np.sqrt(power / alone)
    listed = ", ".join(f"{mass} {100.0 * share:.0f} %" for mass, share in shares.items())
    higher = [mass for mass, share in shares.items() if share > 1.0]
    remark = f" That does not hold for {', '.join(higher)} of this orbit." if higher else " So it is here."
    return f"Root mean square over {motion.record.duration:g} s against the same mass without sinks: {listed}. {paper}{remark}"
