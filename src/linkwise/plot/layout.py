"""Where the panels of a figure stand, from the lengths of the texts around them.

matplotlib's constrained layout draws every text several times to measure it, which takes half of the time of a figure. Here a
text is as wide as its longest line has characters, which is enough for tick labels, titles and a legend below.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.layout_engine import LayoutEngine
from matplotlib.text import Text

from linkwise.arrays import Floats

TITLE_SIZE, SUPTITLE_SIZE, LEGEND_SIZE = 10.0, 10.0, 8.0  # points
_CHARACTER, _LINE, _LEGEND_LINE = 0.62, 1.3, 1.65  # width of a character, height of a line, in font sizes
_POINT = 1.0 / 72.0  # inch
_EDGE = 0.1  # inches around everything, and between the texts of two panels
_TICK, _LABEL_GAP, _TITLE_GAP = 0.1, 0.06, 0.1  # inches between a panel and its texts
_LEAST = 0.3  # inches that a panel has at least, however long its labels are

Extent = Callable[[Text], float]


class EstimatedLayout(LayoutEngine):
    """Gives panels the room that the texts around them leave; for figures whose panels form one grid.

    `legend_rows` is the number of rows of a legend below all panels.
    """

    _adjust_compatible = True
    _colorbar_gridspec = True

    def __init__(self) -> None:
        super().__init__()
        self.legend_rows = 0

    def set(self) -> None:
        """There is nothing to set."""

    def execute(self, fig: Figure) -> None:
        """Set the margins of the grid and the gaps inside it."""
        panels = [axes for axes in fig.axes if axes.get_subplotspec() is not None]
        if not panels:
            return
        inches = fig.bbox.width / fig.dpi, fig.bbox.height / fig.dpi
        rows, columns = _spec(panels[0]).get_gridspec().get_geometry()
        across, down = _Sides(np.zeros(columns), np.zeros(columns)), _Sides(np.zeros(rows), np.zeros(rows))
        for axes in panels:
            column, row = _spec(axes).colspan.start, _spec(axes).rowspan.start
            across.need(column, _beside(axes.yaxis, _width, _height), 0.5 * _ticks(axes.xaxis, _width))
            above = max(_title(axes), 0.5 * _ticks(axes.yaxis, _height))
            down.need(row, above, _beside(axes.xaxis, _height, _height))
        title = fig.get_suptitle()
        down.before[0] += _lines(title, SUPTITLE_SIZE) + _TITLE_GAP if title else 0.0
        down.after[-1] += self.legend_rows * _LEGEND_LINE * LEGEND_SIZE * _POINT + _EDGE * (
            self.legend_rows > 0
        )
        left, right, wspace = across.parts(inches[0])
        top, bottom, hspace = down.parts(inches[1])
        fig.subplots_adjust(
            left=left, right=1.0 - right, bottom=bottom, top=1.0 - top, wspace=wspace, hspace=hspace
        )


@dataclass(frozen=True)
class _Sides:
    """Inches that texts take `before` and `after` (count,) the panels of each column or row."""

    before: Floats
    after: Floats

    def need(self, number: int, before: float, after: float) -> None:
        """Note what one panel needs."""
        self.before[number] = max(self.before[number], before)
        self.after[number] = max(self.after[number], after)

    def parts(self, total: float) -> tuple[float, float, float]:
        """Of `total` inches the parts before the first and after the last panel; the gap between two, in panels."""
        count = len(self.before)
        start, end = float(self.before[0]) + _EDGE, float(self.after[-1]) + _EDGE
        gap = float(np.max(self.after[:-1] + self.before[1:], initial=0.0)) + _EDGE
        panel = max((total - start - end - (count - 1) * gap) / count, _LEAST)
        return start / total, end / total, gap / panel


def _spec(axes: Axes) -> SubplotSpec:
    spec = axes.get_subplotspec()
    assert spec is not None
    return spec


def _points(text: Text) -> float:
    return text.get_fontproperties().get_size_in_points()


def _width(text: Text) -> float:
    return _CHARACTER * _points(text) * _POINT * max(map(len, text.get_text().split("\n")))


def _height(text: Text) -> float:
    return _lines(text.get_text(), _points(text))


def _lines(text: str, size: float) -> float:
    """Inches that the lines of a text of so many points are high."""
    return _LINE * size * _POINT * len(text.split("\n"))


def _ticks(axis: Axis, extent: Extent) -> float:
    """The largest extent of the label of a tick; none where labels are not shown."""
    side = "labelbottom" if axis is axis.axes.xaxis else "labelleft"
    if not (axis.axes.axison and axis.axes.get_visible() and axis.get_tick_params().get(side, True)):
        return 0.0
    labels: Sequence[Text] = axis.get_majorticklabels()
    return max((extent(label) for label in labels if label.get_text()), default=0.0)


def _beside(axis: Axis, extent: Extent, label_extent: Extent) -> float:
    """Inches that the labels of an axis take beside the panel."""
    if not (axis.axes.axison and axis.axes.get_visible()):
        return 0.0
    ticks = _ticks(axis, extent)
    label = label_extent(axis.label) + _LABEL_GAP if axis.label.get_text() else 0.0
    return (ticks + _TICK if ticks else 0.0) + label


def _title(axes: Axes) -> float:
    """Inches that the title takes above the panel."""
    titles = [axes.get_title(loc) for loc in ("left", "center", "right")]
    return max((_lines(title, TITLE_SIZE) + _TITLE_GAP for title in titles if title), default=0.0)
