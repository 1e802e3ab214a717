"""Starting values of structures with hosts whose links have memory.

The smoother of `hosts` gives the elongation and the force of every link whose law is not known. Along these the links are
identified as if they stood on a rig (`memory`), together. Of several records the one that moves most is used: at a low level a
joint hardly slips.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from linkwise.errors import IdentificationError
from linkwise.likelihood.starts.hosts import (
    TOO_LITTLE,
    HostMotion,
    host_motions,
    require_supported,
)
from linkwise.likelihood.starts.memory import MOST_SAMPLES, MemorySearch, Valley
from linkwise.likelihood.starts.mode_tuning import tuned_part, with_starts
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.signals.channel_noise import channel_noise
from linkwise.signals.integrate import smoothed


def host_memory_starts(
    records: Sequence[Record], structure: Structure, given: Mapping[str, float]
) -> tuple[Valley, ...]:
    """Starting values of all parameters of a structure with hosts.

    Parameters
    ----------
    records : sequence of Record
        The records, with the same channels.
    structure : Structure
        The structure.
    given : mapping of str to float
        Starting values by name of the parameter.

    Returns
    -------
    tuple of Valley
        Minima of what the laws leave of the forces of links, the lowest first.

    Raises
    ------
    IdentificationError
        If the record does not determine the motion.
    """
    record = _liveliest(records)
    require_supported(record, structure)
    record, sigma = record[:MOST_SAMPLES], channel_noise(record)
    structure = with_starts(structure, dict(given))
    try:
        tuned, linear = tuned_part(record, structure, sigma)
        by_motion = [
            _valleys(motion, record, structure, {**given, **tuned}, sigma)
            for motion in host_motions(record, linear, sigma)
        ]
    except np.linalg.LinAlgError:
        raise IdentificationError(TOO_LITTLE) from None
    return min(by_motion, key=lambda valleys: valleys[0].misfit)


def _liveliest(records: Sequence[Record]) -> Record:
    """The record that moves most: by the power of its responses, each relative to that in all records."""
    powers = np.array([[np.nanvar(record.channel(name)) for name in record.responses] for record in records])
    return records[
        int(np.argmax((powers / np.maximum(powers.max(axis=0), np.finfo(float).tiny)).sum(axis=1)))
    ]


def _valleys(
    motion: HostMotion,
    record: Record,
    structure: Structure,
    given: Mapping[str, float],
    sigma: Mapping[str, float],
) -> tuple[Valley, ...]:
    """Minima along one motion, in all parameters of the structure; those in no open link keep their starts."""
    fixed: dict[str, float] = {}
    for parameter in structure.parameters:
        if any(link in motion.open for link, _ in parameter.members):
            continue
        start = given.get(parameter.name, parameter.start)
        assert start is not None  # which the smoother needs of modes and masses
        fixed[parameter.name] = start
    names = [structure.links[number].name for number in motion.open]
    shown = {f"f:{name}": motion.signals.force[k] for name, k in zip(names, motion.open, strict=True)}
    measured = [
        name for name in record.channels if name.startswith(("f:", "state:"))
    ]  # before what the smoother infers
    shown |= {name: smoothed(record, name, sigma[name])[0] for name in measured}
    search = MemorySearch(
        structure.with_values(fixed) if fixed else structure,
        record.step,
        motion.signals.d.T,
        motion.signals.v.T,
        (),
        shown,
        given,
    )
    return tuple(
        Valley(np.array([(fixed | values)[p.name] for p in structure.parameters]), valley.misfit)
        for valley in search.valleys()
        for values in [dict(zip((p.name for p in search.structure.parameters), valley.values, strict=True))]
    )
