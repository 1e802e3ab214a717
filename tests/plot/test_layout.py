"""Panels get the room that their texts leave: nothing is cut, nothing lies on something else."""

from collections.abc import Iterator
from itertools import combinations
from typing import Any

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox
from present import some

import linkwise as lw
from linkwise.plot.absorptions import crossings_figure, decay_figure, energy_figure, map_figure
from linkwise.plot.discoveries import evidence_figure, path_figure
from linkwise.plot.graphs import graph_figure
from linkwise.plot.links import force_figure
from linkwise.plot.records import histories_figure

PIXEL = 1.5  # what rounding of glyphs may add


def boxes(figure: Figure) -> Iterator[tuple[str, Bbox]]:
    """What each panel covers with its labels, what its legends and its title cover, in pixels."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # type: ignore[no-untyped-call]
    renderer = canvas.get_renderer()  # type: ignore[no-untyped-call]
    for number, axes in some(enumerate(figure.axes)):
        if axes.get_visible():
            covered = axes.get_tightbbox(renderer)
            assert covered is not None
            yield f"panel {number}", covered
    for legend in figure.legends:
        yield "legend", legend.get_window_extent(renderer)
    for text in figure.texts:
        yield text.get_text(), text.get_window_extent(renderer)


def faults(figure: Figure) -> list[str]:
    """What reaches beyond the figure, and pairs that lie on each other."""
    covered = list(boxes(figure))
    inside = figure.bbox.padded(PIXEL)
    cut = [
        name for name, box in covered
        if box.x0 < inside.x0 or box.y0 < inside.y0 or box.x1 > inside.x1 or box.y1 > inside.y1
    ]  # fmt: skip
    on = [
        f"{a} on {b}"
        for (a, first), (b, second) in combinations(covered, 2)
        if first.padded(-PIXEL).overlaps(second.padded(-PIXEL))
    ]
    return cut + on


@pytest.mark.slow
def test_figures_of_answers_have_no_faults(discovered: lw.Discovery, fitted: lw.Estimate) -> None:
    trial: dict[str, Any] = {"duration": 0.2, "rate": 500.0, "release": {"v:m1": 3.0}}
    over = {"nes1.alpha": [-150.0, -100.0], "nes1.beta": [5e5, 1e6]}
    figures = {
        "graph": graph_figure(discovered),
        "path": path_figure(discovered),
        "evidence": evidence_figure(discovered),
        "histories": histories_figure(fitted.record),
        "two panels": force_figure(fitted, "nes1"),
        "one panel": force_figure(fitted, "spring1"),
        "map": map_figure(lw.absorption.absorption_map(lw.bnes_chain(2), over, **trial)),
    }
    absorption = lw.absorb(lw.bnes_chain(8), **trial)
    for draw in (decay_figure, energy_figure, crossings_figure):
        figures[draw.__name__] = draw(absorption)
    assert {name: faults(figure) for name, figure in figures.items()} == {name: [] for name in figures}


def test_what_is_cut_or_covered_is_seen() -> None:
    """Beside the checks above, one that must find something."""
    figure = Figure()
    figure.subplots().set_ylabel("cut", labelpad=100.0)
    figure.suptitle("covered", y=0.5)
    assert faults(figure) == ["panel 0", "panel 0 on covered"]
