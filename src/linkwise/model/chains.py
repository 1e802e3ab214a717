"""The chain of bistable nonlinear energy sinks of the paper (Eq. 1, Table 1), and structures of links written as text."""

from __future__ import annotations

import re
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from linkwise.display import near_miss
from linkwise.errors import LawError, StructureError, expect
from linkwise.model.coefficient import Name
from linkwise.model.host import rotations_of
from linkwise.model.law import Law
from linkwise.model.link import GROUND, Link, Mass
from linkwise.model.named_laws import is_law_name, named_law
from linkwise.model.structure import Structure
from linkwise.model.structure_file import LinkTable, MassTable, link_of, mass_of, require_named

SPRING_LAW = "k*d + c*v"
SINK_LAW = "alpha*d + beta*d**3 + c*v"

LARGEST = 100_000  # masses: what a structure file and a computer's memory still take without delay


def bnes_chain(
    n: int,
    *,
    primary_mass: float = 1.0,
    sink_mass: float = 0.01,
    k: float = 30000.0,
    c: float = 1.0,
    sink_c: float = 0.02,
    alpha: float = -100.0,
    beta: float = 1e6,
) -> Structure:
    """The chain of bistable nonlinear energy sinks of the paper (its Eq. 1 and Table 1).

    Masses are m1 (primary), m2 (its sink), m3, m4, ...; links are spring1 (m1 to ground), nes1 (m2 to m1), spring2 (m3 to
    m1), nes2 and so on. The springs have the law ``k*d + c*v``, the sinks ``alpha*d + beta*d**3 + c*v``.

    Parameters
    ----------
    n : int
        Number of masses, even: n/2 cells of a primary mass and its sink.
    primary_mass, sink_mass : float
        Masses in kg.
    k, c : float
        Stiffness in N/m and damping in N s/m of the springs.
    sink_c, alpha, beta : float
        Damping in N s/m, linear stiffness in N/m and cubic stiffness in N/m^3 of the sinks.

    Returns
    -------
    Structure
        The chain, with all coefficients known.

    Raises
    ------
    StructureError
        If n is odd, below 2 or too large, or a mass is not positive.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(4)
    >>> [link.name for link in chain.links]
    ['spring1', 'nes1', 'spring2', 'nes2']
    """
    if isinstance(n, bool) or not isinstance(n, int | np.integer):
        raise StructureError(f"the number of masses must be an integer, got {n!r}")
    if n > LARGEST:
        raise StructureError(f"the number of masses must be at most {LARGEST}")
    if n < 2 or n % 2:
        message = f"the number of masses must be even and at least 2, since each cell has a primary mass and a sink; got {n}"
        raise StructureError(message)
    spring, of_spring = Law.parse(SPRING_LAW), {"k": k, "c": c}
    sink, of_sink = Law.parse(SINK_LAW), {"alpha": alpha, "beta": beta, "c": sink_c}
    masses: list[Mass] = []
    links: list[Link] = []
    for cell in range(1, int(n) // 2 + 1):
        primary, attached = f"m{2 * cell - 1}", f"m{2 * cell}"
        below = f"m{2 * cell - 3}" if cell > 1 else GROUND
        masses += [Mass(primary, primary_mass), Mass(attached, sink_mass)]
        links += [
            Link(f"spring{cell}", (primary, below), spring, of_spring),
            Link(f"nes{cell}", (attached, primary), sink, of_sink),
        ]
    return Structure(f"bistable chain of {n} masses", tuple(masses), tuple(links))


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
    of_masses = enumerate(masses.items())
    built = tuple(mass_of(MassTable(mass, given), number, "rig") for number, (mass, given) in of_masses)
    tables = {link: link_table(link, text, signals) for link, text in links.items()}
    names = [str(Name(link, key)) for link, table in tables.items() for key in table.coefficients]
    for full, value in known.items():
        if full not in names:
            message = f"is not a coefficient of this rig{near_miss(full, names)}; they are {', '.join(names) or 'none'}"
            raise StructureError(message, f'known "{full}"')
        owner, key = Name.parse(full).owner, Name.parse(full).key
        tables[owner].coefficients[key] = dict(value) if isinstance(value, Mapping) else value
    rotations = rotations_of((), built)
    numbered = enumerate(tables.values())
    of_links = tuple(link_of(table, number, "rig", rotations, signals) for number, table in numbered)
    require_named(signals, of_links, "rig")
    return Structure(name, built, of_links)


def link_table(name: str, text: str, signals: Mapping[str, str] = MappingProxyType({})) -> LinkTable:
    """The table of a link "FIRST - SECOND: LAW" with all coefficients unknown; StructureError where that is not said."""
    expect(f'link "{name}"', text, str)
    match = _LINK.fullmatch(text)
    if match is None:
        message = f'expected "FIRST - SECOND: LAW", such as "sink - frame: k*d + c*v", got {text!r}'
        raise StructureError(message, f'link "{name}"')
    law, ends = match["law"], [match["first"], match["second"]]
    if is_law_name(law):
        named = named_law(law)
        coefficients = Law.parse(named.law, named.states).coefficients
    else:
        try:
            coefficients = Law.parse(law, signals=signals).coefficients
        except LawError as error:
            raise StructureError(f"invalid law: {error}", f'link "{name}"') from None
    return LinkTable(name, ends, law, dict.fromkeys(coefficients, "unknown"))
