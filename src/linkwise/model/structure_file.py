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
    parts = structure_tables(structure).items()
    blocks = [_lines({name: part for name, part in parts if not isinstance(part, list)})]
    listed = ((kind, tables) for kind, tables in parts if isinstance(tables, list))
    return "\n".join(
        [*blocks, *(f"[[{kind}]]\n{_lines(table)}" for kind, tables in listed for table in tables)]
    )


def structure_tables(structure: Structure) -> dict[str, Any]:
    """The tables of the file of a structure as plain data."""
    of_modes = structure.modes
    return _stated(
        name=structure.name,
        signals=structure.signals,
        host=[_host_table(host.as_in(structure.link)) for host in structure.hosts],
        mass=[_mass_table(mass) for mass in structure.masses if mass.name not in of_modes],
        link=[_link_table(link) for link in structure.links if link.name not in of_modes],
    )


def _stated(**entries: Any) -> dict[str, Any]:
    """The entries of a table that say something."""
    return {key: value for key, value in entries.items() if value not in (None, {}, [])}


def _mass_table(mass: Mass) -> dict[str, Any]:
    return _stated(name=mass.name, unit=None if mass.unit == LENGTH else mass.unit, mass=mass.mass.plain)


def _host_table(host: Host) -> dict[str, Any]:
    modes = []
    for mode in host.modes:
        shape = {point: mode.shape_value(point).plain for point in mode.shape}
        modes.append({"frequency": mode.frequency.plain, "damping": mode.damping.plain, "shape": shape})
    damping = [{"modes": [*pair], "damping": entry.plain} for pair, entry in host.entries.items()]
    turning = [point for point in host.modes[0].shape if point in host.modes[0].rotations]
    return _stated(name=host.name, damping=damping, units=dict.fromkeys(turning, ANGLE), modes=modes)


def _link_table(link: Link) -> dict[str, Any]:
    states = {}
    for name, state in link.states.items():
        initial = "unknown" if state.initial is None else state.initial or None
        table = _stated(rate=state.rate, initial=initial, unit=state.unit or None)
        states[name] = table if len(table) > 1 else state.rate
    coefficients = {name: coefficient.plain for name, coefficient in link.coefficients.items()}
    parts = _stated(name=link.name, between=[*link.between], law=link.law.text, states=states)
    return parts | {"coefficients": coefficients}


def _lines(table: Mapping[str, Any]) -> str:
    """The lines of a table, a list of tables over several."""
    lines = []
    for name, value in table.items():
        if isinstance(value, list) and isinstance(value[0], dict):
            lines += [f"{name} = [", *(f"    {toml_text(row)}," for row in value), "]"]
        else:
            lines.append(f"{name} = {toml_text(value)}")
    return "\n".join([*lines, ""])


def mass_of(entry: MassTable, index: int, source: str) -> Mass:
    """The mass of entry `index` of the file `source`; StructureError with the place of what is wrong."""
    path = f"mass[{index}]"
    where = f'{source}, {path} "{entry.name}"'
    unit = entry.unit or (ANGLE if is_inertia(entry.mass) else LENGTH)
    coefficient = coefficient_of(entry.mass, MASS_UNITS.get(unit, "?"), source, f"{path}.mass")
    with located(where):
        return Mass(entry.name, coefficient, unit)
