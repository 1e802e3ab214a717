"""Structures by what they say, whatever their names: who is linked to whom, by which terms."""

import linkwise as lw
from linkwise.expression import to_text

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
