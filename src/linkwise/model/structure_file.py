"""Structures as TOML files; a structure that is written and read back is the same to the last bit.

A coefficient (or a mass) is a number, a string with a unit ("30 kN/m"), "unknown", a table of `start`, `lower`, `upper` for an
unknown with start value and bounds, a table of `start` and `sigma` for one that is known to within a standard deviation, or
"=link.coefficient" for a shared one. A state of a link is the text of its rate, or a
table of `rate`, `initial` and `unit`. `signals = { u = "V" }` at the top names recorded signals that laws depend on, with
their units. A mass with `unit = "rad"`, or in kg m^2, turns.

Tables of links are decoded strictly. Where only the units of coefficients give the
unit of a state ("43 nF" that of a voltage), they are read first.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import msgspec

from linkwise.errors import LinkwiseError, StructureError, expect, located
from linkwise.expression.dimensions import Dimension
from linkwise.model.coefficient import Coefficient, coefficient_of
from linkwise.model.host import Host, rotations_of
from linkwise.model.host_file import HostTable, host_of
from linkwise.model.law import Law, LinkState, coefficient_dimensions, unit_dimension
from linkwise.model.link import ANGLE, LENGTH, MASS_UNITS, Link, Mass, is_inertia
from linkwise.model.named_laws import NamedLaw, is_law_name, named_law
from linkwise.model.structure import Structure
from linkwise.model.toml import decode, parse_toml, read_toml_text, toml_text
from linkwise.output import atomic_file

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
    entry: LinkTable, index: int, source: str, rotations: Collection[str], signals: Mapping[str, str]
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
            inferred = coefficient_dimensions(law, known)
            units_of = {name: str(inferred[name]) for name in open_states if inferred[name]}
            states |= {name: replace(states[name], unit=unit) for name, unit in units_of.items()}
            law = _law(law.text, tuple(states.items()), angular, inputs)
        units = law.units
    except LinkwiseError as error:
        if isinstance(error, StructureError) and error.where:
            raise
        raise StructureError(f"invalid law: {error}", where) from None
    coefficients = dict.fromkeys(law.coefficients if named else (), Coefficient.unknown())
    for name, given in entry.coefficients.items():
        coefficients[name] = coefficient_of(given, units.get(name, ""), source, f"{path}.coefficients.{name}")
    if named is not None:
        for name, coefficient in coefficients.items():
            with located(f"{source}, {path}.coefficients.{name}"):
                coefficients[name] = named.within_bounds(name, coefficient)
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


_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


class MassTable(msgspec.Struct, forbid_unknown_fields=True):
    name: str
    mass: float | str | dict[str, Any]
    unit: str = ""


class _Table(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """A structure; one with hosts needs neither masses nor links."""

    name: str = ""
    signals: dict[str, str] = {}
    host: list[HostTable] = []
    mass: list[MassTable] = []
    link: list[LinkTable] = []


class _PartialTable(_Table, kw_only=True):
    mass: list[MassTable]


@dataclass(frozen=True)
class PartialStructure:
    """The known part of a structure that is to be discovered; a mass need not have a link.

    Attributes
    ----------
    masses : tuple of Mass
        The masses.
    links : tuple of Link
        The links that are known to be there.
    hosts : tuple of Host
        The hosts.

    See Also
    --------
    read_partial_structure : Read it from a file.
    discover : Discover the rest.

    Examples
    --------
    >>> import linkwise as lw
    >>> lw.model.PartialStructure((lw.Mass("m1", 1.0),), ()).masses[0].name
    'm1'
    """

    masses: tuple[Mass, ...]
    links: tuple[Link, ...]
    hosts: tuple[Host, ...] = ()

    @property
    def places(self) -> tuple[str, ...]:
        """Names of the points of hosts and of the masses: where links end and sensors sit."""
        points = [point for host in self.hosts for point in host.points]
        return (*points, *(mass.name for mass in self.masses))


def read_structure(path: str | Path) -> Structure:
    """Read a structure from a TOML file.

    Parameters
    ----------
    path : str or Path
        The file, or a result folder, of which it is structure.toml.

    Returns
    -------
    Structure
        The structure in SI units.

    Raises
    ------
    StructureError
        If the file cannot be read or is not valid; the error names the file and the line or key.

    See Also
    --------
    write_structure : Write a structure to a file.
    parse_structure : Read a structure from a text.

    Examples
    --------
    >>> import linkwise as lw
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder) / "chain.toml"
    ...     lw.write_structure(lw.bnes_chain(2), path)
    ...     lw.read_structure(path) == lw.bnes_chain(2)
    True
    """
    expect("read_structure(path): path", path, str, Path)
    path = _of_folder(Path(path))
    return parse_structure(read_toml_text(path, StructureError), str(path))


def _of_folder(path: Path) -> Path:
    """The file itself, of a result folder its structure.toml; StructureError for a folder without one."""
    file = path / "structure.toml" if path.is_dir() else path
    if file != path and not file.exists():
        raise StructureError(
            "there is no structure.toml in this folder: give a result folder of identify or discover, or a structure file",
            str(path),
        )
    return file


def read_partial_structure(path: str | Path) -> PartialStructure:
    """Read the known part of a structure that is to be discovered from a TOML file.

    Parameters
    ----------
    path : str or Path
        A structure file in which links may be missing.

    Returns
    -------
    PartialStructure
        Its masses, links and hosts.

    Raises
    ------
    StructureError
        As of `read_structure`.

    Examples
    --------
    >>> import linkwise as lw
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder) / "masses.toml"
    ...     _ = path.write_text('mass = [{ name = "m1", mass = "10 g" }]')
    ...     lw.model.read_partial_structure(path).masses[0].mass.value
    0.01
    """
    path = _of_folder(Path(path))
    source = str(path)
    tables = parse_toml(read_toml_text(path, StructureError), source, StructureError)
    table = decode(tables, _Table if "host" in tables else _PartialTable, source, "", StructureError)
    return PartialStructure(*_parts(table, source))


def write_structure(structure: Structure, path: str | Path) -> None:
    """Write a structure to a TOML file, from which `read_structure` reads the same structure.

    Parameters
    ----------
    structure : Structure
        The structure.
    path : str or Path
        The file; replaced if it exists.

    Raises
    ------
    OutputError
        If the path is a folder or a device, or the file cannot be written.

    See Also
    --------
    format_structure : The text that is written.

    Examples
    --------
    >>> import linkwise as lw
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder) / "chain.toml"
    ...     lw.write_structure(lw.bnes_chain(2), path)
    ...     path.read_text().splitlines()[0]
    'name = "bistable chain of 2 masses"'
    """
    expect("write_structure(structure, path): structure", structure, Structure)
    expect("write_structure(structure, path): path", path, str, Path)
    with atomic_file(Path(path)) as own:
        own.write_text(format_structure(structure), encoding="utf-8", newline="\n")


def parse_structure(text: str, source: str = "structure") -> Structure:
    """Read a structure from a TOML text.

    Parameters
    ----------
    text : str
        The text of a structure file.
    source : str, optional
        Name of the text in error messages.

    Returns
    -------
    Structure
        The structure in SI units.

    Raises
    ------
    StructureError
        If the text is not valid; the error names the line or key.

    Examples
    --------
    >>> import linkwise as lw
    >>> text = lw.model.format_structure(lw.bnes_chain(2))
    >>> lw.parse_structure(text) == lw.bnes_chain(2)
    True
    """
    tables = parse_toml(text, source, StructureError)
    table = decode(tables, _Table, source, "", StructureError)
    parts = _parts(table, source)
    try:
        return Structure(table.name, *parts)
    except StructureError as error:
        raise StructureError(error.message, f"{source}, {error.where}" if error.where else source) from None


def _parts(table: _Table, source: str) -> tuple[tuple[Mass, ...], tuple[Link, ...], tuple[Host, ...]]:
    hosts = tuple(host_of(entry, index, source) for index, entry in enumerate(table.host))
    masses = tuple(mass_of(entry, index, source) for index, entry in enumerate(table.mass))
    rotations = rotations_of(hosts, masses)
    tables, signals = enumerate(table.link), table.signals
    links = tuple(link_of(entry, index, source, rotations, signals) for index, entry in tables)
    require_named(table.signals, links, source)
    return masses, links, hosts


def require_named(signals: Iterable[str], links: Sequence[Link], source: str) -> None:
    """Raise StructureError for a signal that the law of none of the links names."""
    for name in signals:
        if not any(name in link.law.signals for link in links):
            message = f"no law names the signal {name}: write it in one, as in (c0 + cu*{name})*v, or take it out of `signals`"
            raise StructureError(message, f"{source}, signals.{name}")


def format_structure(structure: Structure) -> str:
    """The TOML text of a structure.

    Parameters
    ----------
    structure : Structure
        The structure.

    Returns
    -------
    str
        The text of its structure file.

    Examples
    --------
    >>> import linkwise as lw
    >>> print(lw.model.format_structure(lw.bnes_chain(2)).splitlines()[0])
    name = "bistable chain of 2 masses"
    """
    signals = ", ".join(f"{name} = {toml_text(unit)}" for name, unit in structure.signals.items())
    blocks = [f"name = {toml_text(structure.name)}\n" + (f"signals = {{ {signals} }}\n" if signals else "")]
    blocks += [_host_text(host, structure) for host in structure.hosts]
    for mass in structure.masses:
        if mass.name in structure.modes:
            continue
        unit = f"unit = {toml_text(mass.unit)}\n" if mass.unit != LENGTH else ""
        value = _coefficient_text(mass.mass)
        blocks.append(f"[[mass]]\nname = {toml_text(mass.name)}\n{unit}mass = {value}\n")
    for link in structure.links:
        if link.name in structure.modes:
            continue
        pairs = _pairs_text(link.coefficients)
        ends = ", ".join(toml_text(end) for end in link.between)
        blocks.append(
            f"[[link]]\nname = {toml_text(link.name)}\nbetween = [{ends}]\n"
            f"law = {toml_text(link.law.text)}\n{_states_text(link)}coefficients = {{ {pairs} }}\n"
        )
    return "\n".join(blocks)


def _host_text(host: Host, structure: Structure) -> str:
    """The table of a host, with the frequencies and damping that the structure has now."""
    host = host.as_in(structure.link)
    modes = []
    for mode in host.modes:
        shape = _pairs_text({point: mode.shape_value(point) for point in mode.shape})
        modes.append(
            f"    {{ frequency = {_coefficient_text(mode.frequency)}, damping = {_coefficient_text(mode.damping)}, "
            f"shape = {{ {shape} }} }},\n"
        )
    damping = "".join(
        f"    {{ modes = [{first}, {second}], damping = {_coefficient_text(entry)} }},\n"
        for (first, second), entry in host.entries.items()
    )
    between = f"damping = [\n{damping}]\n" if damping else ""
    turning = [point for point in host.modes[0].shape if point in host.modes[0].rotations]
    rotations = ", ".join(f'{_key(point)} = "rad"' for point in turning)
    between += f"units = {{ {rotations} }}\n" if rotations else ""
    return f"[[host]]\nname = {toml_text(host.name)}\n{between}modes = [\n{''.join(modes)}]\n"


def mass_of(entry: MassTable, index: int, source: str) -> Mass:
    """The mass of entry `index` of the file `source`; StructureError with the place of what is wrong."""
    path = f"mass[{index}]"
    where = f'{source}, {path} "{entry.name}"'
    unit = entry.unit or (ANGLE if is_inertia(entry.mass) else LENGTH)
    coefficient = coefficient_of(entry.mass, MASS_UNITS.get(unit, "?"), source, f"{path}.mass")
    with located(where):
        return Mass(entry.name, coefficient, unit)


def _states_text(link: Link) -> str:
    """The line of the states of a link; empty without memory."""
    entries = []
    for name, state in link.states.items():
        fields = [f"rate = {toml_text(state.rate)}"]
        if state.initial != 0.0:
            initial = toml_text("unknown") if state.initial is None else repr(state.initial)
            fields.append(f"initial = {initial}")
        if state.unit:
            fields.append(f"unit = {toml_text(state.unit)}")
        text = toml_text(state.rate) if len(fields) == 1 else f"{{ {', '.join(fields)} }}"
        entries.append(f"{_key(name)} = {text}")
    return f"states = {{ {', '.join(entries)} }}\n" if entries else ""


def _coefficient_text(coefficient: Coefficient) -> str:
    if coefficient.same_as is not None:
        return toml_text(f"={coefficient.same_as}")
    if coefficient.known:
        return repr(coefficient.value)
    values = (coefficient.value, coefficient.lower, coefficient.upper, coefficient.sigma)
    pairs = [
        f"{name} = {value!r}"
        for name, value in zip(("start", "lower", "upper", "sigma"), values, strict=True)
        if value is not None and math.isfinite(value)
    ]
    return f"{{ {', '.join(pairs)} }}" if pairs else '"unknown"'


def _pairs_text(coefficients: Mapping[str, Coefficient]) -> str:
    """The entries of a table of coefficients."""
    return ", ".join(f"{_key(name)} = {_coefficient_text(value)}" for name, value in coefficients.items())


def _key(name: str) -> str:
    return name if _BARE_KEY.fullmatch(name) else toml_text(name)
