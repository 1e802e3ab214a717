"""A page of sections under a verdict, for every result that has no page of its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.metadata import version

from markupsafe import Markup
from plotly.offline import get_plotlyjs

from linkwise.model.structure import Structure
from linkwise.model.toml_file import format_structure
from linkwise.report.section import Section
from linkwise.report.templates import TEMPLATES


def section_page(
    structure: Structure | None,
    sections: Mapping[str, Section],
    pictures: Mapping[str, Markup],
    *,
    verdict: Sequence[str],
    trusted: bool,
    findings: Sequence[str] = (),
    title: str = "",
) -> str:
    """The page as text, HTML that carries everything in itself.

    The first line of `verdict` is its headline, `findings` is what the result does not determine, and `pictures` are those
    that `write_figures` returned for the sections. The title is the name of the structure unless it is given.
    """
    interactive = any(section.interactive for section in sections.values())
    return TEMPLATES.get_template("section_page.html.jinja").render(
        title=title or (structure and structure.name) or "structure",
        verdict=verdict,
        trusted=trusted,
        findings=findings,
        sections=sections,
        pictures=pictures,
        plotly=Markup(get_plotlyjs()) if interactive else "",
        structure="" if structure is None else format_structure(structure),
        version=version("linkwise"),
    )
