"""What pictures show is what was found, in what units, and that they never warn."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from present import some
from problems import chain_record
from reach_rows import EXACT, reach_maps
from record_faults import changed, without
from structures import host

import linkwise as lw
from linkwise.plot.absorptions import crossings_figure, decay_figure
from linkwise.plot.links import force_figure
from linkwise.plot.records import histories_figure
from linkwise.plot.style import WELL, envelope, scattered


@pytest.fixture(scope="module")
def eight() -> lw.Absorption:
    """The paper's Fig. 5, its first second and a half."""
    return lw.absorb(
        lw.bnes_chain(8), duration=1.5, rate=500.0, release={"v:m1": 3.0}, harvesters={"nes1": 0.01}
    )


def labels(figure: Figure) -> list[str]:
    """The words of its first legend."""
    return [text.get_text() for text in figure.legends[0].get_texts()]


@pytest.mark.slow
def test_decay_shows_every_primary_mass_with_and_without(eight: lw.Absorption) -> None:
    figure = decay_figure(eight)
    assert [axes.get_ylabel() for axes in figure.axes] == ["m1\nmm", "m3\nmm", "m5\nmm", "m7\nmm"]
    without, with_sinks, *_ = (np.asarray(line.get_ydata()) for line in figure.axes[1].get_lines())
    np.testing.assert_allclose(with_sinks, 1000.0 * eight.with_sinks.x[:, 2], rtol=1e-12)
    np.testing.assert_allclose(without, 1000.0 * eight.without.x[:, 1], rtol=1e-12)
    assert "chaos: one motion of many" in labels(figure) and "settled with sinks" not in labels(figure)
    assert "envelope, 95 % of draws" not in labels(figure)
    lower, upper = 0.9 * eight.with_sinks.envelope, 1.1 * eight.with_sinks.envelope
    drawn = lw.absorption.AbsorptionIntervals(eight, 2, 0, (), lower, upper, diverged=0, closure=0.0)
    assert "envelope, 95 % of draws" in labels(decay_figure(drawn))


def test_crossings_are_marked_above_each_sink(eight: lw.Absorption) -> None:
    for axes, work in zip(some(crossings_figure(eight).axes), eight.sinks, strict=True):
        marks = next(line for line in axes.get_lines() if line.get_label() == "crossing")
        np.testing.assert_array_equal(marks.get_xdata(), work.crossings)
        assert axes.get_title("left") == f"{work.sink.link}: {len(work.crossings)} crossings"
    one_well, trial = lw.bnes_chain(2, alpha=100.0), {"v:m1": 1.0}
    figure = crossings_figure(lw.absorb(one_well, sinks=["nes1"], duration=0.2, rate=500.0, release=trial))
    assert labels(figure) == ["elongation"] and figure.axes[0].get_title("left") == "nes1: one well"


CHAIN = lw.bnes_chain(2)


@pytest.fixture(scope="module")
def with_a_gap() -> lw.Estimate:
    """A fit of two records, of which the first lacks samples of a sink."""
    first, second = (chain_record(2, duration=1.0).with_noise(30.0, seed=seed) for seed in (51, 52))
    return lw.identify([without(first, x_m2=slice(200, 230)), second], CHAIN.unknown("all"))


def test_residuals_are_those_of_all_samples_in_standard_deviations(with_a_gap: lw.Estimate) -> None:
    """Of white noise of unit power, whose mean square errs by three hundredths."""
    left = with_a_gap.motion.residuals
    assert left is not None and list(left) == ["x:m1", "x:m2"]
    assert np.flatnonzero(np.isnan(left["x:m2"])).tolist() == list(range(200, 230))
    assert not np.isnan(left["x:m1"]).any() and len(left["x:m1"]) == len(with_a_gap.motion.time)
    np.testing.assert_allclose([np.nanmean(values**2) for values in left.values()], 1.0, atol=0.15)


@pytest.mark.slow
def test_a_missing_term_shows_over_the_motion() -> None:
    """Means over the elongation leave the band of noise where the law lacks a constant force, and not where it has it."""
    record = chain_record(2, duration=2.0).with_noise(30.0, seed=53)
    shifted = changed(record, x_m2=lambda x: x + 2e-4)
    fits = [lw.identify(each, CHAIN.unknown("all"), as_stated=True) for each in (record, shifted)]
    outside = []
    for fit in fits:
        axes = lw.plot.residuals(fit, "x:m2", "d of nes1")
        [mean] = axes.get_lines()
        band = axes.collections[0].get_paths()[0].get_extents().y1
        outside.append(int(np.sum(np.abs(np.asarray(mean.get_ydata())) > band)))
    assert outside[0] <= 4 < outside[1]  # of 24: one in twenty by chance


def test_what_is_not_there_is_refused(with_a_gap: lw.Estimate) -> None:
    with pytest.raises(lw.RecordError, match=r"no residuals of 'x:m3'.*choose from x:m1, x:m2"):
        lw.plot.residuals(with_a_gap, "x:m3")
    with pytest.raises(lw.RecordError, match=r'unknown quantity "d of nes2".*did you mean'):
        lw.plot.residuals(with_a_gap, "x:m1", "d of nes2")
    weak = lw.identify(with_a_gap.more_records[0], CHAIN.unknown("all"), method="weak")
    with pytest.raises(lw.RecordError, match="maximum likelihood alone"):
        lw.plot.residuals(weak, "x:m1")


SHAPES = {"tip": (1.0, -1.0), "joint": (0.62, 0.3)}


def wing(name: str = "wing") -> lw.Host:
    """Two modes at two points."""
    return host(name, (5.2, 21.0), 0.01, SHAPES)


def test_lines_are_the_shapes_at_the_points() -> None:
    axes = lw.plot.shapes(wing())
    assert [text.get_text() for text in axes.get_xticklabels()] == ["tip", "joint"]
    assert axes.get_legend_handles_labels()[1] == ["mode 1, 5.2 Hz", "mode 2, 21 Hz"]
    for mode, bars in enumerate(some(axes.containers)):
        line = bars.get_children()[0]
        assert isinstance(line, Line2D)
        assert list(line.get_ydata()) == [values[mode] for values in SHAPES.values()]  # type: ignore[arg-type]


def test_the_colours_are_the_forces_of_the_law(fitted: lw.Estimate) -> None:
    axes = lw.plot.surface(fitted, "nes1")
    [mesh] = [collection for collection in axes.collections if isinstance(collection, QuadMesh)]
    corners = np.asarray(mesh.get_coordinates())
    shown = np.asarray(mesh.get_array()).ravel()
    link = fitted.link("nes1")
    low, high = link.d_range
    assert corners[..., 0].min() < 1e3 * low and corners[..., 0].max() > 1e3 * high  # in mm
    largest = max(abs(float(link.link.force(d, v))) for d in link.d_range for v in link.v_range)
    assert np.abs(shown).max() >= largest
    motion = axes.lines[0]
    drawn = np.asarray(motion.get_xdata(), dtype=float)
    # what is drawn of the samples may miss an end by the farthest that two of them are apart, each end once
    assert np.ptp(drawn) <= 1e3 * (high - low)
    assert np.ptp(drawn) > 1e3 * (high - low) - 2.0 * np.abs(np.diff(drawn)).max()


def numbers(axes: Axes, color: str) -> dict[tuple[int, int], int]:
    """The numbers of one colour by line and column of their cell."""
    return {
        (int(text.get_position()[1]), int(text.get_position()[0])): int(text.get_text())
        for text in axes.texts
        if to_rgba(text.get_color()) == to_rgba(color)
    }


def test_each_cell_has_its_per_cent_and_in_red_what_is_wrong_and_trusted() -> None:
    """Four cycles: a quarter each; where not all are exact, one more is trusted."""
    axes = lw.plot.success_map(reach_maps()[0])
    share = {(row, column): 25 * EXACT[row][column] for row in range(2) for column in range(3)}
    assert numbers(axes, "black") == share
    assert numbers(axes, WELL) == {cell: 25 for cell, exact in share.items() if exact < 100}
    assert axes.get_xlabel() == "signal-to-noise ratio, dB" and axes.get_ylabel() == "samples a period"
    assert [label.get_text() for label in axes.get_xticklabels()] == ["8", "20", "40"]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["5", "25"]
    colours = np.asarray(axes.collections[0].get_array()).reshape(2, 3)
    np.testing.assert_allclose(colours, np.array(EXACT) / 4.0, rtol=1e-12)


def waves(count: int, *, gap: slice | None = None, samples: int = 500) -> lw.Record:
    """A record of `count` masses that swing, each a little faster than the one before."""
    time = np.arange(samples) / 100.0
    channels = {f"x:m{k}": 0.01 * np.sin((k + 1) * time) for k in range(1, count + 1)}
    if gap is not None:
        channels["x:m1"][gap] = np.nan
    return lw.Record.from_arrays(time, channels, source="waves.csv")


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


def test_force_figure_names_axes_units_and_curves(unseen: lw.Estimate, chain: lw.Structure) -> None:
    figure = force_figure(unseen, "nes1", truth=chain)
    wide, near = figure.axes
    assert wide.get_xlabel() == "elongation d, mm" and wide.get_ylabel() == "force at v = 0, N"
    assert {"range visited", "true", "95 % band", "identified", "wells"} <= set(labels(figure))
    assert figure.get_suptitle() == "nes1 (m2 – m1):  alpha*d + beta*d**3 + c*v"
    low, high = near.get_xlim()
    assert wide.get_xlim()[0] < low < -10.0 and 10.0 < high < wide.get_xlim()[1]  # wells at 10 mm
    blind = replace(unseen, compute_motion=lambda: replace(unseen.motion, compute_residual=lambda: None))
    assert "measured minus damping" in labels(force_figure(unseen, "nes1"))
    assert "minus damping" not in " ".join(labels(force_figure(blind, "nes1")))
    spring = force_figure(unseen, "spring1")
    assert len(spring.axes) == 1 and "wells" not in labels(spring)


@pytest.mark.parametrize(
    "record", [waves(1, gap=slice(100, 200)), waves(2, samples=20_000, gap=slice(0, 9_000))]
)
def test_gaps_are_drawn_as_gaps(record: lw.Record, tmp_path: Path) -> None:
    figure = histories_figure(record)
    assert np.isnan(figure.axes[0].lines[0].get_ydata()).any()
    lw.plot.save(figure, tmp_path / "histories")


@pytest.mark.slow
def test_saved_figures_are_the_same_every_time(fitted: lw.Estimate, tmp_path: Path) -> None:
    first = [path.read_bytes() for path in lw.plot.save(force_figure(fitted, "nes1"), tmp_path / "a.b")]
    again = [path.read_bytes() for path in lw.plot.save(force_figure(fitted, "nes1"), tmp_path / "c.d")]
    assert first == again
    assert {path.name for path in tmp_path.iterdir()} == {"a.b.png", "a.b.svg", "c.d.png", "c.d.svg"}
