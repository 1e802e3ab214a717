"""Figures: what they show, in what units, and that they never warn."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import linkwise as lw
from linkwise.plot import save
from linkwise.plot.links import force_figure
from linkwise.plot.records import histories_figure
from linkwise.plot.style import envelope, scale, scattered


@pytest.fixture
def measured(fitted: lw.Estimate) -> lw.Estimate:
    """The same estimate as if its record had been measured: nobody knows the truth."""
    return replace(fitted, record=replace(fitted.record, simulated=None))


def waves(count: int, *, gap: slice | None = None, samples: int = 500) -> lw.Record:
    """A record of `count` masses that swing, each a little faster than the one before."""
    time = np.arange(samples) / 100.0
    channels = {f"x:m{k}": 0.01 * np.sin((k + 1) * time) for k in range(1, count + 1)}
    if gap is not None:
        channels["x:m1"][gap] = np.nan
    return lw.Record.from_arrays(time, channels, source="waves.csv")


@pytest.mark.parametrize(
    ("largest", "expected"),
    [
        (0.02, (1e3, "mm")),
        (1.0, (1.0, "m")),
        (999.0, (1.0, "m")),
        (1000.0, (1e-3, "km")),
        (3e-7, (1e9, "nm")),
        (1e-15, (1e9, "nm")),
        (0.0, (1.0, "m")),
        (float("nan"), (1.0, "m")),
    ],
)
def test_scale_brings_numbers_near_one(largest: float, expected: tuple[float, str]) -> None:
    factor, unit = scale(largest, "m")
    assert factor == pytest.approx(expected[0], rel=1e-12) and unit == expected[1]
    assert scale(largest, "") == scale(largest, "?") == (1.0, "")


def test_envelope_keeps_every_extreme_and_every_gap() -> None:
    time = np.arange(100_000) / 1000.0
    values = np.sin(time)
    values[12_345], values[54_321] = 7.0, -7.0
    values[70_000:80_000] = np.nan
    thin_time, thin = envelope(time, values, points=1000)
    assert len(thin) <= 1000 and np.all(np.diff(thin_time) >= 0)
    assert np.nanmax(thin) == 7.0 and np.nanmin(thin) == -7.0
    # within the gap by more than the 0.2 s that a bin of 500 is wide
    assert np.isnan(thin[(thin_time > 70.3) & (thin_time < 79.7)]).all()
    np.testing.assert_array_equal(thin, values[np.searchsorted(time, thin_time)])
    short = time[:100]  # is left alone
    assert envelope(short, short)[0] is short
    for count in (0, 1, 2999, 3000, 3001, 100_000):
        assert min(count, 1500) <= len(np.arange(count)[scattered(count)]) <= 3000


def labels(figure: object) -> list[str]:
    """The words of a figure's first legend."""
    return [text.get_text() for text in figure.legends[0].get_texts()]  # type: ignore[attr-defined]


def test_force_figure_names_axes_units_and_curves(measured: lw.Estimate, chain: lw.Structure) -> None:
    figure = force_figure(measured, "nes1", truth=chain)
    wide, near = figure.axes
    assert wide.get_xlabel() == "elongation d, mm" and wide.get_ylabel() == "force at v = 0, N"
    assert {"range visited", "true", "95 % band", "identified", "wells"} <= set(labels(figure))
    assert figure.get_suptitle() == "nes1 (m2 – m1):  alpha*d + beta*d**3 + c*v"
    low, high = near.get_xlim()
    assert wide.get_xlim()[0] < low < -10.0 and 10.0 < high < wide.get_xlim()[1]  # wells at 10 mm
    blind = replace(measured, compute_motion=lambda: replace(measured.motion, compute_residual=lambda: None))
    assert "measured minus damping" in labels(force_figure(measured, "nes1"))
    assert "minus damping" not in " ".join(labels(force_figure(blind, "nes1")))
    spring = force_figure(measured, "spring1")
    assert len(spring.axes) == 1 and "wells" not in labels(spring)


@pytest.mark.parametrize(
    "record", [waves(1, gap=slice(100, 200)), waves(2, samples=20_000, gap=slice(0, 9_000))]
)
def test_gaps_are_drawn_as_gaps(record: lw.Record, tmp_path: Path) -> None:
    figure = histories_figure(record)
    assert np.isnan(figure.axes[0].lines[0].get_ydata()).any()
    save(figure, tmp_path / "histories")


@pytest.mark.slow
def test_saved_figures_are_the_same_every_time(fitted: lw.Estimate, tmp_path: Path) -> None:
    first = [path.read_bytes() for path in save(force_figure(fitted, "nes1"), tmp_path / "a.b")]
    again = [path.read_bytes() for path in save(force_figure(fitted, "nes1"), tmp_path / "c.d")]
    assert first == again
    assert {path.name for path in tmp_path.iterdir()} == {"a.b.png", "a.b.svg", "c.d.png", "c.d.svg"}
