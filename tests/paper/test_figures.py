"""The paper's figures: the right curves, in the paper's arrangement, honest about chaos."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from paper_rows import BEST, paper_rows, paper_study
from present import present

import linkwise as lw
from linkwise.paper import figures
from linkwise.paper.figures import figure_6, figure_7, figure_8
from linkwise.paper.tables import DECIBELS, INFORMED_SECONDS, MASSES, TABLE_2, PaperStudy
from linkwise.plot.studies import accuracy_figure
from linkwise.report.study import StudyReport

SHOWN = 0.8  # s that every curve must follow the reference
FACTOR = {"m": 1.0, "mm": 1e-3}


def titled(figure: Figure) -> dict[str, Axes]:
    """The panels by the name of the mass at the end of their title."""
    return {axes.get_title(loc="left").split()[-1]: axes for axes in figure.axes}


def curve(axes: Axes, label: str) -> tuple[np.ndarray, np.ndarray]:
    """Time in s and displacement in m of the line of that label."""
    line = next(line for line in axes.lines if line.get_label() == label)
    unit = axes.get_ylabel().rpartition(" ")[2]
    return np.asarray(line.get_xdata()), FACTOR[unit] * np.asarray(line.get_ydata())


def worst_departure(figure: Figure, file: Path) -> float:
    """Of every curve from its reference over the first 0.8 s, relative to the largest value that it reaches there."""
    names = [name.partition(":")[2] for name in file.read_text().splitlines()[0].split(",")[1:]]
    table = np.loadtxt(file, delimiter=",", skiprows=1)
    table = table[table[:, 0] <= SHOWN + 1e-9]
    panels = titled(figure)
    assert set(names) == set(panels)
    worst = 0.0
    for column, name in enumerate(names, start=1):
        time, x = curve(panels[name], "this orbit")
        at = np.rint(1000.0 * table[:, 0]).astype(int)
        np.testing.assert_allclose(time[at], table[:, 0], atol=1e-12)
        worst = max(worst, np.abs(x[at] - table[:, column]).max() / np.abs(table[:, column]).max())
    return worst


@pytest.mark.parametrize(("masses", "figure"), [(2, figures.figure_2), (8, figures.figure_4)])
def test_every_curve_is_the_reference_for_as_long_as_it_can_be_told(
    masses: int, figure: Callable[[], Figure], shared_reference: Path
) -> None:
    """1e-6 is what double precision has departed by at the end of the files."""
    assert worst_departure(figure(), shared_reference / f"bnes_{masses}.csv") < 1e-6


@pytest.mark.parametrize(
    ("figure", "masses"), [(figures.figure_3, ["m1"]), (figures.figure_5, ["m1", "m3", "m5", "m7"])]
)
def test_primary_masses_with_and_without_sinks(figure: Callable[[], Figure], masses: list[str]) -> None:
    panels = titled(figure())
    assert list(panels) == masses
    bare = [np.mean(curve(axes, "without sinks")[1] ** 2) for axes in panels.values()]
    absorbed = [np.mean(curve(axes, "with sinks")[1] ** 2) for axes in panels.values()]
    assert 0.0 < absorbed[0] < bare[0]  # m5 of the chain of eight gains a little, whatever the paper says
    assert sum(absorbed) < sum(bare)


def test_the_bare_primary_mass_decays_as_a_linear_oscillator(tmp_path: Path) -> None:
    """Fig. 3: x = v0/w exp(-ct/2m) sin(wt), w^2 = k/m - (c/2m)^2."""
    figure = figures.figure_3()
    time, bare = curve(figure.axes[0], "without sinks")
    w = np.sqrt(30000.0 - 0.25)
    np.testing.assert_allclose(bare, np.exp(-0.5 * time) * np.sin(w * time) / w, atol=1e-12)
    png, svg = lw.plot.save(figure, tmp_path / "figure_3")
    assert png.read_bytes()[:4] == b"\x89PNG" and "<svg" in svg.read_text()
    assert svg.stat().st_size < 500_000


def test_the_printed_numbers_are_those_of_the_paper() -> None:
    paper = Path(__file__).resolve().parents[3] / "shared" / "paper.md"
    if not paper.is_file():
        pytest.skip("no ../shared/paper.md beside the checkout")
    text = paper.read_text()
    for decibel in DECIBELS:
        row = re.search(rf"^{decibel:g}\t([\d.\t]+)$", text, re.MULTILINE)
        printed = [float(cell) for cell in present(row)[1].split()]
        assert printed == [TABLE_2[masses, decibel] for masses in MASSES]
    times = present(re.search(r"computing times are (.*?) for two degrees", text))[1]
    assert [float(number) for number in re.findall(r"[\d.]+", times)] == list(INFORMED_SECONDS.values())


@pytest.fixture(scope="module")
def report() -> StudyReport:
    """What made-up rows of the paper's study tell."""
    study = paper_study()
    return StudyReport.of(study, paper_rows(study))


def values(axes: Axes, label: str) -> np.ndarray:
    """Heights of the line of that label."""
    return np.asarray(next(line for line in axes.lines if line.get_label() == label).get_ydata())


PANELS = ["a  40 dB", "b  30 dB", "c  20 dB", "d  time of one estimate, 20 dB"]


def test_figure_8_has_the_paper_beside_ours(report: StudyReport) -> None:
    figure = figure_8(report.table, report.paper, BEST)
    assert [axes.get_title(loc="left") for axes in figure.axes] == PANELS
    for axes, decibel in zip(figure.axes[:3], DECIBELS, strict=True):
        printed = [TABLE_2[masses, decibel] for masses in MASSES]
        np.testing.assert_array_equal(values(axes, "paper, Table 2"), printed)
        np.testing.assert_allclose(values(axes, BEST), 1.1 * np.array(printed), rtol=1e-12)
        np.testing.assert_array_equal(values(axes, "ml"), [1e-4] * 5)
        assert [text.get_text() for text in axes.get_xticklabels()] == ["2", "4", "6", "8", "10"]
        faint = [line for line in axes.lines if line.get_label() == "SINDy, other conventions"]
        assert len(faint) == 3
    np.testing.assert_allclose(values(figure.axes[3], BEST), 0.01 * np.array(MASSES), rtol=1e-12)
    names = [text.get_text() for text in figure.legends[0].get_texts()]
    assert sorted(names) == sorted({*names}) and "physics-informed" not in names
    part = StudyReport.of(report.study, [row for row in paper_rows(report.study) if row.masses != 6])
    gap = values(figure_8(part.table, part.paper, BEST).axes[0], "ml")
    assert np.flatnonzero(np.isnan(gap)).tolist() == [2]
    own = accuracy_figure(report.table)
    assert [axes.get_title(loc="left") for axes in own.axes] == PANELS
    assert {line.get_label() for line in own.axes[0].lines} == set(report.table.methods)


@pytest.mark.parametrize(("draw", "shown"), [(figure_6, [20.0]), (figure_7, [40.0, 30.0, 20.0])])
def test_forces_beside_the_theory(
    report: StudyReport, draw: Callable[..., Figure], shown: list[float]
) -> None:
    """The made-up coefficients are all off by one factor, so the error is that factor's wherever the force is largest."""
    forces, errors = draw(report.study, report.table, report.paper, BEST).axes
    labels = [line.get_label() for line in forces.lines]
    assert labels == ["theory", *(f"SINDy, {level:g} dB" for level in shown), "ml, 20 dB"]
    theory = values(forces, "theory")
    masses = 2 if draw is figure_6 else 8
    for level in DECIBELS:
        off = np.sqrt(1.1 * TABLE_2[masses, level] / 100.0)
        assert values(errors, f"SINDy, {level:g} dB").max() == pytest.approx(100.0 * off, rel=1e-8)
    np.testing.assert_allclose(values(forces, "ml, 20 dB"), theory * (1.0 + np.sqrt(1e-6)), rtol=1e-8)
    d = np.asarray(forces.lines[0].get_xdata())
    assert d[0] < -20.0 and d[-1] > 20.0 and forces.get_xlabel() == "elongation d, mm"  # wells at 10 mm


def test_only_the_papers_own_chains_count(report: StudyReport) -> None:
    """Another damper, another start or another length, and the paper's numbers have no place beside it."""
    subject = report.study.subject("2 masses")
    for changed in (
        replace(subject, structure=lw.bnes_chain(2, sink_c=0.03)),
        replace(subject, release={"v:m1": 2.0}),
        replace(subject, duration=5.0),
    ):
        own_masses = PaperStudy.of(replace(report.study, subjects=(changed,))).masses
        assert dict(own_masses) == {}
    assert dict(PaperStudy.of(report.study).masses) == {f"{masses} masses": masses for masses in MASSES}
