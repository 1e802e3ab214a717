"""SI units of channels, with those that laws give to the states of their links."""

from __future__ import annotations

from linkwise.model.structure import Structure
from linkwise.records.channel import Channel
from linkwise.records.record import Record


def channel_unit(record: Record, name: str, structure: Structure) -> str:
    """The SI unit of a channel of a record; empty for a state without unit.

    Parameters
    ----------
    record : Record
        The record.
    name : str
        One of its channels.
    structure : Structure
        The structure, whose link a channel such as "state:piezo.V" belongs to.

    Returns
    -------
    str
        The unit, such as "V".
    """
    channel = Channel.parse(name)
    if channel.kind != "state":
        return record.unit(name)
    return structure.link(channel.link).law.state_units[channel.mass.rpartition(".")[2]].replace("?", "")
