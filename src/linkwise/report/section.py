"""What a page consists of: sections with text, tables and figures, from lists that a page keeps.

A new figure is one function and one line in such a list:

    SECTIONS = Registry("section", {..., "forces": figure_section("Forces", lambda fit: plot.forces_figure(fit))})

It is then drawn once, saved as forces.png and forces.svg beside the page and shown on it. `linkwise.plot` loads matplotlib
when the figure is drawn, which another process may do.
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Generic, TypeVar

from markupsafe import Markup

from linkwise.model.structure import Structure
from linkwise.progress import Progress, ProgressReport, silent
from linkwise.registry import lazy_module
from linkwise.report.drawing_process import DrawingProcess, Picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from linkwise.plot import interactive, style
else:  # matplotlib loads where a figure is drawn, which may be another process
    interactive = lazy_module("linkwise.plot.interactive")
    style = lazy_module("linkwise.plot.style")

_FEW = 4  # figures: loading matplotlib in a second process, too, takes as long as drawing so many

R = TypeVar("R")
T = TypeVar("T")


@dataclass(frozen=True)
class Reported(Generic[R]):
    """A result that a page is about, with the true structure and the error of each link's force in % where they are known."""

    result: R
    truth: Structure | None = None
    nmse: Mapping[str, float | None] = field(default_factory=dict)

    def replaced(self, result: T) -> Reported[T]:
        """The same with another result."""
        return Reported(result, self.truth, self.nmse)


@dataclass(frozen=True)
class Section:
    """One heading: paragraphs of `text`, `items` of a list, `rows` of a table (the first are its titles) and a `figure`.

    The figure is shown as a picture, or `interactive`: to zoom and read values off. A `folded` section opens on demand.
    """

    title: str
    text: Sequence[str] = ()
    items: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()
    figure: Callable[[], Figure] | None = None
    interactive: bool = False
    folded: bool = False


Build = Callable[[Reported[R]], Section | None]


def figure_section(title: str, draw: Callable[[R], Figure], *, interactive: bool = False) -> Build[R]:
    """A section that shows the figure that `draw` makes of a result, and nothing else."""
    return lambda reported: Section(title, figure=partial(draw, reported.result), interactive=interactive)


def sections_of(builders: Mapping[str, Build[R]], reported: Reported[R]) -> dict[str, Section]:
    """The sections of a page by name, in order; those that have nothing to say are left out."""
    built = {name: build(reported) for name, build in builders.items()}
    return {name: section for name, section in built.items() if section is not None}


def write_figures(
    sections: Mapping[str, Section],
    folder: Path,
    progress: Progress = silent,
    process: DrawingProcess | None = None,
) -> dict[str, Markup]:
    """Draw the figures of the sections and save each as NAME.png and NAME.svg in `folder`.

    Returns what a page shows of each, by the name of its section. `progress` is called with the fraction done. Where a
    `process` draws the same figures from the first one on, this one draws what that leaves over and, of many, from the last
    one on.
    """
    draws = drawings(sections)
    pictures: dict[str, Picture] = {}

    def draw(name: str) -> None:
        progress(ProgressReport(len(pictures) / len(draws), f"figure {name}"))
        pictures[name] = draws[name]()

    if process is not None:
        for name in reversed(draws if len(draws) > _FEW else ()):
            if process.claim(name):
                draw(name)
        pictures |= {name: picture for name, picture in process.pictures().items() if name in draws}
    for name in draws:
        if name not in pictures:
            draw(name)
        (folder / f"{name}.png").write_bytes(pictures[name].png)
        (folder / f"{name}.svg").write_bytes(pictures[name].svg)
    return {name: Markup(pictures[name].html) for name in draws}


def drawings(sections: Mapping[str, Section]) -> dict[str, Callable[[], Picture]]:
    """What draws the figures of the sections, by name; nothing is drawn yet."""
    return {
        name: partial(_picture, name, section)
        for name, section in sections.items()
        if section.figure is not None
    }


def _picture(name: str, section: Section) -> Picture:
    assert section.figure is not None
    figure = section.figure()
    png, svg = style.encoded(figure)
    if section.interactive:
        return Picture(png, svg, interactive.interactive_html(figure, name))
    image = Markup('<img src="{}" alt="{}">').format(embedded(svg), section.title)
    return Picture(png, svg, str(image))


def embedded(svg: bytes) -> str:
    """The content of an SVG file as an address that holds it, for a page that needs nothing else."""
    return f"data:image/svg+xml;base64,{b64encode(svg).decode('ascii')}"
