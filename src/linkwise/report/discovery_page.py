"""From a discovery to the page: verdict, graph, links by certainty, path; then what the page of `identify` shows."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from linkwise.discovery.result import CERTAIN, Discovery
from linkwise.discovery.scoring import TermScore
from linkwise.discovery.text import (
    all_remarks,
    by_certainty,
    doubt_rows,
    doubt_title,
    headline,
    next_rows,
    term_rows,
)
from linkwise.report.estimate_page import TEMPLATES, page_parts
from linkwise.report.section_page import embedded
from linkwise.verdict import Decision

_HEAD = ("link", "between", "kind", "term", "value", "standard error", "z", "margin", "unit")


def discovery_page(
    found: Discovery,
    figures: Path,
    *,
    score: TermScore | None = None,
    progress: Callable[[float, str], None] = lambda fraction, now: None,
    **options: Any,
) -> str:
    """The page as text, HTML that carries everything in itself.

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
            "doubts": doubt_rows(found, CERTAIN),
            "doubt_title": doubt_title(found, CERTAIN),
            "runners": next_rows(found),
            "score": score,
            **{name: embedded(figures / f"{name}.svg") for name in ("graph", "path", "evidence")},
        }
    )


def _rows(found: Discovery) -> list[tuple[str, ...]]:
    """A row for every term, links and their laws named once."""
    rows = []
    for each in by_certainty(found):
        name = each.link.name + (
            "" if found.decision(each.link.name) is Decision.CERTAIN or not found.trusted else " (in doubt)"
        )
        title = (name, " – ".join(each.link.between), each.kind)
        for number, row in enumerate(term_rows(found, each)):
            rows.append((*(title if number == 0 else ("", "", "")), *row))
    return rows
