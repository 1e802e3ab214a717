"""Damping between the modes of a host: entries of its modal damping matrix beside those that damping ratios give.

An entry c between the modes r and s is a force c q_s' on mode r, and c q_r' on mode s. A link has one elongation, so that this
is a pair of dampers, of c/2 on q_r + q_s and of -c/2 on q_r - q_s, which leave the damping of each mode by itself as it is.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import StructureError
from linkwise.model.coefficient import Coefficient, as_coefficient
from linkwise.model.law import Law
from linkwise.model.link import GROUND, Link

Pair = tuple[int, int]
"""Two modes of a host by number, counted from 1, the lower first; the same twice for what damps one mode."""

DAMPING = "damping"
_BETWEEN_MODES = re.compile(rf"\.mode(\d+)[+-]mode(\d+)(\.{DAMPING})?$")
_OF_SUM, _OF_DIFFERENCE, _OF_ONE = (
    Law.parse(text, units={DAMPING: "N s/m"}) for text in ("0.5*damping*v", "-0.5*damping*v", "damping*v")
)


def checked_damping(
    given: Mapping[Pair, Coefficient | float], modes: int, where: str
) -> dict[Pair, Coefficient]:
    """The entries by pair, the lower mode first; an unknown without a start has 0 as one.

    Raises StructureError for modes that do not exist, or an entry that is given twice.
    """
    entries: dict[Pair, Coefficient] = {}
    for pair, value in given.items():
        first, second = sorted(pair)
        if not 1 <= first <= second <= modes:
            raise StructureError(
                f"damping is given between the modes {pair[0]} and {pair[1]}, of modes 1 to {modes}", where
            )
        if (first, second) in entries:
            raise StructureError(f"the damping between the modes {first} and {second} is given twice", where)
        entry = as_coefficient(value, "the damping between modes")
        if entry.value is None and entry.same_as is None:
            entry = replace(entry, value=min(max(0.0, entry.lower), entry.upper))
        entries[first, second] = entry
    return entries


def damping_link(host: str, pair: Pair) -> str:
    """Name of the link whose coefficient `damping` is the entry of a pair."""
    return f"{host}.mode{pair[0]}+mode{pair[1]}"


def is_between_modes(name: str) -> bool:
    """Whether a name is that of a damper between modes, or of its coefficient."""
    return _BETWEEN_MODES.search(name) is not None


def in_words(link: str) -> str:
    """Which damping a damper between modes is, and how a structure file asks for it.

    Raises ValueError for the name of another link.
    """
    between = _BETWEEN_MODES.search(link)
    if between is None:
        raise ValueError(f"{link} is no damper between modes")
    first, second = between[1], between[2]
    return (
        f"between the modes {first} and {second} of {link[: between.start()]} "
        f'(damping = [ {{ modes = [{first}, {second}], damping = "unknown" }} ] of that host)'
    )


def negated_mode(host: str, mode: int) -> str:
    """Name of the place that moves as a mode does, in the other direction: an end of the damper on a sum."""
    return f"{host}.-mode{mode}"


def damping_links(host: str, entries: Mapping[Pair, Coefficient]) -> tuple[Link, ...]:
    """The dampers of all entries: that with the coefficient first, then the one that shares it."""
    links = []
    for pair, entry in entries.items():
        name = damping_link(host, pair)
        first, second = (f"{host}.mode{number}" for number in pair)
        if first == second:
            links.append(Link(name, (first, GROUND), _OF_ONE, {DAMPING: entry}))
            continue
        shared = Coefficient.shared(f"{name}.{DAMPING}")
        links += [
            Link(name, (first, negated_mode(host, pair[1])), _OF_SUM, {DAMPING: entry}),
            Link(f"{first}-mode{pair[1]}", (first, second), _OF_DIFFERENCE, {DAMPING: shared}),
        ]
    return tuple(links)


def entries_of(matrix: Floats, where: str) -> dict[Pair, float]:
    """Entries of a whole damping matrix (n, n) in N s/m, without those that are 0.

    Raises StructureError unless it is symmetric and dissipates energy in every motion.
    """
    largest = float(np.abs(matrix).max(initial=0.0))
    if np.abs(matrix - matrix.T).max(initial=0.0) > 1e-6 * largest:
        raise StructureError("the damping matrix of the modes is not symmetric", where)
    if np.linalg.eigvalsh(matrix).min(initial=0.0) < -1e-6 * largest:
        raise StructureError("the damping matrix feeds energy into a motion of the modes", where)
    rows, columns = np.nonzero(np.triu(matrix))
    return {
        (row + 1, column + 1): float(matrix[row, column])
        for row, column in zip(rows.tolist(), columns.tolist(), strict=True)
    }
