"""The report page of a discovery: verdict, graph, links by certainty, path; then the sections of an estimate's page."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from linkwise.discovery.result import CERTAIN, Discovery
from linkwise.discovery.scoring import TermScore
from linkwise.discovery.text import (
    all_remarks,
    doubt_mark,
    doubtful_rows,
    doubtful_title,
    headline,
    links_by_certainty,
    runner_up_rows,
    term_rows,
)
from linkwise.progress import Progress, silent
from linkwise.report.estimate_page import TEMPLATES, page_parts
from linkwise.report.section_page import embedded

_HEAD = ("link", "between", "kind", "term", "value", "standard error", "z", "margin", "unit")


def discovery_page(
    found: Discovery,
    figures: Path,
    *,
    score: TermScore | None = None,
    progress: Progress = silent,
    **options: Any,
) -> str:
    """The page as self-contained HTML.

    `figures` is the folder with graph.svg, path.svg and evidence.svg; `score` compares with the truth; `options` are those
    of `page_parts`.
    """
    parts: Mapping[str, Any] = page_parts(found.estimate, progress=progress, **options)
    return TEMPLATES.get_template("discovery.html.jinja").render(
        {
            **parts,
            "found": found,
            "headline": headline(found),
            "remarks": all_remarks(found),
            "certain": CERTAIN,
            "links": [_HEAD, *_rows(found)],
            "doubts": doubtful_rows(found),
            "doubt_title": doubtful_title(found),
            "runners": runner_up_rows(found),
            "score": score,
            **{name: embedded(figures / f"{name}.svg") for name in ("graph", "path", "evidence")},
        }
    )


def _rows(found: Discovery) -> list[tuple[str, ...]]:
    """A row for every term; the first of a link names the link."""
    rows = []
    for link in links_by_certainty(found):
        title = (f"{link.link.name}{doubt_mark(found, link)}", " – ".join(link.link.between), link.kind)
        for number, row in enumerate(term_rows(found, link)):
            rows.append((*(title if number == 0 else ("", "", "")), *row))
    return rows
