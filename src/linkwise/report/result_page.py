"""The page of a result: its head, and sections in order. Templates escape what they print and miss nothing silently."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from markupsafe import Markup

from linkwise import __version__
from linkwise.model.structure import Structure
from linkwise.model.structure_file import format_structure
from linkwise.report.figure_units import lengths_as_in_figures, table_as_in_figures
from linkwise.report.result_folder import R, Reported, ResultFolder, Section, write_graded
from linkwise.templates import filled
from linkwise.verdict import Basis


def rendered(template: str, **parts: Any) -> str:
    """The page that a template makes of its parts, with the version."""
    return filled("report", template, version=__version__, **parts)


@dataclass(frozen=True)
class Head:
    """What stands above the sections of a page.

    The first line of `verdict` is its headline, `findings` is what the result does not determine. The title is the name of
    the structure unless it is given.
    """

    verdict: Sequence[str]
    structure: Structure | None = None
    findings: Sequence[str] = ()
    title: str = ""
    basis: Basis | None = None


def sectioned(
    mark: str,
    head: Callable[[R], Head],
    sections: Callable[[R], Mapping[str, Section]],
    following: Sequence[str],
    data: Callable[[R, Path], None] = lambda result, folder: None,
) -> ResultFolder[R]:
    """The folder of a result whose page is its head and its sections, HTML that carries everything in itself; `following` is
    what to do next, the last for a result that is not trusted.
    """

    def page(reported: Reported[R], sections: Mapping[str, Section], pictures: Mapping[str, Markup]) -> str:
        result: Any = reported.result
        shown = head(result)
        verdict, findings = map(lengths_as_in_figures, (shown.verdict, shown.findings))
        shown = replace(shown, verdict=verdict, findings=findings)
        tables = {name: table_as_in_figures(section.rows) for name, section in sections.items()}
        return rendered(
            "section_page.html.jinja",
            title=shown.title or (shown.structure and shown.structure.name) or "structure",
            head=shown,
            grade=result.grade.value,
            basis=result.basis.remark,
            following=following[0 if result.trusted else -1],
            sections={name: replace(section, rows=tables[name]) for name, section in sections.items()},
            pictures=pictures,
            structure="" if shown.structure is None else format_structure(shown.structure),
        )

    def written(reported: Reported[R], folder: Path) -> None:
        result: Any = reported.result
        shown = head(result)
        if shown.structure is not None:
            write_graded(shown.structure, shown.basis or result.basis, folder)
        data(result, folder)

    return ResultFolder(data=written, sections=lambda one: sections(one.result), page=page, mark=mark)
