"""What can be said of a discovery before any time is spent.

Masses at rest or moving together, records that are too short, no motion at all, candidate terms that were never active.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse.csgraph import connected_components

from linkwise.arrays import Floats
from linkwise.discovery.candidates import Candidates
from linkwise.errors import IdentificationError
from linkwise.model.link import BASE, GROUND
from linkwise.records.channel_units import in_units_of
from linkwise.records.record import Record
from linkwise.signals.noise import channel_noise
from linkwise.weak.displacements import MeasuredDisplacements

_AT_REST = 0.1  # of the noise power (-10 dB): a motion below it cannot be seen
_FAINT = 3.0  # times the noise power (5 dB): a motion below it determines little
_SEPARATE = 30.0  # times the noise power (15 dB) that the difference of two motions should have
# times the noise power (5 dB) by which one motion should differ from all multiples of another
_IN_PROPORTION = 3.0
_STIFF = 0.05  # of the power of the smaller motion: two masses on a stiff link differ by less
_LEAST_SAMPLES = 4  # per candidate, over all masses: below it a regression on all candidates fits noise
_ENOUGH_SAMPLES = 20
# samples in which a term is not zero: noise alone gives a few beyond the range of the motion
_LEAST_ACTIVE = 8
_NAMED = 6  # terms that a remark names
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
    collinear: tuple[str, ...]
    in_proportion: tuple[str, ...]


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
        pronoun = _pronoun(at_rest)
        remarks.append(
            f"{_enumerate(at_rest)} did not move above the noise and {_is(at_rest)} left out: a link to {pronoun} looks like "
            f"one to the ground. Excite the structure nearer to {pronoun}."
        )
    faint = [name for name, ratio in zip(names, ratios, strict=True) if _AT_REST <= ratio < _FAINT]
    if faint:
        remarks.append(
            f"{_enumerate(faint)} hardly moved above the noise: weak terms of links there will be missed."
        )
    remarks += _check_length(records, candidates)
    moving = [name for name in names if name not in at_rest]
    motions = [_displacements(record, moving) for record in records]
    together = _groups(motions, moving, _difference_to_noise, _SEPARATE)
    for group, ratio in together:
        remarks.append(
            f"{_enumerate(group)} moved together, with differences {_level(ratio)}: a link to one of them may be found as a "
            "link to another. Excite them one at a time."
        )
    equal = [set(group) for group, _ in together]
    in_proportion = _groups(motions, moving, _deviation_to_noise, _IN_PROPORTION)
    in_proportion = [
        (group, ratio)
        for group, ratio in in_proportion
        if not any(set(group) <= members for members in equal)
    ]
    for group, ratio in in_proportion:
        remarks.append(
            f"{_enumerate(group)} moved in proportion, as in one mode, with deviations {_level(ratio)}: other links may "
            "explain such motions as well. Excite more than one mode."
        )
    collinear = dict.fromkeys(name for group, _ in (*together, *in_proportion) for name in group)
    proportional = dict.fromkeys(name for group, _ in in_proportion for name in group)
    return DataChecks(tuple(remarks), tuple(at_rest), tuple(collinear), tuple(proportional))


def _check_hosted(records: Sequence[Record], candidates: Candidates) -> DataChecks:
    """What records cannot show of candidates between points of hosts; which of them are alike, the fit says."""
    measured = [name for name in candidates.places if any(record.motions_of(name) for record in records)]
    if not measured:
        raise IdentificationError(
            f"no channel measures the motion of a mass or point, which are {_enumerate(candidates.places)}; add a channel "
            f"a:{candidates.places[0]}",
            arguments=("channels",),
        )
    ratios = [
        _signal_to_noise(record, [name for name in measured if record.motions_of(name)]) for record in records
    ]
    if all(ratio < _AT_REST for record_ratios in ratios for ratio in record_ratios):
        raise IdentificationError(_NO_MOTION)
    remarks = []
    missed = [name for name in candidates.places if name not in measured]
    if missed:
        remarks.append(
            f"No channel measures the motion of {_enumerate(missed)}: it follows from the modes and the other channels, and "
            "links there are determined less well."
        )
    return DataChecks(tuple(remarks), (), (), ())


def _level(ratio: float) -> str:
    return f"down to {10.0 * np.log10(ratio):.0f} dB above the noise" if ratio > 1.0 else "below the noise"


def inactive_terms(
    motions: Sequence[MeasuredDisplacements], rates: Sequence[float], candidates: Candidates
) -> tuple[str, ...]:
    """The names of candidates that were zero throughout `motions`, sampled at `rates` in Hz, but for a few samples.

    A stop that no motion reached is such a term; no record of these determines it.
    """
    names = (*(mass.name for mass in candidates.masses), BASE, GROUND)
    row = {name: number for number, name in enumerate(names)}
    inactive = []
    for entry in candidates.entries:
        if not entry.term.law.kinks:  # a smooth term is zero at isolated points only
            continue
        first, second = (row[end] for end in candidates.pairs[entry.pair].between)
        active = 0
        for motion, rate in zip(motions, rates, strict=True):
            d = motion.displacements[first] - motion.displacements[second]
            present = np.ones(len(d), dtype=bool)
            if motion.missing is not None:
                for end in {first, second} & set(range(len(motion.missing))):
                    present &= ~motion.missing[end]
            force = entry.term.law.force(d, np.gradient(d) * rate, {})
            active += int(np.count_nonzero(np.broadcast_to(force, d.shape)[present]))
        if active < _LEAST_ACTIVE:
            inactive.append(entry.name)
    return tuple(inactive)


def inactive_remark(names: Sequence[str]) -> tuple[str, ...]:
    """A sentence on the candidates `names` that were inactive, if there are any."""
    if not names:
        return ()
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return (
        f"{', '.join(names[:_NAMED])}{more} were never active in this record and are left out; record a motion that "
        "reaches them.",
    )


def _require_sensors(records: Sequence[Record], names: Sequence[str]) -> None:
    for record in records:
        unseen = [name for name in names if not record.motions_of(name)]
        if unseen:
            raise IdentificationError(
                f"no channel measures the motion of {_enumerate(unseen)}, and links to a mass that is not measured cannot be "
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
    if samples < _ENOUGH_SAMPLES * needed:
        return [
            f"{samples} samples for {needed} candidates are few: weak terms will be missed; record for longer."
        ]
    return []


def _signal_to_noise(record: Record, names: Sequence[str]) -> list[float]:
    """The power of the motion of each mass over that of the noise, in its best channel."""
    noise = channel_noise(record)
    best = []
    for name in names:
        channels = record.motions_of(name)
        ratios = [
            _power(record.channel(channel)) / noise[channel] ** 2 - 1.0 if noise[channel] > 0.0 else 0.0
            for channel in channels
        ]
        best.append(max(ratios, default=0.0))
    return best


class _Displacement(NamedTuple):
    """The samples (N,) of a displacement in m, their power in m2, and the deviation of the noise in m."""

    samples: Floats
    power: float
    noise: float


def _displacements(record: Record, names: Sequence[str]) -> dict[str, _Displacement]:
    """The displacements of those of the masses `names` that have a channel of it."""
    noise = channel_noise(record)
    measured = [(name, f"x:{name}") for name in names if f"x:{name}" in record.channels]
    return {
        name: _Displacement(samples := record.channel(channel), _power(samples), noise[channel])
        for name, channel in measured
    }


def _groups(
    motions: Sequence[Mapping[str, _Displacement]],
    names: Sequence[str],
    ratio: Callable[[_Displacement, _Displacement], float],
    separate: float,
) -> list[tuple[list[str], float]]:
    """Groups of masses whose displacements differ by little more than noise in all records, by the `ratio` of two of them.

    A ratio of power to that of the noise from `separate` on distinguishes two masses. With each group the least of its ratios.
    """
    ratios = np.full((len(names), len(names)), np.inf)
    for row, first in enumerate(names):
        for column, second in enumerate(names[:row]):
            if all({first, second} <= motion.keys() for motion in motions):
                ratios[row, column] = max(ratio(motion[first], motion[second]) for motion in motions)
    count, label = connected_components(ratios < separate, directed=False)
    groups = [np.flatnonzero(label == number).tolist() for number in range(count)]
    return [
        ([names[member] for member in group], float(ratios[np.ix_(group, group)].min()))
        for group in groups
        if len(group) > 1
    ]


def _difference_to_noise(first: _Displacement, second: _Displacement) -> float:
    """The power of the difference of two motions over that of its noise; infinite if they clearly differ."""
    variance = first.noise**2 + second.noise**2
    difference = _power(first.samples - second.samples) - variance
    smaller = min(motion.power - motion.noise**2 for motion in (first, second))
    return float(difference / variance) if difference < _STIFF * smaller and variance > 0.0 else np.inf


def _deviation_to_noise(first: _Displacement, second: _Displacement) -> float:
    """The power by which a motion differs from the nearest multiple of the other, over that of its noise.

    The smaller one of both ways round; infinite if they clearly differ.
    """
    return min(_off_multiple(first, second), _off_multiple(second, first))


def _off_multiple(motion: _Displacement, reference: _Displacement) -> float:
    both = np.isfinite(motion.samples) & np.isfinite(reference.samples)
    x, y = motion.samples[both], reference.samples[both]
    x, y = x - x.mean(), y - y.mean()
    moved = float(np.mean(y**2)) - reference.noise**2
    power = float(np.mean(x**2)) - motion.noise**2
    if not (power > 0.0 and moved > 0.0):
        return np.inf
    product = float(np.mean(x * y))
    variance = motion.noise**2 + (product / moved * reference.noise) ** 2
    deviation = power - product**2 / moved
    return deviation / variance if deviation < _STIFF * power and variance > 0.0 else np.inf


def _power(values: Floats) -> float:
    return float(np.nanmean((values - np.nanmean(values)) ** 2))


def _enumerate(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _is(names: Sequence[str]) -> str:
    return "is" if len(names) == 1 else "are"


def _pronoun(names: Sequence[str]) -> str:
    return "it" if len(names) == 1 else "them"


def in_units(records: Sequence[Record], candidates: Candidates) -> list[Record]:
    """The records with the units of points that turn; RecordError for a channel that is stated in others."""
    if not candidates.hosts and not any(record.units for record in records):
        return [*records]
    structure = candidates.full_structure
    return [in_units_of(record, structure) for record in records]
