"""A structure as a notebook shows it: its masses, and a line for every link."""

from __future__ import annotations

from linkwise.display import align_columns, as_html, text_html
from linkwise.model.structure import Structure

_MOST = 40  # masses or links that are shown


@as_html.register
def structure_html(structure: Structure) -> str:
    """The name of the structure, its masses and the laws of its links."""
    masses = [
        (mass.name, "unknown" if mass.mass.value is None else f"{mass.mass.value:g} {mass.mass_unit}")
        for mass in structure.masses[:_MOST]
    ]
    links = [(link.name, " - ".join(link.between), link.law.equations) for link in structure.links[:_MOST]]
    count = f"{len(structure.masses)} masses, {len(structure.links)} links"
    lines = [f"{structure.name or 'structure'}: {count}", *align_columns([("mass", ""), *masses])]
    if links:
        lines += align_columns([("link", "between", "law"), *links])
    left_out = max(len(structure.masses), len(structure.links)) - _MOST
    return text_html("\n".join([*lines, *([f"... and {left_out} more"] if left_out > 0 else [])]))
