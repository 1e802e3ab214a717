"""A link of a structure file: its table, decoded strictly, and the law, states and coefficients that it says.

A state is the text of its rate, or a table of `rate`, `initial` and `unit`. Where only the units of coefficients give the
unit of a state ("43 nF" that of a voltage), they are read first.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import replace
from functools import lru_cache
from types import MappingProxyType
from typing import Any

import msgspec

from linkwise.errors import LinkwiseError, StructureError, located
from linkwise.expression.dimensions import Dimension
from linkwise.model.coefficient import coefficient_of
from linkwise.model.law import Law, LinkState, law_dimensions, unit_dimension
from linkwise.model.link import Link
from linkwise.model.named_laws import NamedLaw, is_law_name, named_law
from linkwise.model.toml import decode

_WITH_UNIT = re.compile(r"\s*[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?\s*[^\W\d].*")


class LinkTable(msgspec.Struct, forbid_unknown_fields=True):
    """A link as written: `states` and `coefficients` are decoded with the law."""

    name: str
    between: list[str]
    law: str
    coefficients: dict[str, Any] = {}
    states: dict[str, Any] = {}


class _StateTable(msgspec.Struct, forbid_unknown_fields=True):
    """A state of a link: its rate, its initial value in SI units or as text with a unit, and its unit."""

    rate: str
    initial: float | str = 0.0
    unit: str = ""


def link_of(
    entry: LinkTable,
    index: int,
    source: str,
    rotations: Collection[str] = (),
    signals: Mapping[str, str] = MappingProxyType({}),
) -> Link:
    """The link of entry `index` of the file `source`; at ends of `rotations` coefficients have the units of a moment and rad,
    and names of `signals` in a law that is written out are inputs in these units.

    Raises StructureError with the place of what is wrong.
    """
    path = f"link[{index}]"
    where = f'{source}, {path} "{entry.name}"'
    try:
        named = named_law(entry.law) if is_law_name(entry.law) else None
        states = _states(entry, named, source, path)
        angular = not set(rotations).isdisjoint(entry.between)
        inputs = () if named else tuple(signals.items())
        law = _law(named.law if named else entry.law, tuple(states.items()), angular, inputs)
        known = {state.name: unit_dimension(state.unit) for state in law.rates if state.unit}
        known |= {name: unit_dimension(unit) for name, unit in law.signal_units}
        stated = _stated_units(entry, law)
        open_states = [name for name, unit in law.state_units.items() if unit == "?"] if stated else []
        if open_states:  # the units of coefficients tell them
            known |= stated
            inferred = law_dimensions(law.text, law.expression, law.rates, known, angular=angular)
            units_of = {name: str(inferred[name]) for name in open_states if inferred[name]}
            states |= {name: replace(states[name], unit=unit) for name, unit in units_of.items()}
            law = _law(law.text, tuple(states.items()), angular, inputs)
        units = law.units
    except LinkwiseError as error:
        if isinstance(error, StructureError) and error.where:
            raise
        raise StructureError(f"invalid law: {error}", where) from None
    coefficients = {name: named.coefficient(name) for name in law.coefficients} if named else {}
    for name, given in entry.coefficients.items():
        place = f"{path}.coefficients.{name}"
        coefficient = coefficient_of(given, units.get(name, ""), source, place)
        with located(f"{source}, {place}"):
            coefficients[name] = named.within_bounds(name, coefficient) if named else coefficient
    for name, state in states.items():
        given = entry.states.get(name)
        initial = given.get("initial", 0.0) if isinstance(given, dict) else 0.0
        value = coefficient_of(initial, law.state_units[name], source, f"{path}.states.{name}.initial")
        states[name] = replace(state, initial=value.value if value.known else None)
    with located(where):
        return Link(entry.name, (*entry.between,), law, coefficients, states)  # type: ignore[arg-type]  # Link counts the ends


def _states(entry: LinkTable, named: NamedLaw | None, source: str, path: str) -> dict[str, LinkState]:
    """The states of a link; initial values are read once their units are known."""
    if named is not None:
        if entry.states:
            raise StructureError(f"the law {entry.law!r} has states of its own: write it out to change them")
        return dict(named.states)
    states: dict[str, LinkState] = {}
    for name, given in entry.states.items():
        place = f"{path}.states.{name}"
        if isinstance(given, dict):
            table = decode(given, _StateTable, source, place, StructureError)
            states[name] = LinkState(table.rate, unit=table.unit)
        elif isinstance(given, str):
            states[name] = LinkState(given)
        else:
            message = f"expected a rate as text or a table of rate, initial, unit; got {given!r}"
            raise StructureError(message, f"{source}, {place}")
    return states


def _stated_units(entry: LinkTable, law: Law) -> dict[str, Dimension]:
    """Dimensions of the coefficients that are given with a unit."""
    return {
        name: unit_dimension(text)
        for name, given in entry.coefficients.items()
        for text in (given.values() if isinstance(given, dict) else (given,))
        if name in law.coefficients and isinstance(text, str) and _WITH_UNIT.fullmatch(text)
    }


@lru_cache(maxsize=256)
def _law(
    text: str, states: tuple[tuple[str, LinkState], ...], angular: bool, signals: tuple[tuple[str, str], ...]
) -> Law:
    """The law of a text, parsed once for all links that have it."""
    law = Law.parse(text, dict(states), signals=dict(signals))
    return replace(law, angular=True) if angular else law
