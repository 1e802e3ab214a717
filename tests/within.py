"""How far estimates are from the truth, in the standard errors that they state, and structures by who is linked how."""

from collections.abc import Mapping

import numpy as np
from present import present, some
from problems import truth

import linkwise as lw
from linkwise.arrays import Floats
from linkwise.expression import to_text


def errors(fit: lw.Estimate, true: lw.Structure | Mapping[str, float]) -> Floats:
    """(p,) errors in standard errors of all coefficients, or of those that are named; NaN without a standard error."""
    if isinstance(true, lw.Structure):
        names = [parameter.name for parameter in fit.parameters]
        true = dict(zip(names, truth(true, fit.given_structure).tolist(), strict=True))
    found = [fit.coefficient(name) for name in true]
    deviations = [np.nan if each.standard_error is None else each.standard_error for each in found]
    return (
        np.array([each.value - value for each, value in zip(found, true.values(), strict=True)]) / deviations
    )


def assert_within(fit: lw.Estimate, true: lw.Structure | Mapping[str, float], most: float = 4.0) -> None:
    """The fit is trusted, and within `most` standard errors: of 4 once in 16 000 coefficients, of 5 in two millions."""
    assert fit.trusted, str(fit)
    off = errors(fit, true)
    assert len(off) and np.abs(off).max() < most, off


def assert_discovered(discovery: lw.Discovery, true: lw.Structure, most: float = 4.5) -> None:
    """The discovery is trusted, with the true terms, each within `most` standard errors: of 4.5 once in 150 000."""
    assert discovery.trusted, str(discovery)
    assert lw.discovery.term_score(discovery.structure, true).exact
    aligned = lw.discovery.align_truth(discovery.structure, true)
    for term in some(discovery.kept):
        assert abs(term.value - present(aligned.coefficient(term.name).value)) < most * term.standard_error


def of(owner: str, values: Mapping[str, float]) -> dict[str, float]:
    """Coefficients of a link by their whole names."""
    return {f"{owner}.{name}": value for name, value in values.items()}


Terms = set[tuple[frozenset[str], str]]


def terms(structure: lw.Structure) -> Terms:
    """Both ends and the text of what a coefficient multiplies, of every coefficient that is not 0."""
    return {
        (frozenset(link.between), to_text(link.law.basis[name]))
        for link in structure.links
        for name, coefficient in link.coefficients.items()
        if coefficient.value != 0.0
    }


def graph(structure: lw.Structure) -> set[frozenset[str]]:
    """The pairs that are linked."""
    return {ends for ends, _ in terms(structure)}


def masses(structure: lw.Structure) -> dict[str, float | str]:
    """What `discover` is told: kg by name."""
    return dict(zip(structure.mass_names, map(float, structure.mass_values), strict=True))
