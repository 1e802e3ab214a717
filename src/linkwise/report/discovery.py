"""The result folder of `discover`: that of `identify`, with the graph, links by certainty, the path and the evidence for
every term.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, replace
from functools import partial
from pathlib import Path

from markupsafe import Markup

from linkwise.discovery.criterion import CERTAIN
from linkwise.discovery.result import (
    PATH_TITLE,
    Discovery,
    TermEvidence,
    all_remarks,
    doubt_mark,
    doubtful_rows,
    doubtful_title,
    headline,
    links_by_certainty,
    memory_rows,
    memory_sentence,
    path_rows,
    runner_up_rows,
    term_rows,
    unknown_rows,
)
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.scoring import align_truth, term_score
from linkwise.model.structure import Structure
from linkwise.plot.discoveries import departures, evidence_figure, path_figure
from linkwise.plot.discovery_graph import graph_figure
from linkwise.plot.style import single
from linkwise.report.estimate import estimate_figures, page_parts, write_numbers
from linkwise.report.result_folder import Reported, ResultFolder, Section, csv_table
from linkwise.report.result_page import rendered
from linkwise.verdict import admit_intervals

_HEAD = ("link", "between", "kind", "term", "value", "standard error", "z", "margin", "unit")


def links_of(reported: Reported[Discovery]) -> Reported[Estimate]:
    """The estimate of a discovery, with the truth under the names of the discovered links."""
    discovery, truth = reported.result, reported.truth
    aligned = None if truth is None else align_truth(discovery.structure, truth)
    return Reported(discovery.estimate, aligned, reported.nmse)


def discovery_figures(reported: Reported[Discovery]) -> dict[str, Section]:
    """All sections with a figure, by the name of its files: those of the discovery, then those of its estimate."""
    return {**_sections(reported), **estimate_figures(links_of(reported))}


def discovery_page(reported: Reported[Discovery], pictures: Mapping[str, Markup]) -> str:
    """The page as self-contained HTML; `pictures` are those that `write_figures` made of `discovery_figures`."""
    discovery = reported.result
    return rendered(
        "discovery.html.jinja",
        **page_parts(links_of(reported), pictures, discovery.grade),
        discovery=discovery,
        headline=headline(discovery),
        remarks=all_remarks(discovery),
        lead=_sections(reported),
    )


def _sections(reported: Reported[Discovery]) -> dict[str, Section]:
    """What stands before the links, by the names of figures."""
    discovery = reported.result
    sections = {"graph": Section("Discovered links", figure=partial(graph_figure, discovery))}
    if reported.truth is not None:
        sections["comparison"] = _comparison(discovery, reported.truth)
    if memory := discovery.memory:
        sentences = [*map(memory_sentence, memory), "Margins: by how much the criterion rises, at least."]
        sections["memory"] = Section("Memory", sentences, rows=memory_rows(memory))
    margin = (
        "Margin: by how much the criterion, -2 log likelihood plus the penalty on links and terms, rises when the "
        f"decision is reversed; beyond {CERTAIN:g} the decision is certain. z: the value in units of its standard error."
    )
    sections["certainty"] = Section("How certain it is", [margin], rows=[_HEAD, *_rows(discovery)])
    if len(rows := doubtful_rows(discovery)) > 1:
        sections["doubts"] = Section(_capitalised(doubtful_title(discovery)), rows=rows)
    figure = partial(path_figure, discovery)
    sections["path"] = Section("Why these terms", rows=runner_up_rows(discovery), figure=figure)
    if len(rows := path_rows(discovery)) > 1:
        sections["sizes"] = Section(_capitalised(PATH_TITLE), rows=rows)
    trusted = admit_intervals(discovery.verdicts)
    link = discovery.average.departing(discovery.estimate.links) if trusted else None
    if link is not None:
        text = (
            "Each is weighted by its criterion. The averaged band includes the uncertainty of the selection."
        )
        figure = partial(single, partial(departures, discovery, link))
        sections["average"] = Section("Other models that survive", [text], figure=figure, folded=True)
    text, figure = "terms.csv lists all candidates that were tested.", partial(evidence_figure, discovery)
    sections["evidence"] = Section("The evidence term by term", [text], figure=figure, folded=True)
    return sections


def _comparison(discovery: Discovery, truth: Structure) -> Section:
    """The terms that are right, missing and false."""
    score = term_score(discovery.structure, truth)
    right, missing, extra = map(len, (score.right, score.missing, score.extra))
    counts = f"{right} terms are right, {missing} are missing, {extra} are false."
    lists = (("Missing", score.missing), ("False", score.extra))
    listed = [f"{label}: {', '.join(names)}." for label, names in lists if names]
    return Section("Comparison with the truth", [counts, *listed])


def _capitalised(title: str) -> str:
    return title[:1].upper() + title[1:]


def _rows(discovery: Discovery) -> list[tuple[str, ...]]:
    """A row for every mass that was unknown and every term; the first of a link names the link."""
    rows = [("", "", "mass", *row) for row in unknown_rows(discovery.estimate.masses)]
    for link in links_by_certainty(discovery):
        title = (f"{link.link.name}{doubt_mark(discovery, link)}", " – ".join(link.link.between), link.kind)
        for number, row in enumerate(term_rows(discovery, link)):
            rows.append((*(title if number == 0 else ("", "", "")), *row))
    return rows


_COLUMNS = {"identifiable": "told", "unambiguous": "reliable"}
"""Columns of terms.csv whose attribute was renamed: keys of files stay."""
_FURTHER = ("first", "second", "certain", "price", "possible_share")
"""Columns of terms.csv behind those that are attributes."""


def _write_data(reported: Reported[Discovery], folder: Path) -> None:
    """The candidates, and what is written of an estimate."""
    _write_terms(reported.result, folder / "terms.csv")
    write_numbers(reported.result.estimate, folder, reported.result)


def _with_aligned_truth(discovery: Discovery) -> Discovery:
    """The discovery with the truth of a simulated record under the names of the discovered links, for figures."""
    estimate = discovery.estimate
    simulated = estimate.record.simulated
    if simulated is None:
        return discovery
    structures = (estimate.structure, simulated.structure)
    plain = all(link.law.is_plain for structure in structures for link in structure.links)
    # else not compared, see term_score
    aligned = replace(simulated, structure=align_truth(*structures)) if plain else None
    return replace(discovery, estimate=replace(estimate, record=replace(estimate.record, simulated=aligned)))


def _write_terms(discovery: Discovery, path: Path) -> None:
    """A line for every candidate that was tested, the kept ones first; what is not finite is left empty."""
    apart = {"between", "possible_share"}
    names = [field.name for field in fields(TermEvidence) if field.name not in apart]
    rows = []
    for term in discovery.terms:
        further = *term.between, term.certain, term.penalty, term.possible_share
        rows.append(map(_cell, (*(getattr(term, name) for name in names), *further)))
    csv_table(path, [*(_COLUMNS.get(name, name) for name in names), *_FURTHER], rows)


def _cell(value: object) -> object:
    """For a cell, true or false and nothing where a number is not finite."""
    if isinstance(value, bool):
        return str(value).lower()
    return "" if isinstance(value, float) and not math.isfinite(value) else value


DISCOVERY_FOLDER: ResultFolder[Discovery] = ResultFolder(
    data=_write_data,
    sections=discovery_figures,
    page=lambda reported, _, pictures: discovery_page(reported, pictures),
    shown=_with_aligned_truth,
)
"""What `discover` hands over."""
