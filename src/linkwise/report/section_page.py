"""A page of sections, each with a table and a picture: verdict first, complete in itself, small."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from linkwise.report.estimate_page import TEMPLATES


@dataclass(frozen=True)
class Section:
    """One heading; `rows` of a table (the first are its titles) and a `picture`, as an address, where there are any."""

    title: str
    text: str = ""
    rows: Sequence[Sequence[str]] = ()
    picture: str = ""


def embedded(svg: Path) -> str:
    """An SVG file as an address that holds it, for a page that needs nothing else."""
    return f"data:image/svg+xml;base64,{b64encode(svg.read_bytes()).decode('ascii')}"


def sheet_page(
    title: str,
    *,
    verdict: Sequence[str],
    trusted: bool,
    sections: Sequence[Section],
    structure: str,
    version: str,
    findings: Sequence[str] = (),
) -> str:
    """The page as text; the first line of `verdict` is its headline, `structure` the text of a structure file."""
    return TEMPLATES.get_template("sheet.html.jinja").render(
        title=title, verdict=verdict, trusted=trusted, sections=sections, structure=structure, version=version,
        findings=findings,
    )  # fmt: skip
