"""SI units of channels: of places that turn, and of states of links, a structure tells them."""

from __future__ import annotations

from dataclasses import replace

from linkwise.errors import RecordError
from linkwise.model.law import unit_dimension
from linkwise.model.structure import Structure
from linkwise.records.channel import ANGULAR_UNITS, KINDS, Channel
from linkwise.records.record import Record


def places_of(kind: str, structure: Structure) -> tuple[str, ...]:
    """What channels of a kind may name in a structure."""
    match KINDS[kind].of:
        case "link":
            return tuple(link.name for link in structure.links)
        case "state":
            return tuple(f"{link.name}.{state}" for link in structure.links for state in link.law.states)
        case "signal":
            return tuple(structure.signals)
        case "mass":
            return structure.places


def unit_in(structure: Structure, name: str) -> str:
    """The SI unit of a channel of a structure, such as "V" or "rad/s"; empty for a state without unit."""
    channel = Channel.parse(name)
    if channel.kind == "state":
        return structure.link(channel.link).law.state_units[channel.state].replace("?", "")
    if channel.kind == "signal":
        return structure.signals.get(channel.place, "")
    if not structure.rotations:
        return channel.unit
    links = {link.name for link in structure.links if link.law.angular}
    turns = channel.place in (links if channel.of_link else structure.rotations)
    return channel.angular_unit if turns else channel.unit


def in_units_of(record: Record, structure: Structure) -> Record:
    """A record with the units of signals and of places of a structure that turn, whose channels it may have without a unit,
    and without signals that no law names.

    RecordError if the channel of a signal is missing or stated in another kind of unit, or a channel is stated in units of a
    rotation and its place moves in m, or the other way round.
    """
    named = [c for c in record.channels if c.kind != "signal" or c.place in structure.signals]
    if len(named) < len(record.channels):
        record = record.select(named)
    if structure.signals:
        record = replace(record, units={**record.units, **_units_of_signals(record, structure)})
    if not structure.rotations and ANGULAR_UNITS.isdisjoint(record.units.values()):
        return record
    units: dict[str, str] = {}
    for channel in record.channels:
        if not channel.angular_unit:
            continue
        unit, stated = unit_in(structure, channel), record.units.get(channel)
        if stated is not None and stated != unit:
            raise RecordError(_contradiction(channel, stated, unit), channel=channel)
        if unit != channel.unit:
            if channel.relative:
                raise RecordError(
                    f"{channel.place} turns, and the base moves in m: nothing turns relative to it; name the channel "
                    f"{channel.kind}:{channel.place}",
                    channel=channel,
                )
            units[channel] = unit
    return replace(record, units={**record.units, **units}) if units else record


def signals_of(record: Record, structure: Structure) -> tuple[str, ...]:
    """The signals of a record, those that the laws of a structure name first: in a search others may come to be named."""
    recorded = [channel.place for channel in record.channels if channel.kind == "signal"]
    return tuple(dict.fromkeys((*structure.signals, *recorded)))


def _units_of_signals(record: Record, structure: Structure) -> dict[str, str]:
    """The units of the channels of the signals that the laws of a structure name."""
    units: dict[str, str] = {}
    for name, unit in structure.signals.items():
        channel = Channel("signal", name)
        if channel not in record.channels:
            raise RecordError(
                f"a law names the signal {name}, and the record lacks its channel; it has {', '.join(record.channels)}. Name "
                f"a column {channel}[{unit}], or map one, as in channels={{'{channel}': 'COLUMN'}}",
                channel=channel,
                arguments=("channels",),
            )
        stated = record.units.get(channel, unit)
        if unit_dimension(stated) != unit_dimension(unit):
            message = f"is stated in {stated}, and the structure has the signal {name} in {unit}: correct one of the two"
            raise RecordError(message, channel=channel)
        units[channel] = unit
    return units


def _contradiction(channel: Channel, stated: str, unit: str) -> str:
    if channel.of_link:
        return f"is stated in a unit that converts to {stated}, and the force of this link is in {unit}: correct the unit"
    turns = unit == channel.angular_unit
    contrary, (host, _, point) = "m" if turns else "rad", channel.place.rpartition(".")
    place = f"point in its host: units = {{ {point} = " if host else "mass: "
    remedy = f"correct the unit of the channel, or that of the {place}"
    remedy += f'"{contrary}" }}' if host else f'unit = "{contrary}"'
    how = "turns" if turns else "moves along a line"
    return f"is stated in a unit that converts to {stated}, and {channel.place} {how}, so it is in {unit}: {remedy}"
