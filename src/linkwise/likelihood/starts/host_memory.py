"""Starting values of structures with hosts whose links have memory.

The smoother of `hosts` gives the elongation and the force of every link whose law is not known. Along these the links are
identified as if they stood on a rig (`memory`), together. Of several records the one that moves most is used: at a low level a
joint hardly slips.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from linkwise.arrays import Floats
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
from linkwise.signals.noise import channel_noise
from linkwise.signals.states import smoothed

_HARDLY_MORE = 1.3  # times the misfit of the best random start
_APART = 0.6  # relative distance of a parameter beyond which starts are far from each other: a factor of 2.5
_SPREAD = 10  # of these at most


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
        The lowest minimum of what the laws leave of the forces of links, then starts far from each other that leave hardly
        more: beside a host these forces are known roughly.

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
    """Starts along one motion, in all parameters of the structure; those in no open link keep their starts."""
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
        for valley in (*search.valleys()[:1], *_spread(search))
        for values in [dict(zip((p.name for p in search.structure.parameters), valley.values, strict=True))]
    )


def _spread(search: MemorySearch) -> tuple[Valley, ...]:
    """Random starts far from each other that leave hardly more of the forces than the best of them, that first."""
    if not search.curved:
        return ()
    chosen: list[tuple[Floats, Valley]] = []
    for curved in search.trials():
        valley = Valley(*search.solved(curved))
        if chosen and valley.misfit > _HARDLY_MORE * chosen[0][1].misfit:
            break
        if all(_are_apart(curved, earlier) for earlier, _ in chosen):
            chosen.append((curved, valley))
    return tuple(valley for _, valley in chosen[:_SPREAD])


def _are_apart(first: Floats, second: Floats) -> bool:
    """Whether a parameter of one start is more than a few times that of another."""
    sizes = np.maximum(np.maximum(np.abs(first), np.abs(second)), np.finfo(float).tiny)
    return bool(np.max(np.abs(first - second) / sizes) > _APART)
