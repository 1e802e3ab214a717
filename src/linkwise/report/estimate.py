"""The result folder of `identify`: result.json, figures, and a page with the verdict first."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from linkwise.display import (
    JudgedView,
    format_both,
    format_chi_square,
    format_error,
    format_percent,
    format_value,
    listed,
)
from linkwise.estimates.causes import UnseenTerm
from linkwise.estimates.curves import GRID, fitted_channels, has_loop
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.link_estimate import CoefficientEstimate, DerivedQuantity, LinkEstimate
from linkwise.estimates.uncertainty import COVARIANCE, Posterior, write_covariance
from linkwise.likelihood.whiteness import whiteness_text
from linkwise.model.structure_file import format_structure
from linkwise.output import COMPARISON
from linkwise.plot import style
from linkwise.plot.estimates import OVERLAID, fit_figure, residuals_figure
from linkwise.plot.links import comparison_figure, force_figure, loop, loop_figure
from linkwise.plot.records import histories_figure
from linkwise.registry import Registry
from linkwise.report.figure_units import lengths_as_in_figures
from linkwise.report.result_folder import Reported, ResultFolder, Section, csv_table, write_graded
from linkwise.report.result_page import Head, rendered, sectioned
from linkwise.verdict import Basis, Grade, status_of

if TYPE_CHECKING:
    from linkwise.identification.compare import Comparison

PICTURED = 24  # links with figures; the others have their numbers and their force file
FIRST = 3  # links whose laws stand on the first screen
UNSEEN_HEAD = (
    "link or mass", "term", "up to, of its force or mass", "would change", "by", "standard errors",
)  # fmt: skip
NOISE_HEAD = ("channel", "noise found", "unit", "signal to noise, dB")


def _sections(reported: Reported[Estimate]) -> dict[str, Section]:
    """What follows the links, the fit on the first screen, by the names of figures."""
    estimate, sections = reported.result, {}
    overlaid = fitted_channels(estimate)
    if overlaid:
        figure = partial(fit_figure, estimate.record, overlaid)
        sections["fit"] = Section("Measured and fitted", figure=figure)
    title, asked, rows = estimate.second_answer
    if rows:
        sections["alternative"] = Section(title, items=asked, rows=rows)
    if estimate.unseen_terms:
        rows = [UNSEEN_HEAD, *map(_unseen, estimate.unseen_terms)]
        sections["unseen"] = Section("Terms that the record does not rule out", rows=rows, folded=True)
    if left := estimate.motion.residuals:
        text = (
            "What the laws leave of each channel, in standard deviations of its noise: over time, over frequency beside white "
            "noise, and its mean over the motion of a link beside the band that holds 95 % of such means of noise alone."
        )
        items = [whiteness_text(name, values) for name, values in left.items()]
        figure = partial(residuals_figure, estimate)
        sections["residuals"] = Section("Residuals", [text], items, figure=figure, folded=True)
    sections["histories"] = _record(estimate, list(overlaid)[:OVERLAID])
    return sections


def _record(estimate: Estimate, drawn: Collection[str]) -> Section:
    """The record: where it comes from, its noise, and its histories where not all are `drawn` with what was fitted."""
    record = estimate.record
    text = (
        f"{record.source or 'A record'}: {len(record)} samples at {record.rate:g} Hz, from {record.time[0]:g} to "
        f"{record.time[-1]:g} s."
    )
    noise = estimate.noise.items()
    rows = [(name, f"{level.sigma:.3g}", level.unit, f"{level.snr_db:.1f}") for name, level in noise]
    rows = [NOISE_HEAD, *rows] if rows else []
    figure = None if {*record.channels} <= {*drawn} else partial(histories_figure, record)
    return Section("Record", text=[text], items=record.notes, rows=rows, figure=figure, folded=True)


def _unseen(term: UnseenTerm) -> tuple[str, ...]:
    """A term, or an error of a stated mass, that the record does not rule out."""
    share, change = format_percent(term.share), format_percent(term.relative_change)
    return term.link, term.term, share, term.coefficient, change, format_error(term.standard_errors)


def _force(reported: Reported[Estimate], link: str) -> Callable[[], Figure]:
    """The force law, over the rate where there is none at rest."""
    estimate = reported.result
    at_rest = estimate.force_band(link, np.linspace(*estimate.link(link).d_range, GRID))[0]
    if not at_rest.any() and not estimate.link(link).link.law.states:
        return partial(style.single, partial(loop, estimate, link, over="v"))
    return partial(force_figure, estimate, link, truth=reported.truth)


def _loop(reported: Reported[Estimate], link: str) -> Callable[[], Figure] | None:
    """The force over one cycle, of a link with memory."""
    return partial(loop_figure, reported.result, link) if has_loop(reported.result, link) else None


LINK_FIGURES: Registry[Callable[[Reported[Estimate], str], Callable[[], Figure] | None]] = Registry(
    "figure", {"force": _force, "loop": _loop}
)
"""What is drawn of each link, from the report and the name of the link; None where there is nothing to draw."""


def estimate_figures(reported: Reported[Estimate]) -> dict[str, Section]:
    """All sections with a figure, by the name of its files: those of the links, then the others."""
    links = {
        f"{kind}_{name}": Section(name, figure=figure)
        for kind, build in LINK_FIGURES.items()
        for name in _pictured(reported.result)
        if (figure := build(reported, name)) is not None
    }
    return {**links, **_sections(reported)}


def estimate_page(reported: Reported[Estimate], pictures: Mapping[str, Markup]) -> str:
    """The page as text: HTML that carries its scripts and data in itself.

    `pictures` are those that `write_figures` made of `estimate_figures`.
    """
    return rendered("page.html.jinja", **page_parts(reported, pictures, reported.result.grade))


def page_parts(reported: Reported[Estimate], pictures: Mapping[str, Markup], grade: Grade) -> dict[str, Any]:
    """What the page's template shows of an answer of this grade, by name, for this page and those that extend it."""
    estimate, truth = reported.result, reported.truth
    identified_first = sorted(estimate.links, key=lambda link: not link.free)
    of_modes = (*(c for mode in estimate.modes for c in mode.coefficients), *estimate.shapes)
    chi_square = estimate.chi_square_per_sample

    def true_value(coefficient: CoefficientEstimate) -> str:
        name, value = coefficient.name, None
        if truth is not None and any(name.owner == link.link.name for link in estimate.links):
            value = truth.link(name.owner).values.get(name.key)
        elif truth is not None:
            value = truth.coefficient(name).value
        return "" if value is None else format_value(value)

    return {
        "estimate": estimate,
        "laws": [link for link in identified_first[:FIRST] if link.free],
        "grade": grade.value,
        "doubt": _doubt(estimate, grade),
        "first": [name for name in (_first_force(estimate, pictures), "fit") if name in pictures],
        "links": identified_first,
        "figures_of": lambda link: [name for kind in LINK_FIGURES if (name := f"{kind}_{link}") in pictures],
        "modes": of_modes,
        "nmse": reported.nmse,
        "chi_square": "" if chi_square is None else format_chi_square(chi_square),
        "sections": {name: one for name, one in _sections(reported).items() if name != "fit"},
        "pictures": pictures,
        "structure": format_structure(estimate.structure),
        "compared": truth is not None,
        "profiled": bool(estimate.profile_intervals),
        "format_value": format_value,
        "force_title": style.force_title,
        "true_value": true_value,
        **{own.__name__[1:]: own for own in (_ends, _numbered, _derived, _within, _length, _as_in_figures)},
    }


def _first_force(estimate: Estimate, pictures: Mapping[str, Markup]) -> str:
    """The figure on the first screen: the force of the link with most unknowns."""
    links = [link for link in estimate.links if f"force_{link.link.name}" in pictures]
    return f"force_{max(links, key=lambda link: len(link.free)).link.name}" if links else ""


def _length(link: LinkEstimate) -> tuple[float, str]:
    """What multiplies meters in the figure of a link, and the unit it gives; an angle has no prefix."""
    return (1.0, "m") if link.link.law.angular else style.scale(link.d_range, "m")


def _as_in_figures(ends: tuple[float, float], unit: str) -> str:
    """A range in the unit that a figure of it has."""
    return lengths_as_in_figures([f"{ends[0]:.3g} to {ends[1]:.3g} {unit}"])[0]


def _numbered(link: LinkEstimate) -> list[tuple[str, DerivedQuantity]]:
    """What follows from the coefficients of a link, with the number of the well that it is of."""
    wells = [(f"well {number}", well) for number, well in enumerate(link.wells, start=1)]
    barrier = [("barrier", link.barrier)] if link.barrier else []
    of_wells = [(f"frequency in well {number}", one) for number, one in enumerate(link.frequencies, start=1)]
    return [*wells, *barrier, *of_wells]


_SMALL = 0.01  # in a unit, below which a number is read less easily than in another


def _within(quantity: CoefficientEstimate | DerivedQuantity, length: tuple[float, str]) -> str:
    """A value and half of its 95 % interval, with meters in the unit of `length` and energy with a prefix.

    What would begin with zeros so, and not in SI units, is in these: stiffness is in N/mm as a rule, and damping in N s/m.
    """
    if quantity.unit == "J":
        times, unit = style.scale(quantity.value, "J")
    else:
        times, unit = length[0] ** _metres(quantity.unit), re.sub(r"\bm\b", length[1], quantity.unit)
        if abs(quantity.value * times) < _SMALL < abs(quantity.value) < 1.0 / _SMALL:
            times, unit = 1.0, quantity.unit
    value = quantity.value * times
    if quantity.interval is None:
        return f"{value:.4g} {unit}".rstrip()
    shown, half = format_both(value, 0.5 * (quantity.interval[1] - quantity.interval[0]) * times)
    if "e" in half and "e" not in shown:
        half = f"{float(half):.{len(shown.partition('.')[2])}f}"
    return f"{shown} ± {half} {unit}".rstrip()


def _metres(unit: str) -> float:
    """The exponent of m in a unit as laws state it: -1.5 of N/m^(3/2). Reading it as a quantity takes a third of a second."""
    sign = 1.0
    for name, power, over in re.findall(r"(\w+)(?:\^\(?([\d/]+))?|(/)", unit):
        if name == "m":
            return sign * float(Fraction(power or 1))
        sign = -1.0 if over else sign
    return 0.0


def _doubt(estimate: Estimate, grade: Grade) -> str:
    """One sentence on what could still be wrong, and by how much."""
    if grade is Grade.REFUSED:
        return "Every number on this page, for the reason above."
    if grade is Grade.APPROXIMATE:
        part = format_percent(estimate.model_error)
        forces = f"Forces by about {part}, and coefficients" if estimate.model_error else "Coefficients"
        return f"{forces} by more than their intervals where a law has another form, or for the reason above."
    if estimate.unseen_terms:
        return f"The record does not rule out {estimate.unseen_terms[0].description}."
    known = [str(c.name) for link in estimate.links for c in link.coefficients if c.known and c.value]
    known += [str(mass.name) for mass in estimate.masses if mass.known]
    stated = f", and an error of what was stated ({listed(known)}) passes on to it" if known else ""
    return f"Nothing that this record shows. Beyond the range visited a law is an extrapolation{stated}."


def _pictured(estimate: Estimate) -> list[str]:
    """The links that get figures: those with something identified or a load cell, as many as anyone looks at."""
    known = {link.link.name: all(one.known for one in link.coefficients) for link in estimate.links}
    links = [name for name in known if not known[name] or f"f:{name}" in estimate.record.channels]
    return sorted(links, key=known.__getitem__)[:PICTURED]


def _ends(interval: tuple[float, float] | None, error: float | None) -> str:
    return "" if interval is None else " … ".join(format_value(end, error) for end in interval)


def _derived(quantity: DerivedQuantity) -> str:
    value, interval = quantity.texts
    of_95 = f" (95 %: {interval.replace(' to ', ' … ')})" if interval else ""
    return f"{value} {quantity.unit}{of_95}"


def write_numbers(estimate: Estimate, folder: Path, result: JudgedView) -> None:
    """Write structure, forces of links at v = 0 with 95 % bands over the range that the record visited and, of an answer that
    is not refused, the covariance into an empty `folder`.
    """
    write_graded(estimate.structure, Basis(result.grade, status_of(result.verdicts)), folder)
    if estimate.alternative is not None:
        asked = format_structure(estimate.alternative.given_structure)
        (folder / "alternative.toml").write_text(asked, encoding="utf-8", newline="\n")
    for link in estimate.links:  # columns d in m, the others in N
        d = np.linspace(*link.d_range, GRID)
        table = np.stack([d, *estimate.force_band(link.link.name, d)], axis=1)
        csv_table(folder / f"force_{link.link.name}.csv", ("d", "force", "lower", "upper"), table.tolist())
    if result.grade is not Grade.REFUSED and estimate.intervals:
        write_covariance(Posterior.of(estimate), folder / COVARIANCE)


ESTIMATE_FOLDER: ResultFolder[Estimate] = ResultFolder(
    data=lambda reported, folder: write_numbers(reported.result, folder, reported.result),
    sections=estimate_figures,
    page=lambda reported, _, pictures: estimate_page(reported, pictures),
)
"""What `identify` hands over."""


def _compared(comparison: Comparison) -> dict[str, Section]:
    """The sections of a comparison by the names of their figures."""
    text = (
        "Maximum likelihood (ml) fits the raw samples, the weak form integrates the equations against test functions, and "
        "sindy is the sparse regression of the paper on differentiated signals. A free run starts from the first samples "
        "and follows the inputs alone, or from those of windows where the motion is chaotic; its error is a root mean "
        "square in % of the deviation of the channel, of which noise alone leaves a part."
    )
    over = "Over the motion of the record, and less the force by maximum likelihood, of which the band is the 95 % interval."
    return {
        "table": Section("Side by side", [text], items=comparison.findings, rows=comparison.rows),
        "forces": Section("Forces", [over], figure=partial(comparison_figure, comparison)),
    }


COMPARISON_FOLDER: ResultFolder[Comparison] = sectioned(
    COMPARISON,
    lambda result: Head(result.head, result.best.structure, basis=Basis(result.grade, result.best.status)),
    _compared,
    [
        "predict a second record with structure.toml, the answer of maximum likelihood (validate).",
        "add what is missing to the structure, and identify again.",
    ],
)
"""What `compare` hands over."""
