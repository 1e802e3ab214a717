"""Starting values of links with memory, one link after another, where inverse dynamics gives the force of each.

Elongations are known up to drift only where velocities or accelerations were measured. A filter that takes the drift away
takes slow motion with it, which a state may need. The force of a link tells which filter is best: each link is searched as if
it stood on a rig, with several filters of its motion, and those that leave least of the force are kept. Slow parts of the
forces, which the filtered motion lacks, are left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.starts.inverse_dynamics import LinkSignals, link_signals
from linkwise.likelihood.starts.memory import MOST_SAMPLES, MemorySearch, Valley
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.signals.noise import channel_noise
from linkwise.signals.states import drift_frequency, highpass, integral, smoothed

_CUTOFFS = tuple(
    2.0 ** (-0.5 * k) for k in range(10)
)  # times the frequency below which all is drift elsewhere
_WORTHWHILE = 0.8  # of the misfit of a rough start: what a search leaves that did not merely follow the drift
_MOST = 3  # minima of a link whose elongation was measured


def memory_starts_by_links(
    record: Record, structure: Structure, given: Mapping[str, float]
) -> tuple[Valley, ...]:
    """Starting values of all parameters of a structure whose masses are known and move as `needs_integration` says.

    Parameters
    ----------
    record : Record
        The record.
    structure : Structure
        The structure.
    given : mapping of str to float
        Starting values by name of the parameter.

    Returns
    -------
    tuple of Valley
        Minima of what the laws leave of the forces of the links, the lowest of every link together first.
    """
    record = record[:MOST_SAMPLES]
    sigma = channel_noise(record)
    signals = link_signals(record, structure, sigma)
    shown = {f"f:{link.name}": force for link, force in zip(structure.links, signals.force, strict=True)}
    shown |= {
        name: smoothed(record, name, sigma[name])[0]
        for name in record.channels
        if name.startswith(("f:", "state:"))
    }
    by_group = [(group, _valleys(structure, group, signals, shown, given)) for group in _connected(structure)]
    valleys = []
    for rank in range(max(len(own) for _, own in by_group)):
        chosen = [(group, own[min(rank, len(own) - 1)]) for group, own in by_group]
        values = {name: value for group, valley in chosen for name, value in _named(structure, group, valley)}
        misfit = float(np.mean([valley.misfit for _, valley in chosen]))
        valleys.append(Valley(np.array([values[p.name] for p in structure.parameters]), misfit))
    return tuple(valleys)


def _connected(structure: Structure) -> tuple[tuple[int, ...], ...]:
    """Numbers of the links that have unknowns, those that share one together."""
    groups: list[set[int]] = []
    for parameter in structure.parameters:
        links = {link for link, _ in parameter.members}
        together = [group for group in groups if group & links]
        groups = [group for group in groups if not group & links] + [links.union(*together)]
    return tuple(tuple(sorted(group)) for group in groups)


def _alone(structure: Structure, group: tuple[int, ...]) -> Structure:
    """The links of a group on a rig."""
    links = tuple(replace(structure.links[number], between=("base", "ground")) for number in group)
    return replace(structure, masses=(), links=links)


def _named(structure: Structure, group: tuple[int, ...], valley: Valley) -> list[tuple[str, float]]:
    parameters = _alone(structure, group).parameters
    return list(zip((p.name for p in parameters), valley.values.tolist(), strict=True))


def _valleys(
    structure: Structure,
    group: tuple[int, ...],
    signals: LinkSignals,
    shown: Mapping[str, Floats],
    given: Mapping[str, float],
) -> tuple[Valley, ...]:
    """Starts for the links of a group, with the filters that leave least of their forces."""
    alone, chosen = _alone(structure, group), list(group)
    own = {name: values for name, values in shown.items() if _belongs(name, alone)}

    def search(cutoff: float) -> MemorySearch:
        d, v = _without_drift(signals.d[chosen], signals.v[chosen], signals.step, cutoff)
        cosines = int(2.0 * cutoff * signals.step * len(d.T)) + 1
        return MemorySearch(alone, signals.step, d.T, v.T, (), own, given, slow=cosines)

    if not signals.integration_order[chosen].any():
        d, v = signals.d[chosen], signals.v[chosen]
        return MemorySearch(alone, signals.step, d.T, v.T, (), own, given).valleys()[:_MOST]
    highest = min(
        drift_frequency(np.gradient(signals.v[number], signals.step), 1.0 / signals.step) for number in group
    )
    searches = sorted((search(part * highest) for part in _CUTOFFS), key=lambda search: search.rough().misfit)
    rough, refined = searches[0].rough(), searches[0].valleys()[0]
    first = (refined, rough) if refined.misfit < _WORTHWHILE * rough.misfit else (rough, refined)
    return *first, searches[1].rough()


def _without_drift(d: Floats, v: Floats, step: float, cutoff: float) -> tuple[Floats, Floats]:
    """Elongations and rates (L, N) above a frequency; each integral is filtered, as that of a drift grows."""
    rates = np.stack([highpass(row, 1.0 / step, cutoff) for row in v])
    return np.stack([highpass(integral(row, step), 1.0 / step, cutoff) for row in rates]), rates


def _belongs(channel: str, structure: Structure) -> bool:
    """Whether a channel shows the force or a state of one of the links."""
    owner = channel.partition(":")[2]
    return any(owner == link.name or owner.startswith(f"{link.name}.") for link in structure.links)
