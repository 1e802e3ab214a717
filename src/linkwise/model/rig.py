"""A structure from short texts, as a person sketches a rig: masses by name, links as "sink - frame: k*d + c*v"."""

from __future__ import annotations

import re
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from linkwise.display import near_miss
from linkwise.errors import LawError, StructureError, expect
from linkwise.model.law import Law
from linkwise.model.link_file import LinkTable, link_of
from linkwise.model.named_laws import is_law_name, named_law
from linkwise.model.names import Name
from linkwise.model.rotations import rotations_of
from linkwise.model.structure import Structure
from linkwise.model.structure_file import MassTable, mass_of, require_named

_LINK = re.compile(r"\s*(?P<first>[^:]+?)\s+-\s+(?P<second>[^:]+?)\s*:\s*(?P<law>.+?)\s*", re.DOTALL)


def rig(
    masses: Mapping[str, float | str],
    links: Mapping[str, str],
    known: Mapping[str, float | str | Mapping[str, Any]] = MappingProxyType({}),
    *,
    signals: Mapping[str, str] = MappingProxyType({}),
    name: str = "rig",
) -> Structure:
    """Build a structure in which every coefficient that is not known is unknown, to be identified.

    Parameters
    ----------
    masses : mapping of str to float or str
        Masses by name: in kg, with a unit as in ``"120 g"``, ``"20 g m^2"`` of what turns, or ``"unknown"``.
    links : mapping of str to str
        ``"FIRST - SECOND: LAW"`` by name, such as ``"sink - frame: alpha*d + beta*d**3 + c*v"``; an end is a mass,
        ``ground`` or ``base``, d is the displacement of the first end less that of the second, and a law may also be named,
        as ``"sink - frame: bouc-wen"``.
    known : mapping of str to float, str or mapping, optional
        What is known of coefficients, by full name: ``{"leaf.c": 1.6}``, ``{"leaf.k": "30 N/mm"}``, equal to another one as
        ``"=leaf.k"``, or a ``start`` with ``lower``, ``upper`` or ``sigma``, as in a structure file.
    signals : mapping of str to str, optional
        Recorded signals that laws name, with their units: ``{"u": "V"}`` for ``"sink - frame: (c0 + cu*u)*v"``.
    name : str
        Title of the structure.

    Returns
    -------
    Structure
        The structure.

    Raises
    ------
    StructureError
        If a text does not say a mass or a link, or a coefficient that is known is in none of the laws.
    LawError
        If a law is not valid.

    See Also
    --------
    read_structure : Read one from a file.

    Examples
    --------
    >>> import linkwise as lw
    >>> sketched = lw.rig(
    ...     masses={"frame": 1.8, "sink": "120 g"},
    ...     links={"leaf": "frame - ground: k*d + c*v", "nes": "sink - frame: alpha*d + beta*d**3 + c*v"},
    ...     known={"leaf.c": 1.6},
    ... )
    >>> [parameter.name for parameter in sketched.parameters]
    ['leaf.k', 'nes.alpha', 'nes.beta', 'nes.c']
    >>> print(sketched)
    rig: 2 masses, 2 links
      mass
      frame  1.8 kg
      sink   0.12 kg
      link         between  law
      leaf  frame - ground  k*d + c*v
      nes     sink - frame  alpha*d + beta*d**3 + c*v
    """
    for argument, mapping in {"masses": masses, "links": links, "known": known, "signals": signals}.items():
        expect(f"rig(masses, links, known): {argument}", mapping, Mapping)
    built = tuple(
        mass_of(MassTable(mass, given), number, "rig") for number, (mass, given) in enumerate(masses.items())
    )
    tables = {link: link_table(link, text, signals) for link, text in links.items()}
    names = [str(Name(link, key)) for link, table in tables.items() for key in table.coefficients]
    for full, value in known.items():
        if full not in names:
            raise StructureError(
                f"is not a coefficient of this rig{near_miss(full, names)}; they are {', '.join(names) or 'none'}",
                f'known "{full}"',
            )
        owner, key = Name.parse(full).owner, Name.parse(full).key
        tables[owner].coefficients[key] = dict(value) if isinstance(value, Mapping) else value
    rotations = rotations_of((), built)
    of_links = tuple(
        link_of(table, number, "rig", rotations, signals) for number, table in enumerate(tables.values())
    )
    require_named(signals, of_links, "rig")
    return Structure(name, built, of_links)


def link_table(name: str, text: str, signals: Mapping[str, str] = MappingProxyType({})) -> LinkTable:
    """The table of a link "FIRST - SECOND: LAW" with all coefficients unknown; StructureError where that is not said."""
    expect(f'link "{name}"', text, str)
    said = _LINK.fullmatch(text)
    if said is None:
        raise StructureError(
            f'expected "FIRST - SECOND: LAW", such as "sink - frame: k*d + c*v", got {text!r}',
            f'link "{name}"',
        )
    law, ends = said["law"], [said["first"], said["second"]]
    if is_law_name(law):
        named = named_law(law)
        coefficients = Law.parse(named.law, named.states).coefficients
    else:
        try:
            coefficients = Law.parse(law, signals=signals).coefficients
        except LawError as error:
            raise StructureError(f"invalid law: {error}", f'link "{name}"') from None
    return LinkTable(name, ends, law, dict.fromkeys(coefficients, "unknown"))
