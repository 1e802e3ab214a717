"""From an estimate to the page: verdict first, then numbers, pictures, and what was done."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from plotly.graph_objects import Figure
from plotly.io import to_html
from plotly.offline import get_plotlyjs

from linkwise.estimates.estimate import Estimate
from linkwise.estimates.link_estimate import CoefficientEstimate, DerivedQuantity
from linkwise.model.structure import Structure
from linkwise.model.toml_file import format_structure
from linkwise.plot.force import force_title
from linkwise.plot.force_view import force_view
from linkwise.plot.interactive import force_page, histories_page
from linkwise.progress import Progress, ProgressReport, silent
from linkwise.text import format_error, format_value

TEMPLATES = Environment(
    loader=PackageLoader("linkwise", "report"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)


@dataclass(frozen=True)
class CoefficientRow:
    """One coefficient as the table shows it."""

    name: str
    value: str
    unit: str
    error: str
    interval: str
    known: bool
    true: str


@dataclass(frozen=True)
class LinkSection:
    """One link: heading, coefficients, derived quantities, comparison with the truth (a sentence) and picture."""

    title: str
    name: str
    rows: tuple[CoefficientRow, ...]
    derived: tuple[str, ...]
    visited: str
    nmse: str
    picture: Markup


def report(
    estimate: Estimate,
    *,
    version: str,
    pictured: tuple[str, ...],
    truth: Structure | None = None,
    nmse: Mapping[str, float | None] | None = None,
    progress: Progress = silent,
) -> str:
    """The page as text: HTML that carries its scripts and data in itself.

    `pictured` names the links that get a picture; `truth` and `nmse` (in %, by link) compare with the true
    structure; `progress` is told the fraction done.
    """
    parts = page_parts(
        estimate, version=version, pictured=pictured, truth=truth, nmse=nmse, progress=progress
    )
    return TEMPLATES.get_template("page.html.jinja").render(parts)


def page_parts(
    estimate: Estimate,
    *,
    version: str,
    pictured: tuple[str, ...],
    truth: Structure | None = None,
    nmse: Mapping[str, float | None] | None = None,
    progress: Progress = silent,
) -> dict[str, Any]:
    """What the page's template shows, by name, for this page and those that extend it."""
    sections = []
    for done, link in enumerate(sorted(estimate.links, key=lambda each: not each.free)):  # found ones first
        progress(ProgressReport(done / len(estimate.links), f"page: {link.link.name}"))
        sections.append(_section(estimate, link.link.name, truth, nmse or {}, link.link.name in pictured))
    return {
        "estimate": estimate,
        "record": estimate.record,
        "sections": sections,
        "masses": [
            _row(mass, None if truth is None else _true_mass(truth, mass.name)) for mass in estimate.masses
        ],
        "noise": [
            (name, f"{found.sigma:.3g}", found.unit, f"{found.snr_db:.1f}")
            for name, found in estimate.noise.items()
        ],
        "chi_square": ""
        if estimate.chi_square_per_sample is None
        else f"{estimate.chi_square_per_sample:.3f}",
        "histories": _picture(histories_page(estimate.record), "histories"),
        "structure": format_structure(estimate.structure),
        "plotly": Markup(get_plotlyjs()),
        "compared": truth is not None,
        "version": version,
    }


def _section(
    estimate: Estimate, name: str, truth: Structure | None, nmse: Mapping[str, float | None], pictured: bool
) -> LinkSection:
    found = estimate.link(name)
    true = {} if truth is None else truth.link(name).values
    derived = [*found.wells, *([found.barrier] if found.barrier else []), *found.frequencies]
    picture = (
        _picture(force_page(force_view(estimate, name, truth)), f"force-{name}") if pictured else Markup("")
    )
    return LinkSection(
        title=force_title(found.link),
        name=name,
        rows=tuple(_row(each, true.get(each.name.rpartition(".")[2])) for each in found.coefficients),
        derived=tuple(_derived(each) for each in derived),
        visited=f"d from {found.d_range[0]:.3g} to {found.d_range[1]:.3g} m, "
        f"v from {found.v_range[0]:.3g} to {found.v_range[1]:.3g} m/s",
        nmse="" if nmse.get(name) is None else f"{nmse[name]:.3g} %",
        picture=picture,
    )


def _row(found: CoefficientEstimate, true: float | None) -> CoefficientRow:
    error = found.standard_error
    return CoefficientRow(
        name=found.name,
        value=format_value(found.value, error),
        unit=found.unit,
        error="" if error is None else format_error(error),
        interval=""
        if found.interval is None
        else " … ".join(format_value(end, error) for end in found.interval),
        known=found.known,
        true="" if true is None else format_value(true),
    )


def _derived(found: DerivedQuantity) -> str:
    if found.interval is None:
        return f"{found.name}: {format_value(found.value)} {found.unit}"
    low, high = found.interval
    error = (high - low) / 4.0  # close enough for the number of digits
    value, low_text, high_text = (format_value(number, error) for number in (found.value, low, high))
    return f"{found.name}: {value} {found.unit} (95 %: {low_text} … {high_text})"


def _true_mass(truth: Structure, name: str) -> float | None:
    return truth.mass(name.removesuffix(".mass")).mass.value


def _picture(figure: Figure, identifier: str) -> Markup:
    """The figure as a part of a page that holds the script already."""
    config = {"displaylogo": False, "responsive": True}
    return Markup(to_html(figure, config=config, include_plotlyjs=False, full_html=False, div_id=identifier))
