"""Success maps as figures: the numbers in the cells, the axes, and which panel stands where."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from reach_rows import EXACT, reach_maps

import linkwise as lw
from linkwise.plot.studies import success_figure
from linkwise.plot.style import WELL


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


def test_without_a_frequency_the_rate_is_shown_and_cells_that_were_not_run_are_empty() -> None:
    cases = np.array([[4, 0, 4], [4, 4, 0]])
    axes = lw.plot.success_map(replace(reach_maps()[0], frequency=None, name="a$b$c", cases=cases))
    assert axes.get_ylabel() == "sampling rate, Hz" and axes.get_title(loc="left") == r"a\$b\$c: discover"
    assert [label.get_text() for label in axes.get_yticklabels()] == ["100", "500"]
    assert set(numbers(axes, "black")) == {(0, 0), (0, 2), (1, 0), (1, 1)}
    with pytest.raises(lw.StudyError, match="nothing to draw: no method of the study looks for terms"):
        success_figure([])
