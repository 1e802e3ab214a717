"""Shapes of hosts at their points."""

from __future__ import annotations

import numpy as np
from present import some

import linkwise as lw

SHAPES = ({"tip": 1.0, "joint": 0.62}, {"tip": -1.0, "joint": 0.3})


def wing(**sigma: float) -> lw.Host:
    """Two modes at two points; the first shape is known to within `sigma` by point."""
    return lw.Host("wing", (lw.HostMode(5.2, 0.01, SHAPES[0], sigma), lw.HostMode(21.0, 0.01, SHAPES[1])))


def test_lines_are_the_shapes_at_the_points() -> None:
    axes = lw.plot.shapes(wing(tip=0.05))
    assert [text.get_text() for text in axes.get_xticklabels()] == ["tip", "joint"]
    assert axes.get_legend_handles_labels()[1] == ["mode 1, 5.2 Hz", "mode 2, 21 Hz"]
    for bars, shape in zip(some(axes.containers), SHAPES, strict=True):
        line = bars.get_children()[0]
        np.testing.assert_allclose(np.asarray(line.get_ydata(), dtype=float), list(shape.values()))
    lengths = [np.ptp(segment[:, 1]) for segment in axes.containers[0].get_children()[-1].get_segments()]
    np.testing.assert_allclose(lengths, [0.2, 0.0], atol=1e-12)  # two standard deviations either way


def test_every_host_has_a_panel() -> None:
    two = lw.Structure("two", (), (), (wing(), lw.Host("tail", wing().modes)))
    assert [axes.get_title(loc="left") for axes in lw.plot.shapes_figure(two).axes] == ["wing", "tail"]
