"""The page of a discovery: verdict, graph, links by certainty, path; then what the page of an estimate shows."""

from __future__ import annotations

from collections.abc import Mapping

from markupsafe import Markup

from linkwise import plot
from linkwise.discovery.memory_text import memory_rows, memory_sentence
from linkwise.discovery.result import CERTAIN, Discovery
from linkwise.discovery.scoring import align_truth, term_score
from linkwise.discovery.text import (
    PATH_TITLE,
    all_remarks,
    doubt_mark,
    doubtful_rows,
    doubtful_title,
    headline,
    links_by_certainty,
    mass_rows,
    path_rows,
    runner_up_rows,
    term_rows,
)
from linkwise.estimates.estimate import Estimate
from linkwise.registry import Registry
from linkwise.report.estimate_page import estimate_figures, page_parts
from linkwise.report.section import Build, Reported, Section, figure_section, sections_of
from linkwise.report.templates import TEMPLATES

_HEAD = ("link", "between", "kind", "term", "value", "standard error", "z", "margin", "unit")


def _comparison(reported: Reported[Discovery]) -> Section | None:
    """The terms that are right, missing and false, where the truth is known."""
    if reported.truth is None:
        return None
    score = term_score(reported.result.structure, reported.truth)
    counts = (
        f"{len(score.right)} terms are right, {len(score.missing)} are missing, {len(score.extra)} are false."
    )
    lists = (("Missing", score.missing), ("False", score.extra))
    listed = [f"{label}: {', '.join(names)}." for label, names in lists if names]
    return Section("Comparison with the truth", [counts, *listed])


def _certainty(reported: Reported[Discovery]) -> Section:
    """Every term with its evidence, the most certain links first."""
    margin = (
        "Margin: by how much the criterion, -2 log likelihood plus the penalty on links and terms, rises when the "
        f"decision is reversed; beyond {CERTAIN:g} the decision is certain. z: the value in units of its standard error."
    )
    return Section("How certain it is", [margin], rows=[_HEAD, *_rows(reported.result)])


def _memory(reported: Reported[Discovery]) -> Section | None:
    """The link that has memory, where one has."""
    memory = reported.result.memory
    if not memory:
        return None
    sentences = [*map(memory_sentence, memory), "Margins: by how much the criterion rises, at least."]
    return Section("Memory", sentences, rows=memory_rows(memory))


def _doubts(reported: Reported[Discovery]) -> Section | None:
    """The decisions that are not beyond doubt, where there are such."""
    rows = doubtful_rows(reported.result)
    title = doubtful_title(reported.result)
    return Section(title[:1].upper() + title[1:], rows=rows) if len(rows) > 1 else None


def _path(reported: Reported[Discovery]) -> Section:
    """The path over model sizes and the next best models."""
    discovery = reported.result
    return Section(
        "Why these terms", rows=runner_up_rows(discovery), figure=lambda: plot.path_figure(discovery)
    )


def _sizes(reported: Reported[Discovery]) -> Section | None:
    """What models of other sizes cost and predict, where pieces of the record were left out."""
    rows = path_rows(reported.result)
    return Section(PATH_TITLE[:1].upper() + PATH_TITLE[1:], rows=rows) if len(rows) > 1 else None


def _average(reported: Reported[Discovery]) -> Section | None:
    """The models that survive beside the selected one, if they give another force; none without trust."""
    discovery = reported.result
    link = discovery.average.departing(discovery.estimate.links) if discovery.trusted else None
    if link is None:
        return None
    return Section(
        "Other models that survive",
        ["Each is weighted by its criterion. The averaged band includes the uncertainty of the selection."],
        figure=lambda: plot.departures_figure(discovery, link),
        folded=True,
    )


def _evidence(reported: Reported[Discovery]) -> Section:
    """What each term explains."""
    return Section(
        "The evidence term by term",
        ["terms.csv lists all candidates that were tested."],
        figure=lambda: plot.evidence_figure(reported.result),
        folded=True,
    )


SECTIONS: Registry[Build[Discovery]] = Registry(
    "section",
    {
        "graph": figure_section("Discovered links", lambda discovery: plot.graph_figure(discovery)),
        "comparison": _comparison,
        "memory": _memory,
        "certainty": _certainty,
        "doubts": _doubts,
        "path": _path,
        "sizes": _sizes,
        "average": _average,
        "evidence": _evidence,
    },
)
"""What stands before the links, in order; the name of a section is that of its figure's files."""


def links_of(reported: Reported[Discovery]) -> Reported[Estimate]:
    """The estimate of a discovery, with the truth under the names of the discovered links."""
    discovery, truth = reported.result, reported.truth
    return Reported(
        discovery.estimate, None if truth is None else align_truth(discovery.structure, truth), reported.nmse
    )


def discovery_figures(reported: Reported[Discovery]) -> dict[str, Section]:
    """All sections with a figure, by the name of its files: those of the discovery, then those of its estimate."""
    return {**sections_of(SECTIONS, reported), **estimate_figures(links_of(reported))}


def discovery_page(reported: Reported[Discovery], pictures: Mapping[str, Markup]) -> str:
    """The page as self-contained HTML; `pictures` are those that `write_figures` made of `discovery_figures`."""
    discovery = reported.result
    return TEMPLATES.get_template("discovery.html.jinja").render(
        {
            **page_parts(links_of(reported), pictures),
            "discovery": discovery,
            "headline": headline(discovery),
            "remarks": all_remarks(discovery),
            "lead": sections_of(SECTIONS, reported),
        }
    )


def _rows(discovery: Discovery) -> list[tuple[str, ...]]:
    """A row for every mass that was unknown and every term; the first of a link names the link."""
    rows = [("", "", "mass", *row) for row in mass_rows(discovery)]
    for link in links_by_certainty(discovery):
        title = (f"{link.link.name}{doubt_mark(discovery, link)}", " – ".join(link.link.between), link.kind)
        for number, row in enumerate(term_rows(discovery, link)):
            rows.append((*(title if number == 0 else ("", "", "")), *row))
    return rows
