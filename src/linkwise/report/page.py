"""What a command hands over in a folder: a document, data files, figures, and a page of sections from lists that it
keeps.

A new figure is one function and one line in such a list:

    SECTIONS = Registry("section", {..., "forces": figure_section("Forces", lambda fit: links.forces_figure(fit))})

It is then drawn once, saved as forces.png beside the page and shown on it. `linkwise.plot` loads matplotlib
when the figure is drawn.
Templates escape what they print and miss nothing silently.
"""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from markupsafe import Markup

from linkwise import __version__
from linkwise.display import JudgedView, format_duration, format_error
from linkwise.model.structure import Structure
from linkwise.model.structure_file import format_structure
from linkwise.output import RESULT, atomic_folder, to_json
from linkwise.progress import Progress, ProgressReport, part, silent
from linkwise.registry import lazy_module

if TYPE_CHECKING:
    import jinja2
    from jinja2 import Environment
    from matplotlib.figure import Figure

    from linkwise.plot import style
else:  # what draws and renders loads where a page is written: who wants the numbers alone does not wait for it
    style = lazy_module("linkwise.plot.style")
    jinja2 = lazy_module("jinja2")

_PIXELS = 96  # of a page in an inch of a figure
_PAGE = 1_200_000  # characters of figures on a page; further ones lie beside it
_ABOUT = re.compile(r"<metadata>.*?</metadata>|<style.*?</style>| xmlns(:\w+)?=\"[^\"]*\"", re.DOTALL)
"""What a page needs not of a picture: who made it, and where its format is defined."""
_PATH = re.compile(r' d="[^"]*"')
_FINE = re.compile(r"(?<=\.\d\d)\d+")
"""Thousandths of a point in paths."""

R = TypeVar("R")


@dataclass(frozen=True)
class Reported(Generic[R]):
    """A result that a page is about, with the true structure and the error of each link's force in % where they are known."""

    result: R
    truth: Structure | None = None
    nmse: Mapping[str, float | None] = field(default_factory=dict)


@dataclass(frozen=True)
class Section:
    """One heading: paragraphs of `text`, `items` of a list, `rows` of a table (the first are its titles) and a `figure`.

    A `folded` section opens on demand.
    """

    title: str
    text: Sequence[str] = ()
    items: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()
    figure: Callable[[], Figure] | None = None
    folded: bool = False


Build = Callable[[Reported[R]], Section | None]


def figure_section(title: str, draw: Callable[[R], Figure]) -> Build[R]:
    """A section that shows the figure that `draw` makes of a result, and nothing else."""
    return lambda reported: Section(title, figure=partial(draw, reported.result))


def sections_of(builders: Mapping[str, Build[R]], reported: Reported[R]) -> dict[str, Section]:
    """The sections of a page by name, in order; those that have nothing to say are left out."""
    built = {name: build(reported) for name, build in builders.items()}
    return {name: section for name, section in built.items() if section is not None}


def write_figures(
    sections: Mapping[str, Section], folder: Path, progress: Progress = silent
) -> dict[str, Markup]:
    """Draw the figures of the sections and save each as NAME.png in `folder`.

    Returns what a page shows of each, by the name of its section. `progress` is called with the fraction done.
    """
    drawn = [(name, section) for name, section in sections.items() if section.figure is not None]
    pictures: dict[str, Markup] = {}
    for name, section in drawn:
        progress(ProgressReport(len(pictures) / len(drawn), f"figure {name}"))
        left = _PAGE - sum(map(len, pictures.values()))
        pictures[name] = _picture(name, section, folder, left)
    return pictures


def _picture(name: str, section: Section, folder: Path, most: int) -> Markup:
    """What a page shows of the figure of a section, which is saved in `folder`: a picture of so many characters at `most`."""
    assert section.figure is not None
    figure = section.figure()
    png, svg = style.encoded(figure, "png", "svg")
    (folder / f"{name}.png").write_bytes(png)
    drawing, still = _ABOUT.sub("", svg.decode("utf-8").partition("<svg")[2]), embedded(png)
    drawing = _PATH.sub(lambda path: _FINE.sub("", path[0]), drawing)
    if min(len(drawing), len(still)) > most:
        return Markup('<p><a href="{0}">{0}</a></p>').format(f"{name}.png")
    if len(drawing) < len(still):
        return Markup('<svg role="img" aria-label="{}"').format(section.title) + Markup(drawing)
    width = round(_PIXELS * figure.get_figwidth())
    return Markup('<img src="{}" alt="{}" width="{}">').format(still, section.title, width)


def embedded(png: bytes) -> str:
    """The content of a PNG file as an address that holds it, for a page that needs nothing else."""
    return f"data:image/png;base64,{b64encode(png).decode('ascii')}"


@cache
def _templates() -> Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("linkwise", "report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"duration": format_duration, "two_digits": format_error}
    return environment


def rendered(template: str, **parts: Any) -> str:
    """The page that a template makes of its parts, with the version."""
    return _templates().get_template(template).render(parts, version=__version__)


@dataclass(frozen=True, kw_only=True)
class ResultFolder(Generic[R]):
    """One kind of result folder, for results of one type.

    `document` is what the JSON file `mark`, which marks the folder as one of this kind, says of a result: the key
    "method", and beside the true structure "nmse_percent" where one is given; the names of the files are added to it.
    `data` writes the files beside it, figures and page aside, into an empty folder. `sections` are those of the page, by the
    name of the files of their figures, and `page` the page as text, from them and the figures as `write_figures` returns them.
    `shown` is what is written of a result.
    """

    document: Callable[[R, Structure | None], dict[str, Any]]
    data: Callable[[Reported[R], Path], None]
    sections: Callable[[Reported[R]], Mapping[str, Section]]
    page: Callable[[Reported[R], Mapping[str, Section], Mapping[str, Markup]], str]
    mark: str = RESULT
    shown: Callable[[R], R] = lambda result: result

    def write(
        self,
        result: R,
        folder: str | Path,
        *,
        truth: Structure | None = None,
        progress: Progress = silent,
        pictured: bool = True,
    ) -> Path:
        """Write everything or nothing, figures and page only if `pictured`; returns the folder.

        An earlier result of this kind is replaced when the new one is complete. Raises OutputError for a folder that holds
        something else.
        """
        shown = self.shown(result)
        document = self.document(shown, truth)
        reported = Reported(shown, truth, document.get("nmse_percent", {}))
        with atomic_folder(Path(folder), self.mark) as partial:
            self.data(reported, partial)
            if pictured:
                sections = self.sections(reported)
                pictures = write_figures(sections, partial, part(progress, 0.0, 0.9))
                progress(ProgressReport(0.9, "page"))
                page = self.page(reported, sections, pictures)
                (partial / "report.html").write_text(page, encoding="utf-8")
            files = sorted(path.name for path in partial.iterdir())
            text = to_json({**document, "files": files}, indent=1) + "\n"
            (partial / self.mark).write_text(text, encoding="utf-8")
        return Path(folder)


def section_page(
    result: JudgedView,
    sections: Mapping[str, Section],
    pictures: Mapping[str, Markup],
    *,
    verdict: Sequence[str],
    structure: Structure | None = None,
    findings: Sequence[str] = (),
    title: str = "",
) -> str:
    """The page as text, HTML that carries everything in itself.

    The first line of `verdict` is its headline, `findings` is what the result does not determine, and `pictures` are those
    that `write_figures` returned for the sections. The title is the name of the structure unless it is given.
    """
    return rendered(
        "section_page.html.jinja",
        title=title or (structure and structure.name) or "structure",
        verdict=verdict,
        trusted=result.trusted,
        findings=findings,
        sections=sections,
        pictures=pictures,
        structure="" if structure is None else format_structure(structure),
    )
