"""A discovered structure as a graph: masses, what holds them, links by kind, stiffness and certainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import atan2, cos, hypot, log10, pi, sin
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from linkwise.analysis.law_kind import BISTABLE, DAMPER, HARDENING, LINEAR, SOFTENING
from linkwise.arrays import Floats
from linkwise.discovery.result import CERTAIN, Discovery
from linkwise.discovery.text import headline
from linkwise.plot.graph_layout import places
from linkwise.plot.palette import SEEN, SERIES, TRUE, scale
from linkwise.plot.style import sheet
from linkwise.verdict import Decision

_COLORS = dict(zip((LINEAR, BISTABLE, HARDENING, SOFTENING), SERIES, strict=False)) | {DAMPER: SEEN}
_OTHER = SERIES[5]
_WIDTHS = (1.2, 4.2)  # points, of the softest and the stiffest link
_DASH, _GAP = 7.0, 3.5  # points, of a link in doubt
_RADIUS = 0.19  # of a mass of mean size, where a link is 1 long
_SIXTH = 1.0 / 6.0  # of masses: over two decades the radius doubles
_SIZES = (0.7, 1.5)
_INCH = (0.4, 1.15)  # that a link may be long
_WIDEST, _HIGHEST = 10.0, 9.0
_LABELLED = 0.75  # inches of a link that has room for a word
_AMOUNTS = 0.6  # and of one beside whose masses there is room for their kilograms
_MARGIN = np.array([0.75, 0.5])  # around the outermost nodes
_FAINT = 12  # dropped links that are drawn


@dataclass(frozen=True)
class Edge:
    """A line from node to node in the drawing; masses come first, then one node for each thing that holds."""

    first: int
    second: int
    kind: str
    stiffness: float
    certain: bool
    there: bool
    doubt: bool  # about some term of it


def graph_figure(found: Discovery) -> Figure:
    """The structure drawn: stiffer links wider, links in doubt dashed, links that were dropped in doubt dotted.

    The ground and the base are drawn wherever a link holds on to them. Kinds of laws stand beside the links where there is
    room, and in the legend.
    """
    names = [mass.name for mass in found.structure.masses]
    edges, held = _edges(found, names)
    points = places(len(names) + len(held), [(edge.first, edge.second) for edge in edges])
    inch = _inches(points)
    low, high = points.min(axis=0) - _MARGIN, points.max(axis=0) + _MARGIN
    width, height = np.maximum((high - low) * inch, (5.0, 1.3))
    with sheet(width=float(width), height=float(height) + 1.1) as (figure, [axes]):
        axes.set_aspect("equal")
        axes.set_xlim(low[0], high[0])
        axes.set_ylim(low[1], high[1])
        axes.axis("off")
        radii = _radii(found)
        _draw_links(axes, edges, points, labelled=inch >= _LABELLED)
        for place, what in enumerate(held, start=len(names)):
            edge = next(each for each in edges if each.second == place)
            _draw_hold(axes, points[edge.first], points[place], "" if what == "ground" else what)
        _draw_masses(axes, found, points, radii, inch)
        figure.suptitle(
            fill(headline(found)[0], int(13 * width)), x=0.01, horizontalalignment="left", fontsize=10
        )
        handles = _legend(edges)
        figure.legend(
            handles=handles, loc="outside lower center", ncols=max(1, min(len(handles), int(width / 1.35)))
        )
    return figure


def _edges(found: Discovery, names: Sequence[str]) -> tuple[list[Edge], list[str]]:
    """Links, then dropped links that are not beyond doubt; and what each node behind the masses is, "ground" or "base"."""
    index = {name: number for number, name in enumerate(names)}
    held: list[str] = []
    edges: list[Edge] = []

    def ends(between: tuple[str, str]) -> tuple[int, int]:
        inside = [index[end] for end in between if end in index]
        if len(inside) == 2:
            return inside[0], inside[1]
        held.append(next(end for end in between if end not in index))
        return inside[0], len(names) + len(held) - 1

    unsure = {term.link for term in found.kept if not term.certain}
    for each in found.estimate.links:
        link = each.link
        reach = max(abs(end) for end in each.d_range)
        stiffness = max(abs(float(link.force(side))) for side in (-reach, reach)) / reach
        certain = found.decision(link.name) is Decision.CERTAIN
        edges.append(Edge(*ends(link.between), each.kind, stiffness, certain, True, link.name in unsure))
    linked = {frozenset(each.link.between) for each in found.estimate.links}
    faint: list[tuple[str, str]] = []
    for term in found.doubtful:
        pair = frozenset(term.between)
        if (
            not term.kept
            and term.identifiable
            and term.margin <= CERTAIN
            and pair not in linked
            and len(faint) < _FAINT
        ):
            linked.add(pair)
            faint.append(term.between)
    edges += [Edge(*ends(between), "", 0.0, False, False, True) for between in faint]
    return edges, held


def _inches(points: Floats) -> float:
    """How long a link of length 1 is drawn."""
    span = points.max(axis=0) - points.min(axis=0) + 2.0 * _MARGIN
    return float(np.clip(min(_WIDEST / span[0], _HIGHEST / span[1]), *_INCH))


def _radii(found: Discovery) -> Floats:
    masses = found.structure.mass_values
    relative = (masses / np.exp(np.mean(np.log(masses)))) ** _SIXTH
    return np.asarray(_RADIUS * np.clip(relative, *_SIZES))


def _draw_links(axes: Axes, edges: Sequence[Edge], points: Floats, *, labelled: bool) -> None:
    stiff = [edge.stiffness for edge in edges if edge.stiffness > 0.0]
    pairs = [frozenset((edge.first, edge.second)) for edge in edges]
    for number, edge in enumerate(edges):
        a, b = points[edge.first], points[edge.second]
        same = pairs.count(pairs[number])
        if same > 1:  # side by side
            aside = np.array([a[1] - b[1], b[0] - a[0]]) / max(hypot(*(b - a)), 1e-9)
            offset = 0.1 * (pairs[:number].count(pairs[number]) - 0.5 * (same - 1)) * aside
            a, b = a + offset, b + offset
        width = _width(edge, stiff)
        dashes = (
            0,
            (_DASH / width, _GAP / width),
        )  # matplotlib counts in widths; a stiff link would fall apart
        style = ":" if not edge.there else "-" if edge.certain else dashes
        axes.plot(
            *np.stack([a, b], axis=1), color=_color(edge), linestyle=style, linewidth=width, solid_capstyle="round", zorder=1,
        )  # fmt: skip
        if labelled and edge.there:
            x, y = 0.5 * (a + b)
            word = edge.kind.replace(" ", "\n") + ("?" if edge.doubt else "")
            axes.text(
                x, y, word, color=_color(edge), fontsize=7, ha="center", va="center", zorder=4,
                bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.8, "alpha": 0.85},
            )  # fmt: skip


def _color(edge: Edge) -> str:
    return _COLORS.get(edge.kind, _OTHER) if edge.there else SEEN


def _width(edge: Edge, stiff: Sequence[float]) -> float:
    thin, thick = _WIDTHS
    if not (edge.there and edge.stiffness > 0.0):
        return thin
    decades = log10(max(stiff) / min(stiff))
    share = log10(edge.stiffness / min(stiff)) / decades if decades > 0.3 else 0.5
    return thin + (thick - thin) * share


def _draw_hold(axes: Axes, mass: Floats, place: Floats, name: str) -> None:
    """The sign of a wall at `place`, across the link that comes from `mass`."""
    along = (place - mass) / max(hypot(*(place - mass)), 1e-9)
    across = np.array([-along[1], along[0]])
    wall = np.stack([place - 0.2 * across, place + 0.2 * across], axis=1)
    axes.plot(*wall, color=TRUE, linewidth=1.6, zorder=2, solid_capstyle="butt")
    for share in np.linspace(-0.16, 0.2, 5):
        foot = place + share * across
        axes.plot(
            *np.stack([foot, foot + 0.1 * along - 0.06 * across], axis=1), color=TRUE, linewidth=0.7, zorder=2
        )
    if name:
        x, y = place + 0.26 * along
        axes.text(x, y, name, fontsize=7, ha="center", va="center")


def _draw_masses(axes: Axes, found: Discovery, points: Floats, radii: Floats, inch: float) -> None:
    size = float(np.clip(9.0 * inch, 4.5, 8.5))
    for number, mass in enumerate(found.structure.masses):
        x, y = points[number]
        radius = 72.0 * inch * radii[number]  # points
        axes.plot(
            x, y, "o", ms=2.0 * radius, color="white", markeredgecolor=TRUE, markeredgewidth=1.2, zorder=5
        )
        fits = 0.3 * size * len(mass.name) < 0.9 * radius
        if fits:
            axes.text(x, y, mass.name, fontsize=size, ha="center", va="center", zorder=6)
        aside = [] if fits else [mass.name]
        if inch >= _AMOUNTS:
            aside.append(_amount(float(found.structure.mass_values[number])))
        angle = _free(number, points)
        reach, side = radii[number] + 0.13, cos(angle)
        axes.text(
            x + reach * side, y + reach * sin(angle), "\n".join(aside), color="#57606A", fontsize=max(size - 1.5, 4.0),
            ha="center" if abs(side) < 0.4 else "left" if side > 0.0 else "right", va="center", zorder=6,
        )  # fmt: skip


def _amount(kilograms: float) -> str:
    """A mass as people write it: 10 g, 1.5 kg, 20 Mg."""
    factor, unit = (1.0, "kg") if 1.0 <= kilograms < 1000.0 else scale(1000.0 * kilograms, "g")
    return f"{kilograms * factor * (1.0 if unit == 'kg' else 1000.0):.3g} {unit}"


def _free(number: int, points: Floats) -> float:
    """The direction from a mass in which the nearest other nodes leave most room; up or down where that is free."""
    others = np.delete(points, number, axis=0) - points[number]
    angles = [atan2(y, x) for x, y in others[np.hypot(*others.T) < 1.8]]
    if not angles:
        return pi / 2.0

    def room(angle: float) -> float:
        return min(abs((angle - each + pi) % (2.0 * pi) - pi) for each in angles)

    upright = [angle for angle in (pi / 2.0, -pi / 2.0) if room(angle) > pi / 3.5]
    return upright[0] if upright else float(max(np.linspace(-pi, pi, 24, endpoint=False), key=room))


def _legend(edges: Sequence[Edge]) -> list[Line2D]:
    kinds = dict.fromkeys(edge.kind for edge in edges if edge.there)
    handles = [Line2D([], [], color=_COLORS.get(kind, _OTHER), linewidth=2.5, label=kind) for kind in kinds]
    if any(edge.there and not edge.certain for edge in edges):
        handles.append(Line2D([], [], color=TRUE, linestyle=(0, (4, 2.5)), label="in doubt"))
    if any(not edge.there for edge in edges):
        handles.append(Line2D([], [], color=SEEN, linestyle=":", label="dropped, in doubt"))
    handles.append(Line2D([], [], color="none", label="wider: stiffer"))
    return handles
