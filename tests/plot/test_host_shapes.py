"""Shapes of hosts at their points."""

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from present import some
from structures import host, structure

import linkwise as lw
from linkwise.plot.estimates import shapes_figure

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


def test_bars_are_two_standard_deviations_either_way() -> None:
    bars = some(lw.plot.shapes(wing().known_to_within(shape=0.05)).containers)[0].get_children()[-1]
    assert isinstance(bars, LineCollection)
    np.testing.assert_allclose([np.ptp(ends[:, 1]) for ends in bars.get_segments()], 4.0 * 0.05, atol=1e-12)
    known = [part for bars in some(lw.plot.shapes(wing()).containers) for part in bars.get_children()]
    assert not any(isinstance(part, LineCollection) for part in known)


def test_every_host_and_unit_has_a_panel() -> None:
    """Shapes of points that turn have another unit and size."""
    two = structure({}, hosts=[wing(), wing("tail")])
    assert [axes.get_title(loc="left") for axes in shapes_figure(two).axes] == ["wing", "tail"]
    shapes = {"tip": (1.7, -1.7), "r": (2.3, -8.0), "mid": (0.6, 1.2)}
    for rotations, unit in (
        ([], "1/√kg"),
        (["r"], "1/√kg or rad/(m √kg)"),
        (["tip", "r", "mid"], "rad/(m √kg)"),
    ):
        beam = host("beam", (5.0, 31.4), 0.01, shapes, rotations=rotations)
        assert lw.plot.shapes(beam).get_ylabel() == f"shape, {unit}"
    beam = host("beam", (5.0, 31.4), 0.01, shapes, rotations=["r"]).known_to_within(shape=0.02)
    panels = shapes_figure(structure({}, hosts=[beam], name="beam")).axes
    assert [panel.get_ylabel() for panel in panels] == ["shape, 1/√kg", "shape, rad/(m √kg)"]
    names = [[text.get_text() for text in panel.get_xticklabels()] for panel in panels]
    assert names == [["tip", "mid"], ["r"]]
