"""How figures look, and the Axes that they are drawn on.

Figures are made with `matplotlib.figure.Figure`; pyplot would keep every figure alive and choose a display.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from io import BytesIO
from pathlib import Path
from textwrap import fill
from typing import Any

from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter, NullFormatter

from linkwise.argument_types import checked
from linkwise.plot.layout import LEGEND_SIZE, SUPTITLE_SIZE, TITLE_SIZE, EstimatedLayout

_STYLE: Any = {
    "axes.axisbelow": True,
    "axes.grid": True,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlesize": TITLE_SIZE,
    "axes.titlelocation": "left",
    "axes.titley": 1.0,  # else every drawing measures all ticks, to keep above those on top, which no figure has
    "figure.dpi": 150,
    "font.size": 9,
    "grid.alpha": 0.35,
    "grid.linewidth": 0.5,
    "legend.frameon": False,
    "legend.fontsize": LEGEND_SIZE,
    "lines.linewidth": 1.2,
    "svg.hashsalt": "linkwise",  # the same figure is the same file
}
_CHARACTERS = 13  # of a title that fit into an inch
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@contextmanager
def sheet(
    rows: int = 1,
    columns: int = 1,
    *,
    width: float = 6.3,
    height: float = 3.6,
    share_time: bool = False,
    colorbars: bool = False,
) -> Iterator[tuple[Figure, list[Axes]]]:
    """A new figure of `width` by `height` inches and its axes, row by row, in the style of this package.

    With `share_time` all axes keep one horizontal range, and only the lowest row is labelled. Panels with `colorbars` are laid
    out by measuring everything, which takes longer.
    """
    with rc_context(_STYLE):
        figure = Figure(figsize=(width, height), layout="constrained" if colorbars else EstimatedLayout())
        yield figure, list(figure.subplots(rows, columns, squeeze=False, sharex=share_time).flat)


@contextmanager
def axes_for(
    ax: Axes | None, *, legend: bool = False, width: float = 6.3, height: float = 3.6, colorbars: bool = False
) -> Iterator[Axes]:
    """The Axes of the caller as they are, or those of a new figure in the style of this package.

    With `legend` they get one of what was drawn when the block ends.
    """
    with (
        nullcontext((None, [ax]))
        if ax is not None
        else sheet(width=width, height=height, colorbars=colorbars) as (
            _,
            [axes],
        )
    ):
        yield axes
        if legend and axes.get_legend_handles_labels()[0]:
            axes.legend()


def literal(text: str) -> str:
    """`text` so that matplotlib prints it as it is: between two dollar signs it would set mathematics."""
    return text.replace("$", r"\$")


def label(name: str) -> str:
    """A name for a legend, which leaves out every entry that begins with an underscore."""
    return literal(f"\u200b{name}" if name.startswith("_") else name)


def wrapped(text: str, inches: float) -> str:
    """`text` as it is printed in a title, broken into lines that fit into so many inches."""
    return literal(fill(text, max(int(_CHARACTERS * inches), 20)))


def wrap_title(axes: Axes, text: str) -> None:
    """Give axes a title in lines that are no longer than the axes are wide."""
    axes.set_title(wrapped(text, axes_inches(axes)[0]))


def heading(figure: Figure, text: str, *, size: float = SUPTITLE_SIZE) -> None:
    """A title above all panels of a figure, at its left edge, in `size` points."""
    figure.suptitle(text, x=0.01, horizontalalignment="left", fontsize=size)


def axes_inches(axes: Axes) -> tuple[float, float]:
    """Width and height in inches that the axes have on their figure."""
    return axes.bbox.width / axes.figure.dpi, axes.bbox.height / axes.figure.dpi


def log_scale(axes: Axes, which: str, *, linear_to: float | None = None) -> None:
    """Make an axis, "x" or "y", logarithmic, or linear up to `linear_to` on both sides of 0 and logarithmic beyond."""
    axis = axes.xaxis if which == "x" else axes.yaxis
    change = axes.set_xscale if which == "x" else axes.set_yscale
    if linear_to is None:
        change("log")
    else:
        change("symlog", linthresh=linear_to, linscale=0.6)
    axis.set_major_formatter(PowerFormatter(linthresh=linear_to))
    between = SparsePowerFormatter() if which == "x" else PowerFormatter()
    axis.set_minor_formatter(between if linear_to is None else NullFormatter())


_NAMED_DIGITS = ((0.35, "23468"), (0.5, "2346"), (0.7, "236"), (1.05, "24"))
"""Decades of a horizontal axis below which these first digits are named: labels of seven characters on a panel of 2 inches."""


class PowerFormatter(LogFormatter):
    """Writes 10⁴ in plain characters, where matplotlib sets mathematics, which takes ten times as long."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        """The text beside the tick at `x`, empty where it has none."""
        if not super().__call__(x, pos):
            return ""
        exponent = _exponent(x)
        if -3 <= exponent <= 3:
            return f"{x:g}".replace("-", "\u2212")
        sign, mantissa = "\u2212" if x < 0.0 else "", abs(x) / 10.0**exponent
        factor = "" if math.isclose(mantissa, 1.0) else f"{mantissa:g}·"
        return f"{sign}{factor}10{str(exponent).translate(_SUPERSCRIPT)}"


class SparsePowerFormatter(PowerFormatter):
    """The same for ticks between powers of ten on a horizontal axis, where labels side by side would overlap."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        """The text below the tick at `x`; empty for most of them, the fewer have one the more decades are shown."""
        text = super().__call__(x, pos)
        if not text or self.axis is None:
            return text
        low, high = self.axis.get_view_interval()
        decades = math.log10(high / low)
        named = next((digits for most, digits in _NAMED_DIGITS if decades < most), "3")
        return text if str(round(x / 10.0 ** _exponent(x))) in named else ""


def _exponent(x: float) -> int:
    """The power of ten at or below the size of `x`; 0 for 0."""
    return math.floor(math.log10(abs(x)) + 1e-9) if x else 0


def legend_below(figure: Figure, *panels: Axes, columns: int = 3) -> None:
    """One legend below all panels that holds every label once."""
    named: dict[str, Artist] = {}
    for axes in panels:
        for handle, text in zip(*axes.get_legend_handles_labels(), strict=True):
            named.setdefault(text, handle)
    if named:
        place_legend(figure, list(named.values()), list(named), columns)


def place_legend(figure: Figure, handles: Sequence[Artist], labels: Sequence[str], columns: int) -> None:
    """A legend of so many columns below all panels of a figure that `sheet` made."""
    engine = figure.get_layout_engine()
    if isinstance(engine, EstimatedLayout):
        engine.legend_rows = -(-len(handles) // columns)
        figure.legend(list(handles), list(labels), loc="lower center", ncols=columns)
    else:
        figure.legend(list(handles), list(labels), loc="outside lower center", ncols=columns)


def encoded(figure: Figure) -> tuple[bytes, bytes]:
    """The figure as the contents of a PNG and of an SVG file."""
    png, svg = BytesIO(), BytesIO()
    with rc_context(_STYLE), _without_glyph_warnings(), _laid_out(figure):
        figure.savefig(png, format="png", metadata={"Software": "linkwise"}, pil_kwargs={"compress_level": 3})
        figure.savefig(svg, format="svg", metadata={"Date": None, "Creator": "linkwise"})
    return png.getvalue(), svg.getvalue()


@contextmanager
def _without_glyph_warnings() -> Iterator[None]:
    """Without a warning for each letter that no font has: the figure shows a box, and the page the name."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from font")
        yield


@checked
def save(figure: Figure, stem: str | Path) -> tuple[Path, Path]:
    """Write a figure as PNG and as SVG.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        The figure.
    stem : str or pathlib.Path
        Folder and name of both files, without suffix.

    Returns
    -------
    png, svg : pathlib.Path
        The files.

    Raises
    ------
    OSError
        If a file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=1.0, rate=1000.0)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     paths = lw.plot.save(lw.plot.histories_figure(record), Path(folder) / "motion")
    >>> [path.name for path in paths]
    ['motion.png', 'motion.svg']
    """
    folder, name = Path(stem).parent, Path(stem).name
    png, svg = folder / f"{name}.png", folder / f"{name}.svg"
    for path, content in zip((png, svg), encoded(figure), strict=True):
        path.write_bytes(content)
    return png, svg


def warm_up() -> None:
    """Load what the first figure of a process loads: backends and fonts."""
    with sheet(width=1.0, height=1.0) as (figure, [axes]):
        axes.set_title("t")
    encoded(figure)


@contextmanager
def _laid_out(figure: Figure) -> Iterator[None]:
    """Lay the figure out once for all files that are written; each would do so again, at the cost of two more drawings."""
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
        figure.set_layout_engine(None)
    try:
        yield
    finally:
        figure.set_layout_engine(engine)
