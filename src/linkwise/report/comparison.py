"""The result folder of `compare`: comparison.json, the structure of maximum likelihood, a figure of forces and a page."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from markupsafe import Markup

from linkwise import __version__
from linkwise.estimates.estimate import grade_comment
from linkwise.identification.compare import Comparison
from linkwise.model.structure_file import format_structure
from linkwise.output import COMPARISON
from linkwise.registry import Registry, lazy_module
from linkwise.report.page import Build, Reported, ResultFolder, Section, section_page, sections_of

if TYPE_CHECKING:
    from linkwise.plot import links as link_figures
else:  # matplotlib loads where a figure is drawn
    link_figures = lazy_module("linkwise.plot.links")


def _table(reported: Reported[Comparison]) -> Section:
    return Section(
        "Side by side",
        [
            "Maximum likelihood (ml) fits the raw samples, the weak form integrates the equations against test functions, and "
            "sindy is the sparse regression of the paper on differentiated signals. A free run starts from the first samples "
            "and follows the inputs alone, or from those of windows where the motion is chaotic; its error is a root mean "
            "square in % of the deviation of the channel, of which noise alone leaves a part."
        ],
        items=reported.result.findings,
        rows=reported.result.rows,
    )


def _forces(reported: Reported[Comparison]) -> Section:
    return Section(
        "Forces",
        [
            "Over the motion of the record, and less the force by maximum likelihood, of which the band is the 95 % interval."
        ],
        figure=lambda: link_figures.comparison_figure(reported.result),
    )


SECTIONS: Registry[Build[Comparison]] = Registry("section", {"table": _table, "forces": _forces})
"""The sections of a comparison, in order; the name of a section is that of its figure's files."""


def comparison_page(
    reported: Reported[Comparison], sections: Mapping[str, Section], pictures: Mapping[str, Markup]
) -> str:
    """The page as text; `pictures` are those of `write_figures`."""
    result = reported.result
    return section_page(result, sections, pictures, verdict=result.head, structure=result.best.structure)


def _write_data(reported: Reported[Comparison], folder: Path) -> None:
    """The structure that maximum likelihood identified, which states its grade."""
    best = reported.result.best
    text = grade_comment(best.grade, best.status) + format_structure(best.structure)
    (folder / "structure.toml").write_text(text, encoding="utf-8", newline="\n")


COMPARISON_FOLDER: ResultFolder[Comparison] = ResultFolder(
    mark=COMPARISON,
    document=lambda comparison, _: {**comparison.to_dict(), "version": __version__},
    data=_write_data,
    sections=partial(sections_of, SECTIONS),
    page=comparison_page,
)
"""What `compare` hands over."""
