"""What a command hands over in a folder: a document, data files, figures, and a page, all of it or nothing.

A new figure is one function that makes a `Section` of a result. It is then drawn once, saved as forces.png beside the page
and shown on it. `linkwise.plot` loads matplotlib when the figure is drawn.
"""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from markupsafe import Markup

from linkwise import __version__
from linkwise.display import to_csv
from linkwise.errors import expect, wrong_type
from linkwise.model.structure import Structure
from linkwise.model.structure_file import format_structure
from linkwise.output import RESULT, atomic_folder, to_json
from linkwise.progress import Progress, ProgressReport, part, silent
from linkwise.registry import Registry, lazy_module
from linkwise.verdict import Basis

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from linkwise.plot import style
    from linkwise.report import truth as truths
else:  # what draws and renders loads where a page is written: who wants the numbers alone does not wait for it
    style = lazy_module("linkwise.plot.style")
    truths = lazy_module("linkwise.report.truth")

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


def write_figures(
    sections: Mapping[str, Section], folder: Path, progress: Progress = silent
) -> dict[str, Markup]:
    """Draw the figures of the sections and save each as NAME.png in `folder`.

    Returns what a page shows of each, by the name of its section. `progress` is called with the fraction done.
    """
    drawn = {name: (section.title, section.figure) for name, section in sections.items() if section.figure}
    pictures: dict[str, Markup] = {}
    for name, (title, draw) in drawn.items():
        progress(ProgressReport(len(pictures) / len(drawn), f"figure {name}"))
        figure = draw()
        png, svg = style.encoded(figure, "png", "svg")
        (folder / f"{name}.png").write_bytes(png)
        picture = embedded(png, svg, title, figure.get_figwidth())
        if len(picture) > _PAGE - sum(map(len, pictures.values())):
            picture = Markup('<p><a href="{0}">{0}</a></p>').format(f"{name}.png")
        pictures[name] = picture
    return pictures


def embedded(png: bytes, svg: bytes, title: str, width: float) -> Markup:
    """A figure of this width in inches as a part of a page that needs nothing else: the smaller of drawing and pixels."""
    drawing = _ABOUT.sub("", svg.decode("utf-8").partition("<svg")[2])
    drawing = _PATH.sub(lambda path: _FINE.sub("", path[0]), drawing)
    still = f"data:image/png;base64,{b64encode(png).decode('ascii')}"
    if len(drawing) < len(still):
        return Markup('<svg role="img" aria-label="{}"').format(title) + Markup(drawing)
    return Markup('<img src="{}" alt="{}" width="{}">').format(still, title, round(_PIXELS * width))


def _document(result: Any, truth: Structure | None) -> dict[str, Any]:
    """What a result says of itself, and beside a true structure; and the version."""
    beside = {} if truth is None else truths.compared(result, truth)
    return {**result.to_dict(), "version": __version__, **beside}


@dataclass(frozen=True, kw_only=True)
class ResultFolder(Generic[R]):
    """One kind of result folder, for results of one type.

    The JSON file `mark`, which marks the folder as one of this kind, holds `result_of` a result and the names of the files.
    `data` writes the files beside it, figures and page aside, into an empty folder. `sections` are those of the page, by the
    name of the files of their figures, and `page` the page as text, from them and the figures as `write_figures` returns them.
    `shown` is what is written of a result.
    """

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
        document = _document(shown, truth)
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


def write_graded(structure: Structure, basis: Basis, folder: Path) -> None:
    """Write structure.toml, which states the grade of the answer that its numbers are of."""
    text = basis.comment + format_structure(structure)
    (folder / "structure.toml").write_text(text, encoding="utf-8", newline="\n")


def csv_table(path: Path, head: Iterable[str], rows: Iterable[Iterable[object]]) -> None:
    """A table as CSV, its numbers with ten digits."""
    to_csv(path, [head, *rows], numbers=".10g")


FOLDERS: Registry[ResultFolder[Any]] = Registry(
    "result",
    {
        "Absorption": "linkwise.report.absorption:ABSORPTION_FOLDER",
        "AbsorptionIntervals": "linkwise.report.absorption:ABSORPTION_FOLDER",
        "AbsorptionMap": "linkwise.report.absorption:MAP_FOLDER",
        "Backbone": "linkwise.report.response:BACKBONE_FOLDER",
        "Basins": "linkwise.report.response:BASINS_FOLDER",
        "Comparison": "linkwise.report.estimate:COMPARISON_FOLDER",
        "Design": "linkwise.report.absorption:DESIGN_FOLDER",
        "Discovery": "linkwise.report.discovery:DISCOVERY_FOLDER",
        "Estimate": "linkwise.report.estimate:ESTIMATE_FOLDER",
        "Inspection": "linkwise.report.inspection:INSPECTION_FOLDER",
        "Response": "linkwise.report.response:RESPONSE_FOLDER",
        "Validation": "linkwise.report.validation:VALIDATION_FOLDER",
    },
)
"""The folder of a result by its type, loaded when one is written."""


def _require_result(result: object, call: str) -> None:
    """ArgumentTypeError, which names the `call`, for what no folder holds."""
    if type(result).__name__ not in FOLDERS:
        raise wrong_type(f"{call}: result", result, list(FOLDERS))


def result_of(result: Any, truth: Structure | None = None) -> dict[str, Any]:
    """Return as plain data what the JSON file of a result's folder holds.

    Parameters
    ----------
    result : Estimate, Discovery, Absorption, Design, Response, Backbone, Basins, Validation, Inspection, ...
        What `identify`, `discover`, `absorb`, `design`, `respond`, `backbone`, `validate` or `inspect` returned.
    truth : Structure, optional
        The true structure beside an estimate or a discovery, which adds "nmse_percent": the NMSE of the force of each link in
        % (paper Eq. 8), None where the record does not determine it; beside a discovery also "truth": "right", "missing",
        "extra", "missing_links" and "extra_links".

    Returns
    -------
    dict
        The result as plain data, and the version of linkwise.

    Raises
    ------
    StructureError
        If the true structure lacks a link, or has other masses.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=2.0, rate=1000.0).with_noise(30.0, seed=1)
    >>> result = lw.report.result_of(lw.identify(record, chain.unknown("nes"), method="weak"), chain)
    >>> result["status"], result["nmse_percent"]["nes1"] < 1.0
    ('converged', True)
    >>> result = lw.report.result_of(lw.respond(chain, force={"m1": 0.1}, hz=(29.0, 31.0), starts=0))
    >>> sorted(result["levels"][0])
    ['branches', 'folds_hz', 'force', 'irregular']
    """
    _require_result(result, "result_of(result, truth)")
    return _document(result, truth)


def write_result(
    result: Any, folder: str | Path, *, truth: Structure | None = None, progress: Progress = silent
) -> Path:
    """Write a result into a folder: its numbers as JSON and CSV files, figures, and a page, report.html.

    The numbers of an estimate are result.json, structure.toml, force_NAME.csv and, of one that can be trusted,
    covariance.csv; where it has an `alternative`, alternative.toml is the structure with unknowns that asks for it. A
    discovery has terms.csv beside these. The JSON file of other results has the name of the question, as absorption.json.

    Parameters
    ----------
    result : Estimate, Discovery, Absorption, Design, Response, Backbone, Basins, Validation, Inspection, ...
        What `identify`, `discover`, `absorb`, `design`, `respond`, `backbone`, `validate` or `inspect` returned.
    folder : path-like
        The folder. An earlier result of this kind in it is replaced when the new one is complete.
    truth : Structure, optional
        The true structure beside an estimate or a discovery: its forces are added to the figures, and the NMSE of the forces
        and the terms that are right to the numbers.
    progress : Progress
        Called with a `ProgressReport` before each figure.

    Returns
    -------
    pathlib.Path
        The folder.

    Raises
    ------
    OutputError
        If the folder holds something else, or cannot be written; then nothing is changed.
    StructureError
        If `truth` lacks a link, or has other masses.

    Examples
    --------
    >>> import tempfile
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=1.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> fit = lw.identify(record, chain.unknown("nes"), method="weak")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     written = lw.report.write_result(fit, f"{folder}/answer")
    ...     names = [path.name for path in written.iterdir()]
    >>> sorted(name for name in names if name.endswith((".json", ".html", ".toml")))
    ['report.html', 'result.json', 'structure.toml']
    """
    call = "write_result(result, folder)"
    _require_result(result, call)
    expect(f"{call}: folder", folder, str, Path)
    return FOLDERS[type(result).__name__].write(result, folder, truth=truth, progress=progress)
