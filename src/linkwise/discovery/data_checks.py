"""What can be said of a discovery before any time is spent: what the records cannot show.

Masses at rest or moving together, records that are too short, no motion at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from scipy.sparse.csgraph import connected_components

from linkwise.arrays import Floats
from linkwise.discovery.candidates import Candidates
from linkwise.display import enumerated
from linkwise.errors import IdentificationError
from linkwise.records.channel import Channel
from linkwise.records.record import Record
from linkwise.signals.noise import channel_noise

_AT_REST = 0.1  # of the noise power (-10 dB): a motion below it cannot be seen
_FAINT = 3.0  # times the noise power (5 dB): a motion below it determines little
_SEPARATE = 30.0  # times the noise power (15 dB) that the difference of two motions should have
# times the noise power (5 dB) by which one motion should differ from all multiples of another
_IN_PROPORTION = 3.0
_STIFF = 0.05  # of the power of the smaller motion: two masses on a stiff link differ by less
_LEAST_SAMPLES = 4  # per candidate, over all masses: below it a regression on all candidates fits noise
_ENOUGH_SAMPLES = 20
_NO_MOTION = (
    "there is no motion above the noise in any channel, so no structure can be found; excite the structure more strongly, or "
    "check the range and the units of the sensors. In a record of about three samples a period motion looks like noise: "
    "sample faster, or state the noise of the sensors"
)


@dataclass(frozen=True)
class DataChecks:
    """What the records cannot show, as sentences in `remarks`, and the masses concerned.

    Masses `at_rest` did not move. Masses that are `collinear` moved so much like another one that links to either can be
    exchanged; those `in_proportion` to it rather than by as much as it.
    """

    remarks: tuple[str, ...]
    at_rest: tuple[str, ...]
    collinear: frozenset[str]
    in_proportion: frozenset[str]


def check_data(records: Sequence[Record], candidates: Candidates) -> DataChecks:
    """What these records cannot show of the candidates.

    Raises IdentificationError if nothing can be discovered: a mass without a sensor, no motion above the noise, fewer samples
    than a regression on all candidates needs.
    """
    if candidates.hosts:  # whose motion follows from fewer sensors than places
        return _check_hosted(records, candidates)
    names = [mass.name for mass in candidates.masses]
    _require_sensors(records, names)
    ratios = np.max([_signal_to_noise(record, names) for record in records], axis=0)
    at_rest = [name for name, ratio in zip(names, ratios, strict=True) if ratio < _AT_REST]
    if len(at_rest) == len(names):
        raise IdentificationError(_NO_MOTION)
    remarks = []
    if at_rest:
        verb, pronoun = ("is", "it") if len(at_rest) == 1 else ("are", "them")
        remarks.append(
            f"{enumerated(at_rest)} did not move above the noise and {verb} left out: a link to {pronoun} looks like "
            f"one to the ground. Excite the structure nearer to {pronoun}."
        )
    faint = [name for name, ratio in zip(names, ratios, strict=True) if _AT_REST <= ratio < _FAINT]
    if faint:
        remarks.append(
            f"{enumerated(faint)} hardly moved above the noise: weak terms of links there will be missed."
        )
    remarks += _check_length(records, candidates)
    moving = [name for name in names if name not in at_rest]
    differences, deviations = np.max([_separations(record, moving) for record in records], axis=0)
    together = _groups(moving, differences, _SEPARATE)
    for group, ratio in together:
        remarks.append(
            f"{enumerated(group)} moved together, with differences {_level(ratio)}: a link to one of them may be found as a "
            "link to another. Excite them one at a time."
        )
    alike = [set(group) for group, _ in together]
    proportional = _groups(moving, deviations, _IN_PROPORTION)
    in_proportion = [pair for pair in proportional if not any(own.issuperset(pair[0]) for own in alike)]
    for group, ratio in in_proportion:
        remarks.append(
            f"{enumerated(group)} moved in proportion, as in one mode, with deviations {_level(ratio)}: other links may "
            "explain such motions as well. Excite more than one mode."
        )
    collinear = frozenset(name for group, _ in (*together, *in_proportion) for name in group)
    only = frozenset(name for group, _ in in_proportion for name in group)
    return DataChecks(tuple(remarks), tuple(at_rest), collinear, in_proportion=only)


def _check_hosted(records: Sequence[Record], candidates: Candidates) -> DataChecks:
    """What records cannot show of candidates between points of hosts; which of them are alike, the fit says."""
    measured = [name for name in candidates.places if any(record.motions_of(name) for record in records)]
    if not measured:
        raise IdentificationError(
            f"no channel measures the motion of a mass or point, which are {enumerated(candidates.places)}; add a channel "
            f"a:{candidates.places[0]}",
            arguments=("channels",),
        )
    if all(ratio < _AT_REST for record in records for ratio in _signal_to_noise(record, measured)):
        raise IdentificationError(_NO_MOTION)
    missed = [name for name in candidates.places if name not in measured]
    remark = (
        f"No channel measures the motion of {enumerated(missed)}: it follows from the modes and the other channels, and "
        "links there are determined less well."
    )
    return DataChecks((remark,) if missed else (), (), frozenset(), frozenset())


def _level(ratio: float) -> str:
    return f"down to {10.0 * np.log10(ratio):.0f} dB above the noise" if ratio > 1.0 else "below the noise"


def _require_sensors(records: Sequence[Record], names: Sequence[str]) -> None:
    for record in records:
        unseen = [name for name in names if not record.motions_of(name)]
        if unseen:
            raise IdentificationError(
                f"no channel measures the motion of {enumerated(unseen)}, and links to a mass that is not measured cannot be "
                f"discovered; add a channel x:{unseen[0]}, or identify a structure of known links",
                arguments=("channels",),
            )


def _check_length(records: Sequence[Record], candidates: Candidates) -> list[str]:
    """A remark on a short record; IdentificationError for one that is too short."""
    masses, needed = len(candidates.masses), len(candidates.entries)
    samples = sum(len(record) for record in records) * masses
    if samples < _LEAST_SAMPLES * needed:
        raise IdentificationError(
            f"the record is too short: {samples} samples over {masses} masses for {needed} candidates, which need at least "
            f"{_LEAST_SAMPLES} each; record {-(-_LEAST_SAMPLES * needed // masses)} samples or more, or offer fewer terms"
        )
    few = f"{samples} samples for {needed} candidates are few: weak terms will be missed; record for longer."
    return [few] if samples < _ENOUGH_SAMPLES * needed else []


def _signal_to_noise(record: Record, names: Sequence[str]) -> list[float]:
    """The power of the motion of each mass over that of the noise, in its best channel; 0 without one."""
    noise = channel_noise(record)

    def ratio(channel: Channel) -> float:
        power = float(np.nanvar(record.channel(channel)))
        return power / noise[channel] ** 2 - 1.0 if noise[channel] > 0.0 else 0.0

    return [max(map(ratio, record.motions_of(name)), default=0.0) for name in names]


def _groups(names: Sequence[str], ratios: Floats, separate: float) -> list[tuple[list[str], float]]:
    """Groups of masses of which not all pairs have a ratio (n, n) from `separate` on; with each the least of its ratios."""
    count, label = connected_components(ratios < separate, directed=False)
    groups = (np.flatnonzero(label == number).tolist() for number in range(count))
    several = [group for group in groups if len(group) > 1]
    return [([names[k] for k in group], float(ratios[np.ix_(group, group)].min())) for group in several]


def _separations(record: Record, names: Sequence[str]) -> Floats:
    """(2, n, n) the power by which each displacement differs from another, and from the nearest multiple of it.

    Over that of its noise; infinite where they clearly differ, and where one was not measured.
    """
    noise, ratios = channel_noise(record), np.full((2, len(names), len(names)), np.inf)
    for row, column in permutations(range(len(names)), 2):
        channels = [f"x:{names[number]}" for number in (row, column)]
        if not set(channels) <= set(record.channels):
            continue
        both = np.array([record.channel(channel) for channel in channels])
        x, y = both[:, np.isfinite(both).all(axis=0)]
        x, y = x - x.mean(), y - y.mean()
        of_x, of_y = (float(noise[channel]) ** 2 for channel in channels)
        power, moved = float(np.mean(x**2)) - of_x, float(np.mean(y**2)) - of_y
        difference, variance = float(np.mean((x - y) ** 2)) - of_x - of_y, of_x + of_y
        if difference < _STIFF * min(power, moved) and variance > 0.0:
            ratios[0, row, column] = difference / variance
        if power > 0.0 and moved > 0.0:
            product = float(np.mean(x * y))
            deviation, variance = power - product**2 / moved, of_x + (product / moved) ** 2 * of_y
            if deviation < _STIFF * power and variance > 0.0:
                ratios[1, row, column] = deviation / variance
    ratios[1] = np.minimum(ratios[1], ratios[1].T)
    return ratios
