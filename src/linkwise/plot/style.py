"""How figures look: the Axes that they are drawn on, colours and number scales, titles, and fewer points for the same
picture.

Figures are made with `matplotlib.figure.Figure`; pyplot would keep every figure alive and choose a display.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from functools import wraps
from inspect import Parameter, Signature, signature
from io import BytesIO
from pathlib import Path
from textwrap import fill
from types import NoneType
from typing import Any, Concatenate, Final, Literal, ParamSpec, TypedDict

import numpy as np
from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter, LogLocator, MaxNLocator, NullFormatter
from numpy.typing import ArrayLike

from linkwise.arrays import Floats
from linkwise.errors import StructureError, expect, require_known
from linkwise.model.structure import Link
from linkwise.output import atomic_file

_STYLE: Any = {
    "axes.axisbelow": True,
    "axes.grid": True,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "axes.titley": 1.0,  # else every drawing measures all ticks, to keep above those on top, which no figure has
    "figure.constrained_layout.use": True,
    "figure.dpi": 150,
    "font.size": 9,
    "grid.alpha": 0.35,
    "grid.linewidth": 0.5,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "lines.linewidth": 1.2,
    "svg.fonttype": "none",  # text stays text: to be searched, and it need not be drawn letter by letter
    "svg.hashsalt": "linkwise",  # the same figure is the same file
}
_CHARACTERS = 13  # of a title that fit into an inch
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@contextmanager
def sheet(
    rows: int = 1, columns: int = 1, *, width: float = 6.3, height: float = 3.6, share_time: bool = False
) -> Iterator[tuple[Figure, list[Axes]]]:
    """A new figure of `width` by `height` inches and its axes, row by row, in the style of this package.

    With `share_time` all axes keep one horizontal range, and only the lowest row is labelled.
    """
    with rc_context(_STYLE):
        figure = Figure(figsize=(width, height))
        yield figure, list(figure.subplots(rows, columns, squeeze=False, sharex=share_time).flat)


def pictures(
    draws: Sequence[Callable[..., Axes]],
    *,
    width: float = 6.3,
    height: tuple[float, float] = (0.0, 3.6),
    columns: int = 2,
    titles: Sequence[str] = (),
    title: str = "",
    outer: bool = False,
    legend_columns: int = 3,
) -> Figure:
    """A figure of pictures by ``draw(legend=False, ax=axes)``, row by row, with one legend below, unless that has no columns.

    `height` inches stand around all rows and are of each. `titles` stand in place of those of the pictures, a `title` above
    all; with `outer` only those at the left and at the bottom label their axes.
    """
    rows = -(-len(draws) // columns)
    with sheet(rows, columns, width=width, height=height[0] + height[1] * rows) as (figure, panels):
        shown = panels[: len(draws)]
        for axes, draw in zip(shown, draws, strict=True):
            draw(legend=False, ax=axes)
            if outer:
                axes.label_outer()
        for axes, text in zip(shown, titles, strict=False):
            axes.set_title(text)
        for axes in panels[len(draws) :]:
            axes.remove()
        if title:
            heading(figure, wrapped(title, width))
        if legend_columns:
            legend_below(figure, *shown, columns=legend_columns)
    return figure


def single(draw: Callable[..., Axes], *, height: float = 3.6) -> Figure:
    """A figure of one picture by ``draw(legend=False, ax=axes)``, with its legend below."""
    return pictures([draw], height=(0.0, height), columns=1)


def strips(
    draws: Sequence[Callable[..., Axes]],
    height: tuple[float, float],
    *,
    title: str = "",
    legend: bool = True,
    columns: int = 3,
) -> Figure:
    """A figure of strips with one horizontal axis, each by ``draw(ax=axes)``; `height` inches around all and of each.

    A `title` stands in place of those of the strips.
    """
    count = max(len(draws), 1)
    with sheet(count, height=height[0] + height[1] * count, share_time=True) as (figure, panels):
        for axes, draw in zip(panels, draws, strict=False):
            draw(ax=axes)
            axes.label_outer()
            if title:
                axes.set_title("")
        if title:
            wrap_title(panels[0], title)
        figure.align_ylabels()
        if legend:
            legend_below(figure, *panels, columns=columns)
    return figure


@contextmanager
def axes_for(
    ax: Axes | None, *, legend: bool = False, width: float = 6.3, height: float = 3.6
) -> Iterator[Axes]:
    """The Axes of the caller as they are, or those of a new figure in the style of this package.

    With `legend` they get one of what was drawn when the block ends.
    """
    expect("ax", ax, Axes, NoneType)
    with nullcontext((None, [ax])) if ax is not None else sheet(width=width, height=height) as (_, [axes]):
        yield axes
        if legend and axes.get_legend_handles_labels()[0]:
            axes.legend()


P = ParamSpec("P")
_KEYWORD = Parameter.KEYWORD_ONLY


class On(TypedDict, total=False):
    """Where a picture is drawn: on axes, by default those of a new figure, and whether they get a legend, which is usual."""

    legend: bool
    ax: Axes | None


def picture(
    *, width: float = 6.3, height: float = 3.6
) -> Callable[[Callable[Concatenate[Axes, P], None]], Callable[P, Axes]]:
    """A decorator that makes of what draws on axes, its first argument, a function with the keywords of `On`.

    It returns the axes; a new figure is of `width` by `height` inches.
    """

    def decorate(draw: Callable[Concatenate[Axes, P], None]) -> Callable[P, Axes]:
        own = list(signature(draw).parameters.values())[1:-1]
        where = {"legend": (True, "bool"), "ax": (None, "Axes | None")}
        keywords = [
            Parameter(key, _KEYWORD, default=usual, annotation=of) for key, (usual, of) in where.items()
        ]
        public = Signature([*own, *keywords], return_annotation="Axes")

        @wraps(draw)
        def drawn(*arguments: P.args, **keywords: P.kwargs) -> Axes:
            public.bind(*arguments, **keywords)  # a keyword that is none would be taken for one of `On`
            rest: Any = keywords
            with axes_for(
                rest.pop("ax", None), legend=rest.pop("legend", True), width=width, height=height
            ) as axes:
                draw(axes, *arguments, **rest)
            return axes

        vars(drawn)["__signature__"] = public
        return drawn

    return decorate


def place_of(kind: str, name: str | None, names: Sequence[str]) -> int:
    """The place of a name among all of its kind, the first without one; StructureError for one that is not there."""
    require_known(kind, names[0] if name is None else name, names, StructureError)
    return 0 if name is None else names.index(name)


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


def heading(figure: Figure, text: str, *, size: float = 10.0) -> None:
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
        axis.set_major_locator(ShownLocator())
        axis.set_minor_locator(ShownLocator(subs=range(2, 10), numticks=_FINELY_DIVIDED))
    else:
        change("symlog", linthresh=linear_to, linscale=0.6)
    axis.set_major_formatter(PowerFormatter(linthresh=linear_to))
    between = SparsePowerFormatter() if which == "x" else PowerFormatter()
    axis.set_minor_formatter(between if linear_to is None else NullFormatter())


_FINELY_DIVIDED = 3  # powers of ten on an axis up to which ticks stand between them


class ShownLocator(LogLocator):
    """Ticks at powers of ten or between them, without those beyond the axis, which cost as much as those that are seen."""

    def tick_values(self, vmin: float, vmax: float) -> Sequence[float]:
        """The places of the ticks from `vmin` to `vmax`."""
        low, high = vmin * (1.0 - 1e-9), vmax * (1.0 + 1e-9)
        return [place for place in super().tick_values(vmin, vmax) if low <= place <= high]


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


_STYLES = ("-", "--", ":", "-.")  # in this order once the colours are used up


def error_bars(
    axes: Axes, number: int, text: str, x: ArrayLike, y: ArrayLike, ends: ArrayLike | None
) -> None:
    """Draw values with bars, the curve of a `number` from 0 of several in one picture."""
    look: dict[str, Any] = {"marker": "o", "ms": 3.5, "lw": 1.0, "capsize": 2.0, "label": label(text)}
    line = _STYLES[number // len(SERIES) % len(_STYLES)]
    axes.errorbar(x, y, ends, color=SERIES[number % len(SERIES)], ls=line, **look)


def over_time(axes: Axes, time: Floats, name: str) -> None:
    """Set axes up for what is drawn over all of a time in s, and called by `name`."""
    axes.set(xlim=(time[0], time[-1]), xlabel="time, s", ylabel=name)
    axes.yaxis.set_major_locator(MaxNLocator(4))


def not_shown(names: Sequence[object], most: int, kind: str) -> str:
    """What a title adds where only the first `most` of the names are drawn."""
    return f" ({len(names) - most} more {kind} not shown)" if len(names) > most else ""


BELOW: Final = "outside lower center"  # where the legend of all panels of a figure stands


def legend_below(figure: Figure, *panels: Axes, columns: int = 3) -> None:
    """One legend below all panels that holds every label once."""
    named: dict[str, Artist] = {}
    for axes in panels:
        for handle, text in zip(*axes.get_legend_handles_labels(), strict=True):
            named.setdefault(text, handle)
    if named:
        figure.legend(list(named.values()), list(named), loc=BELOW, ncols=columns)


def encoded(figure: Figure, *formats: Literal["png", "svg"]) -> list[bytes]:
    """The figure as the contents of files of these formats, laid out once and drawn once for each.

    `Figure.savefig` would lay it out and draw it twice for each.
    """
    canvas, engine, dpi = figure.canvas, figure.get_layout_engine(), figure.dpi
    contents = []
    try:
        with rc_context(_STYLE), warnings.catch_warnings():
            # of each letter that no font has: the figure shows a box, and the page the name
            warnings.filterwarnings("ignore", "Glyph .* missing from font")
            raster = FigureCanvasAgg(figure)
            if engine is not None:
                engine.execute(figure)
                figure.set_layout_engine("none")
            for kind in formats:
                file = BytesIO()
                if kind == "png":
                    raster.print_png(  # type: ignore[no-untyped-call]
                        file, metadata={"Software": "linkwise"}, pil_kwargs={"compress_level": 3}
                    )
                else:
                    FigureCanvasSVG(figure).print_svg(  # type: ignore[no-untyped-call]
                        file, metadata={"Date": None, "Creator": "linkwise"}
                    )
                contents.append(file.getvalue())
    finally:
        figure.dpi = dpi  # an SVG file has points
        figure.set_layout_engine(engine)
        figure.set_canvas(canvas)
    return contents


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
    OutputError
        If a file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import linkwise as lw
    >>> from linkwise.plot.records import histories_figure
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=1.0, rate=1000.0)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     paths = lw.plot.save(histories_figure(record), Path(folder) / "motion")
    >>> [path.name for path in paths]
    ['motion.png', 'motion.svg']
    """
    folder, name = Path(stem).parent, Path(stem).name
    png, svg = folder / f"{name}.png", folder / f"{name}.svg"
    for path, content in zip((png, svg), encoded(figure, "png", "svg"), strict=True):
        with atomic_file(path) as partial:
            partial.write_bytes(content)
    return png, svg


# Okabe and Ito: told apart with any kind of colour vision, and in grey.
IDENTIFIED = "#0072B2"
TRUE = "#000000"
MEASURED = "#8C8C8C"
WELL = "#D55E00"
VISITED = "#E8EEF4"
CHAOS = "#F3EDE4"  # behind a motion that is one of many
SERIES = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00")

_PREFIXES = {3: "G", 2: "M", 1: "k", 0: "", -1: "m", -2: "µ", -3: "n"}


def scale(values: ArrayLike, unit: str) -> tuple[float, str]:
    """Factor and unit that bring the largest size of `values` (in `unit`) between 1 and 1000: (1000.0, "mm") for 0.02 m.

    Units that begin with a power or a quotient take the prefix on their first symbol, as in mm/s. Numbers without a unit, or
    whose unit is open ("?"), stay as they are.
    """
    if unit in ("", "?"):
        return 1.0, ""
    largest = float(np.nanmax(np.abs(values), initial=0.0))
    if not (largest > 0.0 and math.isfinite(largest)):
        return 1.0, unit
    thousands = min(3, max(-3, math.floor(math.log10(largest * (1 + 1e-12)) / 3)))
    return 1000.0**-thousands, _PREFIXES[thousands] + unit


def force_title(link: Link) -> str:
    """Name, ends and law of the link."""
    return f"{link.name} ({' – '.join(link.between)}):  {link.law.text}"


def envelope(time: Floats, values: Floats, points: int = 4000) -> tuple[Floats, Floats]:
    """`time` (N,) and `values` (N,) as at most about `points` points whose line covers the same pixels.

    Each block gives its least and its greatest value in order of time. A block that lacks all its samples gives NaN, so gaps
    stay gaps.
    """
    block = -(-len(time) // max(points // 2, 1))
    if block <= 2:
        return time, values
    count = -(-len(time) // block)
    padded = np.full(count * block, np.nan)
    padded[: len(values)] = values
    blocks = padded.reshape(count, block)
    least = np.where(np.isnan(blocks), np.inf, blocks).argmin(axis=1)
    greatest = np.where(np.isnan(blocks), -np.inf, blocks).argmax(axis=1)
    picked = np.sort(np.stack([least, greatest], axis=1), axis=1) + block * np.arange(count)[:, None]
    index = np.minimum(picked.ravel(), len(time) - 1)
    return time[index], values[index]


def scattered(count: int, points: int = 3000) -> slice:
    """Every k-th of `count` samples, so that about `points` are left; order and spread over time are kept."""
    return slice(None, None, max(1, -(-count // points)))
