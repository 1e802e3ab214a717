"""A discovered structure as a graph: masses, ground and base, links by kind, stiffness and certainty.

Nodes are as far apart as there are links between them, as well as a plane allows: stress majorization (Gansner, Koren and
North 2004) from classical scaling.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import atan2, cos, hypot, log10, pi, sin
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, shortest_path

from linkwise.arrays import Floats
from linkwise.discovery.criterion import CERTAIN
from linkwise.discovery.result import Discovery, headline
from linkwise.model.link import GROUND
from linkwise.plot import style
from linkwise.plot.style import (
    BELOW,
    MEASURED,
    SERIES,
    TRUE,
    axes_for,
    axes_inches,
    label,
    literal,
    scale,
    sheet,
    wrapped,
)
from linkwise.verdict import Decision

_STEPS = 150
_ASIDE = 1e-3  # of a link, at random: how far nodes start off, so that none of them coincide
_GAP = 1.2  # between parts that nothing joins


@lru_cache(maxsize=8)  # a graph is laid out for its size, its lines and its legend
def node_positions(count: int, edges: tuple[tuple[int, int], ...]) -> Floats:
    """(count, 2) positions of the nodes 0 to count - 1, read-only; a link is about 1 long, the picture wider than high.

    Parts that no edge joins stand above each other. The same graph gives the same picture.
    """
    ends = np.array(edges, dtype=np.intp).reshape(-1, 2).T
    graph = csr_array((np.ones(len(edges)), tuple(ends)), shape=(count, count))
    distance = shortest_path(graph, directed=False, unweighted=True)
    parts, part_of = connected_components(graph, directed=False)
    positions, top = np.zeros((count, 2)), 0.0
    for part in range(parts):
        nodes = np.flatnonzero(part_of == part)
        placed = _horizontal(_stress_positions(distance[np.ix_(nodes, nodes)]))
        placed[:, 1] += top - placed[:, 1].min()
        positions[nodes] = placed
        top = float(placed[:, 1].max()) + _GAP
    positions.setflags(write=False)
    return positions


def _stress_positions(distance: Floats) -> Floats:
    """(n, 2) positions of nodes that are to be (n, n) apart: classical scaling, and stress majorization from there."""
    count = len(distance)
    centre = np.eye(count) - 1.0 / count
    sizes, axes = np.linalg.eigh(-0.5 * centre @ distance**2 @ centre)
    points = axes[:, -2:] * np.sqrt(np.maximum(sizes[-2:], 0.0))
    points = points + np.random.default_rng(0).normal(0.0, _ASIDE, (count, 2))
    weight = 1.0 / np.where(distance > 0.0, distance, np.inf) ** 2
    inverse = np.linalg.pinv(np.diag(weight.sum(axis=1)) - weight)
    for _ in range(_STEPS):
        apart = np.linalg.norm(points[:, None] - points[None], axis=2)
        pull = -weight * distance / np.where(apart > 0.0, apart, np.inf)
        np.fill_diagonal(pull, 0.0)
        np.fill_diagonal(pull, -pull.sum(axis=1))
        points = inverse @ (pull @ points)
    return np.asarray(points)


def _horizontal(points: Floats) -> Floats:
    """Turned so that the longest way goes from left to right, the lower node number leading."""
    centred = points - points.mean(axis=0)
    turned = centred @ np.linalg.svd(centred, full_matrices=False)[2].T if len(points) > 1 else centred
    signs = np.where(turned[0] > 0.0, -1.0, 1.0) * np.array([1.0, -1.0])
    return np.asarray(turned * signs)


_SPRINGS = ("linear", "bistable", "hardening", "softening")  # kinds of laws, see `potential_wells.law_kind`
_COLORS = dict(zip(_SPRINGS, SERIES, strict=False)) | {"damper only": MEASURED}
_OTHER_KIND = SERIES[5]
_HOST, _ROD = "#D0D7DE", 7.0  # colour and points of what joins the points of a host
_WIDTHS = (1.2, 4.2)  # points, of the softest and the stiffest link
_DASH, _LABEL_GAP = 7.0, 3.5  # points, of a link in doubt
_RADIUS = 0.19  # of a mass of mean size, where a link is 1 long
_SIXTH = 1.0 / 6.0  # of masses: over two decades the radius doubles
_SIZES = (0.7, 1.5)
_INCH = (0.4, 1.15)  # that a link may be long
_WIDEST, _HIGHEST = 10.0, 9.0
_LABELLED = 0.75  # inches of a link that has room for a word
_AMOUNTS = 0.6  # and of one beside whose masses there is room for their kilograms
_MARGIN = np.array([0.75, 0.5])  # around the outermost nodes
_FAINT = 12  # dropped links that are drawn
_CENTRED: dict[str, Any] = {"ha": "center", "va": "center"}


@dataclass(frozen=True)
class Edge:
    """A line from node to node in the drawing: masses come first, then a node for every end at the ground or the base.

    `selected` is False for a link that was dropped in doubt, `certain` says whether the link is there beyond doubt and
    `doubtful_term` whether one of its terms is not.
    """

    first: int
    second: int
    kind: str
    stiffness: float
    selected: bool
    certain: bool
    doubtful_term: bool


@dataclass(frozen=True)
class Drawing:
    """Edges, and `positions` (V, 2) of the nodes: `bodies`, which are masses and points of hosts, then ground or base.

    `fixed` says of each node behind the bodies which it is; `rods` are pairs of points of the same host.
    """

    bodies: Sequence[str]
    rods: Sequence[tuple[int, int]]
    edges: Sequence[Edge]
    fixed: Sequence[str]
    positions: Floats

    @property
    def corners(self) -> tuple[Floats, Floats]:
        """The lower left and the upper right corner (2,) of the picture."""
        return self.positions.min(axis=0) - _MARGIN, self.positions.max(axis=0) + _MARGIN


def graph(discovery: Discovery, *, legend: bool = True, ax: Axes | None = None) -> Axes:
    """Draw a discovered structure as a graph of masses and links.

    Colours tell the kinds of laws, stiffer links are wider, links in doubt dashed, links that were dropped in doubt dotted. A
    question mark says that a term of the link is in doubt. Ground and base are drawn wherever a link holds on to them.

    Parameters
    ----------
    discovery : Discovery
        An answer of `linkwise.discover`.
    legend : bool, default True
        Add a legend to the axes.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on; their limits are set and their frame is taken off. By default those of a new figure whose size
        fits the structure, which is ``ax.figure`` of the returned axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on. Their coordinates have no unit: a link is about 1 long.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=3.0, rate=1000.0).with_noise(30.0, seed=1)
    >>> found = lw.discover(record, {"m1": 1.0, "m2": 0.01})
    >>> ax = lw.plot.graph(found)
    >>> sorted(text.get_text() for text in ax.texts)
    ['1 kg', '10 g', 'bistable', 'linear', 'm1', 'm2']
    """
    drawing = _graph_drawing(discovery)
    width, height = _figure_size(drawing)
    with axes_for(ax, width=width, height=height) as axes:
        low, high = drawing.corners
        inch = _inches_per_link(drawing) if ax is None else float(min(axes_inches(axes) / (high - low)))
        axes.set_aspect("equal")
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
        axes.axis("off")
        _draw_links(axes, drawing, labelled=inch >= _LABELLED)
        for node, name in enumerate(drawing.fixed, start=len(drawing.bodies)):
            mass = next(edge.first for edge in drawing.edges if edge.second == node)
            title = "" if name == GROUND else name
            _draw_fixed(axes, drawing.positions[mass], drawing.positions[node], title)
        _draw_bodies(axes, discovery, drawing, inch)
        style.wrap_title(axes, headline(discovery)[0])
        if legend:
            axes.legend(handles=_legend_handles(drawing.edges))
    return axes


def graph_figure(discovery: Discovery) -> Figure:
    """The graph on a figure of its own, as large as the structure asks for."""
    width, height = _figure_size(_graph_drawing(discovery))
    with sheet(width=width, height=height) as (figure, [axes]):
        graph(discovery, legend=False, ax=axes)
        axes.set_title("")
        style.heading(figure, wrapped(headline(discovery)[0], width))
        handles = _legend_handles(_graph_drawing(discovery).edges)
        columns = max(1, min(len(handles), int(width / 1.35)))
        figure.legend(handles=handles, loc=BELOW, ncols=columns)
    return figure


def _graph_drawing(discovery: Discovery) -> Drawing:
    bodies, rods = _bodies_of(discovery)
    edges, fixed = _edges_of(discovery, bodies)
    lines = (*((edge.first, edge.second) for edge in edges), *rods)
    return Drawing(bodies, rods, edges, fixed, node_positions(len(bodies) + len(fixed), lines))


def _bodies_of(discovery: Discovery) -> tuple[list[str], list[tuple[int, int]]]:
    """Masses, and points of hosts that a link ends at, with the pairs of points that a host joins."""
    structure = discovery.structure
    ends = {end for link in structure.links for end in link.between}
    ends |= {end for between in _dropped_in_doubt(discovery) for end in between}
    names = [mass.name for mass in structure.masses if mass.name not in structure.modes]
    rods: list[tuple[int, int]] = []
    for host in structure.hosts:
        points = [point for point in host.points if point in ends] or list(host.points[:1])
        rods += [(len(names) + number, len(names) + number + 1) for number in range(len(points) - 1)]
        names += points
    return names, rods


def _edges_of(discovery: Discovery, bodies: Sequence[str]) -> tuple[list[Edge], list[str]]:
    """Links, then dropped links that are in doubt; and what each node behind the bodies is, ground or base."""
    index = {name: number for number, name in enumerate(bodies)}
    fixed: list[str] = []

    def nodes(between: tuple[str, str]) -> tuple[int, int]:
        masses = [index[end] for end in between if end in index]
        if len(masses) == 2:
            return masses[0], masses[1]
        fixed.append(next(end for end in between if end not in index))
        return masses[0], len(index) + len(fixed) - 1

    unsure = {term.link for term in discovery.kept if not term.certain}
    edges: list[Edge] = []
    for link in discovery.estimate.links:
        reach = max(abs(end) for end in link.d_range)
        name = link.link.name
        forces = np.abs(link.link.force(np.array([-reach, reach]), 0.0, link.link.zero_states))
        stiffness, certain = float(np.max(forces)) / reach, discovery.decision(name) is Decision.CERTAIN
        edges.append(Edge(*nodes(link.link.between), link.kind, stiffness, True, certain, name in unsure))
    for between in _dropped_in_doubt(discovery):
        edges.append(Edge(*nodes(between), "", 0.0, selected=False, certain=False, doubtful_term=True))
    return edges, fixed


def _dropped_in_doubt(discovery: Discovery) -> list[tuple[str, str]]:
    """Ends of the links that were dropped although a term of them is not beyond doubt, the most doubtful first."""
    linked = {frozenset(link.link.between) for link in discovery.estimate.links}
    dropped: list[tuple[str, str]] = []
    for term in discovery.doubtful:
        in_doubt = not term.kept and term.identifiable and term.margin <= CERTAIN
        if in_doubt and frozenset(term.between) not in linked and len(dropped) < _FAINT:
            linked.add(frozenset(term.between))
            dropped.append(term.between)
    return dropped


def _figure_size(drawing: Drawing) -> tuple[float, float]:
    """Width and height in inches of a figure that has room for the drawing, its title and its legend."""
    low, high = drawing.corners
    width, height = np.maximum((high - low) * _inches_per_link(drawing), (5.0, 1.3))
    return float(width), float(height) + 1.1


def _inches_per_link(drawing: Drawing) -> float:
    """How long a link of length 1 is drawn on a figure of its own."""
    low, high = drawing.corners
    span = high - low
    return float(np.clip(min(_WIDEST / span[0], _HIGHEST / span[1]), *_INCH))


def _radii(masses: Floats) -> Floats:
    """(n,) radii of masses in units of a link's length; those of points, whose mass is NaN, are the smallest."""
    known = masses[np.isfinite(masses)]
    mean = np.exp(np.mean(np.log(known))) if len(known) else 1.0
    relative = np.where(np.isfinite(masses), masses / mean, 0.0) ** _SIXTH
    return np.asarray(_RADIUS * np.clip(relative, *_SIZES))


def _draw_links(axes: Axes, drawing: Drawing, *, labelled: bool) -> None:
    for rod in drawing.rods:
        axes.plot(*drawing.positions[list(rod)].T, color=_HOST, lw=_ROD, solid_capstyle="round", zorder=0)
    stiffnesses = [edge.stiffness for edge in drawing.edges if edge.stiffness > 0.0]
    pairs = [frozenset((edge.first, edge.second)) for edge in drawing.edges]
    for number, edge in enumerate(drawing.edges):
        a, b = drawing.positions[edge.first], drawing.positions[edge.second]
        parallel = pairs.count(pairs[number])
        if parallel > 1:  # side by side
            aside = np.array([a[1] - b[1], b[0] - a[0]]) / max(hypot(*(b - a)), 1e-9)
            offset = 0.1 * (pairs[:number].count(pairs[number]) - 0.5 * (parallel - 1)) * aside
            a, b = a + offset, b + offset
        width = _edge_width(edge, stiffnesses)
        dashes = (0, (_DASH / width, _LABEL_GAP / width))  # matplotlib counts in line widths
        style = ":" if not edge.selected else "-" if edge.certain else dashes
        ends = np.stack([a, b], axis=1)
        axes.plot(*ends, color=_edge_color(edge), ls=style, lw=width, solid_capstyle="round", zorder=1)
        if labelled and edge.selected:
            x, y = 0.5 * (a + b)
            text = edge.kind.replace(" ", "\n") + ("?" if edge.doubtful_term else "")
            box = {"facecolor": "white", "edgecolor": "none", "pad": 0.8, "alpha": 0.85}
            axes.text(x, y, text, color=_edge_color(edge), fontsize=7, zorder=4, bbox=box, **_CENTRED)


def _edge_color(edge: Edge) -> str:
    return _COLORS.get(edge.kind, _OTHER_KIND) if edge.selected else MEASURED


def _edge_width(edge: Edge, stiffnesses: Sequence[float]) -> float:
    """Width in points: the wider, the stiffer, in equal steps a decade."""
    thin, thick = _WIDTHS
    if not (edge.selected and edge.stiffness > 0.0):
        return thin
    decades = log10(max(stiffnesses) / min(stiffnesses))
    share = log10(edge.stiffness / min(stiffnesses)) / decades if decades > 0.3 else 0.5
    return thin + (thick - thin) * share


def _draw_fixed(axes: Axes, mass: Floats, position: Floats, name: str) -> None:
    """The sign of a wall at `position`, across the link that comes from `mass`, with a `name` where it is not the ground."""
    along = (position - mass) / max(hypot(*(position - mass)), 1e-9)
    across = np.array([-along[1], along[0]])
    wall = np.stack([position - 0.2 * across, position + 0.2 * across], axis=1)
    axes.plot(*wall, color=TRUE, lw=1.6, zorder=2, solid_capstyle="butt")
    for share in np.linspace(-0.16, 0.2, 5):
        foot = position + share * across
        hatch = np.stack([foot, foot + 0.1 * along - 0.06 * across], axis=1)
        axes.plot(*hatch, color=TRUE, lw=0.7, zorder=2)
    if name:
        x, y = position + 0.26 * along
        axes.text(x, y, literal(name), fontsize=7, **_CENTRED)


def _draw_bodies(axes: Axes, discovery: Discovery, drawing: Drawing, inch: float) -> None:
    """Circles with names, and kilograms beside them where a link of `inch` inches leaves room; grey ones for points."""
    size, positions = float(np.clip(9.0 * inch, 4.5, 8.5)), drawing.positions
    kilograms = dict(zip(discovery.structure.mass_names, discovery.structure.mass_values, strict=True))
    masses = np.array([kilograms.get(name, np.nan) for name in drawing.bodies])
    radii = _radii(masses)
    for number, name in enumerate(drawing.bodies):
        x, y = positions[number]
        radius, is_mass = 72.0 * inch * radii[number], bool(np.isfinite(masses[number]))  # points
        inside = "white" if is_mass else _HOST
        axes.plot(x, y, "o", ms=2.0 * radius, color=inside, mec=TRUE, mew=1.2, zorder=5)
        fits = 0.3 * size * len(name) < 0.9 * radius
        if fits:
            axes.text(x, y, literal(name), fontsize=size, zorder=6, **_CENTRED)
        beside = [] if fits else [literal(name)]
        if inch >= _AMOUNTS and is_mass:
            turns = name in discovery.structure.rotations
            beside.append(f"{masses[number]:.3g} kg m²" if turns else _mass_text(float(masses[number])))
        angle = _free_direction(number, positions)
        reach, side = radii[number] + 0.13, cos(angle)
        aligned = "center" if abs(side) < 0.4 else "left" if side > 0.0 else "right"
        look: dict[str, Any] = {"color": "#57606A", "fontsize": max(size - 1.5, 4.0), "zorder": 6}
        x, y = x + reach * side, y + reach * sin(angle)
        axes.text(x, y, "\n".join(beside), **{**_CENTRED, "ha": aligned, **look})


def _mass_text(kilograms: float) -> str:
    """A mass as people write it: 10 g, 1.5 kg, 20 Mg."""
    factor, unit = (1.0, "kg") if 1.0 <= kilograms < 1000.0 else scale(1000.0 * kilograms, "g")
    return f"{kilograms * factor * (1.0 if unit == 'kg' else 1000.0):.3g} {unit}"


def _free_direction(number: int, positions: Floats) -> float:
    """The direction from a mass in which the nearest other nodes leave most room; up or down where that is free."""
    others = np.delete(positions, number, axis=0) - positions[number]
    angles = [atan2(y, x) for x, y in others[np.hypot(*others.T) < 1.8]]
    if not angles:
        return pi / 2.0

    def room(direction: float) -> float:
        return min(abs((direction - angle + pi) % (2.0 * pi) - pi) for angle in angles)

    upright = [direction for direction in (pi / 2.0, -pi / 2.0) if room(direction) > pi / 3.5]
    return upright[0] if upright else float(max(np.linspace(-pi, pi, 24, endpoint=False), key=room))


def _legend_handles(edges: Sequence[Edge]) -> list[Line2D]:
    colors = {edge.kind: _edge_color(edge) for edge in edges if edge.selected}
    handles = [Line2D([], [], color=color, lw=2.5, label=label(kind)) for kind, color in colors.items()]
    if any(edge.selected and not edge.certain for edge in edges):
        handles.append(Line2D([], [], color=TRUE, ls=(0, (4, 2.5)), label="in doubt"))
    if any(not edge.selected for edge in edges):
        handles.append(Line2D([], [], color=MEASURED, ls=":", label="dropped, in doubt"))
    handles.append(Line2D([], [], color="none", label="wider: stiffer"))
    return handles
