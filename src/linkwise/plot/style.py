"""How figures look, and the Axes that they are drawn on.

Figures are made with `matplotlib.figure.Figure`; pyplot would keep every figure alive and choose a display.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from textwrap import fill
from typing import Any

from matplotlib import rc_context
from matplotlib.artist import Artist
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
_CHARACTERS = 13  # of a title that fit into an inch


@contextmanager
def sheet(
    rows: int = 1, columns: int = 1, *, width: float = 6.3, height: float = 3.6, share_time: bool = False
) -> Iterator[tuple[Figure, list[Axes]]]:
    """A new figure of `width` by `height` inches and its axes, row by row, in the style of this package.

    With `share_time` all axes keep one horizontal range, and only the lowest row is labelled.
    """
    with rc_context(_STYLE):
        figure = Figure(figsize=(width, height), layout="constrained")
        yield figure, list(figure.subplots(rows, columns, squeeze=False, sharex=share_time).flat)


@contextmanager
def axes_for(ax: Axes | None, *, width: float = 6.3, height: float = 3.6) -> Iterator[Axes]:
    """The Axes of the caller as they are, or those of a new figure in the style of this package.

    Raises TypeError for anything else, such as the array that `plt.subplots(2)` returns.
    """
    if ax is None:
        with sheet(width=width, height=height) as (_, [axes]):
            yield axes
    elif isinstance(ax, Axes):
        yield ax
    else:
        raise TypeError(f"ax must be a matplotlib Axes or None, got {type(ax).__name__}")


def literal(text: str) -> str:
    """`text` so that matplotlib prints it as it is: between two dollar signs it would set mathematics."""
    return text.replace("$", r"\$")


def label(name: str) -> str:
    """A name for a legend, which leaves out every entry that begins with an underscore."""
    return literal(f"\u200b{name}" if name.startswith("_") else name)


def wrapped(text: str, inches: float) -> str:
    """`text` as it is printed in a title, broken into lines that fit into so many inches."""
    return literal(fill(text, max(int(_CHARACTERS * inches), 20)))


def axes_inches(axes: Axes) -> tuple[float, float]:
    """Width and height in inches that the axes have on their figure."""
    return axes.bbox.width / axes.figure.dpi, axes.bbox.height / axes.figure.dpi


def legend_below(figure: Figure, *panels: Axes, columns: int = 3) -> None:
    """One legend below all panels that holds every label once."""
    named: dict[str, Artist] = {}
    for axes in panels:
        for handle, text in zip(*axes.get_legend_handles_labels(), strict=True):
            named.setdefault(text, handle)
    if named:
        figure.legend(list(named.values()), list(named), loc="outside lower center", ncols=columns)


def save(figure: Figure, stem: Path) -> tuple[Path, Path]:
    """Write `stem`.png and `stem`.svg and return both paths."""
    png, svg = stem.with_name(f"{stem.name}.png"), stem.with_name(f"{stem.name}.svg")
    with rc_context(_STYLE):
        figure.savefig(png, metadata={"Software": "linkwise"})
        figure.savefig(svg, metadata={"Date": None, "Creator": "linkwise"})
    return png, svg
