"""Figures for print: matplotlib's Figure without pyplot, which would keep every figure and pick a display."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

_STYLE: Any = {
    "axes.grid": True,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "figure.dpi": 150,
    "font.size": 9,
    "grid.alpha": 0.35,
    "grid.linewidth": 0.5,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "lines.linewidth": 1.2,
    "svg.hashsalt": "linkwise",  # the same figure is the same file
}


@contextmanager
def sheet(
    rows: int = 1, columns: int = 1, *, width: float = 6.3, height: float = 3.6
) -> Iterator[tuple[Figure, list[Axes]]]:
    """An empty figure of `width` by `height` inches and its axes, row by row, in the style of this package."""
    with rc_context(_STYLE):
        figure = Figure(figsize=(width, height), layout="constrained")
        yield figure, list(figure.subplots(rows, columns, squeeze=False).flat)


def save(figure: Figure, stem: Path) -> tuple[Path, Path]:
    """Write `stem`.png and `stem`.svg and return both paths."""
    png, svg = stem.with_name(f"{stem.name}.png"), stem.with_name(f"{stem.name}.svg")
    with rc_context(_STYLE):
        figure.savefig(png, metadata={"Software": "linkwise"})
        figure.savefig(svg, metadata={"Date": None, "Creator": "linkwise"})
    return png, svg
