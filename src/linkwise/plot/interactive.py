"""The same pictures to look into: a figure of matplotlib as one of plotly, where a reader zooms and reads values off.

What is drawn with lines, markers, bands and spans has an interactive form, so that a figure is drawn by one function. plotly's
figures are plain data for its script; its Python package would check them at the cost of a second.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import ArrayLike

_PIXELS = 115  # of an inch of the figure's height
_POINT = 96 / 72  # pixels of a point
_GAP_X, _GAP_Y = 0.09, 0.15  # between columns; between rows, of all of them together
_DASHES = {"-": "solid", "--": "dash", ":": "dot", "-.": "dashdot"}
_MARKERS = {
    "o": "circle",
    ".": "circle",
    "s": "square",
    "D": "diamond",
    "^": "triangle-up",
    "v": "triangle-down",
    "x": "x",
}
_SMALL = 0.5  # of the size of a marker that matplotlib's point has
_LAYOUT: dict[str, Any] = {
    "font": {"family": "system-ui, sans-serif", "size": 13},
    "margin": {"l": 70, "r": 15, "t": 15, "b": 50},
    "legend": {"orientation": "h", "y": 1.0, "yanchor": "bottom"},
    "hoverlabel": {"namelength": -1},
}
_BESIDE = 6  # pixels between the labels of a vertical axis and its title
_HEADING = 30  # pixels that the heading of a panel is high, as a part of a height that margins are taken from
_CONFIG = {"displaylogo": False, "responsive": True, "toImageButtonOptions": {"format": "svg"}}


def interactive_html(figure: Figure, identifier: str) -> str:
    """`figure` as a part of a page that holds plotly's script; `identifier` is the id of its element.

    Raises TypeError for a figure with something that has no interactive form, such as an image.
    """
    content = to_plotly(figure)
    # JSON may stand in a script if nothing in it can be taken for the end of the script
    parts = [
        json.dumps(part, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
        for part in (identifier, content["data"], content["layout"], _CONFIG)
    ]
    height = content["layout"]["height"]
    return (
        f'<div id="{escape(identifier)}" class="plotly-graph-div" style="height:{height}px; width:100%;"></div>\n'
        f"<script>Plotly.newPlot({','.join(parts)})</script>"
    )


def to_plotly(figure: Figure) -> dict[str, Any]:
    """Traces ("data") and "layout" of plotly, as plain data, that show what `figure` shows.

    Raises TypeError for a figure with something that has no interactive form, such as an image.
    """
    panels = [axes for axes in figure.axes if axes.get_visible()]
    data: list[dict[str, Any]] = []
    shapes: list[dict[str, Any]] = []
    layout: dict[str, Any] = {**_LAYOUT, "height": round(_PIXELS * figure.get_figheight())}
    named: set[str] = set()
    for number, axes in enumerate(panels, start=1):
        suffix = "" if number == 1 else str(number)
        layout |= _axis_layouts(axes, suffix, panels)
        for artist in sorted(_drawn(axes), key=lambda drawn_artist: drawn_artist.get_zorder()):
            for part in _converted(artist, axes, suffix, named):
                (shapes if "type" in part and part["type"] in ("rect", "line") else data).append(part)
    layout["shapes"] = shapes
    if len(panels) > 1:
        headings = [_heading(axes) for axes in panels if _title(axes)]
        layout["annotations"] = headings
        if any(heading["y"] == 1.0 for heading in headings):  # which the legend must not cover
            layout["legend"] = {**_LAYOUT["legend"], "y": 1.0 + _HEADING / layout["height"]}
    return {"data": data, "layout": layout}


def _drawn(axes: Axes) -> list[Artist]:
    """The artists of the axes that show data."""
    drawn = [*axes.lines, *axes.collections, *axes.patches, *axes.images]
    return [artist for artist in drawn if artist.get_visible()]


def _converted(artist: Artist, axes: Axes, suffix: str, named: set[str]) -> list[dict[str, Any]]:
    """What plotly draws for one artist; `named` collects the labels that the legend has already."""
    name = str(artist.get_label())
    shown = bool(name) and not name.startswith("_")
    common = {
        "name": _text(name) if shown else "",
        "showlegend": shown and name not in named,
        "legendgroup": _text(name) if shown else "",
    }
    in_data = artist.get_transform().contains_branch_seperately(axes.transData)
    if shown:
        named.add(name)
    if isinstance(artist, Line2D) and all(in_data):
        return [{**common, **_trace(artist), **_ids(suffix)}]
    if isinstance(artist, Line2D) and artist.get_linestyle() in _DASHES:
        line = {"color": _color(artist.get_color()), "width": _POINT * artist.get_linewidth()}
        dash = _DASHES[str(artist.get_linestyle())]
        return [_shape(common, "line", artist.get_xydata(), in_data, suffix, line={**line, "dash": dash})]
    if isinstance(artist, PolyCollection):
        color = _color(artist.get_facecolor()[0])
        return [{**common, **_area(path.vertices, color), **_ids(suffix)} for path in artist.get_paths()]
    if isinstance(artist, Patch):
        corners = artist.get_path().transformed(artist.get_patch_transform()).vertices
        fill = {"fillcolor": _color(artist.get_facecolor()), "line": {"width": 0}, "layer": "below"}
        return [_shape(common, "rect", corners, in_data, suffix, **fill)]
    raise TypeError(f"a {type(artist).__name__} has no interactive form")


def _trace(line: Line2D) -> dict[str, Any]:
    """A line through data, or markers at them."""
    marker, style = line.get_marker(), line.get_linestyle()
    has_line, has_marker = style in _DASHES, marker in _MARKERS
    if not has_line and not has_marker:
        raise TypeError(f"a line with the marker {marker!r} has no interactive form")
    size = _POINT * line.get_markersize() * (_SMALL if marker == "." else 1.0)
    trace: dict[str, Any] = {
        "type": "scatter",
        "x": _numbers(line.get_xdata()),
        "y": _numbers(line.get_ydata()),
        "mode": "+".join(["lines"] * has_line + ["markers"] * has_marker),
        "opacity": 1.0 if line.get_alpha() is None else line.get_alpha(),
    }
    if has_line:
        width = _POINT * line.get_linewidth()
        trace["line"] = {"color": _color(line.get_color(), 1.0), "width": width, "dash": _DASHES[str(style)]}
    if has_marker:
        color = _color(line.get_markerfacecolor())
        trace["marker"] = {"color": color, "symbol": _MARKERS[str(marker)], "size": max(size, 2.0)}
    return trace


def _area(outline: ArrayLike, color: str) -> dict[str, Any]:
    points = np.asarray(outline)
    return {
        "type": "scatter",
        "x": _numbers(points[:, 0]),
        "y": _numbers(points[:, 1]),
        "mode": "lines",
        "fill": "toself",
        "fillcolor": color,
        "line": {"width": 0},
        "hoverinfo": "skip",
    }


def _shape(
    common: dict[str, Any], kind: str, corners: ArrayLike, in_data: Sequence[bool], suffix: str, **style: Any
) -> dict[str, Any]:
    """A line or a rectangle from corner to corner, each way either in data or in parts of the axes."""
    points = np.asarray(corners, dtype=float)
    (x0, y0), (x1, y1) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    refs = {
        f"{letter}ref": f"{letter}{suffix}" if data else f"{letter}{suffix} domain"
        for letter, data in zip("xy", in_data, strict=True)
    }
    return {**common, "type": kind, "x0": x0, "x1": x1, "y0": y0, "y1": y1, **refs, **style}


def _ids(suffix: str) -> dict[str, str]:
    return {"xaxis": f"x{suffix}", "yaxis": f"y{suffix}"}


def _axis_layouts(axes: Axes, suffix: str, panels: Sequence[Axes]) -> dict[str, Any]:
    """Where the axes stand, what they show, and with which of the panels before they zoom."""
    (left, right), (bottom, top) = _domains(axes)
    joined = axes.get_shared_x_axes().joined
    shared = next(panel for panel in panels if panel is axes or joined(axes, panel))
    number = panels.index(shared) + 1
    across: dict[str, Any] = {
        **_axis(axes.get_xlabel(), axes.get_xlim(), axes.get_xscale()),
        "domain": [left, right],
        "anchor": f"y{suffix}",
        "showticklabels": bool(axes.xaxis.get_tick_params().get("labelbottom", True)),
    }
    if shared is not axes:
        across["matches"] = "x" if number == 1 else f"x{number}"
    up: dict[str, Any] = {
        **_axis(axes.get_ylabel(), axes.get_ylim(), axes.get_yscale()),
        "domain": [bottom, top],
        "anchor": f"x{suffix}",
        "nticks": 6,
        "automargin": True,
    }
    up["title"]["standoff"] = _BESIDE
    return {f"xaxis{suffix}": across, f"yaxis{suffix}": up}


def _axis(text: str, limits: tuple[float, float], kind: str) -> dict[str, Any]:
    if kind not in ("linear", "log"):
        raise TypeError(f"a {kind} axis has no interactive form")
    ends = [float(end) for end in (np.log10(limits) if kind == "log" else limits)]
    exponents = {"exponentformat": "power"} if kind == "log" else {}
    return {"title": {"text": _text(text)}, "range": ends, "type": kind, "zeroline": False, **exponents}


def _domains(axes: Axes) -> tuple[tuple[float, float], tuple[float, float]]:
    """The parts of the picture, across and up, that the axes fill in their grid."""
    spec = axes.get_subplotspec()
    if spec is None:
        return (0.0, 1.0), (0.0, 1.0)
    rows, columns = spec.get_gridspec().get_geometry()
    row, column = spec.rowspan.start, spec.colspan.start
    width, height = (1.0 - _GAP_X * (columns - 1)) / columns, (1.0 - _GAP_Y * (rows > 1)) / rows
    gap_y = _GAP_Y / (rows - 1) if rows > 1 else 0.0
    left, top = column * (width + _GAP_X), 1.0 - row * (height + gap_y)
    return (left, min(left + width, 1.0)), (max(top - height, 0.0), top)


def _title(axes: Axes) -> str:
    return axes.get_title(loc="left") or axes.get_title()


def _heading(axes: Axes) -> dict[str, Any]:
    (left, _), (_, top) = _domains(axes)
    return {
        "text": _text(_title(axes)),
        "x": left,
        "y": top,
        "xref": "paper",
        "yref": "paper",
        "xanchor": "left",
        "yanchor": "bottom",
        "showarrow": False,
    }


def _text(text: str) -> str:
    """A label of matplotlib as plotly prints it: nothing in it is markup."""
    return escape(text.replace("\u200b", "").replace(r"\$", "$"), quote=False).replace("\n", "<br>")


def _color(color: Any, alpha: float | None = None) -> str:
    red, green, blue, opacity = to_rgba(color, alpha)
    return f"rgba({round(255 * red)},{round(255 * green)},{round(255 * blue)},{opacity:.3g})"


def _numbers(values: ArrayLike) -> list[float | None]:
    """Values to seven digits, None where there is a gap."""
    return [
        float(f"{value:.7g}") if np.isfinite(value) else None for value in np.asarray(values, dtype=float)
    ]
